"""``machopt.optimize``: the main job, with its answer in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, Unpack

import numpy as np

from machopt.api.cell import Cell, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.figure import Figure
from machopt.api.option_types import PlanOptionValues
from machopt.api.request_options import NOWHERE, check_value_type, convert_to_path, convert_to_texts
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result, use_cell_effects
from machopt.api.table import Table
from machopt.api.toolpath import Toolpath, read_toolpath_argument
from machopt.commands.optimize.computation import OptimizeComputation, compute_optimize_plan
from machopt.commands.optimize.document import build_objectives_section
from machopt.commands.optimize.report_files import list_tool_names
from machopt.commands.optimize.request import OptimizeRequest, prepare_optimize_inputs
from machopt.commands.optimize.verified_files import VerifiedFiles, write_verified_files
from machopt.data_types.documents.optimize_document import ObjectivesSection, OptimizeDocument
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.output.tables.plan_tables import list_points_columns, list_trajectory_columns
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.infeasibility_reasons import list_breaks
from machopt.report.page_data.optimize_rotation_map import build_rotation_map
from machopt.report.page_data.optimize_series import compute_cut_length
from machopt.report.page_types.optimize_page_data import Quantity
from machopt.report.svg.rotation_map_picture import build_rotation_svg
from machopt.verification import Verification


@dataclass(frozen=True)
class PlanFigures:
    """Pictures of a plan."""

    _made: OptimizeComputation

    def map(self) -> Figure:
        """Return the rotation map: index over path length and rotation, infeasible regions, and the chosen line.

        Raises:
            InputError: the toolpath has no cutting point, so there is no map.
        """
        made = self._made.job_result
        s = compute_cut_length(made.toolpath, made.plan.path.counted[made.points.rows])
        data = build_rotation_map(made.plan, made.shown, s)
        if data is None:
            raise InputError("the toolpath has no cutting point, and a map is of these", file=made.toolpath.source)
        index = made.plan.scores.index
        quantity: Quantity = index if index in ("deflection", "stiffness") else "index"
        return Figure(build_rotation_svg(data, quantity, title=f"Rotation map of {made.toolpath.source}"))


@dataclass(frozen=True)
class Plan:
    """Planned postures along a toolpath of N points. :func:`optimize` makes one.

    An infeasible plan is a plan too: ``feasible`` is False, ``why`` gives the obstacle, and ``points["reason"]`` the
    reason at each point.
    """

    cell: Cell
    toolpath: Toolpath
    _made: OptimizeComputation

    @property
    def feasible(self) -> bool:
        """Whether there is a motion (exit code 0 of the command, unless the verification fails)."""
        return self._made.job_result.exit_code == 0

    @property
    def verdict(self) -> str:
        """Verdict in words, with what was not checked."""
        return self._made.job_result.verdict

    @property
    def why(self) -> str:
        """Reason why there is no motion: conflicting rules, else the first break or point; "" with a motion."""
        made = self._made.job_result
        if made.timeline is not None and made.timeline.trajectory is not None:
            return ""
        if made.plan.conflict:
            return made.plan.conflict
        breaks = list_breaks(made.plan, made.timeline.obstructions if made.timeline else ())
        if breaks:
            return f"No continuous motion {breaks[0].where}: {breaks[0].text}."
        lost = [k for k, text in enumerate(self.points["reason"].tolist()) if text]
        return f"Point {lost[0]}: {self.points['reason'][lost[0]]}" if lost else self.verdict

    @cached_property
    def points(self) -> Table:
        """Columns of ``points.csv``, one row for each toolpath point."""
        return Table(list_points_columns(self._made.job_result.points.table))

    @cached_property
    def trajectory(self) -> Table | None:
        """Columns of ``trajectory.csv``, one row for each control sample; None without a motion."""
        timeline = self._made.job_result.timeline
        if timeline is None or timeline.trajectory is None:
            return None
        table = self._made.job_result.points.table
        tools = list_tool_names(self._made.job_result.plan)
        return Table(list_trajectory_columns(timeline.trajectory, table.operations, table.external_prismatic, tools))

    @property
    def joints(self) -> Array:
        """(N, 6 + E) joint position at each toolpath point by encoder, degrees; mm for prismatic external axes.

        NaN where the point has no posture. The motion between the points is in :attr:`trajectory`.
        """
        names = [n for n in self.points if n[0] in "qe" and n[1:].partition("_")[0].isdigit()]
        return self.points.array(*names)

    @property
    def deflection(self) -> Array:
        """(N,) length of the tip deflection predicted under ``force_N``, mm; NaN without a force or a posture."""
        return self.points["deflection_mm"]

    @cached_property
    def objective(self) -> ObjectivesSection:
        """Objective values of the plan, of the CAM file's own rotation, and of the method of jiao2022, as in
        result.json.
        """
        return build_objectives_section(self._made.job_result.plan)

    @property
    def cycle_time_s(self) -> float | None:
        """Duration of the whole motion from home to home, s; None without a motion."""
        timeline = self._made.job_result.timeline
        return None if timeline is None or timeline.trajectory is None else float(timeline.trajectory.time[-1])

    @property
    def figures(self) -> PlanFigures:
        """Pictures: ``figures.map()`` is the rotation map of the report."""
        return PlanFigures(self._made)

    @use_argument_names()
    def verify(self) -> Verification:
        """Write the plan into a temporary folder, and verify every file of it against cell and toolpath.

        The checks share no code with the planner; they are those of ``machopt verify``.

        Raises:
            InputError: the plan has no motion, or the cell has changed since it was loaded.
        """
        if self.trajectory is None:
            raise InputError(f"{self.verdict}: there is no motion to verify", file=self.toolpath.path)
        with tempfile.TemporaryDirectory(prefix="machopt-") as text, use_cell_effects(self.cell.unchanged()):
            found = self._get_written_files(Path(text)).verification
        if found is None:  # write() leaves it out only where there is no motion
            raise AssertionError("a motion was written and not checked")
        return found

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> OptimizeDocument:
        """Write what ``machopt optimize`` writes: tables, programs, report, result.json, manifest.json.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Returns:
            result.json, typed. Its ``exit_code`` is the command's: 0; 3 without a feasible answer; 4 where the
            verification failed, and then no program is left in the folder.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        return save_result(self.cell, out, lambda folder: self._get_written_files(folder).result, force=force)

    def _get_written_files(self, folder: Path) -> VerifiedFiles:
        made = self._made
        timings = StageTimings(dict(made.timings.seconds), made.timings.progress)  # each writing adds its own
        return write_verified_files(OptimizeComputation(made.inputs, made.job_result, timings), folder)

    def _repr_html_(self) -> str:
        """Small, for notebooks: the verdict, and the least a plan is known by."""
        from machopt.report.template_rendering import render_macro

        facts = [("points", f"{len(self.toolpath)}"), ("cell", str(self.cell.path))]
        if self.cycle_time_s is not None:
            facts.append(("cycle time", f"{self.cycle_time_s:.1f} s"))
        if np.isfinite(self.deflection).any():
            facts.append(("worst deflection", f"{np.nanmax(self.deflection):.3f} mm"))
        return str(render_macro("notebook.html", "plan", str(self.toolpath.path), self.verdict, facts))

    def __repr__(self) -> str:
        return f"<Plan for {len(self.toolpath)} points of {self.toolpath.path}: {self.verdict}>"


@use_argument_names()
def optimize(
    cell: Cell | Named,
    toolpath: Toolpath | Named,
    *,
    plan_file: Named | None = None,
    posts: Iterable[Named] = (),
    program_tolerance_mm: float | None = None,
    front: bool = False,
    map_collisions: Literal["chosen", "full"] = "chosen",
    tables: Literal["csv", "parquet"] = "csv",
    progress: Progress = ignore_progress,
    **options: Unpack[PlanOptionValues],
) -> Plan:
    """The stiffest smooth way along a toolpath: ``machopt optimize``.

    Args:
        cell: a cell, or the path of its folder.
        toolpath: a toolpath, or the path of its file.
        plan_file: planning options as YAML (``--plan``).
        posts: robot programs that :meth:`Plan.save` writes: names of posts or template files (``--post``); without
            any, the cell's own.
        program_tolerance_mm: how far straight lines between a program's points may leave the motion
            (``--program-tolerance-mm``).
        front: plan further trade-offs when the plan is saved (``--front``).
        map_collisions: ``full`` looks for the collisions of every configuration, for the map (``--map-collisions``).
        tables: ``parquet``: :meth:`Plan.save` writes every table as Parquet, too (``--tables``).
        progress: receives the name of each stage.
        options: planning options as in cell.yaml's ``plan:`` and ``--set``, e.g. ``method="jiao2022"``,
            ``rotation_step_deg=2.5``, ``force_N={"axial": 200}``; docs/reference.md lists them with their defaults.

    Returns:
        The plan, also where there is no feasible answer.

    Raises:
        InputError: cell, toolpath or an option is wrong; says which, and what would work.
    """
    a_cell = load_cell_argument(cell)
    path = read_toolpath_argument(toolpath, a_cell)
    if map_collisions not in ("chosen", "full"):
        raise InputError(f"found {map_collisions!r}; valid: chosen, full", where="map_collisions")
    request = OptimizeRequest(
        cell=a_cell.path,
        toolpath=path.path,
        out=NOWHERE,
        plan_file=None if plan_file is None else convert_to_path(plan_file, "plan_file"),
        direct={**options},
        reading=dict(path.reading),
        allow_external=a_cell.allow_external,
        posts=convert_to_texts(posts, "posts"),
        front=front,
        program_tolerance_mm=check_value_type(program_tolerance_mm, float | None, "program_tolerance_mm"),
        effects=tuple(own.file for own in a_cell.effects),
        map_all=map_collisions == "full",
        tables=tables,
    )
    with use_cell_effects(a_cell):
        timings = StageTimings(progress=progress)
        with timings.stage("load"):
            given = prepare_optimize_inputs(a_cell.description, lambda: path.description, request)
        return Plan(a_cell, path, compute_optimize_plan(given, timings))
