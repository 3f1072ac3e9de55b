"""Re-checks an exported trajectory with code that shares nothing with the planner.

Only the domain nouns are common: the tables are read anew, kinematics are pinocchio's of the whole URDF, contacts
are found by coal, every column is recomputed by laws of its own. An error in the planner's model, its exporter or its
unit conversions shows here.
"""

from machopt.verify.changes import verify_stints
from machopt.verify.check import Check, Verification
from machopt.verify.output import verify_output

__all__ = ["Check", "Verification", "verify_output", "verify_stints"]
