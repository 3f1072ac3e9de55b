"""The best plan where external joints are free, and how good it is at least.

In: a setup, a path, values that look good (:mod:`machopt.plan.external`). Out: the best of the plans in full, refined
(:func:`~machopt.plan.best.base.best_plan`), and what no sequence undercuts that chooses the external joints too.
"""
