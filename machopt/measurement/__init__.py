"""Measurements on a real robot: recordings, design, identification and diagnosis."""
