"""One robot program of an output folder, and what came of comparing it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.domain.results.optimize import ReadBack
from machopt.verify.check import Check, Information, Promise, Verification


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
    information: tuple[Information, ...] = ()

    @classmethod
    def of(cls, posted: Posted, found: Verification | None) -> Compared:
        """From the verification of a whole folder what is about one program."""
        mine = tuple(c for c in found.checks if c.file == posted.files[0]) if found else ()
        stated = tuple(i for i in found.information if i.file == posted.files[0]) if found else ()
        moves = next((i.value for i in stated if i.promise == Promise.MOVES), 0.0)
        return cls(posted, int(moves), mine, not any(c.promise == Promise.COMPARED for c in mine), stated)

    @property
    def differences(self) -> tuple[str, ...]:
        """What is not as it should be, in words."""
        return tuple(
            f"{c.promise}: {c.where}" + (f" ({c.value:.4g} {c.unit})" if np.isfinite(c.value) else "")
            for c in self.checks
            if c.passed is False
        )

    def worst(self, promise: str) -> float:
        """The value of the check of a promise; NaN where it was not made."""
        return next((c.value for c in self.checks if c.promise == promise), float("nan"))

    def passed(self, promise: str) -> bool | None:
        """The same of its verdict; None where it was not made."""
        return next((c.passed for c in self.checks if c.promise == promise), None)

    def as_result(self) -> ReadBack | None:
        """For result.json: mm, deg, mm/min; null where a post has no such thing, or nobody reads it."""
        if not self.readable:
            return None
        return ReadBack(
            moves=self.moves,
            positions_max_mm=self.worst(Promise.CAM_POINTS),
            orientations_max_deg=self.worst(Promise.ORIENTATIONS),
            joints_max_deg=self.worst(Promise.JOINTS),
            feeds_max_mm_min=self.worst(Promise.CAM_FEED),
            path_max_mm=self.worst(Promise.LINES),
            path_axis_max_deg=self.worst(Promise.LINES_AXIS),
            path_turn_max_deg=self.worst(Promise.LINES_TURN),
            configuration_equal=self.passed(Promise.CONFIGURATION),
            events_equal=self.passed(Promise.EVENTS),
        )
