"""``machopt.plan_poses``: which poses and loads to measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Unpack

from machopt.api.cell import Cell, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import PlanPosesOptions
from machopt.api.request_options import NOWHERE, build_request
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result, use_cell_effects
from machopt.api.table import Table
from machopt.commands.plan_poses.computation import PlanPosesComputation, compute_pose_plan
from machopt.commands.plan_poses.run import write_pose_plan_files
from machopt.data_types.documents.pose_plan_document import PosesDocument
from machopt.measurement.design.request import PosesRequest
from machopt.output.tables.measurement_poses_table import list_poses_columns


@dataclass(frozen=True)
class PosePlan:
    """Load tests to identify the stiffness. :func:`plan_poses` makes one."""

    cell: Cell
    _made: PlanPosesComputation

    @property
    def result(self) -> PosesDocument:
        """plan.json, typed."""
        return self._made.result

    @property
    def feasible(self) -> bool:
        """Whether at least one load test can be measured (exit code 0 of the command)."""
        return self._made.exit_code == 0

    @property
    def verdict(self) -> str:
        """One sentence, with what was not checked."""
        return self._made.message

    @property
    def poses(self) -> Table | None:
        """Columns of ``poses.csv``, one row for each load test in order of work; None without any."""
        return None if self._made.table is None else Table(list_poses_columns(self._made.table))

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> PosesDocument:
        """Write what ``machopt plan-poses`` writes; returns plan.json, typed.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        save_result(self.cell, out, lambda folder: write_pose_plan_files(self._made, folder), force=force)
        return self.result

    def __repr__(self) -> str:
        return f"<PosePlan for {self.cell.name!r}: {self.verdict}>"


@use_argument_names()
def plan_poses(
    cell: Cell | Named, *, progress: Progress = ignore_progress, **options: Unpack[PlanPosesOptions]
) -> PosePlan:
    """Measurement poses and loads for identification, or to tell rival explanations apart: ``machopt plan-poses``.

    Args:
        cell: a cell, or the path of its folder.
        progress: called with each stage, in words.
        options: as :class:`machopt.measurement.design.request.PosesRequest` has them, e.g. ``poses=12``,
            ``weights_kg=[50]``.

    Raises:
        InputError: bad cell or option.
    """
    a_cell = load_cell_argument(cell)
    request = build_request(
        PosesRequest,
        options,
        cell=a_cell.path,
        out=NOWHERE,
        allow_external=a_cell.allow_external,
        effects=tuple(own.file for own in a_cell.effects),
    )
    with use_cell_effects(a_cell):
        return PosePlan(a_cell, compute_pose_plan(request, progress, a_cell.description))
