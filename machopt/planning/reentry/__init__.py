"""Re-entry in closed contours: the tool is lifted inside of a cut and enters again at the same point.

Along a closed contour the rotation of the tool has to follow the path, or the arm has to wind up. With one lift the cut
becomes two, and each of them has its own posture. A lift leaves a mark, so it is made only where the user permits it
(``max_reentries``).

::

    plan ─► closed_contours ─► reentry_planning ─► plan with its places
            (points at which   (places over all contours, then ever nearer to the best one;
             a lift may be)     each planned in full; kept where J falls by LEAST_GAIN)

The planning path has the point of a re-entry twice (:mod:`machopt.planning.stations.planning_path`): a run ends there
and the next one begins. Search, contact checks and retiming then treat the lift like any rapid move, and its time has
the price of one.
"""
