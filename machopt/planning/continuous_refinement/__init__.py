"""Continuous refinement of rotation and external joints together, after both are chosen.

In: a plan. Out: a better one or the same
(:func:`~machopt.planning.continuous_refinement.plan_improvement.refine_plan`). Offsets that minimise J of a
quadratic model at some stations are tried on the whole path.
"""
