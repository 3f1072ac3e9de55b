"""Models of cutting processes: forces of milling and drilling, materials, stability of milling."""
