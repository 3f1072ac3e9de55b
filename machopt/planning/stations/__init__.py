"""The toolpath as the planner walks it.

In: a toolpath and where the external joints stand. Out: :class:`~machopt.planning.stations.planning_path.PlanningPath`,
planning points,
stations and runs; parts of it; the rotation that the user fixed. Nothing here knows an arm.
"""
