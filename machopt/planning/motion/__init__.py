"""The whole motion in time, from home to home.

In: a plan whose points are free. Out: :class:`~machopt.planning.motion.trajectory_builder.MotionTimeline`, runs at the
feed
(:mod:`machopt.planning.retiming`) and between them lifts and rapid moves that are looked at for contacts.
"""
