"""Outputs of a diagnosis: its file, the extended stiffness and kinematics, and the effect on a toolpath."""
