"""Verification of one exported trajectory against cell and toolpath."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.numerics.array_types import Array
from machopt.numerics.heap_release import release_free_memory
from machopt.verification.check_results import (
    CheckName,
    Verification,
    VerificationCheck,
    VerificationRow,
    build_count_check,
    build_file_check,
    build_skipped_check,
    build_worst_value_check,
)
from machopt.verification.motion.checks.compensation_shift import (
    ShiftComparison,
    compare_compensation_shift,
    compute_commanded_corners,
)
from machopt.verification.motion.checks.dwells_and_stops import check_dwells_and_stops
from machopt.verification.motion.checks.empty_cells import check_empty_cells
from machopt.verification.motion.checks.feed_rate import check_feed
from machopt.verification.motion.checks.force_and_error_columns import check_process_columns
from machopt.verification.motion.checks.move_labels import check_move_labels
from machopt.verification.motion.checks.path_following import check_path
from machopt.verification.motion.checks.points_columns import PointsTableCheck
from machopt.verification.motion.checks.rapid_corners import (
    CORNER_CHECKS,
    CORNERS_CLEAR,
    check_corner_contacts,
    check_rapid_corners,
    measure_passing_distance,
)
from machopt.verification.motion.checks.reentries import check_reentries
from machopt.verification.motion.checks.requested_choices import check_requested_choices
from machopt.verification.motion.checks.tilt_columns import TiltTables, check_tilt
from machopt.verification.motion.checks.time_and_joint_limits import check_limits
from machopt.verification.motion.collision.bodies import CoalBody
from machopt.verification.motion.collision.cell_bodies import CellBodies, load_cell_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.clearance_column import (
    CLEARANCE_TOLERANCE_M,
    check_clearances,
    find_cutting_points,
)
from machopt.verification.motion.collision.contact_search import BLOCK_ROWS, PlacedBodies, find_contacts, find_leap
from machopt.verification.motion.collision.cutter_contact_depth import (
    check_contacts,
    check_cut_level,
    measure_depth_outside_cuts,
)
from machopt.verification.motion.collision.gouge_check import check_gouges
from machopt.verification.motion.collision.urdf_inventory import check_inventory
from machopt.verification.motion.kinematics.encoder_correction import (
    check_correction_range,
    compute_true_angles,
    list_unchecked_corrections,
)
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.sample_location import SampleLocations, locate_samples
from machopt.verification.motion.path_geometry.tool_tilt import ToolTilt
from machopt.verification.tables.advised_feeds import check_advised_feeds
from machopt.verification.tables.exported_tables import (
    ExportedMotion,
    ExportedPoints,
    ExportedShift,
    ExportedTilt,
    read_compensation,
    read_motion,
    read_points,
    read_tilt,
)
from machopt.verification.tables.rapid_corner_table import read_rapid_corners

COLLISION_CHECKS_OFF = "collision checks are switched off (collision: false)"


@dataclass(frozen=True)
class ExportedTables:
    """trajectory.csv, points.csv, compensation.csv, tilt.csv and rapid_corners.csv as they were read."""

    motion: ExportedMotion
    points: ExportedPoints
    shift: ExportedShift | None
    tilt: ExportedTilt | None = None
    corners: RapidCorners | None = None  # rapid_corners.csv


def read_tables(cell: Cell, out: Path, motion: ExportedMotion | None = None) -> ExportedTables | Verification:
    """The tables of an output folder; a table that cannot be read is a failed check like any other damage.

    Args:
        cell: the robot cell.
        out: the output folder.
        motion: trajectory.csv where it has been read already.
    """
    try:
        motion = motion or read_motion(out / "trajectory.csv", cell)
        points = read_points(out / "points.csv", cell)
        return ExportedTables(
            motion,
            points,
            read_compensation(out / "compensation.csv") if points.shift is not None else None,
            read_tilt(out / "tilt.csv") if _has_tilt(motion, points, out) else None,
            read_rapid_corners(out / "rapid_corners.csv", cell),
        )
    except InputError as error:
        name = Path(str(error.file)).name if error.file is not None else "tables"
        place = f"{error.where}: " if error.where else ""
        check = build_file_check(name, CheckName.READABLE, False, np.nan, np.nan, "", f"{place}{error.reason}", of=" ")
        return Verification((check,), 0, 0.0)


def _has_tilt(motion: ExportedMotion, points: ExportedPoints, out: Path) -> bool:
    return points.lead is not None or motion.lead is not None or (out / "tilt.csv").exists()


def verify_motion(
    cell: Cell,
    toolpath: Toolpath,
    out: Path,
    *,
    options: PlanOptions | None = None,
    motion: ExportedMotion | None = None,
    touching: Sequence[tuple[str, str]] | None = None,
) -> Verification:
    """Check ``out/trajectory.csv`` and ``out/points.csv``, and ``compensation.csv`` where points.csv states a shift.

    Every column of both tables is recomputed; what the rows call their moves is checked against the CAM file and
    believed nowhere. Where points.csv holds a compensation, the commanded path is the toolpath shifted as
    compensation.csv says, and the shift is compared with the deflection computed here. Joint columns are encoder
    angles, limits hold for them; the true angles follow with the cell's corrections.

    Args:
        cell: the robot cell.
        toolpath: what was to be followed.
        out: the output folder.
        options: those of the run; with ``allow_gaps`` points that points.csv gives up need not be visited; without
            ``collision`` contacts are not checked, and the verdict states it.
        motion: trajectory.csv where it has been read already.
        touching: names of the bodies that the folder's manifest says touch by construction; None: it lists none.
    """
    options = options or PlanOptions()
    tables = read_tables(cell, Path(out), motion)
    if isinstance(tables, Verification):
        return tables
    motion, home = tables.motion, cell.joints_at_home
    checks = [
        *check_limits(motion, cell, options, (home, home)),
        *verify_single_tool(cell, toolpath, tables, options, touching),
    ]
    return Verification.from_rows(checks, len(motion.time), float(motion.time[-1] - motion.time[0]))


def verify_single_tool(
    cell: Cell,
    toolpath: Toolpath,
    tables: ExportedTables,
    options: PlanOptions,
    touching: Sequence[tuple[str, str]] | None = None,
) -> list[VerificationRow]:
    """Return every check except time, joint limits and both ends of the motion; see :func:`verify_motion`.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        tables: The exported tables of the folder.
        options: The planning options in force.
        touching: Pairs of body names that may touch.
    """
    context = _VerifiedTool.build(cell, toolpath, tables, options)
    checked_pairs, unfounded = context.cell_bodies.list_checked_pairs(cell, context.arm, options.clearance, touching)
    wanted = checked_pairs if touching is not None else list_checked_pairs(cell, context.arm, context.bodies)
    of_motion = context.check_motion()
    failed = {row.name for row in of_motion if isinstance(row, VerificationCheck) and row.passed is False}
    checks = [*of_motion, *context.check_points(checked_pairs)]
    release_free_memory()
    if options.collision and touching is not None:
        checks.append(build_count_check(CheckName.TOUCHING, unfounded, "pairs"))
    return [*checks, *context.check_bodies(wanted, fits_corners=failed.isdisjoint(CORNER_CHECKS))]


@dataclass(frozen=True, kw_only=True)
class _VerifiedTool:
    """The motion of one tool, by the second kinematics, and its tables."""

    cell: Cell
    toolpath: Toolpath
    tables: ExportedTables
    options: PlanOptions
    arm: UrdfKinematics
    cell_bodies: CellBodies
    motion: ExportedMotion  # with true angles
    points: ExportedPoints  # with true angles
    corners: tuple[Array, Array]  # index (P,) and position (P, 3) m of the commanded path in the workpiece
    tilt: ToolTilt | None
    locations: SampleLocations

    @classmethod
    def build(cls, cell: Cell, toolpath: Toolpath, tables: ExportedTables, options: PlanOptions) -> _VerifiedTool:
        """Locate the samples of the motion on the toolpath."""
        motion, points, shift = tables.motion, tables.points, tables.shift
        arm = UrdfKinematics(cell)
        corners = (
            (np.arange(len(toolpath), dtype=float), toolpath.position)
            if shift is None
            else compute_commanded_corners(toolpath, shift)
        )
        true_motion = replace(motion, q=compute_true_angles(cell.kinematics, motion.q))
        tool = arm.compute_tcp_in_workpiece(true_motion.q, motion.external, rows=3)
        tilt = None if tables.tilt is None else ToolTilt.build(cell, toolpath, tables.tilt, corners)
        return cls(
            cell=cell,
            toolpath=toolpath,
            tables=tables,
            options=options,
            arm=arm,
            cell_bodies=load_cell_bodies(cell, arm),
            motion=true_motion,
            points=replace(points, q=compute_true_angles(cell.kinematics, points.q)),
            corners=corners,
            tilt=tilt,
            locations=locate_samples(motion, toolpath, corners[0], corners[1], tool, options, tilt),
        )

    @property
    def bodies(self) -> list[CoalBody]:
        """All collision bodies of the cell."""
        return self.cell_bodies.bodies

    def check_motion(self) -> list[VerificationRow]:
        """Return the checks of path, labels, feed and stops of the motion."""
        motion, points, on = self.tables.motion, self.tables.points, self.locations
        corners, beyond = self.tables.corners, np.full(len(self.toolpath), np.inf)
        of_corners: list[VerificationCheck] = []
        if corners is not None:
            passed = measure_passing_distance(motion, corners, on.tool, self.toolpath)
            beyond = np.maximum(passed - self.options.rapid_blend, 0.0)
            angles = compute_true_angles(self.cell.kinematics, corners.q)
            place = self.arm.compute_tcp_in_workpiece(angles, corners.external)[:, :3, 3]
            of_corners = check_rapid_corners(motion, self.toolpath, corners, place, self.options.rapid_blend)
        return [
            *check_path(motion, self.toolpath, points, on, self.options.allow_gaps, beyond),
            *of_corners,
            *check_move_labels(motion, self.toolpath, points, on, self.options.allow_gaps),
            *check_reentries(motion, self.toolpath, self.options),
            *check_feed(motion, self.toolpath, on, self.options, self.cell),
            *check_dwells_and_stops(motion, self.toolpath, points, on, self.corners, self.cell),
        ]

    def check_points(self, pairs: list[tuple[CoalBody, CoalBody]]) -> list[VerificationRow]:
        """Return the checks of the tables; the clearance of points applies to ``pairs``."""
        cell, toolpath, options, arm = self.cell, self.toolpath, self.options, self.arm
        motion, points = self.tables.motion, self.tables.points
        table = PointsTableCheck(cell, toolpath, points, arm, np.nan_to_num(self.points.q), options, self.tilt)
        checks: list[VerificationRow] = []
        if self.tilt is not None and self.tables.tilt is not None:
            checks += check_tilt(
                TiltTables(
                    cell=cell,
                    toolpath=toolpath,
                    motion=motion,
                    points=points,
                    exported=self.tables.tilt,
                    tilt=self.tilt,
                    locations=self.locations,
                    tcp_of_points=table.tool,
                    live=table.live,
                    options=options,
                )
            )
        of_points = [
            *table.check_all(motion, self.locations),
            *_check_clearance(table, self.points, self.cell_bodies, pairs, options),
            *check_process_columns(cell, toolpath, points, motion, arm, options),
            *check_advised_feeds(toolpath, points, options),
            check_empty_cells(points),
        ]
        checks += [replace(c, file="points.csv") for c in of_points]
        checks += check_requested_choices(cell, toolpath, points, np.flatnonzero(table.live), options, motion)
        checks += [*check_correction_range(cell.kinematics, motion.q), *list_unchecked_corrections(cell.kinematics)]
        if self.tables.shift is not None:
            checks += [
                _build_shift_check(f)
                for f in compare_compensation_shift(
                    cell, toolpath, self.motion, self.points, self.tables.shift, arm, options
                )
            ]
        return checks

    def check_bodies(self, pairs: list[tuple[CoalBody, CoalBody]], *, fits_corners: bool) -> list[VerificationRow]:
        """Return the checks of gouges, contacts and depths; rounded corners are searched where their table fits."""
        motion, on, arm, bodies = self.motion, self.locations, self.arm, self.bodies
        checks: list[VerificationRow] = [*check_inventory(self.cell, arm, bodies, pairs)]
        checks += check_gouges(motion, self.toolpath, on, arm, bodies, self.options, self.tables.shift is not None)
        if not self.options.collision:
            return [*checks, build_skipped_check(CheckName.CONTACTS, COLLISION_CHECKS_OFF)]
        if self.tables.corners is not None and not fits_corners:
            checks.append(build_skipped_check(CORNERS_CLEAR, "rapid_corners.csv does not fit the motion"))
        elif self.tables.corners is not None:
            corners = self.tables.corners
            corners = replace(corners, q=compute_true_angles(self.cell.kinematics, corners.q))
            checks.append(check_corner_contacts(arm, pairs, motion, corners))
        leap = find_leap(motion.joints, self.cell.limits.velocity, motion.sample_time)
        if leap is not None:
            where = f"{motion.describe_row(leap)}: a joint leaps; not searched"
            return [*checks, build_count_check(CheckName.CONTACTS, [where], "leaps")]
        contacts = find_contacts(arm, pairs, motion.q, motion.external, on.is_free)
        return [
            *checks,
            check_contacts(contacts, motion, arm, bodies),
            *measure_depth_outside_cuts(motion, self.toolpath, on, arm, bodies),
            *check_cut_level(motion, self.toolpath, on, self.cell, self.corners),
        ]


CLEARANCE_COLUMN = "points.csv clearance_mm"


def _check_clearance_is_stated(
    table: PointsTableCheck, rows: NDArray[np.intp], stated: Array, options: PlanOptions
) -> VerificationCheck | None:
    """Return the check of a column (n,) mm that must not be compared: collisions are off, or a value is missing."""
    if not options.collision:
        extra = np.where(np.isnan(stated), 0.0, np.inf)
        at = table.describe_row(rows)
        return build_worst_value_check(
            CLEARANCE_COLUMN, "mm", extra, 0.0, lambda n: f"{at(n)} has one, but collisions are switched off"
        )
    if np.isnan(stated).any():
        lacking = table.describe_row(rows[np.isnan(stated)])(0)
        return VerificationCheck(
            name=CLEARANCE_COLUMN,
            passed=False,
            value=np.nan,
            limit=1e3 * CLEARANCE_TOLERANCE_M,
            unit="mm",
            where=f"{lacking} is ok and has none",
        )
    return None


def _check_clearance(
    table: PointsTableCheck,
    exported: ExportedPoints,
    cell_bodies: CellBodies,
    wanted: list[tuple[CoalBody, CoalBody]],
    options: PlanOptions,
) -> list[VerificationCheck]:
    """clearance_mm and nearest_pair; empty where collisions are not checked."""
    rows = np.flatnonzero(table.live)
    if not len(rows):
        return []
    stated, named = table.points.numbers["clearance_mm"][rows], table.points.words.get("nearest_pair")
    unusable = _check_clearance_is_stated(table, rows, stated, options)
    if unusable is not None:
        return [unusable]
    if named is None:
        return [
            VerificationCheck(
                name="points.csv nearest_pair",
                passed=False,
                value=np.nan,
                limit=0.0,
                unit="mm",
                where="the column is missing",
            )
        ]
    graze, at = find_cutting_points(table.toolpath)[table.k[rows]], table.describe_row(rows)
    wanted = cell_bodies.list_varying_pairs(table.arm, wanted)
    short, beyond, pair = np.zeros(len(rows)), np.zeros(len(rows)), [""] * len(rows)
    for first in range(0, len(rows), BLOCK_ROWS):
        some = slice(first, first + BLOCK_ROWS)
        scene = PlacedBodies(table.arm, cell_bodies.bodies, np.hstack([exported.q, exported.external])[rows[some]])
        found = check_clearances(scene, wanted, stated[some] / 1e3, tuple(named[n] for n in rows[some]), graze[some])
        short[some], beyond[some], pair[some] = found.too_small, found.too_large, found.pair
    return [
        build_worst_value_check(
            CLEARANCE_COLUMN,
            "mm",
            1e3 * short,
            1e3 * CLEARANCE_TOLERANCE_M,
            lambda n: f"{at(n)}{f', {pair[n]}' if pair[n] else ''}",
        ),
        build_worst_value_check(
            "points.csv nearest_pair", "mm", 1e3 * beyond, 0.0, lambda n: f"{at(n)}, {named[rows[n]] or 'none'}"
        ),
    ]


def _build_shift_check(shift_comparison: ShiftComparison) -> VerificationCheck:
    if shift_comparison.not_run:
        return build_skipped_check(shift_comparison.name, shift_comparison.not_run, shift_comparison.unit)
    return replace(
        build_worst_value_check(
            shift_comparison.name,
            shift_comparison.unit,
            shift_comparison.values,
            shift_comparison.limit,
            shift_comparison.where,
        ),
        file=shift_comparison.file,
    )
