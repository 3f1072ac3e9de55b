"""points.csv, every column recomputed: from the CAM file what it gives, from the joints what follows from them.

========================================  =========================================================================
column                                    recomputed as
========================================  =========================================================================
point, operation, move, x … z, i … k,     the CAM file's; numbers complete and in order
feed_mm_min
q1 … q6                                   forward kinematics of the true angles lies on the point (shifted where
                                          the path is compensated) and along the axis; the motion passes them at the
                                          point's index
gamma_deg                                 as docs/conventions.md has it, ``reference_direction.py``
branch, singularity, limit_margin_deg     :mod:`machopt.verification.motion.kinematics.posture`
k_*, deflection_*, stiffness_from         :mod:`machopt.verification.motion.stiffness.arm_compliance`
clearance_mm, nearest_pair                :mod:`machopt.verification.motion.collision.clearance_column`
status, reason                            ok: every column is there, and no reason but that the move is slow; else a
                                          reason and no stiffness, rotation or clearance. What is driven or not:
                                          :mod:`machopt.verification.motion.checks.path_following`
========================================  =========================================================================

A limit is what the printed decimals explain: half of the last digit, and what half of the joints' last digit (5e-7
deg, six joints) makes of the column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.verification.check_results import (
    VerificationCheck,
    build_count_check,
    build_skipped_check,
    build_worst_value_check,
)
from machopt.verification.motion.kinematics import posture
from machopt.verification.motion.kinematics.arm_configuration import ArmConfiguration
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry import reference_direction
from machopt.verification.motion.path_geometry.process_force import compute_sideways_directions
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.motion.path_geometry.tool_tilt import ToolTilt
from machopt.verification.motion.stiffness import arm_compliance
from machopt.verification.motion.stiffness.spring_terms import UnknownTermError
from machopt.verification.tables.advised_feeds import ADVISED, apply_exported_feeds
from machopt.verification.tables.exported_tables import MOVE_WORDS, ExportedMotion, ExportedPoints

PLACE_MM, AXIS, FEED_MM_MIN = 1e-6, 1e-9, 1e-3  # six, nine and three decimals, without the joints
BLOCK_ROWS = 5_000  # of the table, recomputed at once
PLACE_TOLERANCE_MM, AXIS_TOLERANCE_DEG = 1e-3, 1e-5  # FK: 6 × 5e-7 deg over a reach of metres is 2e-4 mm
ROTATION_TOLERANCE_DEG = 1e-5
ANGLE_TOLERANCE_DEG = 2e-5  # five decimals
RELATIVE_TOLERANCE = 5e-6  # of stiffness and deflection: 5e-8 rad in all joints, squared levers
STIFFNESS_TOLERANCE_N_MM, DEFLECTION_TOLERANCE_MM = 1e-4, 2e-7  # four and seven decimals
JOINT_TOLERANCE_DEG = 0.1  # of the samples around the point: corners are rounded by up to 15 µm, over a short lever
DWELL_TOLERANCE_S = 6e-4  # printed to a millisecond
HELD_FEED_SHARE = 0.95  # of the programmed feed: below it a move may be called slow
TILT_FEED_SPREAD = 0.01  # of a tilted ball's feed: the planner judges that of its tip, which differs inside a move
POINT_INDEX_TOLERANCE = 1e-6  # of the index, printed to nine decimals


def rotate_vectors(T: Array, v: Array) -> Array:
    """Return (N, 3) vectors rotated by the axes of frames.

    Args:
        T: (N, 4, 4) frames.
        v: (N, 3) vectors in the frames' axes.
    """
    return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], v))


@dataclass(frozen=True, kw_only=True)
class _PointStiffness:
    """Stiffness and deflection at n points; NaN where they are not computed."""

    axial: Array  # (n,) N/m, along the tool axis
    normal: Array  # (n,) N/m, across it; of two directions that the travel permits, the one nearer to the table
    held: Array  # (n,) N/m, with the other directions held
    deflection: Array  # (n,) m
    axial_std: Array  # (n,) N/m, 1 sigma
    deflection_std: Array  # (n,) m, 1 sigma


class PointsTableCheck:
    """Rows of points.csv with the CAM file's points and the arm at the rows' joint positions.

    Args:
        stance: The arm at the rows' true angles, in base_link; NaN joints are set to zero.
    """

    def __init__(
        self,
        cell: Cell,
        toolpath: Toolpath,
        points: ExportedPoints,
        arm: UrdfKinematics,
        q: Array,
        options: PlanOptions,
        tilt: ToolTilt | None = None,
    ) -> None:
        """Args: q (N, 6) rad, true angles of the rows; tilt of the tool, None: there is none."""
        self.cell, self.toolpath, self.points, self.options = cell, toolpath, points, options
        self.arm, self.q = arm, q
        known = np.isfinite(points.external).all(axis=1, keepdims=True)
        self.external = np.where(known, points.external, cell.external_home)
        self.T_base_workpiece = arm.T_base_workpiece(self.external)  # (N, 4, 4)
        self.inside = (points.point >= 0) & (points.point < len(toolpath))
        self.k = np.clip(points.point, 0, len(toolpath) - 1)  # point of each row
        self.known: Bools = np.asarray(np.isfinite(np.hstack([points.q, points.external])).all(axis=1))
        self.live = self.known & points.ok & self.inside
        self.directions = reference_direction.compute_directions_at_points(toolpath)
        self.tool = np.empty((len(q), 4, 4))
        for some, stance in self.compute_configurations(np.arange(len(q))):
            self.tool[some] = np.linalg.inv(self.T_base_workpiece[some]) @ stance.tcp
        self.tcp = self.tool if tilt is None else tilt.turn_back(self.tool, self.k.astype(float))

    def compute_configurations(self, rows: NDArray[np.intp]) -> Iterator[tuple[slice, ArmConfiguration]]:
        """Yield the arm at the given rows in blocks that fit the memory, each with the slice of its rows.

        Args:
            rows: Row numbers, from 0.
        """
        for first in range(0, len(rows), BLOCK_ROWS):
            some = slice(first, first + BLOCK_ROWS)
            yield some, self.arm.compute_configuration(self.q[rows[some]], self.external[rows[some]])

    def describe_row(self, rows: NDArray[np.intp]) -> Callable[[int], str]:
        """Return a function that names the n-th of the rows.

        Args:
            rows: Row numbers, from 0.
        """
        return lambda n: f"point {self.points.point[rows[n]]}"

    def check_all(self, motion: ExportedMotion, ride: SampleLocations) -> list[VerificationCheck]:
        """Return every check except clearance and compensation.

        Args:
            motion: The exported motion (trajectory.csv), SI.
            ride: Position of each motion sample relative to the toolpath.
        """
        checks = [self._check_completeness(), *self._check_cam_columns(), self._check_status(motion)]
        if self.live.any():
            checks += [
                *self._check_tool_pose(),
                self._check_motion_joints(motion, ride),
                *self._check_posture(),
                *self._check_stiffness(),
            ]
        return checks

    def check_column(
        self,
        name: str,
        wanted: Array,
        rows: NDArray[np.intp],
        unit: str,
        limit: float,
        share: float = 0.0,
        ambiguity: Array | float = 0.0,
    ) -> VerificationCheck:
        """Check one column of numbers on some rows; a missing number is the worst.

        Args:
            name: Name of the column.
            wanted: (rows,) recomputed values in the file's unit.
            rows: Row numbers, from 0.
            unit: Unit of the column.
            limit: Greatest allowed difference in the file's unit.
            share: Further allowed difference as a share of the value; the check then reports the difference as a
                share of both.
            ambiguity: (rows,) range within which the quantity is undefined, in the file's unit.
        """
        stated = self.points.numbers.get(name)
        if stated is None:
            return VerificationCheck(
                name=f"points.csv {name}",
                passed=False,
                value=np.nan,
                limit=limit,
                unit=unit,
                where="the column is missing",
            )
        off = np.abs(stated[rows] - wanted)
        off = np.where(np.isnan(stated[rows]) & np.isnan(wanted), 0.0, np.maximum(off - ambiguity, 0.0))

        def told_and_wanted(n: int) -> str:
            at = self.describe_row(rows)(n)
            follows = f"{wanted[n]:.7g} {unit} follows" if np.isfinite(wanted[n]) else "nothing follows"
            return (
                f"{at}: {stated[rows][n]:.7g} {unit}, {follows}"
                if np.isfinite(stated[rows][n])
                else f"{at}: none, {follows}"
            )

        if share:
            room = limit + share * np.nan_to_num(np.abs(wanted))
            off, unit, limit = off / room, f"of {limit:g} {unit} and {share:g} of it", 1.0
        return replace(build_worst_value_check(f"points.csv {name}", unit, off, limit, told_and_wanted), instead=True)

    def _check_completeness(self) -> VerificationCheck:
        have, n = self.points.point, len(self.toolpath)
        complete = self.points.is_complete(n)
        if complete or len(have) != n:
            where = "one row a toolpath point, numbered from 0"
        else:
            row = int(np.flatnonzero(have != np.arange(n))[0])
            where = f"data row {row + 1} is point {have[row]}, not {row}"
        return VerificationCheck(
            name="points.csv complete",
            passed=complete,
            value=float(len(have)),
            limit=float(n),
            unit="rows",
            where=where,
        )

    def _check_cam_columns(self) -> list[VerificationCheck]:
        """What the CAM file gives."""
        t, k, every = self.toolpath, self.k, np.arange(len(self.k))
        label = np.array([" ".join(o.label.split()) for o in t.operations] or [""], dtype=object)[t.operation[k]]
        move = np.array(MOVE_WORDS, dtype=object)[t.move[k]]
        place = np.column_stack([self.points.numbers[f"{c}_mm"] for c in "xyz"]) - 1e3 * t.position[k]
        axis = np.column_stack([self.points.numbers[c] for c in "ijk"]) - t.axis[k]
        words = [(have, wanted) for have, wanted in zip(self.points.words["operation"], label, strict=True)]
        out = [
            build_worst_value_check(
                "points.csv x y z", "mm", np.abs(place).max(axis=1), PLACE_MM, self.describe_row(every)
            ),
            build_worst_value_check("points.csv i j k", "1", np.abs(axis).max(axis=1), AXIS, self.describe_row(every)),
            build_count_check(
                "points.csv operation",
                [
                    f"point {p} is of {a!r}, the toolpath says {b!r}"
                    for p, (a, b) in zip(self.points.point, words, strict=True)
                    if a != b
                ],
            ),
            build_count_check(
                "points.csv move",
                [
                    f"point {p} is called {a}, the toolpath says {b}"
                    for p, a, b in zip(self.points.point, self.points.words["move"], move, strict=True)
                    if a != b
                ],
            ),
        ]
        waits = np.zeros(len(t))
        for event in t.events:
            if event.kind == "dwell" and event.index > 0 and event.value > 0:
                waits[min(event.index, len(t)) - 1] += event.value
        if waits.any() or "dwell_s" in self.points.numbers:
            out.append(self.check_column("dwell_s", waits[k], every, "s", DWELL_TOLERANCE_S))
        if "feed_mm_min" in self.points.numbers:
            out.append(self.check_column("feed_mm_min", 6e4 * t.feed[k], every, "mm/min", FEED_MM_MIN))
        return out

    def _check_status(self, motion: ExportedMotion) -> VerificationCheck:
        """Words that exist; an ok point states everything, any other a reason and nothing else.

        The only reason of an ok point is that the move to it is driven slower than programmed.
        """
        wrong, slow = [], self._find_slow_points(motion)
        words = {reason.word for reason in InfeasibilityReason}
        numbers = self.points.numbers
        for n, status in enumerate(self.points.status):
            at, reason = f"point {self.points.point[n]}", self.points.words["reason"][n]
            if status not in words:
                wrong.append(f"{at}: {status!r} is no status")
            elif status == "ok":
                lacks = [
                    name
                    for name in ("gamma_deg", "branch", "limit_margin_deg", "singularity")
                    if not np.isfinite(numbers[name][n])
                ]
                lacks += [] if self.known[n] else ["joints"]
                wrong += [f"{at} is ok and lacks {', '.join(lacks)}"] if lacks else []
                wrong += [f"{at} is ok and has a reason"] if reason and not slow[self.k[n]] else []
            else:
                more = [
                    name
                    for name in ("gamma_deg", "k_axial_N_mm", "k_normal_N_mm", "deflection_mm", "clearance_mm")
                    if np.isfinite(numbers[name][n])
                ]
                wrong += [f"{at} is {status} and has {', '.join(more)}"] if more else []
                wrong += [] if reason else [f"{at} is {status} without a reason"]
        return build_count_check("points.csv status", wrong, "points")

    def _find_slow_points(self, motion: ExportedMotion) -> Bools:
        """(P,) some sample that lies, in part at least, on the move to a point of the toolpath is below its feed."""
        n, s = len(self.toolpath), motion.point
        b = 1 + np.flatnonzero((motion.move[1:] != MoveKind.RAPID) & np.isfinite(s[1:]) & np.isfinite(s[:-1]))
        first = np.clip(np.floor(s[b - 1] + POINT_INDEX_TOLERANCE) + 1, 0, n - 1).astype(int)
        last = np.maximum(np.clip(np.ceil(s[b] - POINT_INDEX_TOLERANCE), 0, n - 1).astype(int), first)
        fed = apply_exported_feeds(self.toolpath, self.points.numbers.get(ADVISED), self.points.point).feed
        programmed = np.where(np.isfinite(fed), fed, self.options.approach_feed)
        feed_threshold = HELD_FEED_SHARE + (0.0 if motion.lead is None else TILT_FEED_SPREAD)
        low = motion.feed[b] < feed_threshold * np.fmax(programmed[first], programmed[last])
        edges = np.bincount(first[low], minlength=n + 1) - np.bincount(last[low] + 1, minlength=n + 1)
        return np.asarray(np.cumsum(edges[:n]) > 0)

    def _check_tool_pose(self) -> list[VerificationCheck]:
        """Tool on its point and along its axis; and the rotation."""
        rows = np.flatnonzero(self.live)
        shift = 0.0 if self.points.shift is None else self.points.shift[rows]
        away = np.linalg.norm(self.tcp[rows, :3, 3] - self.toolpath.position[self.k[rows]] - shift, axis=1)
        tilt = np.linalg.norm(np.cross(-self.tcp[rows, :3, 2], self.toolpath.axis[self.k[rows]]), axis=1)
        tilt = np.where(np.einsum("ij,ij->i", self.tcp[rows, :3, 2], self.toolpath.axis[self.k[rows]]) < 0, tilt, np.pi)
        found = self.directions.compute_rotation_angle(self.tool[self._row_of_point()])[self.k[rows]]
        stated = np.radians(self.points.numbers["gamma_deg"][rows])
        turn = np.abs((found - stated[:, None] + np.pi) % (2.0 * np.pi) - np.pi)
        return [
            build_worst_value_check(
                "points.csv on the toolpath", "mm", 1e3 * away, PLACE_TOLERANCE_MM, self.describe_row(rows)
            ),
            build_worst_value_check(
                "points.csv along the axis", "deg", np.degrees(tilt), AXIS_TOLERANCE_DEG, self.describe_row(rows)
            ),
            build_worst_value_check(
                "points.csv gamma_deg",
                "deg",
                np.degrees(np.fmin(turn[:, 0], turn[:, 1])),
                ROTATION_TOLERANCE_DEG,
                self.describe_row(rows),
            ),
        ]

    def _row_of_point(self) -> NDArray[np.intp]:
        """(P,) a row of the table for each point of the toolpath; 0 where it has none."""
        out = np.zeros(len(self.toolpath), np.intp)
        out[self.k] = np.arange(len(self.k))
        return out

    def _check_motion_joints(self, motion: ExportedMotion, ride: SampleLocations) -> VerificationCheck:
        """Where the motion has the point's index, its joints are the row's."""
        rows = np.flatnonzero(self.live & (self.toolpath.move[self.k] != 1))
        s = motion.point
        on = np.flatnonzero(np.isfinite(s) & (ride.on_feed_move | ride.on_retract_move))
        if not len(rows) or not len(on):
            return VerificationCheck(
                name="points.csv as driven",
                passed=not len(rows),
                value=np.nan,
                limit=JOINT_TOLERANCE_DEG,
                unit="deg",
                where="nothing to measure",
            )
        at = self.points.point[rows]
        after = np.searchsorted(s[on], at, side="left")
        before = np.searchsorted(s[on], at, side="right") - 1
        a, b = on[np.clip(before, 0, len(on) - 1)], on[np.clip(after, 0, len(on) - 1)]
        driven = motion.joints
        low, high = np.minimum(driven[a], driven[b]), np.maximum(driven[a], driven[b])
        q = np.hstack([self.points.q, self.points.external])[rows]
        off = np.degrees(np.maximum(low - q, q - high).max(axis=1))  # a metre of a slide counts as a radian
        return build_worst_value_check(
            "points.csv as driven", "deg", np.maximum(off, 0.0), JOINT_TOLERANCE_DEG, self.describe_row(rows)
        )

    def _check_posture(self) -> list[VerificationCheck]:
        rows = np.flatnonzero(self.known & self.inside)
        limits = self.cell.limits
        margin = posture.compute_limit_margin(self.points.q[rows], limits.lower[:6], limits.upper[:6])
        singularity, branch, ambiguity = (np.empty(len(rows)) for _ in range(3))
        numbered = True
        for some, stance in self.compute_configurations(rows):
            classified = posture.compute_posture(self.arm.build_nominal(stance))
            singularity[some], ambiguity[some] = classified.singularity, classified.ambiguity
            numbered = numbered and classified.branch is not None
            branch[some] = np.nan if classified.branch is None else classified.branch
        out = [
            self.check_column("limit_margin_deg", np.degrees(margin), rows, "deg", ANGLE_TOLERANCE_DEG),
            self.check_column(
                "singularity",
                np.degrees(singularity),
                rows,
                "deg",
                ANGLE_TOLERANCE_DEG,
                ambiguity=np.degrees(ambiguity),
            ),
        ]
        if not numbered:
            why = "this arm has no branches by shape: they are numbered by the planner's solver"
            return [*out, build_skipped_check("points.csv branch", why)]
        return [*out, self.check_column("branch", branch, rows, "1", 0.0)]

    def _check_stiffness(self) -> list[VerificationCheck]:
        """The columns of :mod:`machopt.verification.motion.stiffness.arm_compliance`."""
        name = "points.csv stiffness and deflection"
        if self.cell.stiffness is None:
            return [build_skipped_check(name, "the cell names no stiffness")]
        try:
            law = arm_compliance.ComplianceModel(self.cell, self.arm, self.cell.stiffness)
        except UnknownTermError as error:
            return [build_skipped_check(name, f"no second law is written for {error}")]
        rows = np.flatnonzero(self.live)
        soft = self._compute_stiffness(law, rows)
        given = self.options.force.given
        columns: list[tuple[str, Array, str, float, float]] = [
            ("k_axial_N_mm", soft.axial / 1e3, "N/mm", STIFFNESS_TOLERANCE_N_MM, RELATIVE_TOLERANCE),
            ("k_normal_N_mm", soft.normal / 1e3, "N/mm", STIFFNESS_TOLERANCE_N_MM, RELATIVE_TOLERANCE),
        ]
        if "k_jiao_x_N_mm" in self.points.numbers:
            columns.append(("k_jiao_x_N_mm", soft.held / 1e3, "N/mm", STIFFNESS_TOLERANCE_N_MM, RELATIVE_TOLERANCE))
        relative = RELATIVE_TOLERANCE if given else 0.0
        columns.append(("deflection_mm", 1e3 * soft.deflection, "mm", DEFLECTION_TOLERANCE_MM, relative))
        if law.has_uncertainty:
            axial_std = soft.axial_std / 1e3
            columns.append(("k_axial_std_N_mm", axial_std, "N/mm", STIFFNESS_TOLERANCE_N_MM, RELATIVE_TOLERANCE))
            if given:
                bend_std = 1e3 * soft.deflection_std
                columns.append(("deflection_std_mm", bend_std, "mm", DEFLECTION_TOLERANCE_MM, RELATIVE_TOLERANCE))
        out = [
            self.check_column(column, values, rows, unit, absolute, share)
            for column, values, unit, absolute, share in columns
        ]
        if law.stiffness.grid is not None:
            out.append(self._check_grid(law))
        return out

    def _compute_stiffness(self, law: arm_compliance.ComplianceModel, rows: NDArray[np.intp]) -> _PointStiffness:
        """Return stiffness and deflection at rows (n,) of the table by the second law."""
        o, pull = self.options.force, compute_sideways_directions(self.toolpath)
        axial, normal, other, held, bend, axial_std, bend_std = (np.full(len(rows), np.nan) for _ in range(7))
        for some, stance in self.compute_configurations(rows):
            k = self.k[rows[some]]
            T = self.T_base_workpiece[rows[some]]
            soft = law.evaluate(stance, rotate_vectors(T, self.toolpath.position[k]) + T[:, :3, 3])
            axis = self.toolpath.axis[k]
            e, across = rotate_vectors(T, axis), rotate_vectors(T, np.cross(axis, self.directions.travel[k]))
            own = None if self.toolpath.force is None else self.toolpath.force[k]
            force = rotate_vectors(T, arm_compliance.compute_force(pull[k], axis, *o.resolve_components(own)))
            axial[some], normal[some], held[some] = (
                soft.compute_stiffness_along(e),
                soft.compute_stiffness_along(across),
                soft.compute_jiao_stiffness(e),
            )
            other[some] = soft.compute_stiffness_along(rotate_vectors(T, np.cross(axis, self.directions.other[k])))
            unknown = self._has_unknown_force(k)
            if o.given:
                bend[some] = np.where(unknown, np.nan, np.linalg.norm(soft.compute_displacement(force), axis=1))
            if law.has_uncertainty:
                axial_std[some] = law.compute_axial_std(soft, e)
                if o.given:
                    bend_std[some] = np.where(unknown, np.nan, law.compute_deflection_std(soft, force))
        stated = self.points.numbers.get("k_normal_N_mm", np.full(len(self.k), np.nan))[rows] * 1e3
        return _PointStiffness(
            axial=axial,
            normal=np.where(np.abs(stated - other) < np.abs(stated - normal), other, normal),
            held=held,
            deflection=bend,
            axial_std=axial_std,
            deflection_std=bend_std,
        )

    def _has_unknown_force(self, k: NDArray[np.intp]) -> Bools:
        """Return (n,) whether the end of a milling cutter cuts at toolpath points."""
        found = self.toolpath.engagement
        return np.zeros(len(k), bool) if found is None else np.asarray(found.is_end_cut[k])

    def _check_grid(self, law: arm_compliance.ComplianceModel) -> VerificationCheck:
        """Which rows rest on a cell of the grid: all rows, whether or not they have a configuration."""
        T = self.T_base_workpiece
        _, holds = law.compute_joint_stiffness(rotate_vectors(T, self.toolpath.position[self.k]) + T[:, :3, 3])
        stated = self.points.words.get("stiffness_from", ())
        if not stated:
            return VerificationCheck(
                name="points.csv stiffness_from",
                passed=False,
                value=np.nan,
                limit=0.0,
                unit="rows",
                where="the column is missing",
            )
        wanted = ["grid" if len(cells) else "constant" for cells, _ in holds]
        return build_count_check(
            "points.csv stiffness_from",
            [
                f"point {p} rests on the {a}, not the {b}"
                for p, a, b in zip(self.points.point, stated, wanted, strict=True)
                if a != b
            ],
        )
