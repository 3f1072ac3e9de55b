"""What a verification says: one row a promise, kept, broken or not looked at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array


@dataclass(frozen=True)
class Check:
    """One promise and whether it is kept."""

    name: str
    passed: bool | None  # None: it could not be run, ``where`` says why
    value: float  # NaN where there was nothing to measure
    limit: float
    unit: str
    where: str  # sample, time and point of the worst value, or why nothing was measured


@dataclass(frozen=True)
class Verification:
    """All checks of one exported trajectory."""

    checks: tuple[Check, ...]
    samples: int
    duration: float  # s

    @property
    def ok(self) -> bool:
        return all(check.passed is not False for check in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.passed is False)


def worst(name: str, unit: str, values: Array, limit: float, where: Sequence[str] | Callable[[int], str]) -> Check:
    """The greatest of ``values`` against a limit; NaN is the greatest of all, none at all a failure.

    Args:
        where: what is said of entry n: a text each, or what makes it.
    """
    if not len(values):
        return Check(name, False, np.nan, limit, unit, "nothing to measure")
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    told = where(n) if callable(where) else where[n]
    return Check(name, bool(values[n] <= limit), float(values[n]), limit, unit, told)


def not_run(name: str, why: str, unit: str = "") -> Check:
    """A check that was not made, and why."""
    return Check(name, None, np.nan, np.nan, unit, why)


def counted(name: str, wrong: Sequence[str] | list[str], unit: str = "rows") -> Check:
    """So many places are wrong, the first of them named; none is the promise."""
    more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
    return Check(name, not wrong, float(len(wrong)), 0.0, unit, f"{wrong[0]}{more}" if wrong else "none")
