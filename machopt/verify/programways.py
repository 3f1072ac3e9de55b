"""The ways between a program's targets: what the controller draws there, held against the motion's samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.arrays import Array
from machopt.domain.program import LIN
from machopt.domain.readprogram import ReadProgram
from machopt.verify.check import Check, Promise
from machopt.verify.programtargets import AXIS_LEVER, Allowed, between, worst_move
from machopt.verify.table import Motion

SHORT = 1e-4  # m: on a shorter line the place does not tell how far the tool has turned
SPUN = 1e-3  # sine of the angle between tool axis and rotation axis, below which the tool axis tells nothing
RAPID_DEG = 0.1  # deg: between rapid way points joints go straight; corners there are rounded in time only
SPOT = 2e-6  # m: two prints of one place, to a thousandth of a millimetre
AT_ONCE = 50_000  # samples


def along_lines(
    said: ReadProgram, motion: Motion, tcp: Array, at: Array, allowed: Allowed, where: list[str]
) -> list[Check]:
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
        ways = [f"the move to {where[k]}" for k in move[linear]]
        for column, (what, unit, limit, scale) in enumerate(
            (
                (Promise.LINES, "mm", allowed.position + said.place_step, 1e3),
                (Promise.LINES_AXIS, "deg", allowed.axis + said.joint_step, 180.0 / np.pi),
                (Promise.LINES_TURN, "deg", allowed.turn + said.joint_step, 180.0 / np.pi),
            )
        ):
            checks.append(worst_move(said, what, unit, scale * off[:, column], scale * limit, ways))
        if motion.external.shape[1]:
            checks.append(_along(said, motion, rows[linear], move[linear], off[:, 3], at, allowed, ways))
    if not linear.all():
        pick = np.flatnonzero(~linear)
        driven, told = np.hstack([motion.q, motion.external]), np.hstack([said.q, said.external])
        q = np.full((len(at), driven.shape[1]), np.nan)
        q[known] = between(driven, at[known])
        joint = np.isfinite(told).all(axis=1)
        q[joint] = told[joint]
        bow = _off_joint_line(driven[rows[pick]], q[move[pick] - 1], q[move[pick]])
        ways = [f"the move to {where[k]}" for k in move[pick]]
        limit = RAPID_DEG + float(np.degrees(said.joint_step))
        checks.append(worst_move(said, "joint moves along the motion", "deg", np.degrees(bow), limit, ways))
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
        there &= np.linalg.norm(tcp[rows, :3, 3] - T[end, :3, 3], axis=1) < SPOT + said.printed_distance
        k = np.flatnonzero(there)
        k = k[np.linalg.norm(T[other[k], :3, 3] - T[other[k] - 1, :3, 3], axis=1) < SPOT + said.printed_distance]
        if len(k):
            second = _off_line(tcp[rows[k]], T[other[k] - 1], T[other[k]])
            less = np.hypot(second[:, 0], AXIS_LEVER * second[:, 1]) < np.hypot(off[k, 0], AXIS_LEVER * off[k, 1])
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
    ends[known] = between(motion.external, at[known])
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
    check = worst_move(said, "external axes along lines", words, off.max(axis=1) / most, 1.0, ways)
    return replace(check, where=f"{check.where}: e{axis + 1} by {away}")


def _off_line(T: Array, A: Array, B: Array) -> Array:
    """(K, 4) m, rad, rad, share: poses against even moves A → B, tip straight, orientation about one axis."""
    way = B[:, :3, 3] - A[:, :3, 3]
    length2 = np.einsum("ij,ij->i", way, way)
    along = np.einsum("ij,ij->i", T[:, :3, 3] - A[:, :3, 3], way)
    share = np.clip(np.where(length2 > 0.0, along / np.where(length2 > 0.0, length2, 1.0), 0.0), 0.0, 1.0)
    start = Rotation.from_matrix(A[:, :3, :3])
    whole = (start.inv() * Rotation.from_matrix(B[:, :3, :3])).as_rotvec()
    now = Rotation.from_matrix(T[:, :3, :3])
    turned, swept = _share_of_turn(whole, start.inv().apply(T[:, :3, 2]), (start.inv() * now).magnitude())
    share = np.where(AXIS_LEVER * swept > np.sqrt(length2), turned, share)
    gap = np.linalg.norm(T[:, :3, 3] - A[:, :3, 3] - share[:, None] * way, axis=1)
    share = np.where(length2 < SHORT**2, turned, share)
    there = start * Rotation.from_rotvec(share[:, None] * whole)
    z = np.linalg.norm(there.apply([0.0, 0.0, 1.0]) - T[:, :3, 2], axis=1)
    return np.column_stack([gap, 2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0)), (there.inv() * now).magnitude(), share])


def _share_of_turn(whole: Array, axis: Array, turned: Array) -> tuple[Array, Array]:
    """How far a rotation about one axis has come, by where the tool axis is.

    Args:
        whole: (K, 3) rad, the rotation vector of the whole move in the frame of its start.
        axis: (K, 3) the TCP's z in that frame now.
        turned: (K,) rad between the orientations of the start and now; tells where the rotation is about z itself.

    Returns:
        (K,) share, 0 to 1; (K,) rad, length of the arc that the TCP's z moves along.
    """
    angle = np.linalg.norm(whole, axis=1)
    u = whole / np.where(angle > 1e-12, angle, 1.0)[:, None]
    start = np.array([0.0, 0.0, 1.0]) - u[:, 2:] * u
    flat = axis - np.einsum("ij,ij->i", axis, u)[:, None] * u
    radius = np.linalg.norm(start, axis=1)
    done = np.arctan2(np.einsum("ij,ij->i", u, np.cross(start, flat)), np.einsum("ij,ij->i", start, flat))
    done = np.where(radius > SPUN, done, turned)
    return np.clip(done / np.where(angle > 1e-12, angle, 1.0), 0.0, 1.0), angle * radius


def _off_joint_line(q: Array, a: Array, b: Array) -> Array:
    """(K,) rad: the axis farthest from the straight joint move a → b at its nearest place."""
    way = b - a
    length2 = np.einsum("ij,ij->i", way, way)
    share = np.einsum("ij,ij->i", q - a, way) / np.where(length2 > 0.0, length2, 1.0)
    return np.asarray(np.abs(q - a - np.clip(share, 0.0, 1.0)[:, None] * way).max(axis=1))
