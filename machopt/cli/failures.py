"""Failed checks in the order in which somebody looks for a fault: what is behind the others first, in plain words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.recheck.resultcheck import RESULT
from machopt.verify import Check
from machopt.verify.check import Promise

_FOLLOWS = (Promise.VERDICT, Promise.OUTPUTS, Promise.VERIFICATION)  # of result.json: tell of the other checks
_FROM_PLACE = (Promise.VELOCITY, Promise.ACCELERATION, Promise.JERK, Promise.FEED)  # a sample out of place breaks these
_OF_FOLDER = {Promise.FILES, Promise.INPUTS, Promise.MANIFEST, Promise.PROGRAMS, Promise.TABLES}
_OF_FOLDER |= {Promise.PARQUET, Promise.OPTIONS, Promise.READING}
_MOTION = "trajectory.csv"
_CONSEQUENCE = 6  # rank of what follows from other failures
MOST = 6  # failures that are told in full


def causes_first(checks: Sequence[Check]) -> list[Check]:
    """Failed checks before all others, causes before what follows from them."""
    failed = {id(c): _rank(c, checks) for c in checks if c.passed is False}
    return sorted(checks, key=lambda c: failed.get(id(c), 99))  # stable: else in the order they were made


def failures(checks: Sequence[Check]) -> str:
    """The first cause on the first line; the other failures below it, those that follow from them by name."""
    failed = [c for c in causes_first(checks) if c.passed is False]
    causes = [c for c in failed if _rank(c, checks) < _CONSEQUENCE]
    follow = [c.name for c in failed if c not in causes]
    first, *others = causes or failed
    told = sentence(first)
    if first.promise == Promise.FILES and first.file:  # what changed in it belongs on the same line
        inside = next((c for c in others if _file(c) == first.file), None)
        if inside is not None:
            others.remove(inside)
            told = f"{told}; {sentence(inside)}"
    lines = [told, *(f"  also {sentence(c)}" for c in others[: MOST - 1])]
    if len(others) >= MOST:
        lines.append(f"  and {len(others) - MOST + 1} more checks")
    if follow and causes:
        lines.append(f"  because of that also: {', '.join(follow[:MOST])}{' …' if len(follow) > MOST else ''}")
    return "\n".join(lines)


def sentence(c: Check) -> str:
    """File, what, how much, place."""
    if c.promise == Promise.FILES:
        return c.where
    if c.promise == Promise.INPUTS:
        return f"OUT was not made from these inputs: {c.where}"
    name = c.name if c.file or not _file(c) else f"{_MOTION}, {c.name}"
    name = c.file if c.promise == Promise.READABLE else name
    if math.isnan(c.value) and math.isfinite(c.limit) and " " not in c.unit and c.limit:
        return f"{name}: no value where one belongs (or one where none does), {c.where}"
    counts = math.isnan(c.value) or c.limit == 0.0 or math.isnan(c.limit)  # so many places are wrong, the first named
    if counts or c.instead:
        return f"{name}: {c.where}"
    return f"{name}: {c.value:.4g} {c.unit}, the limit is {c.limit:.4g}" + (f", at {c.where}" if c.where else "")


def _file(c: Check) -> str:
    """The file that a check is about: trajectory.csv where none is named; empty where it is about the whole folder."""
    return c.file or ("" if c.promise in _OF_FOLDER else _MOTION)


def _rank(c: Check, checks: Sequence[Check]) -> int:
    if c.promise in (Promise.INPUTS, Promise.MANIFEST):
        return 0
    if c.promise == Promise.FILES:
        return 1
    if c.promise == Promise.READABLE:
        return 2
    unread = {o.file for o in checks if o.passed is False and o.promise == Promise.READABLE}
    of_result = c.file == RESULT
    if (of_result and (unread or c.promise in _FOLLOWS)) or c.because in unread:
        return _CONSEQUENCE
    if of_result:
        return 5
    return 4 if c.promise in _FROM_PLACE else 3
