"""Uncertainty of a plan's results.

In: a plan. Out: the effect of the uncertainty of the stiffness, of its model discrepancy,
of measured poses and of the springs of external joints on its numbers. This package does not change the plan.
"""
