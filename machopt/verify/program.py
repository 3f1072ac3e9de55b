"""A robot program held against the exported motion: every target lies on it, every line leads along it.

Targets are found on the motion in order: the n-th one at or after the place of the one before. One that is nowhere
ahead is where the program goes elsewhere, goes back, or goes twice. Between two targets the controller leads the tool
tip straight and turns it evenly about one axis (LIN), or all joints straight in joint space (PTP); the samples of the
motion must lie on that. What the controller makes of the corners is its own matter and not part of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.arrays import Array
from machopt.domain.program import LIN
from machopt.domain.readprogram import ReadProgram
from machopt.domain.toolpath import Move
from machopt.verify.check import Check, Promise, of_file
from machopt.verify.inorder import targets_in_order
from machopt.verify.points import JOINT_DEG
from machopt.verify.ride import AXIS_DEG, PATH_MM
from machopt.verify.table import Motion

LEVER = 0.01  # m: an angle counts as much as the way it moves a point so far from the tip, to tell places apart
NEAR = 2.5e-4  # m: a target farther from the motion is not on it; ten times what a right one is off
NEAR_JOINT = float(np.radians(0.3))  # rad, the same of joint targets
GIVEN_UP = 25  # targets that lie nowhere: enough to say so
SHORT = 1e-4  # m: on a shorter line the place does not tell how far the tool has turned
RAPID_DEG = 0.1  # deg: between rapid way points joints go straight; corners there are rounded in time only
EXTERNAL = 0.05  # mm or deg of an external axis at a target
PRINTED = 2.0  # of the step that a program prints places in: how far from a target the tool may be said to stand on it
SPOT = 2e-6  # m: two prints of one place, to a thousandth of a millimetre
SAME_PLACE = 1e-8  # m: what the decimals of trajectory.csv's joints leave of a place where the tool stands
BRANCH = 3.0  # of the orientation's tolerance: joints of a pose that has been compared only tell which branch it is
AT_ONCE = 50_000  # samples


@dataclass(frozen=True)
class Allowed:
    """How far a program may be from the motion it was written from."""

    position: float  # m between the controller's lines and the motion
    axis: float  # rad between the tool axes
    turn: float  # rad between the whole orientations
    corner: float  # m that the motion rounds corners by, at which the program has targets
    axis_corner: float  # rad, the same of the tool axis
    external: float = 1e-3  # m or rad of an external axis between the controller's even way and the motion's


def along_motion(said: ReadProgram, motion: Motion, tcp: Array, allowed: Allowed) -> tuple[list[Check], Array]:
    """Compare a program with the motion.

    Args:
        said: the program.
        motion: trajectory.csv.
        tcp: (S, 4, 4) its poses in the workpiece by nominal kinematics.
        allowed: tolerances.

    Returns:
        The checks; and (M,) the sample each move ends at, fractional, NaN where it ends nowhere on the motion.
    """
    at, gap, tilt, turn, joints = _matched(said, motion, tcp, allowed)
    where = [f"move {k + 1}, line {line}" for k, line in enumerate(said.line.tolist())]
    linear = said.kind == LIN
    place = max(PATH_MM * 1e-3, allowed.corner, allowed.position) + said.place_step  # corners lie between samples
    checks = [
        _worst(said, "targets on the motion", "mm", 1e3 * gap, 1e3 * place, where),
        _worst(
            said,
            "tool axis at targets",
            "deg",
            np.degrees(tilt),
            max(AXIS_DEG, np.degrees(allowed.axis_corner)) + np.degrees(said.joint_step),
            where,
        ),
        _worst(said, Promise.ORIENTATIONS, "deg", np.degrees(turn), np.degrees(allowed.turn + said.joint_step), where),
    ]
    for rows, what, most in (
        (np.isfinite(joints) & ~linear, Promise.JOINTS, JOINT_DEG),
        (np.isfinite(joints) & linear, "joints on lines", BRANCH * float(np.degrees(allowed.turn))),
    ):
        if rows.any():
            k = np.flatnonzero(rows)
            checks.append(
                _worst(
                    said, what, "deg", np.degrees(joints[k]), most + np.degrees(said.joint_step), [where[n] for n in k]
                )
            )
    if motion.external.shape[1]:
        checks.append(_external(said, motion, tcp, at, allowed, where))
    checks.append(_whole(said, motion, at))
    checks += [
        *_lines(said, motion, tcp, at, allowed, where),
        _kinds(said, motion, tcp[:, :3, 3], at, linear, where, 1e-3 * PATH_MM + place),
    ]
    if said.streamed:
        checks.append(_timed(said, motion, at, where))
    return checks, at


def _worst(said: ReadProgram, what: str, unit: str, values: Array, limit: float, where: Sequence[str]) -> Check:
    """The greatest of ``values``; a NaN is worse than all."""
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    return of_file(said.file, what, bool(values[n] <= limit), float(values[n]), float(limit), unit, where[n])


def _matched(
    said: ReadProgram, motion: Motion, tcp: Array, allowed: Allowed
) -> tuple[Array, Array, Array, Array, Array]:
    """(M,) sample, m, rad (axis), rad (orientation), rad (joints) of each target to the motion there."""
    n = len(said)
    tilt, turn, joints = (np.full(n, np.nan) for _ in range(3))
    p, R = tcp[:, :3, 3], tcp[:, :3, :3]
    near = max(NEAR, 3.0 * (allowed.corner + said.place_step))
    near_joint = max(NEAR_JOINT, 3.0 * said.joint_step)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(said.q).all(axis=1))
    driven, wanted = motion.q, said.q
    if np.isfinite(said.external).all():  # rails and tables tell places apart as joints do; a metre counts as a radian
        driven, wanted = np.hstack([motion.q, motion.external]), np.hstack([said.q, said.external])
    if said.streamed and n == len(p) and known.all():
        turn = np.asarray(Rotation.from_matrix(np.swapaxes(R, -1, -2) @ said.T_workpiece_tcp[:, :3, :3]).magnitude())
        return (
            np.arange(n, dtype=float),
            np.linalg.norm(p - said.T_workpiece_tcp[:, :3, 3], axis=1),
            np.linalg.norm(R[:, :, 2] - said.T_workpiece_tcp[:, :3, 2], axis=1),
            turn,
            np.abs(motion.q - said.q).max(axis=1),
        )
    # a target between two samples is up to half of what they are apart from the nearer one
    gone = _longest(
        np.linalg.norm(np.diff(p, axis=0), axis=1) + LEVER * np.linalg.norm(np.diff(R, axis=0), axis=(1, 2))
    )
    swept = _longest(np.abs(np.diff(driven, axis=0)).max(axis=1))
    by_joints = known & (said.kind != LIN)
    T = said.T_workpiece_tcp
    nearest, at, gap = targets_in_order(
        np.ascontiguousarray(p),
        np.ascontiguousarray(R),
        np.ascontiguousarray(driven, float),
        np.ascontiguousarray(T[:, :3, 3]),
        np.ascontiguousarray(T[:, :3, :3]),
        np.ascontiguousarray(wanted, float),
        by_joints,
        near + 0.5 * gone,
        near_joint + 0.5 * swept,
        LEVER,
        GIVEN_UP,
    )
    on = nearest >= 0
    gap[on], tilt[on], turn[on] = _foot(at[on], T[on], p, R, allowed.corner)
    told = on & known
    joints[told] = np.abs(_between(motion.q, at[told]) - said.q[told]).max(axis=1)
    return at, gap, tilt, turn, joints


def _external(
    said: ReadProgram, motion: Motion, tcp: Array, at: Array, allowed: Allowed, where: Sequence[str]
) -> Check:
    """Every target says where rails and positioners stand, and they stand there at that place of the motion.

    Where the motion rounds a corner of the program, the place along it is known to as much, and they leave a bend
    of their own to the same way before and after it.
    """
    off = np.full(len(said), np.nan)
    on = np.flatnonzero(np.isfinite(at))
    a = np.clip(at[on].astype(np.int64), 0, len(tcp) - 1)
    b = np.minimum(a + 1, len(tcp) - 1)
    away = np.abs(_between(motion.external, at[on]) - said.external[on])
    way = np.linalg.norm(tcp[b, :3, 3] - tcp[a, :3, 3], axis=1)
    share = np.minimum(max(allowed.corner, 1e-6) / np.maximum(way, 1e-6), 1.0)[:, None]
    loose = np.maximum(share * np.abs(motion.external[b] - motion.external[a]), _rounded(at[on], motion, tcp, allowed))
    away = np.maximum(away - loose * (said.kind[on] == LIN)[:, None], 0.0)
    unit = np.where(motion.slides, 1e3, 180.0 / np.pi)
    off[on] = (away * unit).max(axis=1)
    missing = np.flatnonzero(~np.isfinite(said.external).all(axis=1))
    if len(missing):
        text = f"{where[int(missing[0])]} does not say where the external axes stand"
        return of_file(said.file, "external axes at targets", False, np.nan, EXTERNAL, "mm or deg", text)
    return _worst(said, "external axes at targets", "mm or deg", np.nan_to_num(off), EXTERNAL, where)


def _rounded(at: Array, motion: Motion, tcp: Array, allowed: Allowed) -> Array:
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


def _longest(step: Array) -> Array:
    """(S,) the longer of the ways to the sample before and to the one after."""
    return np.asarray(np.maximum(np.append(0.0, step), np.append(step, 0.0)))


def _foot(at: Array, T: Array, p: Array, R: Array, corner: float) -> tuple[Array, Array, Array]:
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
    turned = np.minimum(_angle(R[nearest], T[:, :3, :3]), _angle((1 - wide) * R[a] + wide * R[b], T[:, :3, :3]))
    return gap, np.asarray(2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0))), turned


def _angle(A: Array, B: Array) -> Array:
    """(K,) between rotations (K, 3, 3), exact for small angles."""
    return np.asarray(2.0 * np.arcsin(np.clip(np.linalg.norm(A - B, axis=(1, 2)) / np.sqrt(8.0), 0.0, 1.0)))


def _between(values: Array, at: Array) -> Array:
    """(K, n) rows of (S, n) at fractional places (K,)."""
    a = np.clip(at.astype(np.int64), 0, len(values) - 1)
    b, f = np.minimum(a + 1, len(values) - 1), (at - a)[:, None]
    return np.asarray((1.0 - f) * values[a] + f * values[b])


def _whole(said: ReadProgram, motion: Motion, at: Array) -> Check:
    """The program begins where the motion does and leaves nothing of its end."""
    known = np.flatnonzero(np.isfinite(at))
    if not len(known):
        return of_file(said.file, "whole motion", False, float(len(at)), 0.0, "targets off", "no target is on it")
    last = len(motion.time) - 1
    driven = np.hstack([motion.q, motion.external])
    moved = np.abs(driven - driven[-1]).max(axis=1) > NEAR_JOINT
    end = int(np.flatnonzero(moved)[-1]) + 1 if moved.any() else 0  # at rest from here on
    start = np.abs(motion.q[: int(at[known[0]]) + 1] - motion.q[0]).max() if at[known[0]] > 0 else 0.0
    left = [f"it ends at sample {at[known[-1]]:.0f} of {last}"] if at[known[-1]] < end - 1 else []
    left += [f"it begins at sample {at[known[0]]:.0f}"] if start > NEAR_JOINT else []
    return of_file(
        said.file,
        "whole motion",
        not left,
        float(len(left)),
        0.0,
        "ends missing",
        "; ".join(left) or "from the first sample to the last",
    )


def _lines(said: ReadProgram, motion: Motion, tcp: Array, at: Array, allowed: Allowed, where: list[str]) -> list[Check]:
    """The motion's samples against what the controller draws between the targets."""
    known = np.flatnonzero(np.isfinite(at))
    if len(known) < 2 or said.streamed:
        return []
    rows = np.arange(len(tcp))
    nth = np.searchsorted(at[known], rows, side="left")
    inside = (nth > 0) & (nth < len(known))
    rows, nth = rows[inside], nth[inside]
    move, before = known[nth], known[nth - 1]
    joined = before == move - 1  # where one is missing there is no line to compare with
    rows, move = rows[joined], move[joined]
    linear = said.kind[move] == LIN
    checks = []
    if linear.any():
        off = np.vstack(
            [
                _off_line(
                    tcp[rows[linear][k : k + AT_ONCE]],
                    said.T_workpiece_tcp[move[linear][k : k + AT_ONCE] - 1],
                    said.T_workpiece_tcp[move[linear][k : k + AT_ONCE]],
                )
                for k in range(0, int(linear.sum()), AT_ONCE)
            ]
        )
        _on_the_spot(off, said, tcp, rows[linear], move[linear])
        ways = [f"on the way to {where[k]}" for k in move[linear]]
        for column, (what, unit, limit, scale) in enumerate(
            (
                (Promise.LINES, "mm", allowed.position + said.place_step, 1e3),
                (Promise.LINES_AXIS, "deg", allowed.axis + said.joint_step, 180.0 / np.pi),
                (Promise.LINES_TURN, "deg", allowed.turn + said.joint_step, 180.0 / np.pi),
            )
        ):
            checks.append(_worst(said, what, unit, scale * off[:, column], scale * limit, ways))
        if motion.external.shape[1]:
            checks.append(_along(said, motion, rows[linear], move[linear], off[:, 3], at, allowed, ways))
    if not linear.all():
        pick = np.flatnonzero(~linear)
        driven, told = np.hstack([motion.q, motion.external]), np.hstack([said.q, said.external])
        q = np.full((len(at), driven.shape[1]), np.nan)
        q[known] = _between(driven, at[known])
        joint = np.isfinite(told).all(axis=1)
        q[joint] = told[joint]
        bow = _off_joint_line(driven[rows[pick]], q[move[pick] - 1], q[move[pick]])
        ways = [f"on the way to {where[k]}" for k in move[pick]]
        limit = RAPID_DEG + float(np.degrees(said.joint_step))
        checks.append(_worst(said, "joint moves along the motion", "deg", np.degrees(bow), limit, ways))
    return checks


def _on_the_spot(off: Array, said: ReadProgram, tcp: Array, rows: NDArray[np.intp], move: NDArray[np.intp]) -> None:
    """Samples at a target's place where only the orientation turns may be on the way before or after it: the better.

    Args:
        off: (K, 4) of samples ``rows`` (K,) against the ways to ``move`` (K,); changed in place.
    """
    T = said.T_workpiece_tcp
    for end, other in ((move, move + 1), (move - 1, move - 1)):
        there = (other >= 1) & (other < len(said))
        there[there] &= said.kind[other[there]] == LIN
        there &= np.linalg.norm(tcp[rows, :3, 3] - T[end, :3, 3], axis=1) < SPOT + said.place_step
        k = np.flatnonzero(there)
        k = k[np.linalg.norm(T[other[k], :3, 3] - T[other[k] - 1, :3, 3], axis=1) < SPOT]
        if len(k):
            second = _off_line(tcp[rows[k]], T[other[k] - 1], T[other[k]])
            less = second[:, 1] < off[k, 1]
            off[k[less]] = second[less]


def _along(
    said: ReadProgram,
    motion: Motion,
    rows: NDArray[np.int64],
    move: NDArray[np.int64],
    share: Array,
    at: Array,
    allowed: Allowed,
    ways: list[str],
) -> Check:
    """External axes at samples against the even way that the controller makes of them between two targets.

    The place of a sample on its line is known to the corner that the motion rounds there, over which they move on.
    """
    known = np.isfinite(at)
    ends = np.full((len(at), motion.external.shape[1]), np.nan)
    ends[known] = _between(motion.external, at[known])
    ends = np.where(np.isfinite(said.external), said.external, ends)
    whole = ends[move] - ends[move - 1]
    tip = said.T_workpiece_tcp[:, :3, 3]
    way = np.linalg.norm(tip[move] - tip[move - 1], axis=1)
    loose = np.minimum(max(allowed.corner, allowed.position) / np.maximum(way, 1e-9), 1.0)[:, None] * np.abs(whole)
    off = np.maximum(np.abs(motion.external[rows] - ends[move - 1] - share[:, None] * whole) - loose, 0.0)
    most, n = allowed.external, int(np.argmax(off.max(axis=1)))
    axis = int(np.argmax(off[n]))
    away = f"{1e3 * off[n, axis]:.3g} mm" if motion.slides[axis] else f"{np.degrees(off[n, axis]):.3g} deg"
    words = f"of {1e3 * most:g} mm or {np.degrees(most):.3g} deg"
    check = _worst(said, "external axes along lines", words, off.max(axis=1) / most, 1.0, ways)
    return replace(check, where=f"{check.where}: e{axis + 1} by {away}")


def _off_line(T: Array, A: Array, B: Array) -> Array:
    """(K, 4) m, rad, rad, share: poses against even moves A → B, tip straight, orientation about one axis."""
    way = B[:, :3, 3] - A[:, :3, 3]
    length2 = np.einsum("ij,ij->i", way, way)
    along = np.einsum("ij,ij->i", T[:, :3, 3] - A[:, :3, 3], way)
    share = np.clip(np.where(length2 > 0.0, along / np.where(length2 > 0.0, length2, 1.0), 0.0), 0.0, 1.0)
    gap = np.linalg.norm(T[:, :3, 3] - A[:, :3, 3] - share[:, None] * way, axis=1)
    start = Rotation.from_matrix(A[:, :3, :3])
    whole = (start.inv() * Rotation.from_matrix(B[:, :3, :3])).as_rotvec()
    now = Rotation.from_matrix(T[:, :3, :3])
    angle = np.linalg.norm(whole, axis=1)
    done = (start.inv() * now).magnitude()
    share = np.where(length2 < SHORT**2, np.clip(done / np.where(angle > 1e-12, angle, 1.0), 0.0, 1.0), share)
    there = start * Rotation.from_rotvec(share[:, None] * whole)
    z = np.linalg.norm(there.apply([0.0, 0.0, 1.0]) - T[:, :3, 2], axis=1)
    return np.column_stack([gap, 2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0)), (there.inv() * now).magnitude(), share])


def _off_joint_line(q: Array, a: Array, b: Array) -> Array:
    """(K,) rad: the axis farthest from the straight joint move a → b at its nearest place."""
    way = b - a
    length2 = np.einsum("ij,ij->i", way, way)
    share = np.einsum("ij,ij->i", q - a, way) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(np.abs(q - a - np.clip(share, 0.0, 1.0)[:, None] * way).max(axis=1))


def _kinds(
    said: ReadProgram, motion: Motion, p: Array, at: Array, linear: NDArray[np.bool_], where: list[str], place: float
) -> Check:
    """No joint move where the tool cuts, and what comments call a move is what the motion does there.

    Samples within ``place`` (m) of either target tell nothing: round a corner the tool dwells there, and it may stand
    on a point before it leaves it. Nor do samples at which the machine stands, of a joint move. Beside a joint move it
    is the decimals that the program prints: where the tool comes to rest many samples lie closer to the target than
    these.
    """
    ends = np.flatnonzero(np.isfinite(at[1:]) & np.isfinite(at[:-1])) + 1
    first = np.ceil(at[ends - 1] + 0.5).astype(np.int64)
    count = np.maximum(np.floor(at[ends] - 0.5).astype(np.int64) - first + 1, 0)
    nth = np.repeat(np.arange(len(ends)), count)  # of each sample between two targets: whose way it is
    rows = first[nth] + np.arange(len(nth)) - np.repeat(np.cumsum(count) - count, count)
    k = ends[nth]
    tip = said.T_workpiece_tcp[:, :3, 3]
    apart = np.minimum(*(np.linalg.norm(p[rows] - tip[n], axis=1) for n in (k - 1, k)))
    tells = apart > np.where(linear[k] & linear[k - 1], place, PRINTED * said.place_step + SAME_PLACE)
    x = np.hstack([motion.q, motion.external])
    stands = np.r_[False, (np.diff(x, axis=0) == 0.0).all(axis=1)]
    stands[:-1] |= stands[1:]
    tells &= linear[k] | ~stands[rows]  # joint targets are printed coarser than the place where the tool stands
    n, moves = len(at), motion.move[rows[tells]]
    seen, cuts, led = (
        np.bincount(k[tells][which], minlength=n) > 0 for which in (slice(None), moves == Move.CUT, moves != Move.RAPID)
    )
    astray = seen & ~linear & led & (not said.streamed)
    called = seen & linear & ((said.move == Move.CUT) != cuts)
    wrong = [
        f"{where[m]} is a joint move where the tool is led along the path"
        if astray[m]
        else f"{where[m]} is called {Move(int(said.move[m])).word} where the motion says otherwise"
        for m in np.flatnonzero(astray | called).tolist()
    ]
    text = "; ".join(wrong[:3]) or "all agree"
    return of_file(said.file, "kinds of moves", not wrong, float(len(wrong)), 0.0, "moves", text)


def _timed(said: ReadProgram, motion: Motion, at: Array, where: list[str]) -> Check:
    """Streamed targets: one a control sample, each at its own time."""
    n = len(motion.time)
    if len(said) != n:
        return of_file(
            said.file,
            "one target a sample",
            False,
            float(len(said)),
            float(n),
            "targets",
            f"{len(said)} targets for {n} samples",
        )
    known = np.isfinite(said.time)
    off = (
        np.where(known, np.abs(said.time - said.time[known][0] - motion.time + motion.time[known][0]), np.inf)
        if (known.any())
        else np.full(n, np.inf)
    )
    off[0] = 0.0 if not known[0] else off[0]  # the first one may be a joint move without a time
    return _worst(said, "times of the samples", "s", off, 2e-6, where)
