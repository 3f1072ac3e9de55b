"""Output of a plan as tables and messages.

In: a plan with its motion. Out: one row per point, causes and remedies of infeasible points, the collision map,
and the sections of result.json.
"""
