"""Moves between a program's targets as the controller interpolates them, compared with the motion's samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck
from machopt.verification.motion.path_geometry.sample_location import AXIS_LEVER_M
from machopt.verification.programs.target_matching import (
    TargetTolerances,
    build_worst_move_check,
    interpolate_rows,
)
from machopt.verification.tables.exported_tables import ExportedMotion

MIN_LINE_M = 1e-4  # m: on a shorter line the place does not tell how far the tool has turned
MIN_AXIS_SINE = 1e-3  # sine of the angle between tool axis and rotation axis, below which the tool axis is undetermined
RAPID_TOLERANCE_DEG = 0.1  # deg: between rapid way points joints go straight; corners there are rounded in time only
SAME_PLACE_M = 2e-6  # m: two prints of one place, to a thousandth of a millimetre
BLOCK_ROWS = 10_000  # samples


def check_moves_between_targets(
    program: ProgramInCell, motion: ExportedMotion, tcp: Array, at: Array, allowed: TargetTolerances, where: list[str]
) -> list[VerificationCheck]:
    """Compare the motion's samples with the lines and joint moves that the controller interpolates between targets.

    Args:
        program: The program in the cell's frames and units.
        motion: The exported motion (trajectory.csv), SI.
        tcp: (S, 3, 4) poses of the TCP in the workpiece frame.
        at: (M,) fractional samples at which the targets are reached.
        allowed: Tolerances of the comparison.
        where: (M,) place of each target in the program, for messages.
    """
    known = np.flatnonzero(np.isfinite(at))
    if len(known) < 2 or program.is_streamed:
        return []
    rows = np.arange(len(tcp))
    nth = np.searchsorted(at[known], rows, side="left")
    inside = (nth > 0) & (nth < len(known))
    rows, nth = rows[inside], nth[inside]
    move, before = known[nth], known[nth - 1]
    joined = before == move - 1  # where one is missing there is no line to compare with
    rows, move = rows[joined], move[joined]
    linear = program.kind[move] == LIN
    checks = []
    if linear.any():
        checks += _check_lines(program, motion, tcp, (rows[linear], move[linear], at), allowed, where)
    if not linear.all():
        checks.append(_check_joint_moves(program, motion, (rows[~linear], move[~linear], at), known, where))
    return checks


_Samples = tuple[NDArray[np.intp], NDArray[np.intp], Array]  # rows of the motion, the move each lies in, ``at``


def _check_lines(
    program: ProgramInCell,
    motion: ExportedMotion,
    tcp: Array,
    samples: _Samples,
    allowed: TargetTolerances,
    where: list[str],
) -> list[VerificationCheck]:
    """Compare samples with the straight lines between targets."""
    rows, move, at = samples
    checks = []
    off = np.vstack([_compute_line_deviations(program, tcp, rows[some], move[some]) for some in _list_blocks(rows)])
    names = [f"the move to {place}" for place in where]
    for column, (what, unit, limit, scale) in enumerate(
        (
            (CheckName.LINES, "mm", allowed.position + program.place_step, 1e3),
            (CheckName.LINES_AXIS, "deg", allowed.axis + program.joint_step, 180.0 / np.pi),
            (CheckName.LINES_TURN, "deg", allowed.turn + program.joint_step, 180.0 / np.pi),
        )
    ):
        values, largest = scale * off[:, column], scale * limit
        checks.append(build_worst_move_check(program, what, unit, values, largest, names, move))
    if motion.external.shape[1]:
        checks.append(_check_external_axes(program, motion, rows, move, off[:, 3], at, allowed, names))
    return checks


def _check_joint_moves(
    program: ProgramInCell,
    motion: ExportedMotion,
    samples: _Samples,
    known: NDArray[np.intp],
    where: list[str],
) -> VerificationCheck:
    """Compare samples with joint moves between targets."""
    rows, move, at = samples
    driven, stated = motion.joints, np.hstack([program.q, program.external])
    q = np.full((len(at), driven.shape[1]), np.nan)
    q[known] = interpolate_rows(driven, at[known])
    joint = np.isfinite(stated).all(axis=1)
    q[joint] = stated[joint]
    bow = np.concatenate(
        [
            _compute_joint_line_deviation(driven[rows[some]], q[move[some] - 1], q[move[some]])
            for some in _list_blocks(rows)
        ]
    )
    names = [f"the move to {place}" for place in where]
    limit = RAPID_TOLERANCE_DEG + float(np.degrees(program.joint_step))
    what = "joint moves along the motion"
    return build_worst_move_check(program, what, "deg", np.degrees(bow), limit, names, move)


def _list_blocks(rows: NDArray[np.intp]) -> list[slice]:
    """Return the blocks in which samples are compared, so that the memory does not grow with the motion."""
    return [slice(k, k + BLOCK_ROWS) for k in range(0, len(rows), BLOCK_ROWS)]


def _compute_line_deviations(
    program: ProgramInCell, tcp: Array, rows: NDArray[np.intp], move: NDArray[np.intp]
) -> Array:
    """Return (K, 4) of :func:`_compute_line_deviation` for samples ``rows`` (K,) on the lines to ``move`` (K,).

    Samples at a target's place where only the orientation turns may be on the line before or after it: the better.
    """
    T = program.T_workpiece_tcp
    off = _compute_line_deviation(tcp[rows], T[move - 1], T[move])
    for end, other in ((move, move + 1), (move - 1, move - 1)):
        there = (other >= 1) & (other < len(program))
        there[there] &= program.kind[other[there]] == LIN
        there &= np.linalg.norm(tcp[rows, :3, 3] - T[end, :3, 3], axis=1) < SAME_PLACE_M + program.print_resolution
        k = np.flatnonzero(there)
        k = k[
            np.linalg.norm(T[other[k], :3, 3] - T[other[k] - 1, :3, 3], axis=1)
            < SAME_PLACE_M + program.print_resolution
        ]
        if len(k):
            second = _compute_line_deviation(tcp[rows[k]], T[other[k] - 1], T[other[k]])
            less = np.hypot(second[:, 0], AXIS_LEVER_M * second[:, 1]) < np.hypot(off[k, 0], AXIS_LEVER_M * off[k, 1])
            off[k[less]] = second[less]
    return off


def _check_external_axes(
    program: ProgramInCell,
    motion: ExportedMotion,
    rows: NDArray[np.int64],
    move: NDArray[np.int64],
    share: Array,
    at: Array,
    allowed: TargetTolerances,
    names: list[str],
) -> VerificationCheck:
    """External axes at samples against the even way that the controller makes of them between two targets.

    The place of a sample on its line is known to the corner that the motion rounds there, over which they move on.
    """
    known = np.isfinite(at)
    ends = np.full((len(at), motion.external.shape[1]), np.nan)
    ends[known] = interpolate_rows(motion.external, at[known])
    ends = np.where(np.isfinite(program.external), program.external, ends)
    whole = ends[move] - ends[move - 1]
    tip = program.T_workpiece_tcp[:, :3, 3]
    way = np.linalg.norm(tip[move] - tip[move - 1], axis=1)
    loose = np.minimum(max(allowed.corner, allowed.position) / np.maximum(way, 1e-9), 1.0)[:, None] * np.abs(whole)
    off = np.maximum(np.abs(motion.external[rows] - ends[move - 1] - share[:, None] * whole) - loose, 0.0)
    most, n = allowed.external, int(np.argmax(off.max(axis=1)))
    axis = int(np.argmax(off[n]))
    away = f"{1e3 * off[n, axis]:.3g} mm" if motion.slides[axis] else f"{np.degrees(off[n, axis]):.3g} deg"
    words = f"of {1e3 * most:g} mm or {np.degrees(most):.3g} deg"
    what, share_used = "external axes along lines", off.max(axis=1) / most
    check = build_worst_move_check(program, what, words, share_used, 1.0, names, move)
    return replace(check, where=f"{check.where}: e{axis + 1} by {away}")


def _compute_line_deviation(T: Array, A: Array, B: Array) -> Array:
    """(K, 4) m, rad, rad, share: poses against even moves A → B, tip straight, orientation about one axis."""
    way = B[:, :3, 3] - A[:, :3, 3]
    length2 = np.einsum("ij,ij->i", way, way)
    along = np.einsum("ij,ij->i", T[:, :3, 3] - A[:, :3, 3], way)
    share = np.clip(np.where(length2 > 0.0, along / np.where(length2 > 0.0, length2, 1.0), 0.0), 0.0, 1.0)
    start = Rotation.from_matrix(A[:, :3, :3])
    whole = (start.inv() * Rotation.from_matrix(B[:, :3, :3])).as_rotvec()
    now = Rotation.from_matrix(T[:, :3, :3])
    turned, swept = _compute_turn_share(whole, start.inv().apply(T[:, :3, 2]), (start.inv() * now).magnitude())
    share = np.where(AXIS_LEVER_M * swept > np.sqrt(length2), turned, share)
    gap = np.linalg.norm(T[:, :3, 3] - A[:, :3, 3] - share[:, None] * way, axis=1)
    share = np.where(length2 < MIN_LINE_M**2, turned, share)
    there = start * Rotation.from_rotvec(share[:, None] * whole)
    z = np.linalg.norm(there.apply([0.0, 0.0, 1.0]) - T[:, :3, 2], axis=1)
    return np.column_stack([gap, 2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0)), (there.inv() * now).magnitude(), share])


def _compute_turn_share(whole: Array, axis: Array, turned: Array) -> tuple[Array, Array]:
    """How far a rotation about one axis has come, by where the tool axis is.

    Args:
        whole: (K, 3) rad, the rotation vector of the whole move in the frame of its start.
        axis: (K, 3) the TCP's z in that frame now.
        turned: (K,) rad between the orientations of the start and now; used where the rotation is about z itself.

    Returns:
        (K,) share, 0 to 1; (K,) rad, length of the arc that the TCP's z moves along.
    """
    angle = np.linalg.norm(whole, axis=1)
    u = whole / np.where(angle > 1e-12, angle, 1.0)[:, None]
    start = np.array([0.0, 0.0, 1.0]) - u[:, 2:] * u
    flat = axis - np.einsum("ij,ij->i", axis, u)[:, None] * u
    radius = np.linalg.norm(start, axis=1)
    done = np.arctan2(np.einsum("ij,ij->i", u, np.cross(start, flat)), np.einsum("ij,ij->i", start, flat))
    done = np.where(radius > MIN_AXIS_SINE, done, turned)
    return np.clip(done / np.where(angle > 1e-12, angle, 1.0), 0.0, 1.0), angle * radius


def _compute_joint_line_deviation(q: Array, a: Array, b: Array) -> Array:
    """(K,) rad: the axis farthest from the straight joint move a → b at its nearest place."""
    way = b - a
    length2 = np.einsum("ij,ij->i", way, way)
    share = np.einsum("ij,ij->i", q - a, way) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(np.abs(q - a - np.clip(share, 0.0, 1.0)[:, None] * way).max(axis=1))
