"""Rigid-body dynamics and gravity torques of the arm."""
