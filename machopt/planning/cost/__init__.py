"""What a configuration costs, and what a plan does.

In: configurations, a model of what gives way, the process force along the path. Out: the index of each configuration,
and J, the objective, which is written nowhere else (:mod:`~machopt.planning.cost.objective`).
"""
