"""Smooth rotation curve between and beyond the grid steps.

In: a choice, and the corridor that the grid leaves around it. Out: the rotation at every planning point that minimises
J near that choice (:func:`~machopt.planning.smoothing.rotation_smoothing.follow_grid_rotation`).
"""
