"""Stiffness and deflection, computed independently of the planner."""
