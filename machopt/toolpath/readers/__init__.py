"""Readers of CAM exports: APT/CL, G-code, Sinumerik, Heidenhain, Mastercam NCI."""
