"""Checks and measured values of a verification: name, result, value, limit and place.

A check has a readable name. Code that needs one check finds it by its :class:`CheckName`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from machopt.numerics.array_types import Array


class CheckName(StrEnum):
    """Names of the checks that code refers to; all other checks are only listed."""

    MANIFEST = "manifest.json"
    FILES = "files as listed"
    INPUTS = "made from these inputs"
    READABLE = "can be read"
    TABLES = "tables"
    PROGRAMS = "robot programs"
    PARQUET = "Parquet tables"
    OPTIONS = "options"
    READING = "reading options"
    CHANGES = "tool changes"
    TOUCHING = "pairs that touch by construction"
    CONTACTS = "collisions"  # check that reports that contacts and clearances were not checked
    VELOCITY = "joint velocity"
    ACCELERATION = "joint acceleration"
    JERK = "joint jerk"
    FEED = "feed"
    # of result.json
    VERDICT = "verdict"
    OUTPUTS = "outputs"
    VERIFICATION = "verification"
    # of a robot program
    MOVES = "moves read"
    COMPARED = "compared with motion and CAM file"
    CAM_POINTS = "CAM points"
    CAM_FEED = "CAM feed"
    ORIENTATIONS = "orientation at targets"
    JOINTS = "joints at targets"
    LINES = "lines along the motion"
    LINES_AXIS = "tool axis along lines"
    LINES_TURN = "orientation along lines"
    CONFIGURATION = "configuration"
    EVENTS = "events"


@dataclass(frozen=True, kw_only=True)
class VerificationCheck:
    """One check with its result."""

    name: str  # for readers; of a promise about one file, that one first
    passed: bool | None  # None: it could not be run, ``where`` says why
    value: float  # NaN where there was nothing to measure
    limit: float  # greatest allowed value, in ``unit``
    unit: str
    where: str  # sample, time and point of the worst value, words that go behind "at"; or why nothing was measured
    file: str = ""  # of the folder, where the promise is about one
    what: str = ""  # the promise about it
    because: str = ""  # another file of the folder, that could not be read for this
    beyond: str = ""  # the unit alone, where the value is a distance from a limit, positive on the wrong side
    instead: bool = False  # ``where`` says what was found and what follows: value and limit add nothing

    @property
    def check_name(self) -> str:
        """Name of the check without the file: equal to a :class:`CheckName` where it is one."""
        return self.what or self.name


@dataclass(frozen=True, kw_only=True)
class VerificationInformation:
    """Measured value without a condition: it cannot fail, so it is not counted as a check."""

    name: str
    value: float  # NaN where there was nothing to measure
    unit: str
    where: str
    file: str = ""  # of the folder, where the value is about one
    what: str = ""  # the name without the file

    @property
    def check_name(self) -> str:
        """Name without the file."""
        return self.what or self.name


VerificationRow = VerificationCheck | VerificationInformation


@dataclass(frozen=True)
class Verification:
    """All checks and measured values of one exported trajectory."""

    checks: tuple[VerificationCheck, ...]
    samples: int
    duration: float  # s
    information: tuple[VerificationInformation, ...] = ()

    @classmethod
    def from_rows(cls, rows: Sequence[VerificationRow], samples: int, duration: float) -> Verification:
        """Build a verification from checks and information in the order in which they were found.

        Args:
            rows: Checks and measured values.
            samples: Number of motion samples.
            duration: Duration of the motion, s.
        """
        checks = tuple(row for row in rows if isinstance(row, VerificationCheck))
        return cls(checks, samples, duration, tuple(row for row in rows if isinstance(row, VerificationInformation)))

    @property
    def ok(self) -> bool:
        return all(check.passed is not False for check in self.checks)

    @property
    def failed(self) -> tuple[VerificationCheck, ...]:
        return tuple(check for check in self.checks if check.passed is False)


def build_worst_value_check(
    name: str, unit: str, values: Array, limit: float, where: Sequence[str] | Callable[[int], str]
) -> VerificationCheck:
    """Return a check of the greatest value against a limit; NaN is the worst value, and no values fail.

    Args:
        name: Name of the check.
        unit: Unit of the value.
        values: (n,) values, in ``unit``.
        limit: The greatest allowed value.
        where: Place of entry n: one text each, or a function of n.
    """
    if not len(values):
        return VerificationCheck(
            name=name, passed=False, value=np.nan, limit=limit, unit=unit, where="nothing to measure"
        )
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    stated = where(n) if callable(where) else where[n]
    return VerificationCheck(
        name=name, passed=bool(values[n] <= limit), value=float(values[n]), limit=limit, unit=unit, where=stated
    )


def build_file_check(
    file: str, what: str, passed: bool | None, value: float, limit: float, unit: str, where: str, *, of: str = ": "
) -> VerificationCheck:
    """Return a check of one file of the folder.

    Args:
        file: Name of the file in the folder.
        what: Checked quantity; the name of the check is ``file + of + what``.
        passed: Result; None where it was not checked.
        value: Greatest value found, in ``unit``.
        limit: Greatest allowed value, in ``unit``.
        unit: Unit of the value.
        where: Place of the greatest value.
        of: Text between file and quantity in the name.
    """
    return VerificationCheck(
        name=f"{file}{of}{what}", passed=passed, value=value, limit=limit, unit=unit, where=where, file=file, what=what
    )


def build_skipped_check(name: str, why: str, unit: str = "") -> VerificationCheck:
    """Return a check that could not be made.

    Args:
        name: Name of the check.
        why: Reason why it was not made.
        unit: Unit of the quantity.
    """
    return VerificationCheck(name=name, passed=None, value=np.nan, limit=np.nan, unit=unit, where=why)


def build_count_check(name: str, wrong: Sequence[str] | list[str], unit: str = "rows") -> VerificationCheck:
    """Return a check that passes if no place is wrong.

    Args:
        name: Name of the check.
        wrong: Wrong places; the first one is named.
        unit: What is counted.
    """
    more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    return VerificationCheck(
        name=name,
        passed=not wrong,
        value=float(len(wrong)),
        limit=0.0,
        unit=unit,
        where=f"{wrong[0]}{more}" if wrong else "none",
    )
