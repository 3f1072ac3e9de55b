"""G-code of Fanuc, Haas, LinuxCNC and Sinumerik; the control that the other dialects build on."""
