"""How far a plan's numbers can be trusted.

In: a plan. Out: what no other sequence undercuts, and what the uncertainty of the stiffness, the misfit of its model,
measured poses and the springs of external joints make of its numbers. Nothing here changes the plan.
"""
