"""Cost of a configuration and objective of a plan.

In: configurations, a compliance model, the process force along the path. Out: the index of each configuration,
and the objective J, which is defined only in :mod:`~machopt.planning.cost.objective`.
"""
