"""Check of a robot program whose text lists the first differences."""

from __future__ import annotations

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.verification.check_results import VerificationCheck, build_file_check

MAX_NAMED = 3


def build_list_check(program: ProgramInCell, what: str, wrong: list[str], unit: str) -> VerificationCheck:
    """Build the check of a list of differences, the first of which are named.

    Args:
        program: the program.
        what: name of the check.
        wrong: the differences.
        unit: what is counted.
    """
    return build_file_check(
        program.file, what, not wrong, float(len(wrong)), 0.0, unit, "; ".join(wrong[:MAX_NAMED]) or "all"
    )
