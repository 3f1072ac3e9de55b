"""Read a toolpath file of any supported format."""
