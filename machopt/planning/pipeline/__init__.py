"""A path planned from its first step to its last, the external joints standing where they are told to.

In: a cell, a toolpath, options, where the external joints stand. Out: :class:`~machopt.planning.pipeline.plan.Plan`
with
the result of every step (:func:`~machopt.planning.pipeline.path_planner.plan_path`), where it breaks off and which
stretches are driven.
"""
