"""``machopt.plan_poses``: which poses and loads to measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from machopt.api.asked import NOWHERE, asked
from machopt.api.cell import Cell, cell_of
from machopt.api.saved import Named, Progress, effects_of, saved, silent
from machopt.api.table import Table
from machopt.design.asked import PosesRequest
from machopt.domain.results.poses import PosesResult
from machopt.formats.poses import poses_columns
from machopt.services.poses import write
from machopt.services.poses_planned import Planned, planned


@dataclass(frozen=True)
class PosePlan:
    """Load tests that make the stiffness known. :func:`plan_poses` makes one."""

    cell: Cell
    _made: Planned

    @property
    def result(self) -> PosesResult:
        """plan.json, typed."""
        return self._made.result

    @property
    def feasible(self) -> bool:
        """At least one load test can be measured (exit code 0 of the command)."""
        return self._made.exit_code == 0

    @property
    def verdict(self) -> str:
        """One sentence, with what was not checked."""
        return self._made.message

    @property
    def poses(self) -> Table | None:
        """The columns of ``poses.csv``, one row a load test in order of work; None where there is none."""
        return None if self._made.table is None else Table(poses_columns(self._made.table))

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    def save(self, out: Named, *, force: bool = False) -> PosesResult:
        """Write what ``machopt plan-poses`` writes; returns plan.json, typed.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        saved(self.cell, out, lambda folder: write(self._made, folder), force=force)
        return self.result

    def __repr__(self) -> str:
        return f"<PosePlan for {self.cell.name!r}: {self.verdict}>"


def plan_poses(cell: Cell | Named, *, progress: Progress = silent, **options: Any) -> PosePlan:
    """Measurement poses and loads for identification, or to tell rival explanations apart: ``machopt plan-poses``.

    Args:
        cell: a cell, or the path of its folder.
        progress: told what is being done.
        options: as :class:`machopt.design.asked.PosesRequest` has them, e.g. ``poses=12``, ``weights_kg=[50]``.

    Raises:
        InputError: bad cell or option.
    """
    a_cell = cell_of(cell)
    request = asked(
        PosesRequest,
        options,
        cell=a_cell.path,
        out=NOWHERE,
        allow_external=a_cell.allow_external,
        effects=tuple(own.file for own in a_cell.effects),
    )
    with effects_of(a_cell):
        return PosePlan(a_cell, planned(request, progress, a_cell.description))
