"""``machopt.optimize``: the main job, with its answer in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from machopt.api.asked import NOWHERE, path_of, texts, typed
from machopt.api.cell import Cell, cell_of
from machopt.api.figure import Figure
from machopt.api.saved import Named, Progress, effects_of, saved, silent
from machopt.api.table import Table
from machopt.api.toolpath import Toolpath, toolpath_of
from machopt.arrays import Array
from machopt.domain.results.optimize import Objectives, OptimizeResult
from machopt.errors import InputError
from machopt.formats.tables import points_columns, trajectory_columns
from machopt.plan.pipeline.setup import Timings
from machopt.plan.written.contact_map import mapped
from machopt.plan.written.explain import all_breaks
from machopt.report.data import Quantity
from machopt.report.gather.optimize_map import rotation_map
from machopt.report.gather.optimize_series import cut_length
from machopt.report.rotation_svg import rotation_svg
from machopt.services.load import OptimizeRequest, prepared
from machopt.services.planned import Planned, planned
from machopt.services.result import objectives_of
from machopt.services.tell import tool_names
from machopt.services.written import Written, write
from machopt.verify import Verification


@dataclass(frozen=True)
class PlanFigures:
    """Pictures of a plan."""

    _made: Planned

    def map(self) -> Figure:
        """The index over path length and rotation about the tool axis, what forbids a place, and the chosen line.

        Raises:
            InputError: the toolpath has no cutting point, so there is no map.
        """
        made = self._made.made
        s = cut_length(made.toolpath, made.plan.path.counted[made.points.rows])
        data = rotation_map(made.plan, mapped(made.plan, self._made.given.map_all), s)
        if data is None:
            raise InputError("the toolpath has no cutting point, and a map is of these", file=made.toolpath.source)
        index = made.plan.scores.index
        quantity: Quantity = index if index in ("deflection", "stiffness") else "index"
        return Figure(rotation_svg(data, quantity, title=f"Rotation map of {made.toolpath.source}"))


@dataclass(frozen=True)
class Plan:
    """How the robot holds itself along a toolpath of N points. :func:`optimize` makes one.

    A plan without a feasible answer is a plan too: ``feasible`` is False, ``why`` says what is in the way, and
    ``points["reason"]`` the same point by point.
    """

    cell: Cell
    toolpath: Toolpath
    _made: Planned

    @property
    def feasible(self) -> bool:
        """There is a motion (exit code 0 of the command, unless the verification fails)."""
        return self._made.made.exit_code == 0

    @property
    def verdict(self) -> str:
        """The answer in words, with what was not checked."""
        return self._made.made.verdict

    @property
    def why(self) -> str:
        """Why there is no motion: wishes that cannot be kept together, else the first break or point; "" with one."""
        made = self._made.made
        if made.timeline is not None and made.timeline.trajectory is not None:
            return ""
        if made.plan.conflict:
            return made.plan.conflict
        breaks = all_breaks(made.plan, made.timeline.obstructions if made.timeline else ())
        if breaks:
            return f"No continuous motion {breaks[0].where}: {breaks[0].text}."
        lost = [k for k, text in enumerate(self.points["reason"].tolist()) if text]
        return f"Point {lost[0]}: {self.points['reason'][lost[0]]}" if lost else self.verdict

    @cached_property
    def points(self) -> Table:
        """One row a toolpath point: the columns of ``points.csv``."""
        return Table(points_columns(self._made.made.points.table))

    @cached_property
    def trajectory(self) -> Table | None:
        """One row a control sample: the columns of ``trajectory.csv``; None where there is no motion."""
        timeline = self._made.made.timeline
        if timeline is None or timeline.trajectory is None:
            return None
        table = self._made.made.points.table
        tools = tool_names(self._made.made.plan)
        return Table(trajectory_columns(timeline.trajectory, table.operations, table.external_prismatic, tools))

    @property
    def joints(self) -> Array:
        """(N, 6 + E) joint position at each toolpath point by encoder: degrees, mm where an external axis slides.

        NaN where the point has no posture. The motion between the points is in :attr:`trajectory`.
        """
        names = [n for n in self.points if n[0] in "qe" and n[1:].partition("_")[0].isdigit()]
        return self.points.array(*names)

    @property
    def deflection(self) -> Array:
        """(N,) mm, length of the tip's deflection predicted under ``force_N``; NaN without a force or a posture."""
        return self.points["deflection_mm"]

    @cached_property
    def objective(self) -> Objectives:
        """What the plan comes to, beside the CAM file's own rotation and the method of jiao2022; as in result.json."""
        return objectives_of(self._made.made.plan)

    @property
    def cycle_time_s(self) -> float | None:
        """s, of the whole motion from home to home; None without one."""
        timeline = self._made.made.timeline
        return None if timeline is None or timeline.trajectory is None else float(timeline.trajectory.time[-1])

    @property
    def figures(self) -> PlanFigures:
        """Pictures: ``figures.map()`` is the rotation map of the report."""
        return PlanFigures(self._made)

    def verify(self) -> Verification:
        """Write the plan into a folder that is thrown away, and hold every file of it against cell and toolpath.

        The checks share no code with the planner; they are those of ``machopt verify``.

        Raises:
            InputError: the plan has no motion; or the cell has changed since.
        """
        if self.trajectory is None:
            raise InputError(f"{self.verdict}: there is no motion to verify", file=self.toolpath.path)
        with tempfile.TemporaryDirectory(prefix="machopt-") as text, effects_of(self.cell.unchanged()):
            found = self._written(Path(text)).verification
        if found is None:  # write() leaves it out only where there is no motion
            raise AssertionError("a motion was written and not checked")
        return found

    def save(self, out: Named, *, force: bool = False) -> OptimizeResult:
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
        return saved(self.cell, out, lambda folder: self._written(folder).result, force=force)

    def _written(self, folder: Path) -> Written:
        made = self._made
        timings = Timings(dict(made.timings.seconds), made.timings.progress)  # each writing adds its own
        return write(Planned(made.given, made.made, timings), folder)

    def _repr_html_(self) -> str:
        """Small, for notebooks: the verdict, and the least a plan is known by."""
        from machopt.report.template import fragment

        told = [("points", f"{len(self.toolpath)}"), ("cell", str(self.cell.path))]
        if self.cycle_time_s is not None:
            told.append(("cycle time", f"{self.cycle_time_s:.1f} s"))
        if np.isfinite(self.deflection).any():
            told.append(("worst deflection", f"{np.nanmax(self.deflection):.3f} mm"))
        return str(fragment("notebook.html", "plan", str(self.toolpath.path), self.verdict, told))

    def __repr__(self) -> str:
        return f"<Plan for {len(self.toolpath)} points of {self.toolpath.path}: {self.verdict}>"


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
    progress: Progress = silent,
    **options: Any,
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
        progress: told the stage at work.
        options: planning options as in cell.yaml's ``plan:`` and ``--set``, e.g. ``method="jiao2022"``,
            ``rotation_step_deg=2.5``, ``force_N={"axial": 200}``; docs/reference.md lists them with their defaults.

    Returns:
        The plan, also where there is no feasible answer.

    Raises:
        InputError: cell, toolpath or an option is wrong; says which, and what would work.
    """
    a_cell = cell_of(cell)
    path = toolpath_of(toolpath, a_cell)
    if map_collisions not in ("chosen", "full"):
        raise InputError(f"found {map_collisions!r}; valid: chosen, full", where="map_collisions")
    request = OptimizeRequest(
        cell=a_cell.path,
        toolpath=path.path,
        out=NOWHERE,
        plan_file=None if plan_file is None else path_of(plan_file, "plan_file"),
        direct=options,
        reading=dict(path.reading),
        allow_external=a_cell.allow_external,
        posts=texts(posts, "posts"),
        front=front,
        program_tolerance_mm=typed(program_tolerance_mm, float | None, "program_tolerance_mm"),
        effects=tuple(own.file for own in a_cell.effects),
        map_all=map_collisions == "full",
        tables=tables,
    )
    with effects_of(a_cell):
        timings = Timings(progress=progress)
        with timings.stage("load"):
            given = prepared(a_cell.description, lambda: path.description, request)
        return Plan(a_cell, path, planned(given, timings))
