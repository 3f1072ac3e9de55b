"""Collisions at planning points and between them.

In: joints along a path and collision bodies. Out: the contacts
(:mod:`~machopt.planning.collision_handling.path_check`), the vertices and edges of the search grid
that are excluded because of them, and the places where the CAM path itself cuts into the part.
"""
