"""Verification result of one robot program of an output folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.data_types.documents.program_entries import ReadBackSection
from machopt.verification.check_results import CheckName, Verification, VerificationCheck, VerificationInformation


@dataclass(frozen=True)
class ListedProgram:
    """One program of an output folder, as the folder's manifest lists it."""

    label: str  # the post, as the user gave it
    post: str | Path | None  # to write it again; None: the template is not at hand
    files: tuple[str, ...]  # inside the folder, the one that is run first


@dataclass(frozen=True)
class ProgramComparison:
    """Verification result of one program."""

    program: ListedProgram
    moves: int
    checks: tuple[VerificationCheck, ...]
    readable: bool = True  # False: no reader here knows its language
    information: tuple[VerificationInformation, ...] = ()

    @classmethod
    def build(cls, posted: ListedProgram, verification: Verification | None) -> ProgramComparison:
        """Select what a verification of the whole folder found about one program.

        Args:
            posted: The program as the manifest lists it.
            verification: The verification; None where there is none.
        """
        mine = tuple(c for c in verification.checks if c.file == posted.files[0]) if verification else ()
        stated = tuple(i for i in verification.information if i.file == posted.files[0]) if verification else ()
        moves = next((i.value for i in stated if i.check_name == CheckName.MOVES), 0.0)
        return cls(posted, int(moves), mine, not any(c.check_name == CheckName.COMPARED for c in mine), stated)

    @property
    def differences(self) -> tuple[str, ...]:
        """Differences in words."""
        return tuple(
            f"{c.check_name}: {c.where}" + (f" ({c.value:.4g} {c.unit})" if np.isfinite(c.value) else "")
            for c in self.checks
            if c.passed is False
        )

    def get_value(self, promise: str) -> float:
        """Return the value of a check; NaN where it was not made.

        Args:
            promise: Name of the check, a :class:`CheckName`.
        """
        return next((c.value for c in self.checks if c.check_name == promise), float("nan"))

    def get_verdict(self, promise: str) -> bool | None:
        """Return whether a check passed; None where it was not made.

        Args:
            promise: Name of the check, a :class:`CheckName`.
        """
        return next((c.passed for c in self.checks if c.check_name == promise), None)

    def to_read_back(self) -> ReadBackSection | None:
        """Entry for result.json: mm, deg, mm/min; null where a post has no such value or no reader exists."""
        if not self.readable:
            return None
        return ReadBackSection(
            moves=self.moves,
            positions_max_mm=self.get_value(CheckName.CAM_POINTS),
            orientations_max_deg=self.get_value(CheckName.ORIENTATIONS),
            joints_max_deg=self.get_value(CheckName.JOINTS),
            feeds_max_mm_min=self.get_value(CheckName.CAM_FEED),
            path_max_mm=self.get_value(CheckName.LINES),
            path_axis_max_deg=self.get_value(CheckName.LINES_AXIS),
            path_turn_max_deg=self.get_value(CheckName.LINES_TURN),
            configuration_equal=self.get_verdict(CheckName.CONFIGURATION),
            events_equal=self.get_verdict(CheckName.EVENTS),
        )
