"""Kinematics of the whole URDF, independent of the planner."""
