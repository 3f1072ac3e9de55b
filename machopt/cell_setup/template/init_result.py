"""Result of ``machopt init``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from machopt.data_types.cell import Cell
from machopt.data_types.documents.cell_documents import InitDocument


@dataclass(frozen=True)
class InitResult:
    """What came out."""

    cell: Cell
    folder: Path
    guesses: tuple[str, ...]  # what the user should put in or look at, one sentence each
    notes: tuple[str, ...] = ()  # what was changed of the robot's files

    @property
    def result(self) -> InitDocument:
        """As ``--json`` prints it."""
        return InitDocument(
            cell=str(self.folder),
            joints=self.cell.arm_joints,
            flange_link=self.cell.flange_link,
            guesses=self.guesses,
            warnings=(*self.notes, *self.cell.warnings),
        )
