"""Cutting loads recomputed for the verification, by numerical integration and without the planner's formulas."""
