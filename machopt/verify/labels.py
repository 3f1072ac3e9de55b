"""The words of trajectory.csv, and its rotation: what the CAM file says at each row's index, not what the row says.

``move`` is the file's word for the move that the sample lies on; ``approach`` or ``retract`` where the tool is drawn
straight along its axis at a point; ``rapid`` from and to home and where points are given up. Where points lie closer
than samples, a sample next to a cut counts as ``cut`` although it lies past its end, because no other sample shows
that cut. ``operation`` is that of the point the move leads to; empty on the way home. ``gamma_deg`` is empty in rapid
moves, lifts, and where points coincide; elsewhere as docs/conventions.md has it (:mod:`machopt.verify.reference`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Bools
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify import reference
from machopt.verify.check import Check, counted, worst
from machopt.verify.reference import SAME
from machopt.verify.ride import Ride
from machopt.verify.table import Motion, Points

BLOCK = 50_000  # samples compared at a time
GAMMA_DEG = 0.1  # the axis may be 0.05° off while the tool rounds a corner, which turns what is measured about it


def check_labels(motion: Motion, toolpath: Toolpath, points: Points, ride: Ride, allow_gaps: bool) -> list[Check]:
    """Moves, operations and rotation of trajectory.csv."""
    return [
        counted("moves of the samples", _moves(motion, toolpath, points, ride, allow_gaps)),
        counted("operations of the samples", _operations(motion, toolpath)),
        *_gamma(motion, toolpath, ride),
    ]


def _moves(motion: Motion, toolpath: Toolpath, points: Points, ride: Ride, allow_gaps: bool) -> list[str]:
    known = np.isfinite(motion.point)
    wanted = np.where(known, toolpath.move[ride.toward], Move.RAPID)
    wanted = np.where(known & (ride.toward == 0), Move.RAPID, wanted)
    wrong = (motion.move != wanted) & (motion.move != toolpath.move[_next(motion, toolpath, ride.toward)])
    drawn = np.isin(motion.move, (Move.APPROACH, Move.RETRACT)) & ride.drawn(motion.point)
    wrong &= ~drawn
    wrong &= ~_completes_a_cut(motion, toolpath, wanted)
    if allow_gaps:
        wrong &= ~((motion.move == Move.RAPID) & _in_gap(motion, toolpath, points))
    return [
        f"{motion.at(n)} is called {Move(int(motion.move[n])).word}, the toolpath says {Move(int(wanted[n])).word}"
        for n in np.flatnonzero(wrong)
    ]


def _next(motion: Motion, toolpath: Toolpath, toward: NDArray[np.int64]) -> NDArray[np.int64]:
    """(S,) the point after ``toward`` where the printed index may as well lie on the feed move to that one."""
    after = np.minimum(toward + 1, len(toolpath) - 1)
    edge = (np.abs(np.nan_to_num(motion.point) - toward) <= 2 * SAME) & (toolpath.move[after] != Move.RAPID)
    return np.where(edge & np.isfinite(motion.point), after, toward)


def _completes_a_cut(motion: Motion, toolpath: Toolpath, wanted: NDArray[np.int64]) -> Bools:
    """(S,) rows on either side of a cut's point that no row of that cut is near."""
    s = motion.point
    out = np.zeros(len(s), bool)
    doubt = np.flatnonzero((motion.move == Move.CUT) & (wanted != Move.CUT) & np.isfinite(s))
    for n in doubt:
        for a in (n - 1, n):
            if not (a >= 0 and a + 1 < len(s) and np.isfinite(s[[a, a + 1]]).all()):
                continue
            pair = np.array([a, a + 1])
            for k in range(int(np.ceil(s[a] - SAME)), int(np.floor(s[a + 1] + SAME)) + 1):
                if toolpath.move[min(k, len(toolpath) - 1)] == Move.CUT:
                    out[n] |= not ((np.abs(s[pair] - k) <= 0.5) & (wanted[pair] == Move.CUT)).any()
    return out


def _in_gap(motion: Motion, toolpath: Toolpath, points: Points) -> Bools:
    """(S,) rows of rapid moves that pass or touch a point given up."""
    given_up = np.zeros(len(toolpath), bool)
    inside = (points.point >= 0) & (points.point < len(toolpath))
    given_up[points.point[inside & ~points.ok]] = True
    before = np.concatenate([[0], np.cumsum(given_up)])
    rapid = (motion.move == Move.RAPID) & np.isfinite(motion.point)
    out = np.zeros(len(rapid), bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rapid, [False]]).astype(int)))
    for a, b in edges.reshape(-1, 2):
        low = int(np.floor(motion.point[max(a - 1, 0)] if np.isfinite(motion.point[max(a - 1, 0)]) else 0.0))
        high = min(int(np.ceil(motion.point[b - 1])), len(toolpath) - 1)
        out[a:b] = before[high + 1] > before[low]
    return out


def _operations(motion: Motion, toolpath: Toolpath) -> list[str]:
    labels = np.array([" ".join(o.label.split()) for o in toolpath.operations] or [""], dtype=object)
    s, last = motion.point, len(toolpath) - 1
    known = np.flatnonzero(np.isfinite(s))
    if not len(known):
        return ["no row has a point"]
    toward = np.clip(np.ceil(np.nan_to_num(s) - SAME), 0, last).astype(int)
    toward[: known[0]] = toward[known[0]]
    wanted = labels[toolpath.operation[toward]]
    wanted[known[-1] + 1 :] = ""
    have = np.array(motion.operation, dtype=object)
    wrong = (have != wanted) & (have != labels[toolpath.operation[_next(motion, toolpath, toward)]])
    rapid = motion.move == Move.RAPID  # one that passes points by belongs to where it ends
    for n in np.flatnonzero(wrong & rapid & np.isfinite(s)):
        after = np.flatnonzero(~rapid[n:])
        end = n + int(after[0]) if len(after) else len(s) - 1
        places = s[n : end + 1][np.isfinite(s[n : end + 1])]
        wrong[n] = have[n] not in set(labels[toolpath.operation[np.clip(np.ceil(places - SAME), 0, last).astype(int)]])
    return [f"{motion.at(n)} is of {have[n]!r}, the toolpath says {wanted[n]!r}" for n in np.flatnonzero(wrong)]


def _gamma(motion: Motion, toolpath: Toolpath, ride: Ride) -> list[Check]:
    told = np.isfinite(motion.gamma)
    step = np.linalg.norm(np.diff(toolpath.position, axis=0, prepend=toolpath.position[:1]), axis=1)
    step += np.linalg.norm(np.diff(toolpath.axis, axis=0, prepend=toolpath.axis[:1]), axis=1)
    moving = np.isfinite(motion.point) & (step[ride.toward] > 0) & (toolpath.move[ride.toward] != Move.RAPID)
    lift = np.isin(motion.move, (Move.APPROACH, Move.RETRACT)) & ride.drawn(motion.point)
    due = moving & (motion.move != Move.RAPID) & ~ride.lifted & ride.fed & ~lift
    blank = (motion.move == Move.RAPID) | ~np.isfinite(motion.point)
    wrong = [f"{motion.at(n)} has none" for n in np.flatnonzero(due & ~told)]
    wrong += [f"{motion.at(n)} has one in a rapid move" for n in np.flatnonzero(blank & told)]
    rows = np.flatnonzero(told & ride.fed)
    out = [counted("rotation of the samples told", wrong)]
    if not len(rows):
        return out
    known = reference.at_points(toolpath)
    off = np.full(len(rows), np.inf)
    for start in range(0, len(rows), BLOCK):
        some = rows[start : start + BLOCK]
        off[start : start + BLOCK] = _off_rotation(motion, toolpath, known, ride.tcp[some], some)
    out.append(worst("rotation of the samples", "deg", np.degrees(off), GAMMA_DEG, lambda n: motion.at(rows[n])))
    return out


def _off_rotation(
    motion: Motion, toolpath: Toolpath, known: reference.Directions, tcp: Array, rows: NDArray[np.intp]
) -> Array:
    """(M,) rad by which some rows (M,) with TCP poses (M, 4, 4) miss the nearest rotation that the path gives them."""
    s = np.clip(motion.point[rows], 0.0, len(toolpath) - 1)
    off = np.full(len(rows), np.inf)
    for leaving in (False, True):
        there = reference.between(toolpath, known, s, leaving=leaving)
        for found in there.gamma(tcp).T:
            apart = np.abs((found - motion.gamma[rows] + np.pi) % (2.0 * np.pi) - np.pi)
            off = np.fmin(off, np.maximum(apart - _leeway(toolpath, known, s, there), 0.0))
    return off


def _leeway(toolpath: Toolpath, known: reference.Directions, s: Array, there: reference.Directions) -> Array:
    """(M,) rad by which the reference of a place inside a move whose axis turns differs from that carried from its
    start.

    The planner counts rotation from a direction carried along by the smallest turn; where the travel is inclined to an
    axis that turns sideways, its projection turns away from that.
    """
    low = np.clip(np.ceil(s - SAME).astype(int) - 1, 0, len(toolpath) - 1)
    a, b, x = toolpath.axis[low], there.axis, known.zero[low]
    v = np.cross(a, b)
    c = np.einsum("ij,ij->i", a, b)[:, None]
    carried = x + np.cross(v, x) + np.cross(v, np.cross(v, x)) / np.maximum(1.0 + c, 0.1)
    turn = np.arctan2(np.linalg.norm(np.cross(carried, there.zero), axis=1), np.einsum("ij,ij->i", carried, there.zero))
    return np.where(np.abs(a - b).max(axis=1) > 1e-9, turn, 0.0)
