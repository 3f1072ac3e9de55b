"""Ordered matching: targets along a motion, points of a CAM file along a program's lines.

The place of one item decides where the search for the next one begins. So these loops cannot be array operations;
they are compiled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

LEAVING_RAD = 1e-5  # rad from the place of arrival: the motion leaves it
NEAR_TURN_RAD = 0.1  # rad between orientations of the same target: far more than any tolerance, less than a posture
SPIN_LEVER_M = 1e-3  # m/rad: of a rotation about the tool axis, which decides only where nothing else changes


@jit_compile
def match_targets_in_order(
    place: Array,
    turn: Array,
    joints: Array,
    wanted_place: Array,
    wanted_turn: Array,
    wanted_joints: Array,
    by_joints: NDArray[np.bool_],
    near: Array,
    axis_lever: float,
    arrived: float,
    give_up: int,
    by_turn: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """Find each target on the polyline of the motion, at or after the place of the target before.

    A target lies on the first stretch ahead that is near it, an unbroken row of segments, at the least distance in
    position and tool axis. A motion that goes in and out of a shallow hole stays near a joint target all the time and
    passes it twice: the first arrival counts. Where the tool turns about its tip, the position is the same along the
    whole turn. Where no stretch is within the first of the limits ``near``, the next one counts. A move in joint space
    that only turns the tool leaves its place and comes back to it: of the end of such a move (``by_turn``) the
    orientation must be near, too, unless that of no stretch is.

    Args:
        place: (V, 3) positions at the vertices, m.
        turn: (V, 3, 3) orientations at the vertices.
        joints: (V, n) joint positions at the vertices, rad.
        wanted_place: (M, 3) positions of the targets, m.
        wanted_turn: (M, 3, 3) orientations of the targets.
        wanted_joints: (M, n) joint positions of the targets, rad.
        by_joints: (M,) the target is found by its joints, else by its pose.
        near: (L, 2) limits of the distance, of poses (m) and of joint targets (rad), rising.
        axis_lever: M/rad, by which an angle of the tool axis counts as a distance.
        arrived: Distance (rad) to a joint target at which the motion has arrived; the place counts if it then leaves.
        give_up: Number of unmatched targets that ends the search.
        by_turn: (M,) the stretch of a pose has to come near the orientation of the target, too.

    Returns:
        (M,) place on the polyline, fractional, NaN where nothing ahead is near; (M,) distance to the nearest vertex
        ahead of unmatched targets, m, NaN elsewhere.
    """
    count = len(wanted_place)
    at, missed = np.full(count, np.nan), np.full(count, np.nan)
    here, lost = 0.0, 0
    for k in range(count):
        if lost >= give_up:
            break
        for level in range(len(near)):
            if by_joints[k]:
                foot = _find_joint_stretch(joints, wanted_joints[k], here, near[level, 1], arrived)
            else:
                goal, goal_turn = wanted_place[k], wanted_turn[k]
                foot = _find_pose_stretch(place, turn, goal, goal_turn, here, near[level, 0], axis_lever, by_turn[k])
            if not np.isnan(foot):
                at[k] = here = max(foot, here)
                break
        if np.isnan(at[k]):
            lost += 1
            missed[k] = _compute_vertex_distance(place, wanted_place[k], int(here))
    return at, missed


@jit_compile
def _find_joint_stretch(joints: Array, wanted: Array, here: float, limit: float, arrived: float) -> float:
    """Return the place of a joint target on the first stretch from ``here`` on within the limit (rad); NaN for none."""
    vertices = len(joints)
    best, foot, found = np.inf, 0.0, False
    for a in range(min(int(here), max(vertices - 2, 0)), max(vertices - 1, 1)):
        away, share = _compute_joint_distance(joints[a], joints[min(a + 1, vertices - 1)], wanted)
        if away <= limit:
            if best <= arrived and away > best + LEAVING_RAD:
                break
            found = True
            if away < best - 1e-12:
                best, foot = away, a + share
        elif found:
            break
    return foot if found else np.nan


@jit_compile
def _find_pose_stretch(
    place: Array,
    turn: Array,
    wanted: Array,
    wanted_turn: Array,
    here: float,
    limit: float,
    axis_lever: float,
    by_turn: bool,
) -> float:
    """Return the place of a pose on the first stretch from ``here`` on within the limit (m); NaN for none.

    With ``by_turn`` the stretch also has to come near the orientation, unless none does: then the first one counts.
    """
    vertices = len(place)
    best, foot, found, turned, first = np.inf, 0.0, False, np.inf, -1.0
    for a in range(min(int(here), max(vertices - 2, 0)), max(vertices - 1, 1)):
        b = min(a + 1, vertices - 1)
        away, fine, share = _compute_pose_distance(
            place[a], place[b], turn[a], turn[b], wanted, wanted_turn, limit, axis_lever
        )
        if away <= limit:
            found = True
            if fine < best - 1e-12:
                best, foot = fine, a + share
                turned = _compute_turn_distance(turn[a], turn[b], wanted_turn, share)
        elif found:
            if not by_turn or turned <= NEAR_TURN_RAD:
                break
            first = foot if first < 0.0 else first
            best, found = np.inf, False
    if first >= 0.0 and not (found and turned <= NEAR_TURN_RAD):
        return first
    return foot if found else np.nan


@jit_compile
def _compute_vertex_distance(place: Array, wanted: Array, first: int) -> float:
    """Return the distance (m) of a place to the nearest vertex from ``first`` on."""
    least = np.inf
    for n in range(first, len(place)):
        way = 0.0
        for c in range(3):
            way += (place[n, c] - wanted[c]) ** 2
        least = min(least, way)
    return float(np.sqrt(least))


@jit_compile
def _compute_joint_distance(start: Array, end: Array, wanted: Array) -> tuple[float, float]:
    """Largest joint difference (rad) to the segment at its foot, and the foot's share of the segment."""
    length, along = 0.0, 0.0
    for c in range(len(start)):
        way = end[c] - start[c]
        length += way * way
        along += (wanted[c] - start[c]) * way
    share = min(max(along / length, 0.0), 1.0) if length > 1e-20 else 0.0
    away = 0.0
    for c in range(len(start)):
        away = max(away, abs(start[c] + share * (end[c] - start[c]) - wanted[c]))
    return away, share


@jit_compile
def _compute_turn_distance(start_turn: Array, end_turn: Array, wanted_turn: Array, share: float) -> float:
    """Angle (rad, of small ones) between a wanted orientation and that at a share of a segment."""
    away = 0.0
    for c in range(3):
        for d in range(3):
            away += (start_turn[c, d] + share * (end_turn[c, d] - start_turn[c, d]) - wanted_turn[c, d]) ** 2
    return float(np.sqrt(0.5 * away))


@jit_compile
def _compute_pose_distance(
    start: Array,
    end: Array,
    start_turn: Array,
    end_turn: Array,
    wanted: Array,
    wanted_turn: Array,
    limit: float,
    axis_lever: float,
) -> tuple[float, float, float]:
    """Distance (m) to the segment at its foot, the same with the tool axis counted, and the foot's share."""
    length, along, off = 0.0, 0.0, 0.0
    for c in range(3):
        way = end[c] - start[c]
        length += way * way
        along += (wanted[c] - start[c]) * way
        off += (wanted[c] - start[c]) ** 2
    reach = limit + np.sqrt(length)
    if off > reach * reach:  # no place of the segment is near
        return np.inf, np.inf, 0.0
    for c in range(3):
        for d in range(3):
            weight = SPIN_LEVER_M * SPIN_LEVER_M / 2.0 + (axis_lever * axis_lever if d == 2 else 0.0)
            step = end_turn[c, d] - start_turn[c, d]
            length += weight * step * step
            along += weight * (wanted_turn[c, d] - start_turn[c, d]) * step
    share = min(max(along / length, 0.0), 1.0) if length > 1e-20 else 0.0
    away, fine = 0.0, 0.0
    for c in range(3):
        away += (start[c] + share * (end[c] - start[c]) - wanted[c]) ** 2
        for d in range(3):
            weight = SPIN_LEVER_M * SPIN_LEVER_M / 2.0 + (axis_lever * axis_lever if d == 2 else 0.0)
            fine += weight * (start_turn[c, d] + share * (end_turn[c, d] - start_turn[c, d]) - wanted_turn[c, d]) ** 2
    return np.sqrt(away), np.sqrt(away + fine), share


@jit_compile
def match_lines_in_order(
    ends: Array,
    end_axes: Array,
    wanted: Array,
    wanted_axes: Array,
    is_requested: NDArray[np.bool_],
    limit: float,
    lever: float,
    noise: float,
    give_up: int,
) -> tuple[NDArray[np.int64], Array, Array]:
    """Find each wanted point on the polyline through ``ends``: on the best line of the first stretch that is near it.

    A stretch is an unbroken row of lines that pass within ``limit`` of the point. Of several, the one with the least
    distance in place and tool axis is taken: at a corner of the tool axis all have the same place. A missing point
    leaves the place where the next is looked for as it was.

    Args:
        ends: (M, 3) m.
        end_axes: (M, 3) unit tool axes at the ends.
        wanted: (N, 3) m.
        wanted_axes: (N, 3) unit.
        is_requested: (N,) which of them are looked for.
        limit: m, nearer than this to a line counts.
        lever: m/rad, by which an angle of the tool axis counts as a distance.
        noise: m; a later line is taken only where it is nearer by more, because its start is the same place.
        give_up: so many missing points end the search.

    Returns:
        (N,) the end of its line, −1 for none; (N,) share of the line that lies behind it; (N,) m to the line; where
        there is none to the nearest ahead, infinite after the search had ended; NaN where not requested.
    """
    count = len(wanted)
    reached = np.full(count, -1)
    share, gap = np.full(count, np.nan), np.full(count, np.nan)
    here, passed, missed = 1, -1.0, 0
    for k in range(count):
        if not is_requested[k]:
            continue
        nearest, best, behind = np.inf, np.inf, 0.0
        if missed < give_up:
            for j in range(here, len(ends)):
                f, size = _compute_line_share(ends, end_axes, j, wanted[k], wanted_axes[k], lever)
                if j == here and passed >= 0.0 and f * size < passed - limit:
                    continue  # on the line of the last point only what lies behind it
                away, fine = _compute_foot_distance(ends, end_axes, j, f, wanted[k], wanted_axes[k], lever)
                nearest = min(nearest, away)
                if away > limit:
                    if reached[k] >= 0:
                        break
                    continue
                if fine < best - noise:
                    best, behind = fine, f * size
                    reached[k], share[k], gap[k] = j, f, away
        if reached[k] < 0:
            missed += 1
            gap[k] = nearest
        else:
            here, passed = reached[k], behind
    return reached, share, gap


@jit_compile
def _compute_foot_distance(
    ends: Array, axes: Array, j: int, share: float, place: Array, axis: Array, lever: float
) -> tuple[float, float]:
    """Return the distance (m) of a pose to a share of line j, and the same with the tool axis counted."""
    off, tilt = 0.0, 0.0
    for c in range(3):
        off += (ends[j - 1, c] + share * (ends[j, c] - ends[j - 1, c]) - place[c]) ** 2
        foot_axis = axes[j - 1, c] + share * (axes[j, c] - axes[j - 1, c])
        tilt += (foot_axis - axis[c]) ** 2
    return np.sqrt(off), np.sqrt(off + lever * lever * tilt)


@jit_compile
def _compute_line_share(
    ends: Array, axes: Array, j: int, place: Array, axis: Array, lever: float
) -> tuple[float, float]:
    """Share of line j behind a wanted pose, and the line's length (m): by place, or by axis where that changes more."""
    length, along, turned, done = 0.0, 0.0, 0.0, 0.0
    for c in range(3):
        way = ends[j, c] - ends[j - 1, c]
        length += way * way
        along += (place[c] - ends[j - 1, c]) * way
        turned += axes[j, c] * axes[j - 1, c]
        done += axis[c] * axes[j - 1, c]
    angle = np.arccos(min(max(turned, -1.0), 1.0))
    if lever * angle > np.sqrt(length):
        share = np.arccos(min(max(done, -1.0), 1.0)) / angle
    else:
        share = along / length if length > 0.0 else 0.0
    return min(max(share, 0.0), 1.0), np.sqrt(length + (lever * angle) ** 2)
