"""Where to put the workpiece, or the robot, so that the worst index of all jobs is best.

::

    asked (ranges) ─► shifts ─► moved: the cell with part, fixtures or base shifted
                                  ├► standing: would it stand in something?
                                  └► outlook: reach, limits, margins; a bound; what the grid comes to
                                       │ best first, by the outlook
                                       └► search: whole plans, until none left can be better
                                             └► between the places around the best; what ± 20 mm make of them

The bound of a place (:mod:`machopt.placement.placement_estimate`) leaves out collisions and continuity, so no plan
there has a
worst index below it: a place whose bound is above the best plan found need not be planned. The search so ends with a
proof over the places it was given, or, where its time is over, with how much a place it left could still be better.
"""
