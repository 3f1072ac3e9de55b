"""Planning points, stations and runs of a toolpath.

In: a toolpath and the external joints. Out: :class:`~machopt.planning.stations.planning_path.PlanningPath` with
planning points, stations and runs; parts of it; the user's fixed rotations. This package does not depend on an arm.
"""
