"""Faults of a load-test recording: units, signs, impossible rows."""
