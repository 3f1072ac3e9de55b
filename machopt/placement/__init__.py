"""Placement of the workpiece, or the robot, that minimises the worst index of all jobs.

::

    request (ranges) ─► shifts ─► moved cell: part, fixtures or base shifted
                                    ├► support check: does it collide with fixed bodies?
                                    └► estimate: reach, limits, margins; a bound; the best sequence of the grid
                                         │ best first, by the estimate
                                         └► search: whole plans, until no remaining place can be better
                                               └► between the places around the best; effect of ± 20 mm

The bound of a place (:mod:`machopt.placement.placement_estimate`) leaves out collisions and continuity, so no plan
there has a worst index below it. A place whose bound is above the best plan need not be planned. The search therefore
ends with a proof over the given places, or, at its time limit, with the possible improvement of the remaining places.
"""
