"""Places looked for one after the other: targets along a motion, points of a CAM file along a program's lines.

Where the n-th lies decides where the next is looked for, so these loops cannot be written as array operations; they
are compiled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.compiled import compiled

SPIN_LEVER = 1e-3  # m/rad: of a rotation about the tool axis, which decides only where nothing else changes


@compiled
def targets_in_order(
    place: Array,
    turn: Array,
    joints: Array,
    wanted_place: Array,
    wanted_turn: Array,
    wanted_joints: Array,
    by_joints: NDArray[np.bool_],
    near_pose: Array,
    near_joint: Array,
    lever: float,
    axis_lever: float,
    give_up: int,
) -> tuple[NDArray[np.int64], Array, Array]:
    """Find each target on the motion: on the first stretch ahead that is near it, at its foot next to the nearest sample.

    The nearest sample and the foot have the least distance in place and tool axis: where the tool turns about its tip
    (a corner of the tool axis) the place is the same all along the turn.

    Args:
        place: (S, 3) m, turn (S, 3, 3), joints (S, 6) rad of the motion's samples.
        wanted_place: (M, 3) m, wanted_turn (M, 3, 3), wanted_joints (M, 6) rad of the targets.
        by_joints: (M,) the target is found by its joints, else by its pose.
        near_pose: (S,) m, near_joint (S,) rad: nearer than this to a sample counts.
        lever: m/rad, by which a rotation counts as a distance where the stretch is looked for.
        axis_lever: m/rad, by which an angle of the tool axis counts as a distance along the stretch.
        give_up: so many targets that lie nowhere end the search.

    Returns:
        (M,) nearest sample, −1 where nothing ahead is near; (M,) place on the motion, fractional, NaN there; (M,) m to
        the nearest sample ahead of targets that lie nowhere, NaN elsewhere.
    """
    samples, count = len(place), len(wanted_place)
    nearest = np.full(count, -1)
    at, missed = np.full(count, np.nan), np.full(count, np.nan)
    here, lost = 0.0, 0
    for k in range(count):
        if lost >= give_up:
            break
        best, found = np.inf, -1
        start = int(here)
        for n in range(start, samples):
            off, fine = 0.0, 0.0
            if by_joints[k]:
                for c in range(joints.shape[1]):
                    off = max(off, abs(joints[n, c] - wanted_joints[k, c]))
                near = near_joint[n]
            else:
                for c in range(3):
                    off += (place[n, c] - wanted_place[k, c]) ** 2
                near = near_pose[n]
                if off < near * near:  # the turn can only add to it
                    chord, tilt = 0.0, 0.0
                    for c in range(3):
                        tilt += (turn[n, c, 2] - wanted_turn[k, c, 2]) ** 2
                        for d in range(3):
                            chord += (turn[n, c, d] - wanted_turn[k, c, d]) ** 2
                    fine = np.sqrt(off + axis_lever * axis_lever * tilt + SPIN_LEVER * SPIN_LEVER * chord / 2.0)
                    off = np.sqrt(off + lever * lever * chord / 2.0)
                else:
                    off = np.inf
            if off < near:
                if by_joints[k]:
                    fine = off
                if fine < best:
                    best, found = fine, n
            elif found >= 0:
                break
        nearest[k] = found
        if found < 0:
            lost += 1
            least = np.inf
            for n in range(start, samples):
                way = 0.0
                for c in range(3):
                    way += (place[n, c] - wanted_place[k, c]) ** 2
                least = min(least, way)
            missed[k] = np.sqrt(least)
            continue
        gap, foot = np.inf, float(found)
        for a in (found - 1, found):
            if a < 0 or a >= samples - 1:
                continue
            length, along = 0.0, 0.0
            for c in range(3):
                way = place[a + 1, c] - place[a, c]
                length += way * way
                along += (wanted_place[k, c] - place[a, c]) * way
                for d in range(3):
                    weight = SPIN_LEVER * SPIN_LEVER / 2.0 + (axis_lever * axis_lever if d == 2 else 0.0)
                    step = turn[a + 1, c, d] - turn[a, c, d]
                    length += weight * step * step
                    along += weight * (wanted_turn[k, c, d] - turn[a, c, d]) * step
            share = min(max(along / length, 0.0), 1.0) if length > 1e-16 else float(found - a)
            off = 0.0
            for c in range(3):
                off += (place[a, c] + share * (place[a + 1, c] - place[a, c]) - wanted_place[k, c]) ** 2
                for d in range(3):
                    weight = SPIN_LEVER * SPIN_LEVER / 2.0 + (axis_lever * axis_lever if d == 2 else 0.0)
                    there = turn[a, c, d] + share * (turn[a + 1, c, d] - turn[a, c, d])
                    off += weight * (there - wanted_turn[k, c, d]) ** 2
            off = np.sqrt(off)
            if off < gap - 1e-12:
                gap, foot = off, a + share
        here = max(foot, here)
        at[k] = here
    return nearest, at, missed


@compiled
def lines_in_order(
    ends: Array,
    end_axes: Array,
    wanted: Array,
    wanted_axes: Array,
    asked: NDArray[np.bool_],
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
        asked: (N,) which of them are looked for.
        limit: m, nearer than this to a line counts.
        lever: m/rad, by which an angle of the tool axis counts as a distance.
        noise: m; a later line is taken only where it is nearer by more, because its start is the same place.
        give_up: so many missing points end the search.

    Returns:
        (N,) the end of its line, −1 for none; (N,) share of the line that lies behind it; (N,) m to the line; where
        there is none to the nearest ahead, infinite after the search had ended; NaN where not asked.
    """
    count = len(wanted)
    reached = np.full(count, -1)
    share, gap = np.full(count, np.nan), np.full(count, np.nan)
    here, passed, missed = 1, -1.0, 0
    for k in range(count):
        if not asked[k]:
            continue
        nearest, best, behind = np.inf, np.inf, 0.0
        if missed < give_up:
            for j in range(here, len(ends)):
                f, size = _share_of_line(ends, end_axes, j, wanted[k], wanted_axes[k], lever)
                if j == here and passed >= 0.0 and f * size < passed - limit:
                    continue  # on the line of the last point only what lies behind it
                off, tilt = 0.0, 0.0
                for c in range(3):
                    off += (ends[j - 1, c] + f * (ends[j, c] - ends[j - 1, c]) - wanted[k, c]) ** 2
                    axis = end_axes[j - 1, c] + f * (end_axes[j, c] - end_axes[j - 1, c])
                    tilt += (axis - wanted_axes[k, c]) ** 2
                away = np.sqrt(off)
                nearest = min(nearest, away)
                if away > limit:
                    if reached[k] >= 0:
                        break
                    continue
                off = np.sqrt(off + lever * lever * tilt)
                if off < best - noise:
                    best, behind = off, f * size
                    reached[k], share[k], gap[k] = j, f, away
        if reached[k] < 0:
            missed += 1
            gap[k] = nearest
        else:
            here, passed = reached[k], behind
    return reached, share, gap


@compiled
def _share_of_line(
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
