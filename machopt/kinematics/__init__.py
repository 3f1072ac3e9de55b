"""Kinematics of the arm, the external joints and their corrections."""
