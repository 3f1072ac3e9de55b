"""Re-checks an exported trajectory with code that shares nothing with the planner.

Only the domain nouns are common: the tables are read anew, kinematics are pinocchio's of the whole URDF, contacts
are found by coal, every column is recomputed by laws of its own. An error in the planner's model, its exporter or its
unit conversions shows here. :mod:`machopt.verification.motion.tool_changes` checks a whole folder,
:mod:`machopt.verification.motion.motion_verification` what one
tool did; words of a check are wanted where nothing is checked yet, so neither is imported here.
"""

from machopt.verification.checks import Verification, VerificationCheck, VerificationInformation

__all__ = ["Verification", "VerificationCheck", "VerificationInformation"]
