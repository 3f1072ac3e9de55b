"""What is said of a diagnosis as a whole: its sentence, whether enough was read, which springs of the cell are off."""
