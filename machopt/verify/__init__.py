"""Re-checks an exported trajectory with code that shares nothing with the planner.

Only the domain nouns are common: the tables are read anew, kinematics are pinocchio's of the whole URDF, contacts
are found by coal, every column is recomputed by laws of its own. An error in the planner's model, its exporter or its
unit conversions shows here. :mod:`machopt.verify.changes` checks a whole folder, :mod:`machopt.verify.output` what one
tool did; words of a check are wanted where nothing is checked yet, so neither is imported here.
"""

from machopt.verify.check import Check, Information, Verification

__all__ = ["Check", "Information", "Verification"]
