"""Data types of each page, as plain data."""
