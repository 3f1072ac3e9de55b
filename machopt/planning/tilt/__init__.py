"""Lead and side of a ball cutter, chosen together with the rotation about the tool axis.

::

    plan with the CAM axes ─► joint search (rotation × branch × tilt, coarse) ─► smooth tilt curve ─► tilted path
                                                                                                          │
               the better of both ◄── plan of the tilted path (all steps of the pipeline, baselines reused) ◄┘

* ``tilt_limits``: permitted tilts at each planning point, for the moves before and after it.
* ``tilt_grid``: configurations and costs over a grid of tilts, and the lower bound of the mean index over it.
* ``tilt_and_rotation_search``: sequence of rotation, branch and tilt by dynamic programming.
* ``tilt_smoothing``: smooth tilts along each run at a given rotation.
* ``tilt_planning``: the steps in order.

A tilted path (:mod:`machopt.planning.stations.tilt_curve`) is a path like any other. Loads keep the axes of the CAM
file: the ball turns about its centre, and neither the surface nor the cut on it changes.
"""
