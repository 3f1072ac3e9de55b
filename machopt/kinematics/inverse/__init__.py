"""Inverse kinematics: closed forms, the general 6R solver, Newton refinement."""
