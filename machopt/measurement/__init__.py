"""Measurements on a real robot: recordings, experiment design, identification and diagnosis."""
