"""Inverse kinematics on a grid of neighbouring poses: solve a few, track the solutions in between, label the branches.

Between two solved poses a and b of one grid line all solutions of a are tracked step by step (Newton with step
halving). If each arrives at a different solution of b and no solution of b remains, the poses in between have exactly
these solutions. Otherwise the middle pose is solved and both halves are treated alike, down to single steps.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from machopt.kinematics.inverse.newton_iteration import track_solutions
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

GridIndex = NDArray[np.int64]
POINT_STRIDE = 8  # grid points between solved rows: some millimetres of path
ROTATION_STRIDE = 4  # rotations between solved columns: 20° at the usual 5° step
SAME_SOLUTION_RAD = (
    1e-5  # rad; a followed solution and a solved one are the same below: both are exact to 1e-9 off singularities
)
MAX_BRANCH_STEP_RAD = 0.8  # rad; two solutions of neighbouring poses further apart than this are never one branch


def fill_grid(robot: Robot, T: Array, solve: Callable[[Array], Array], branches: int) -> Array:
    """Return all solutions (N, R, B, 6) in rad of a grid of poses, unlabelled.

    Args:
        robot: kinematic model.
        T: (N, R, 4, 4) flange poses in base_link.
        solve: returns all solutions (M, B, 6) of poses (M, 4, 4).
        branches: B.
    """
    N, R = T.shape[:2]
    flat = np.ascontiguousarray(T.reshape(-1, 4, 4))
    q = np.full((N * R, branches, 6), np.nan)
    rows, columns = _list_coarse_indices(N, POINT_STRIDE), _list_coarse_indices(R, ROTATION_STRIDE)
    nodes = (rows[:, None] * R + columns).ravel()
    q[nodes] = solve(flat[nodes])
    start, steps = (rows[:, None] * R + columns[:-1]).ravel(), np.tile(np.diff(columns), len(rows))
    _fill_lines(robot, flat, q, start, steps, 1, solve)
    start, steps = (rows[:-1, None] * R + np.arange(R)).ravel(), np.repeat(np.diff(rows), R)
    _fill_lines(robot, flat, q, start, steps, R, solve)
    return q.reshape(N, R, branches, 6)


def _list_coarse_indices(n: int, stride: int) -> GridIndex:
    return np.unique(np.append(np.arange(0, n, stride), n - 1)).astype(np.int64)


def _fill_lines(
    robot: Robot, T: Array, q: Array, start: GridIndex, steps: GridIndex, stride: int, solve: Callable[[Array], Array]
) -> None:
    """Fill q strictly between ``start`` and ``start + steps·stride`` of every line, both ends being solved."""
    while True:
        longer = steps > 1
        start, steps = start[longer], steps[longer]
        if len(start) == 0:
            return
        open_ = ~_track_lines(robot, T, q, start, steps, stride)
        start, steps = start[open_], steps[open_]
        half = steps // 2
        middle = start + half * stride
        q[middle] = solve(T[middle])
        start, steps = np.concatenate([start, middle]), np.concatenate([half, steps - half])


def _track_lines(
    robot: Robot, T: Array, q: Array, start: GridIndex, steps: GridIndex, stride: int
) -> NDArray[np.bool_]:
    """Track all solutions along lines; write those of consistent lines, and return which are consistent."""
    line, branch = np.nonzero(np.isfinite(q[start, :, 0]))
    longest = int(steps.max(initial=0))
    way = np.full((longest, len(line), 6), np.nan)  # way[j]: after j+1 steps
    here = q[start[line], branch]
    alive = np.ones(len(line), bool)
    lost = np.zeros(len(start), bool)
    for j in range(longest):
        go = np.flatnonzero(alive & (steps[line] > j) & ~lost[line])
        at = start[line[go]] + j * stride
        here[go] = track_solutions(robot.axis, robot.point, robot.T_base_flange_zero, T, at, at + stride, here[go])
        way[j, go] = here[go]
        alive[go] = np.isfinite(here[go, 0])
        lost[line[go[~alive[go]]]] = True
    closed = ~lost & _is_bijective(here, line, q[start + steps * stride])
    for j in range(longest - 1):
        put = np.flatnonzero(closed[line] & (steps[line] > j + 1))
        q[start[line[put]] + (j + 1) * stride, branch[put]] = _wrap_angle(way[j, put])
    return closed


def _is_bijective(arrived: Array, line: GridIndex, ends: Array) -> NDArray[np.bool_]:
    """Whether the arrivals (K, 6) of each line are, one to one, the solutions (L, B, 6) at its end."""
    gap = np.abs(_wrap_angle(ends[line] - arrived[:, None])).max(axis=-1)  # (K, B)
    hit = gap < SAME_SOLUTION_RAD
    per_arrival = hit.sum(axis=1) == 1
    per_end = np.zeros(ends.shape[:2], np.int64)
    np.add.at(per_end, line, hit)
    ok: NDArray[np.bool_] = (per_end == np.isfinite(ends[..., 0])).all(axis=1)
    ok[line[~per_arrival]] = False
    return ok


def _wrap_angle(angle: Array) -> Array:
    return np.pi - np.remainder(np.pi - angle, 2 * np.pi)


def label_grid(q: Array) -> Array:
    """Reorder the branches so that an index follows one solution from pose to neighbouring pose.

    The first row is labelled along the rotations, every further row from the previous row. A solution without a
    predecessor takes its neighbour's index along the rotations where that is free.

    Args:
        q: (N, R, B, 6) rad, NaN where there is no solution.
    """
    out = np.full(q.shape, np.nan)
    _label_branches(np.ascontiguousarray(q), out, MAX_BRANCH_STEP_RAD)
    return out


@jit_compile
def _label_branches(q: Array, out: Array, jump: float) -> None:
    N, R, B = q.shape[:3]
    is_taken = np.zeros(B, np.bool_)
    used = np.zeros(B, np.bool_)
    empty = np.full((B, 6), np.nan)
    for n in range(N):
        for r in range(R):
            is_taken[:] = False
            used[:] = False
            before = out[n - 1, r] if n > 0 else empty
            neighbour = out[n, r - 1] if r > 0 else empty
            _continue_branches(q[n, r], before, out[n, r], is_taken, used, jump)
            _continue_branches(q[n, r], neighbour, out[n, r], is_taken, used, jump)
            # new solution: an index that was free at both neighbours, else any
            for strict in (True, False):
                for b in range(B):
                    if is_taken[b] or np.isnan(q[n, r, b, 0]):
                        continue
                    for c in range(B):
                        free = np.isnan(before[c, 0]) and np.isnan(neighbour[c, 0])
                        if not used[c] and (free or not strict):
                            out[n, r, c] = q[n, r, b]
                            is_taken[b] = used[c] = True
                            break


@jit_compile
def _continue_branches(
    q: Array, neighbour: Array, out: Array, is_taken: NDArray[np.bool_], used: NDArray[np.bool_], jump: float
) -> None:
    """Assign each solution the index of the nearest solution of a neighbour, closest pair first."""
    B = len(q)
    gap = np.full((B, B), np.inf)
    for b in range(B):
        if is_taken[b] or np.isnan(q[b, 0]):
            continue
        for c in range(B):
            if used[c] or np.isnan(neighbour[c, 0]):
                continue
            worst = 0.0
            for i in range(6):
                d = (q[b, i] - neighbour[c, i]) / (2.0 * np.pi)
                worst = max(worst, abs(d - np.round(d)) * 2.0 * np.pi)
            gap[b, c] = worst
    while True:
        best, bi, ci = jump, -1, -1
        for b in range(B):
            for c in range(B):
                if gap[b, c] < best:
                    best, bi, ci = gap[b, c], b, c
        if bi < 0:
            return
        out[ci] = q[bi]
        is_taken[bi] = used[ci] = True
        gap[bi, :] = np.inf
        gap[:, ci] = np.inf
