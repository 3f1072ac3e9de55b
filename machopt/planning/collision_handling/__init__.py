"""What touches, at planning points and on the way between them.

In: joints along a path and collision bodies. Out: where it touches
(:mod:`~machopt.planning.collision_handling.path_check`), vertices and
ways of the grid that are struck out for it, and where the file itself cuts into the part.
"""
