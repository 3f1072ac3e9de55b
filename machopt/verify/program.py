"""A robot program held against the exported motion: every target lies on it, every line leads along it.

Targets are found on the motion in order: the n-th one at or after the place of the one before. One that is nowhere
ahead is where the program goes elsewhere, goes back, or goes twice. Between two targets the controller leads the tool
tip straight and turns it evenly about one axis (LIN), or all joints straight in joint space (PTP); the samples of the
motion must lie on that. What the controller makes of the corners is its own matter and not part of this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.domain.program import LIN
from machopt.domain.readprogram import ReadProgram
from machopt.domain.toolpath import Move
from machopt.verify.check import Check
from machopt.verify.points import JOINT_DEG
from machopt.verify.ride import AXIS_DEG, PATH_MM
from machopt.verify.table import Motion

Array = NDArray[np.float64]

LEVER = 0.01  # m: an angle counts as much as the way it moves a point so far from the tip, to tell places apart
NEAR = 2.5e-4  # m: a target farther from the motion is not on it; ten times what a right one is off
NEAR_JOINT = float(np.radians(0.3))  # rad, the same of joint targets
GIVEN_UP = 25  # targets that lie nowhere: enough to say so
FIRST_WINDOW = 128  # samples
SHORT = 1e-4  # m: on a shorter line the place does not tell how far the tool has turned
RAPID_DEG = 0.1  # deg: between rapid way points joints go straight; corners there are rounded in time only
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


def along_motion(
    said: ReadProgram, motion: Motion, tcp: Array, allowed: Allowed
) -> tuple[list[Check], Array]:  # fmt: skip
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
        _worst(said, "tool axis at targets", "deg", np.degrees(tilt),
               max(AXIS_DEG, np.degrees(allowed.axis_corner)) + np.degrees(said.joint_step), where),
        _worst(said, "orientation at targets", "deg", np.degrees(turn),
               np.degrees(allowed.turn + said.joint_step), where),
    ]  # fmt: skip
    for rows, what, most in (
        (np.isfinite(joints) & ~linear, "joints at targets", JOINT_DEG),
        (np.isfinite(joints) & linear, "joints on lines", BRANCH * float(np.degrees(allowed.turn))),
    ):  # fmt: skip
        if rows.any():
            k = np.flatnonzero(rows)
            checks.append(_worst(said, what, "deg", np.degrees(joints[k]), most + np.degrees(said.joint_step),
                                 [where[n] for n in k]))  # fmt: skip
    checks.append(_whole(said, motion, at))
    checks += [
        *_lines(said, motion, tcp, at, allowed, where),
        _kinds(said, motion, tcp[:, :3, 3], at, linear, where, 1e-3 * PATH_MM + place),
    ]
    if said.streamed:
        checks.append(_timed(said, motion, at, where))
    return checks, at


def _worst(
    said: ReadProgram, what: str, unit: str, values: Array, limit: float, where: Sequence[str]
) -> Check:  # fmt: skip
    """The greatest of ``values``; a NaN is worse than all."""
    n = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    return Check(f"{said.file}: {what}", bool(values[n] <= limit), float(values[n]), float(limit), unit, where[n])


def _matched(
    said: ReadProgram, motion: Motion, tcp: Array, allowed: Allowed
) -> tuple[Array, Array, Array, Array, Array]:
    """(M,) sample, m, rad (axis), rad (orientation), rad (joints) of each target to the motion there."""
    n = len(said)
    at, gap, tilt, turn, joints = (np.full(n, np.nan) for _ in range(5))
    p, R = tcp[:, :3, 3], tcp[:, :3, :3]
    near = max(NEAR, 3.0 * (allowed.corner + said.place_step))
    near_joint = max(NEAR_JOINT, 3.0 * said.joint_step)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(said.q).all(axis=1))
    if said.streamed and n == len(p) and known.all():
        turn = np.asarray(Rotation.from_matrix(np.swapaxes(R, -1, -2) @ said.T_workpiece_tcp[:, :3, :3]).magnitude())
        return (np.arange(n, dtype=float), np.linalg.norm(p - said.T_workpiece_tcp[:, :3, 3], axis=1),
                np.linalg.norm(R[:, :, 2] - said.T_workpiece_tcp[:, :3, 2], axis=1), turn,
                np.abs(motion.q - said.q).max(axis=1))  # fmt: skip
    # a target between two samples is up to half of what they are apart from the nearer one
    gone = _longest(
        np.linalg.norm(np.diff(p, axis=0), axis=1) + LEVER * np.linalg.norm(np.diff(R, axis=0), axis=(1, 2))
    )
    swept = _longest(np.abs(np.diff(motion.q, axis=0)).max(axis=1))
    lost, here = 0, 0.0
    for k in range(n):
        T = said.T_workpiece_tcp[k]

        def joint_off(rows: slice, k: int = k) -> Array:
            return np.asarray(np.abs(motion.q[rows] - said.q[k]).max(axis=1))

        def pose_off(rows: slice, T: Array = T) -> Array:
            chord = np.sum((R[rows] - T[:3, :3]) ** 2, axis=(1, 2)) / 2.0  # (angle)² where it is small
            way = np.sum((p[rows] - T[:3, 3]) ** 2, axis=1)
            return np.asarray(np.sqrt(way + LEVER**2 * chord))

        joint = bool(known[k]) and said.kind[k] != LIN
        off, most = (joint_off, near_joint + 0.5 * swept) if joint else (pose_off, near + 0.5 * gone)
        found = _ahead(off, most, int(here), len(p)) if lost < GIVEN_UP else None
        if found is None:
            lost += 1
            if lost <= GIVEN_UP:  # how far the nearest sample ahead is
                rest = slice(int(here), len(p))
                gap[k] = float(np.linalg.norm(p[rest] - T[:3, 3], axis=1).min())
            continue
        at[k], gap[k], tilt[k], turn[k] = _foot(found, here, T, p, R, allowed.corner)
        here = at[k]
        if known[k]:
            joints[k] = float(np.abs(_between(motion.q, at[k]) - said.q[k]).max())
    return at, gap, tilt, turn, joints


def _longest(step: Array) -> Array:
    """(S,) the longer of the ways to the sample before and to the one after."""
    return np.asarray(np.maximum(np.append(0.0, step), np.append(step, 0.0)))


def _ahead(off: Callable[[slice], Array], most: Array, start: int, stop: int) -> int | None:
    """The nearest sample of the first stretch from ``start`` on where ``off`` is below ``most`` (S,); None for none."""
    window = FIRST_WINDOW
    while True:
        end = min(start + window, stop)
        values = off(slice(start, end))
        below: NDArray[np.bool_] = np.asarray(values < most[start:end])
        if below.any():
            first = int(np.argmax(below))
            after = int(np.argmax(~below[first:])) if not below[first:].all() else len(below) - first
            if first + after < len(below) or end == stop:
                return start + first + int(np.argmin(values[first : first + after]))
        elif end == stop:
            return None
        window *= 4


def _foot(
    sample: int, here: float, T: Array, p: Array, R: Array, corner: float
) -> tuple[float, float, float, float]:  # fmt: skip
    """Place of the foot on the motion's polyline beside ``sample``, never before ``here``; m, rad, rad to there."""
    best = (float(sample), np.inf)
    for a in (sample - 1, sample):
        if not 0 <= a < len(p) - 1:
            continue
        way = p[a + 1] - p[a]
        length2 = float(way @ way)
        share = float(np.clip((T[:3, 3] - p[a]) @ way / length2, 0.0, 1.0)) if length2 > 1e-16 else float(sample - a)
        gap = float(np.linalg.norm(p[a] + share * way - T[:3, 3]))
        if gap < best[1] - 1e-12:
            best = (a + share, gap)
    at = max(best[0], here)
    a = min(int(at), len(p) - 2) if len(p) > 1 else 0
    share = at - a
    b = min(a + 1, len(p) - 1)
    gap = float(np.linalg.norm((1 - share) * p[a] + share * p[b] - T[:3, 3]))
    nearest = a if share < 0.5 else b
    ends = min(float(np.linalg.norm(R[n, :, 2] - T[:3, 2])) for n in (a, b))
    blend = (1 - share) * R[a, :, 2] + share * R[b, :, 2]
    z = min(ends, float(np.linalg.norm(blend / max(float(np.linalg.norm(blend)), 1e-12) - T[:3, 2])))
    # where the axis turns differently before and after, the chord between the samples cuts that corner
    before, after = R[a, :, 2] - R[max(a - 1, 0), :, 2], R[min(b + 1, len(p) - 1), :, 2] - R[b, :, 2]
    slack = share * (1 - share) * float(np.linalg.norm(after - before))
    # and where the tool rounds the point, the foot is uncertain by as much along the path
    way = float(np.linalg.norm(p[b] - p[a]))
    slack += min(corner / max(way, corner), 1.0) * float(np.linalg.norm(R[b, :, 2] - R[a, :, 2])) if corner > 0 else 0.0
    z = max(z - min(slack, np.radians(AXIS_DEG)), 0.0)
    turned = min(_angle(R[nearest], T[:3, :3]), _angle((1 - share) * R[a] + share * R[b], T[:3, :3]))
    return at, gap, float(2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0))), turned


def _angle(A: Array, B: Array) -> float:
    """Between two rotations, exact for small angles."""
    return float(2.0 * np.arcsin(np.clip(np.linalg.norm(A - B) / np.sqrt(8.0), 0.0, 1.0)))


def _between(values: Array, at: float) -> Array:
    a = int(np.clip(at, 0, len(values) - 1))
    b = min(a + 1, len(values) - 1)
    return np.asarray((1.0 - (at - a)) * values[a] + (at - a) * values[b])


def _whole(said: ReadProgram, motion: Motion, at: Array) -> Check:
    """The program begins where the motion does and leaves nothing of its end."""
    known = np.flatnonzero(np.isfinite(at))
    if not len(known):
        return Check(f"{said.file}: whole motion", False, float(len(at)), 0.0, "targets off", "no target is on it")
    last = len(motion.time) - 1
    moved = np.abs(motion.q - motion.q[-1]).max(axis=1) > NEAR_JOINT
    end = int(np.flatnonzero(moved)[-1]) + 1 if moved.any() else 0  # at rest from here on
    start = np.abs(motion.q[: int(at[known[0]]) + 1] - motion.q[0]).max() if at[known[0]] > 0 else 0.0
    left = [f"it ends at sample {at[known[-1]]:.0f} of {last}"] if at[known[-1]] < end - 1 else []
    left += [f"it begins at sample {at[known[0]]:.0f}"] if start > NEAR_JOINT else []
    return Check(f"{said.file}: whole motion", not left, float(len(left)), 0.0, "ends missing",
                 "; ".join(left) or "from the first sample to the last")  # fmt: skip


def _lines(
    said: ReadProgram, motion: Motion, tcp: Array, at: Array, allowed: Allowed, where: list[str]
) -> list[Check]:  # fmt: skip
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
        off = np.vstack([
            _off_line(tcp[rows[linear][k : k + AT_ONCE]], said.T_workpiece_tcp[move[linear][k : k + AT_ONCE] - 1],
                      said.T_workpiece_tcp[move[linear][k : k + AT_ONCE]])
            for k in range(0, int(linear.sum()), AT_ONCE)
        ])  # fmt: skip
        ways = [f"on the way to {where[k]}" for k in move[linear]]
        for column, (what, unit, limit, scale) in enumerate((
            ("lines along the motion", "mm", allowed.position + said.place_step, 1e3),
            ("tool axis along lines", "deg", allowed.axis + said.joint_step, 180.0 / np.pi),
            ("orientation along lines", "deg", allowed.turn + said.joint_step, 180.0 / np.pi),
        )):  # fmt: skip
            checks.append(_worst(said, what, unit, scale * off[:, column], scale * limit, ways))
    if not linear.all():
        pick = np.flatnonzero(~linear)
        q = np.array([_between(motion.q, a) if np.isfinite(a) else np.full(6, np.nan) for a in at])
        joint = np.isfinite(said.q).all(axis=1)
        q[joint] = said.q[joint]
        bow = _off_joint_line(motion.q[rows[pick]], q[move[pick] - 1], q[move[pick]])
        ways = [f"on the way to {where[k]}" for k in move[pick]]
        limit = RAPID_DEG + float(np.degrees(said.joint_step))
        checks.append(_worst(said, "joint moves along the motion", "deg", np.degrees(bow), limit, ways))
    return checks


def _off_line(T: Array, A: Array, B: Array) -> Array:
    """(K, 3) m, rad, rad: poses against even moves A → B: tip straight, orientation about one axis."""
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
    return np.column_stack([gap, 2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0)), (there.inv() * now).magnitude()])


def _off_joint_line(q: Array, a: Array, b: Array) -> Array:
    """(K,) rad: the axis farthest from the straight joint move a → b at its nearest place."""
    way = b - a
    length2 = np.einsum("ij,ij->i", way, way)
    share = np.einsum("ij,ij->i", q - a, way) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(np.abs(q - a - np.clip(share, 0.0, 1.0)[:, None] * way).max(axis=1))


def _kinds(
    said: ReadProgram, motion: Motion, p: Array, at: Array, linear: NDArray[np.bool_], where: list[str], place: float
) -> Check:  # fmt: skip
    """No joint move where the tool cuts, and what comments call a move is what the motion does there.

    Samples within ``place`` (m) of either target tell nothing: round a corner the tool dwells there, and it may stand
    on a point before it leaves it.
    """
    wrong: list[str] = []
    for k in np.flatnonzero(np.isfinite(at[1:]) & np.isfinite(at[:-1])) + 1:
        rows = np.arange(int(np.ceil(at[k - 1] + 0.5)), int(np.floor(at[k] - 0.5)) + 1)
        if linear[k] and linear[k - 1]:
            ends = said.T_workpiece_tcp[[k - 1, k], :3, 3]
            rows = rows[np.linalg.norm(p[rows, None] - ends, axis=2).min(axis=1) > place]
        inside = motion.move[rows]
        if not len(inside):
            continue
        if not linear[k] and not said.streamed and (inside != Move.RAPID).any():
            wrong.append(f"{where[k]} is a joint move where the tool is led along the path")
        elif linear[k] and (said.move[k] == Move.CUT) != bool((inside == Move.CUT).any()):
            wrong.append(f"{where[k]} is called {Move(int(said.move[k])).word} where the motion says otherwise")
    text = "; ".join(wrong[:3]) or "all agree"
    return Check(f"{said.file}: kinds of moves", not wrong, float(len(wrong)), 0.0, "moves", text)


def _timed(said: ReadProgram, motion: Motion, at: Array, where: list[str]) -> Check:
    """Streamed targets: one a control sample, each at its own time."""
    n = len(motion.time)
    if len(said) != n:
        return Check(f"{said.file}: one target a sample", False, float(len(said)), float(n), "targets",
                     f"{len(said)} targets for {n} samples")  # fmt: skip
    known = np.isfinite(said.time)
    off = np.where(known, np.abs(said.time - said.time[known][0] - motion.time + motion.time[known][0]), np.inf) if (
        known.any()) else np.full(n, np.inf)  # fmt: skip
    off[0] = 0.0 if not known[0] else off[0]  # the first one may be a joint move without a time
    return _worst(said, "times of the samples", "s", off, 2e-6, where)
