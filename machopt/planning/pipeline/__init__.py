"""Planning of a path from its first step to its last, with given external joints.

In: a cell, a toolpath, options, positions of the external joints. Out:
:class:`~machopt.planning.pipeline.plan_data_types.Plan` with the result of every step
(:func:`~machopt.planning.pipeline.path_planner.plan_path`), its breaks, and the driven stretches.
"""
