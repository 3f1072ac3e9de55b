"""The whole motion in time, from home to home.

In: a plan without infeasible points. Out: :class:`~machopt.planning.motion.trajectory_builder.MotionTimeline`, with
runs at the feed (:mod:`machopt.planning.retiming`), and collision-checked lifts and rapid moves between them.
Rapid moves are planned one by one (:mod:`machopt.planning.motion.rapid_moves`), detours shortened
(:mod:`machopt.planning.motion.rapid_shortcuts`); when all are known, the corners between them are rounded
(:mod:`machopt.planning.motion.rapid_corners`).
"""
