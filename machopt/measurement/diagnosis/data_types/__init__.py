"""Data types of a diagnosis: problem, readings, signals, result."""
