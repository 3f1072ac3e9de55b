"""What touches, at planning points and on the way between them.

In: joints along a path and collision bodies. Out: where it touches (:mod:`~machopt.plan.contacts.check`), vertices and
ways of the grid that are struck out for it, and where the file itself cuts into the part.
"""
