"""The best plan where external joints are free, and how good it is at least.

In: a setup, a path, values that look good (:mod:`machopt.planning.external_axes`). Out: the best of the plans in full,
refined
(:func:`~machopt.planning.external_axis_optimization.best_plan.find_best_plan`), and what no sequence undercuts that
chooses the external joints too.
"""
