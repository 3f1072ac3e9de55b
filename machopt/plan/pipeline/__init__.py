"""A path planned from its first step to its last, the external joints standing where they are told to.

In: a cell, a toolpath, options, where the external joints stand. Out: :class:`~machopt.plan.pipeline.planned.Plan` with
the result of every step (:func:`~machopt.plan.pipeline.run.plan`), where it breaks off and which stretches are driven.
"""
