"""Checks of the motion, one concern a file."""
