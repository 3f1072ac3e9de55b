"""Channels of an arm at rest: load tests, measured poses, inclinometers."""
