"""Candidate configurations of the arm at each station.

In: a path and an arm. Out: every branch, turn and rotation with the reason where it cannot be used
(:mod:`~machopt.planning.sampling.candidate_enumeration`), and joints at every planning point along a given rotation
(:mod:`~machopt.planning.sampling.joint_path`).
"""
