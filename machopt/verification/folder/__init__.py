"""Verification of an output folder against its inputs: programs, tables and documents are read back."""
