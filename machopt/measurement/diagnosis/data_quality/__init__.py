"""The record before the robot: what is wrong with a resting record, mended and said like any other finding."""
