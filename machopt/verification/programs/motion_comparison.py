"""Comparison of a robot program with the exported motion: every target and every line lies on it.

Targets are found on the motion in order: each at or after the place of the one before. A target that is not ahead is
where the program goes elsewhere, goes back, or repeats. Between two targets the controller moves the tool tip on a
line and turns it about one axis (LIN), or interpolates all joints linearly (PTP). The samples of the motion must lie
on that. The controller's rounding of corners is not part of this.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.data_types.robot_program import LIN
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck, build_file_check
from machopt.verification.motion.checks.points_columns import JOINT_TOLERANCE_DEG
from machopt.verification.motion.path_geometry.motion_polyline import CommandedPath
from machopt.verification.motion.path_geometry.sample_location import AXIS_DEG, PATH_MM
from machopt.verification.programs.controller_interpolation import check_moves_between_targets
from machopt.verification.programs.target_matching import (
    MAX_JOINT_DISTANCE_RAD,
    TargetTolerances,
    build_worst_move_check,
    check_external_axes,
    match_targets,
)
from machopt.verification.tables.exported_tables import ExportedMotion

PLACE_TOLERANCE_M = 1e-8  # m: what the decimals of trajectory.csv's joints leave of a place where the tool is
BRANCH_TOLERANCE_FACTOR = (
    3.0  # of the orientation's tolerance: joints of a pose that has been compared only tell which branch it is
)

WHOLE_SAMPLE = 1e-6  # of a sample: nearer than this a target lies at it


def _check_joints(
    program: ProgramInCell, joints: Array, allowed: TargetTolerances, where: list[str]
) -> list[VerificationCheck]:
    """Return the checks of joint deviations (M,) rad: at joint targets, and on lines."""
    linear = program.kind == LIN
    checks = []
    for rows, what, most in (
        (np.isfinite(joints) & ~linear, CheckName.JOINTS, JOINT_TOLERANCE_DEG),
        (np.isfinite(joints) & linear, "joints on lines", BRANCH_TOLERANCE_FACTOR * float(np.degrees(allowed.turn))),
    ):
        if rows.any():
            k = np.flatnonzero(rows)
            limit = most + np.degrees(program.joint_step)
            checks.append(
                build_worst_move_check(program, what, "deg", np.degrees(joints[k]), limit, [where[n] for n in k])
            )
    return checks


def compare_with_motion(
    program: ProgramInCell,
    motion: ExportedMotion,
    tcp: Array,
    allowed: TargetTolerances,
    path: CommandedPath | None = None,
) -> tuple[list[VerificationCheck], Array]:
    """Compare a program with the motion.

    Args:
        program: the program.
        motion: trajectory.csv.
        tcp: (S, 3, 4) its poses in the workpiece by nominal kinematics.
        allowed: tolerances.
        path: the commanded path, whose corners lie between the samples; None: the samples alone are known.

    Returns:
        The checks; and (M,) the sample each move ends at, fractional, NaN where it ends nowhere on the motion.
    """
    at, gap, tilt, turn, joints = match_targets(program, motion, tcp, allowed, path)
    where = [f"move {k + 1}, line {line}" for k, line in enumerate(program.line.tolist())]
    linear = program.kind == LIN
    place = max(PATH_MM * 1e-3, allowed.corner, allowed.position) + program.place_step  # corners lie between samples
    checks = [
        build_worst_move_check(program, "targets on the motion", "mm", 1e3 * gap, 1e3 * place, where),
        build_worst_move_check(
            program,
            "tool axis at targets",
            "deg",
            np.degrees(tilt),
            max(AXIS_DEG, np.degrees(allowed.axis_corner)) + np.degrees(program.joint_step),
            where,
        ),
        build_worst_move_check(
            program,
            CheckName.ORIENTATIONS,
            "deg",
            np.degrees(turn),
            np.degrees(allowed.turn + program.joint_step),
            where,
        ),
    ]
    checks += _check_joints(program, joints, allowed, where)
    if motion.external.shape[1]:
        checks.append(check_external_axes(program, motion, tcp, at, allowed, where))
    checks.append(_check_completeness(program, motion, at))
    checks += [
        *check_moves_between_targets(program, motion, tcp, at, allowed, where),
        _check_move_kinds(program, motion, tcp[:, :3, 3], at, linear, where, 1e-3 * PATH_MM + place),
    ]
    if program.is_streamed:
        checks.append(_check_timing(program, motion, at, where))
    return checks, at


def _check_completeness(program: ProgramInCell, motion: ExportedMotion, at: Array) -> VerificationCheck:
    """The program begins where the motion does and leaves nothing of its end."""
    known = np.flatnonzero(np.isfinite(at))
    if not len(known):
        return build_file_check(
            program.file, "whole motion", False, float(len(at)), 0.0, "targets off", "no target is on it"
        )
    last = len(motion.time) - 1
    moved = np.zeros(last + 1, bool)
    for column in motion.joints.T:  # one by one: a million samples of all joints at once are a hundred MiB
        moved |= np.abs(column - column[-1]) > MAX_JOINT_DISTANCE_RAD
    end = int(np.flatnonzero(moved)[-1]) + 1 if moved.any() else 0  # at rest from here on
    start = np.abs(motion.q[: int(at[known[0]]) + 1] - motion.q[0]).max() if at[known[0]] > 0 else 0.0
    left = [f"it ends at sample {at[known[-1]]:.0f} of {last}"] if at[known[-1]] < end - 1 else []
    left += [f"it begins at sample {at[known[0]]:.0f}"] if start > MAX_JOINT_DISTANCE_RAD else []
    return build_file_check(
        program.file,
        "whole motion",
        not left,
        float(len(left)),
        0.0,
        "ends missing",
        "; ".join(left) or "from the first sample to the last",
    )


def _check_move_kinds(
    program: ProgramInCell,
    motion: ExportedMotion,
    p: Array,
    at: Array,
    linear: NDArray[np.bool_],
    where: list[str],
    place: float,
) -> VerificationCheck:
    """No joint move where the tool cuts, and what comments call a move is what the motion does there.

    A sample shows the way from the sample before; between lines, one that passes the first target shows both.
    Samples within ``place`` (m) of either target tell nothing: round a corner the tool dwells there, and it may stand
    on a point before it leaves it. Nor do samples at which the machine stands, of a joint move. Beside a joint move it
    is the decimals that the program prints: where the tool comes to rest many samples lie closer to the target than
    these.
    """
    ends = np.flatnonzero(np.isfinite(at[1:]) & np.isfinite(at[:-1])) + 1
    start, along = at[ends - 1], linear[ends] & linear[ends - 1]
    # between two lines the row before covers the target itself; beside a joint move the decimals decide, below
    first = np.where(along, np.ceil(start - WHOLE_SAMPLE) + 1.0, np.ceil(start + 0.5)).astype(np.int64)
    count = np.maximum(np.floor(at[ends] - 0.5).astype(np.int64) - first + 1, 0)
    nth = np.repeat(np.arange(len(ends)), count)  # of each sample between two targets: whose way it is
    rows = first[nth] + np.arange(len(nth)) - np.repeat(np.cumsum(count) - count, count)
    k = ends[nth]
    tip = program.T_workpiece_tcp[:, :3, 3]
    apart = np.minimum(*(np.linalg.norm(p[rows] - tip[n], axis=1) for n in (k - 1, k)))
    printed = program.print_resolution + PLACE_TOLERANCE_M
    is_informative = apart > np.where(linear[k] & linear[k - 1], place, printed)
    is_standing = np.append(False, np.ones(max(len(motion.time) - 1, 0), bool))
    for column in motion.joints.T:
        is_standing[1:] &= np.diff(column) == 0.0
    is_standing[:-1] |= is_standing[1:]
    is_informative &= (
        linear[k] | ~is_standing[rows]
    )  # joint targets are printed coarser than the place where the tool stands
    n, moves = len(at), motion.move[rows[is_informative]]
    seen, cuts, led = (
        np.bincount(k[is_informative][which], minlength=n) > 0
        for which in (slice(None), moves == MoveKind.CUT, moves != MoveKind.RAPID)
    )
    astray = seen & ~linear & led & (not program.is_streamed)
    called = seen & linear & ((program.move == MoveKind.CUT) != cuts)
    wrong = [
        f"{where[m]} is a joint move where the tool is led along the path"
        if astray[m]
        else f"{where[m]} is called {MoveKind(int(program.move[m])).word} where the motion says otherwise"
        for m in np.flatnonzero(astray | called).tolist()
    ]
    text = "; ".join(wrong[:3]) or "all agree"
    return build_file_check(program.file, "kinds of moves", not wrong, float(len(wrong)), 0.0, "moves", text)


def _check_timing(program: ProgramInCell, motion: ExportedMotion, at: Array, where: list[str]) -> VerificationCheck:
    """Streamed targets: one a control sample, each at its own time."""
    n = len(motion.time)
    if len(program) != n:
        return build_file_check(
            program.file,
            "one target a sample",
            False,
            float(len(program)),
            float(n),
            "targets",
            f"{len(program)} targets for {n} samples",
        )
    known = np.isfinite(program.time)
    off = (
        np.where(known, np.abs(program.time - program.time[known][0] - motion.time + motion.time[known][0]), np.inf)
        if (known.any())
        else np.full(n, np.inf)
    )
    off[0] = 0.0 if not known[0] else off[0]  # the first one may be a joint move without a time
    return build_worst_move_check(program, "times of the samples", "s", off, 2e-6, where)
