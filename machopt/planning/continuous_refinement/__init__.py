"""Rotation and external joints made better together, continuously, once both are chosen.

In: a plan. Out: a better one or the same
(:func:`~machopt.planning.continuous_refinement.plan_improvement.refine_plan`): offsets that make J of a
quadratic model least at some stations, tried on the whole path.
"""
