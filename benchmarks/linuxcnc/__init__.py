"""machopt's G-code reader compared with LinuxCNC's interpreter (`rs274` of the Debian package linuxcnc-uspace)."""
