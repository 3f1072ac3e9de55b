"""The whole motion in time, from home to home.

In: a plan whose points are free. Out: :class:`~machopt.plan.motion.timeline.Timeline`, runs at the feed
(:mod:`machopt.plan.feed`) and between them lifts and rapid moves that are looked at for contacts.
"""
