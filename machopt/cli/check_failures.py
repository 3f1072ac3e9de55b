"""Order and format of failed checks: causes first."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.verification import VerificationCheck
from machopt.verification.check_results import CheckName
from machopt.verification.folder.result_json.result_checks import RESULT_FILE

_FOLLOWS = (CheckName.VERDICT, CheckName.OUTPUTS, CheckName.VERIFICATION)  # of result.json: tell of the other checks
_FROM_PLACE = (
    CheckName.VELOCITY,
    CheckName.ACCELERATION,
    CheckName.JERK,
    CheckName.FEED,
)  # a sample out of place breaks these
_OF_FOLDER = {CheckName.FILES, CheckName.INPUTS, CheckName.MANIFEST, CheckName.PROGRAMS, CheckName.TABLES}
_OF_FOLDER |= {CheckName.PARQUET, CheckName.OPTIONS, CheckName.READING}
_MOTION = "trajectory.csv"
_CONSEQUENCE = 6  # rank of what follows from other failures
MOST = 6  # failures that are listed in full


def sort_causes_first(checks: Sequence[VerificationCheck]) -> list[VerificationCheck]:
    """Return failed checks before all others, causes before consequences.

    Args:
        checks: The checks.
    """
    failed = {id(c): _rank_check(c, checks) for c in checks if c.passed is False}
    return sorted(checks, key=lambda c: failed.get(id(c), 99))  # stable: else in the order they were made


def format_failures(checks: Sequence[VerificationCheck]) -> str:
    """Return the first cause on the first line, other failures below it, consequences by name.

    Args:
        checks: The checks.
    """
    failed = [c for c in sort_causes_first(checks) if c.passed is False]
    causes = [c for c in failed if _rank_check(c, checks) < _CONSEQUENCE]
    follow = [c.name for c in failed if c not in causes]
    first, *others = causes or failed
    message = format_failed_check(first)
    if first.check_name == CheckName.FILES and first.file:  # what changed in it belongs on the same line
        inside = next((c for c in others if _find_checked_file(c) == first.file), None)
        if inside is not None:
            others.remove(inside)
            message = f"{message}; {format_failed_check(inside)}"
    lines = [message, *(f"  also {format_failed_check(c)}" for c in others[: MOST - 1])]
    if len(others) >= MOST:
        lines.append(f"  and {len(others) - MOST + 1} more checks")
    if follow and causes:
        lines.append(f"  because of that also: {', '.join(follow[:MOST])}{' …' if len(follow) > MOST else ''}")
    return "\n".join(lines)


def format_failed_check(c: VerificationCheck) -> str:
    """Return file, quantity, value and place of a failed check.

    Args:
        c: The check.
    """
    if c.check_name == CheckName.FILES:
        return c.where
    if c.check_name == CheckName.INPUTS:
        return f"OUT was not made from these inputs: {c.where}"
    name = c.name if c.file or not _find_checked_file(c) else f"{_MOTION}, {c.name}"
    name = c.file if c.check_name == CheckName.READABLE else name
    if math.isnan(c.value) and math.isfinite(c.limit) and " " not in c.unit and c.limit:
        return f"{name}: no value where one belongs (or one where none does), {c.where}"
    counts = math.isnan(c.value) or c.limit == 0.0 or math.isnan(c.limit)  # so many places are wrong, the first named
    if counts or c.instead:
        return f"{name}: {c.where}"
    return f"{name}: {c.value:.4g} {c.unit}, the limit is {c.limit:.4g}" + (f", at {c.where}" if c.where else "")


def _find_checked_file(c: VerificationCheck) -> str:
    """The file that a check is about: trajectory.csv where none is named; empty where it is about the whole folder."""
    return c.file or ("" if c.check_name in _OF_FOLDER else _MOTION)


def _rank_check(c: VerificationCheck, checks: Sequence[VerificationCheck]) -> int:
    if c.check_name in (CheckName.INPUTS, CheckName.MANIFEST):
        return 0
    if c.check_name == CheckName.FILES:
        return 1
    if c.check_name == CheckName.READABLE:
        return 2
    unread = {o.file for o in checks if o.passed is False and o.check_name == CheckName.READABLE}
    of_result = c.file == RESULT_FILE
    if (of_result and (unread or c.check_name in _FOLLOWS)) or c.because in unread:
        return _CONSEQUENCE
    if of_result:
        return 5
    return 4 if c.check_name in _FROM_PLACE else 3
