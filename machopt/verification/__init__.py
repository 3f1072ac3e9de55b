"""Re-check of an exported trajectory with code that shares nothing with the planner.

Only the data types are common. The tables are read again, kinematics are pinocchio's of the whole URDF, coal finds
the contacts, and every column is recomputed by separate laws. An error in the planner's model, its exporter or its
unit conversions is detected here. :mod:`machopt.verification.motion.tool_changes` checks a whole folder,
:mod:`machopt.verification.motion.motion_verification` the motion of one tool. Other packages need the names of checks
without a verification, so neither is imported here.
"""

from machopt.verification.check_results import Verification, VerificationCheck, VerificationInformation

__all__ = ["Verification", "VerificationCheck", "VerificationInformation"]
