"""Re-checks an exported trajectory with code that shares nothing with the planner.

Only the domain nouns are common: the table is read anew, kinematics are pinocchio's of the whole URDF, contacts
are found by coal. An error in the planner's model, its exporter or its unit conversions shows here.
"""

from machopt.verify.output import Check, Verification, verify_output

__all__ = ["Check", "Verification", "verify_output"]
