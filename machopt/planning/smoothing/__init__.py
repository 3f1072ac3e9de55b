"""The rotation as a smooth curve, between and beyond the grid.

In: a choice, and the room that the grid leaves around it. Out: the rotation at every planning point that makes J least
near that choice (:func:`~machopt.planning.smoothing.rotation_smoothing.follow_grid_rotation`).
"""
