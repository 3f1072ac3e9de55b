"""What ``machopt init`` has to say of a cell that it wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from machopt.domain.cell import Cell
from machopt.domain.results.cells import InitResult


@dataclass(frozen=True)
class InitOutcome:
    """What came out."""

    cell: Cell
    folder: Path
    guesses: tuple[str, ...]  # what the user should put in or look at, one sentence each
    notes: tuple[str, ...] = ()  # what was changed of the robot's files

    @property
    def result(self) -> InitResult:
        """As ``--json`` prints it."""
        return InitResult(
            cell=str(self.folder),
            joints=self.cell.arm_joints,
            flange_link=self.cell.flange_link,
            guesses=self.guesses,
            warnings=(*self.notes, *self.cell.warnings),
        )
