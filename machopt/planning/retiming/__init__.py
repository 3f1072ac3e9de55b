"""Retiming of a run: from rest to rest, as fast as the programmed feed and the axes allow.

In: points of a run, a robot, its limits. Out: samples of the joints within velocity, acceleration and jerk
(:func:`~machopt.planning.retiming.run_retiming.retime_run`), and the places where an axis reduced the feed. This
package does not depend on a plan.
"""
