"""One robot program of an output folder, and what came of comparing it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.domain.results.optimize import ReadBack
from machopt.verify.check import Check

MOVES, COMPARED = "moves read", "compared with motion and CAM file"


@dataclass(frozen=True)
class Posted:
    """One program of an output folder, as the folder's manifest lists it."""

    label: str  # the post, as the user gave it
    post: str | Path | None  # to write it again; None: the template is not at hand
    files: tuple[str, ...]  # inside the folder, the one that is run first


@dataclass(frozen=True)
class Compared:
    """What came of one program."""

    posted: Posted
    moves: int
    checks: tuple[Check, ...]
    readable: bool = True  # False: no reader here knows its language

    @classmethod
    def of(cls, posted: Posted, checks: Sequence[Check]) -> Compared:
        """From the checks of a whole folder those of one program."""
        mine = tuple(c for c in checks if c.name.startswith(f"{posted.files[0]}: "))
        moves = next((c.value for c in mine if c.name.endswith(f": {MOVES}")), 0.0)
        return cls(posted, int(moves), mine, not any(c.name.endswith(f": {COMPARED}") for c in mine))

    @property
    def differences(self) -> tuple[str, ...]:
        """What is not as it should be, in words."""
        return tuple(
            f"{c.name.partition(': ')[2]}: {c.where}" + (f" ({c.value:.4g} {c.unit})" if np.isfinite(c.value) else "")
            for c in self.checks
            if c.passed is False
        )

    def worst(self, what: str) -> float:
        """The value of a check by its name behind the file's; NaN where it was not made."""
        return next((c.value for c in self.checks if c.name.partition(": ")[2] == what), float("nan"))

    def passed(self, what: str) -> bool | None:
        """The same of its verdict; None where it was not made."""
        return next((c.passed for c in self.checks if c.name.partition(": ")[2] == what), None)

    def as_result(self) -> ReadBack | None:
        """For result.json: mm, deg, mm/min; null where a post has no such thing, or nobody reads it."""
        if not self.readable:
            return None
        return ReadBack(
            moves=self.moves,
            positions_max_mm=self.worst("CAM points"),
            orientations_max_deg=self.worst("orientation at targets"),
            joints_max_deg=self.worst("joints at targets"),
            feeds_max_mm_min=self.worst("CAM feed"),
            path_max_mm=self.worst("lines along the motion"),
            path_axis_max_deg=self.worst("tool axis along lines"),
            path_turn_max_deg=self.worst("orientation along lines"),
            configuration_equal=self.passed("configuration"),
            events_equal=self.passed("events"),
        )
