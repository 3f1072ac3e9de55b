"""Position of each program target along the motion, and its deviation from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_file_check
from machopt.verification.motion.path_geometry.motion_polyline import CommandedPath, build_motion_polyline
from machopt.verification.motion.path_geometry.sample_location import AXIS_DEG, AXIS_LEVER_M, PATH_MM
from machopt.verification.programs.ordered_matching import match_targets_in_order
from machopt.verification.tables.exported_tables import ExportedMotion

MAX_TARGET_DISTANCE_M = 2.5e-4  # m: a target farther from the motion is not on it; ten times what a right one is off
MAX_JOINT_DISTANCE_RAD = float(np.radians(0.3))  # rad, the same of joint targets
ARRIVAL_RAD = 1e-4  # rad: a right joint target is nearer, as samples and digits have it
MAX_UNMATCHED = 25  # targets that lie nowhere: enough to say so
EXTERNAL_TOLERANCE = 0.05  # mm or deg of an external axis at a target


@dataclass(frozen=True, kw_only=True)
class TargetTolerances:
    """Tolerances between a program and the motion it was written from."""

    position: float  # m between the controller's lines and the motion
    axis: float  # rad between the tool axes
    turn: float  # rad between the whole orientations
    corner: float  # m that the motion rounds corners by, at which the program has targets
    axis_corner: float  # rad, the same of the tool axis
    external: float = 1e-3  # m or rad of an external axis between the controller's even way and the motion's


def _compare_sample_by_sample(
    program: ProgramInCell, motion: ExportedMotion, tcp: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return what :func:`match_targets` does, for a program that has one target a sample."""
    R = tcp[:, :3, :3]
    turn = np.asarray(Rotation.from_matrix(np.swapaxes(R, -1, -2) @ program.T_workpiece_tcp[:, :3, :3]).magnitude())
    return (
        np.arange(len(program), dtype=float),
        np.linalg.norm(tcp[:, :3, 3] - program.T_workpiece_tcp[:, :3, 3], axis=1),
        np.linalg.norm(R[:, :, 2] - program.T_workpiece_tcp[:, :3, 2], axis=1),
        turn,
        np.abs(motion.q - program.q).max(axis=1),
    )


def match_targets(
    program: ProgramInCell,
    motion: ExportedMotion,
    tcp: Array,
    allowed: TargetTolerances,
    path: CommandedPath | None = None,
) -> tuple[Array, Array, Array, Array, Array]:
    """Return sample and deviations of each target: (M,) sample, m, rad (axis), rad (orientation), rad (joints).

    Args:
        program: The program in the cell's frames and units.
        motion: The exported motion (trajectory.csv), SI.
        tcp: (S, 3, 4) poses of the TCP in the workpiece frame by nominal kinematics.
        allowed: Tolerances of the comparison.
        path: The commanded path, whose corners lie between the samples; None: only the samples are known.
    """
    n = len(program)
    tilt, turn, joints = (np.full(n, np.nan) for _ in range(3))
    known: NDArray[np.bool_] = np.asarray(np.isfinite(program.q).all(axis=1))
    if program.is_streamed and n == len(tcp) and known.all():
        return _compare_sample_by_sample(program, motion, tcp)
    driven, wanted = motion.q, program.q
    if motion.external.shape[1] and np.isfinite(program.external).all():
        # rails and tables tell places apart as joints do; a metre counts as a radian
        driven, wanted = motion.joints, np.hstack([program.q, program.external])
    line = build_motion_polyline(motion, tcp, driven, path)
    p, R = line.position, line.rotation
    right = max(PATH_MM * 1e-3, allowed.corner, allowed.position) + program.place_step
    limits = [
        (right, max(MAX_JOINT_DISTANCE_RAD, 3.0 * program.joint_step)),
        (
            max(MAX_TARGET_DISTANCE_M, 3.0 * (allowed.corner + program.place_step)),
            max(MAX_JOINT_DISTANCE_RAD, 3.0 * program.joint_step),
        ),
    ]
    T = program.T_workpiece_tcp
    on_line, gap = match_targets_in_order(
        p,
        R,
        np.ascontiguousarray(line.joints, float),
        np.ascontiguousarray(T[:, :3, 3]),
        np.ascontiguousarray(T[:, :3, :3]),
        np.ascontiguousarray(wanted, float),
        known & (program.kind != LIN),
        np.array(limits),
        AXIS_LEVER_M,
        max(ARRIVAL_RAD, program.joint_step),
        MAX_UNMATCHED,
        np.asarray(~known & (program.kind != LIN)),
    )
    on = np.isfinite(on_line)
    gap[on], tilt[on], turn[on] = _compute_target_distance(on_line[on], T[on], p, R, allowed.corner)
    stated = on & known
    joints[stated] = np.abs(
        interpolate_rows(line.joints, on_line[stated])[:, : program.q.shape[1]] - program.q[stated]
    ).max(axis=1)
    return line.convert_to_sample(on_line), gap, tilt, turn, joints


def check_external_axes(
    program: ProgramInCell,
    motion: ExportedMotion,
    tcp: Array,
    at: Array,
    allowed: TargetTolerances,
    where: Sequence[str],
) -> VerificationCheck:
    """Check that every target states the external axis positions of its place along the motion.

    Where the motion rounds a corner, the place is uncertain by as much, and the axes may deviate accordingly.

    Args:
        program: The program in the cell's frames and units.
        motion: The exported motion (trajectory.csv), SI.
        tcp: (S, 3, 4) poses of the TCP in the workpiece frame.
        at: (M,) fractional samples at which the targets are reached.
        allowed: Tolerances of the comparison.
        where: (M,) place of each target in the program, for messages.
    """
    off = np.full(len(program), np.nan)
    on = np.flatnonzero(np.isfinite(at))
    a = np.clip(at[on].astype(np.int64), 0, len(tcp) - 1)
    b = np.minimum(a + 1, len(tcp) - 1)
    away = np.abs(interpolate_rows(motion.external, at[on]) - program.external[on])
    way = np.linalg.norm(tcp[b, :3, 3] - tcp[a, :3, 3], axis=1)
    share = np.minimum(max(allowed.corner, 1e-6) / np.maximum(way, 1e-6), 1.0)[:, None]
    loose = np.maximum(
        share * np.abs(motion.external[b] - motion.external[a]),
        _compute_rounding_tolerance(at[on], motion, tcp, allowed),
    )
    away = np.maximum(away - loose * (program.kind[on] == LIN)[:, None], 0.0)
    unit = np.where(motion.slides, 1e3, 180.0 / np.pi)
    off[on] = (away * unit).max(axis=1)
    missing = np.flatnonzero(~np.isfinite(program.external).all(axis=1))
    if len(missing):
        text = f"{where[int(missing[0])]} does not state the positions of the external axes"
        return build_file_check(
            program.file, "external axes at targets", False, np.nan, EXTERNAL_TOLERANCE, "mm or deg", text
        )
    return build_worst_move_check(
        program, "external axes at targets", "mm or deg", np.nan_to_num(off), EXTERNAL_TOLERANCE, where
    )


def _compute_rounding_tolerance(at: Array, motion: ExportedMotion, tcp: Array, allowed: TargetTolerances) -> Array:
    """(K, n) m or rad by which external axes may pass beside a target at places (K,), rounding their own bend there.

    Over ``allowed.corner`` before and after it, by half of what their slopes differ there; where they go evenly, none.
    """
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tcp[:, :3, 3], axis=0), axis=1)))
    here = np.interp(at, np.arange(len(way)), way)
    bend = np.empty((len(at), motion.external.shape[1]))
    for axis, value in enumerate(motion.external.T):
        begin, start, stop, end = (np.interp(here + n * allowed.corner, way, value) for n in (-2, -1, 1, 2))
        bend[:, axis] = 0.5 * np.abs((end - stop) - (start - begin))
    return bend


def _compute_target_distance(at: Array, T: Array, p: Array, R: Array, corner: float) -> tuple[Array, Array, Array]:
    """(K,) m, rad (axis), rad (orientation) from targets (K, 4, 4) to the motion's polyline at places (K,)."""
    last = len(p) - 1
    a = np.clip(at.astype(np.int64), 0, max(last - 1, 0))
    b = np.minimum(a + 1, last)
    share = (at - a)[:, None]
    gap = np.linalg.norm((1 - share) * p[a] + share * p[b] - T[:, :3, 3], axis=1)
    axis, wanted = R[:, :, 2], T[:, :3, 2]
    ends = np.minimum(*(np.linalg.norm(axis[n] - wanted, axis=1) for n in (a, b)))
    blend = (1 - share) * axis[a] + share * axis[b]
    blend /= np.maximum(np.linalg.norm(blend, axis=1, keepdims=True), 1e-12)
    z = np.minimum(ends, np.linalg.norm(blend - wanted, axis=1))
    # where the axis turns differently before and after, the chord between the samples cuts that corner
    before, after = axis[a] - axis[np.maximum(a - 1, 0)], axis[np.minimum(b + 1, last)] - axis[b]
    slack = share[:, 0] * (1 - share[:, 0]) * np.linalg.norm(after - before, axis=1)
    # and where the tool rounds the point, the foot is uncertain by as much along the path
    if corner > 0:
        way = np.linalg.norm(p[b] - p[a], axis=1)
        slack += np.minimum(corner / np.maximum(way, corner), 1.0) * np.linalg.norm(axis[b] - axis[a], axis=1)
    z = np.maximum(z - np.minimum(slack, np.radians(AXIS_DEG)), 0.0)
    nearest = np.where(share[:, 0] < 0.5, a, b)
    wide = share[:, :, None]
    turned = np.minimum(
        _compute_rotation_angle(R[nearest], T[:, :3, :3]),
        _compute_rotation_angle((1 - wide) * R[a] + wide * R[b], T[:, :3, :3]),
    )
    return gap, np.asarray(2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0))), turned


def _compute_rotation_angle(A: Array, B: Array) -> Array:
    """(K,) between rotations (K, 3, 3), exact for small angles."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(8.0), 0.0, 1.0)))


def interpolate_rows(values: Array, at: Array) -> Array:
    """Return (K, n) rows at fractional row numbers, by linear interpolation.

    Args:
        values: (S, n) rows.
        at: (K,) fractional row numbers.
    """
    a = np.clip(at.astype(np.int64), 0, len(values) - 1)
    b, f = np.minimum(a + 1, len(values) - 1), (at - a)[:, None]
    return np.asarray((1.0 - f) * values[a] + f * values[b])


def build_worst_move_check(
    program: ProgramInCell,
    what: str,
    unit: str,
    values: Array,
    limit: float,
    where: Sequence[str],
    move: NDArray[np.intp] | None = None,
) -> VerificationCheck:
    """Return a check of the greatest value; a NaN is worse than all.

    Args:
        program: The program in the cell's frames and units.
        what: Name of the checked quantity.
        unit: Unit of the value.
        values: (M,) value of each move; (K,) of samples where ``move`` is given.
        limit: The greatest allowed value.
        where: (M,) place of each move in the program, for messages.
        move: (K,) the move that each sample lies in.
    """
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    place = where[n if move is None else int(move[n])]
    return build_file_check(program.file, what, bool(values[n] <= limit), float(values[n]), float(limit), unit, place)
