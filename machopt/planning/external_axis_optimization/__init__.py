"""Optimisation of the external joints, with a lower bound of the objective.

In: a setup, a path, promising values (:mod:`machopt.planning.external_axes`). Out: the best of the full plans, refined
(:func:`~machopt.planning.external_axis_optimization.single_toolpath_planning.find_best_plan`), and a lower bound over
all sequences that include the external joints.
"""
