"""Robot programs of an output folder, read back and compared."""
