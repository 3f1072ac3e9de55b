"""Rounded corners between the straight legs of rapid moves, in place of exact stops.

Data flow, after all legs of a motion are planned and free:

1. Consecutive rapid legs make chains of straight steps. A corner of a chain may be rounded unless the machine rests or
   acts there (dwell, stop, spindle, coolant, tool).
2. Points that a straight move passes near enough are no corners (:mod:`machopt.planning.motion.rapid_chain`).
3. :mod:`machopt.planning.motion.corner_timing` times each chain with corners rounded over at most half of either leg.
4. Each corner is checked: the tool passes a point of the file within ``rapid_blend_mm``; the curve and a fan of chords
   over the triangle of corner, begin and end of the rounding are free, with the clearance of rapid moves; no place of
   them is under a cut. So any other curve in that triangle, such as that of a controller, is as free as a
   straight leg.
5. A corner that fails is rounded over less, in the end not at all, and its chain is timed again.
6. The legs get new samples, the shares of their ends that are rounded, and the rows nearest to their ends.

The retracts, approaches and cuts before and after a chain are not touched: it begins and ends at rest.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.planning.motion.corner_timing import CornerTiming, time_legs
from machopt.planning.motion.motion_segment import MotionSegment
from machopt.planning.motion.rapid_chain import (
    CornerSpace,
    RapidChain,
    count_standing_rows,
    find_chains,
    place_chain_nodes,
)
from machopt.planning.motion.rapid_moves import retime_straight_segments
from machopt.planning.motion.rapid_node_placement import HALF

STATED_SHARE = 1e-5  # of a leg, at least: the table has 4 decimals of a percent, and a sample step is much longer
STRAIGHT = 5e-9  # rad or m, of a corner from the line between its neighbours: any share is on it
LEAST_SHARE = 0.02  # of a leg; a corner rounded over less is a stop
SMALLER = 0.6  # of the share, where the corner collides
ROUNDS = 8  # of checking and timing
CURVE_PLACES, CURVE_STEP = 17, 2  # of the curve of a corner; every second one is checked, and between them straight
FAN_M, FAN_RAD = 5e-3, float(np.radians(2.5))  # distance of the chords over the triangle, at the tool and in the joints


@dataclass(frozen=True)
class _Corner:
    """One rounded corner of a chain."""

    chain: RapidChain
    node: int
    fan: Array  # (F, n) rad or m, true angles: the curve and chords over the triangle
    off: float  # m by which the tool passes the point where it is nearest


def round_rapid_corners(legs: Sequence[MotionSegment], toolpath: Toolpath, space: CornerSpace) -> list[MotionSegment]:
    """Return the legs of a motion with the corners of the rapid moves rounded where that is free and faster.

    Args:
        legs: legs of the motion in order; rapid ones are straight between their way points.
        toolpath: with its events.
        space: what the corners have to keep.
    """
    chains = find_chains(legs, toolpath, space)
    place_chain_nodes(chains, space)
    for chain in chains:
        _time_chain(chain, space)
    pending = chains
    for _ in range(ROUNDS):
        corners = [corner for chain in pending for corner in _list_corners(chain, space)]
        failed = _shrink_failed_corners(corners, space)
        if not failed:
            break
        pending = [chain for chain in pending if any(chain is bad for bad in failed)]
        for chain in pending:
            _time_chain(chain, space)
    else:
        for chain in pending:  # never seen: each round lowers a share
            chain.most[:] = 0.0
            _time_chain(chain, space)
    out = list(legs)
    for chain in chains:
        if chain.placement.passed.any() or any(timing is not None for timing in chain.timings.values()):
            _resample(out, chain, space)
    return out


def _time_chain(chain: RapidChain, space: CornerSpace) -> None:
    """Time the groups of a chain; where rounding saves nothing, its corners become stops."""
    limits, steps = space.build_limits(chain.nodes.shape[1]), np.diff(chain.corners, axis=0)
    chain.timings, chain.nearest = {}, {}
    for first, last in chain.list_groups():
        chain.timings[first, last] = None
        if last - first < 2:
            continue
        found = time_legs(steps[first:last], limits, chain.most[first : last - 1])
        if found is not None and _has_rows(found, space.timing.sample):
            chain.timings[first, last] = found


def _has_rows(timing: CornerTiming, sample: float) -> bool:
    """Whether the corners are so far apart that each has a row of its own."""
    rows = _find_rows(timing, sample, [])
    return all(b > a for a, b in itertools.pairwise(rows))


def _find_rows(timing: CornerTiming, sample: float, nearest: Sequence[float]) -> list[int]:
    """Return the row of each node, the nearest to the given times in s of the corners.

    Where these rows are not in order, those in the middle of the corners.
    """
    count = max(int(np.ceil(timing.duration / sample - 1e-9)), 1)
    slower = count * sample / timing.duration
    curves = [timing.get_curve(n) for n in range(1, len(timing.weight))]
    middles = [float(timing.start[m] + timing.length[m] / 2.0) for m in curves]
    rows = [0, *(round(time * slower / sample) for time in nearest), count]
    if not nearest or not all(b > a for a, b in itertools.pairwise(rows)):
        rows = [0, *(round(time * slower / sample) for time in middles), count]
    return rows


def _list_corners(chain: RapidChain, space: CornerSpace) -> list[_Corner]:
    out = []
    for (first, _), timing in chain.timings.items():
        for n in range(1, len(timing.weight)) if timing is not None else ():
            out.append(_build_corner(chain, first + n, timing, n, space))  # type: ignore[arg-type]  # not None here
    return out


def _build_corner(chain: RapidChain, node: int, timing: CornerTiming, n: int, space: CornerSpace) -> _Corner:
    before, w, after = chain.corners[node - 1 : node + 2]
    shares = timing.get_rounded_shares(n)
    m = timing.get_curve(n)
    times = timing.start[m] + np.linspace(0.0, timing.length[m], CURVE_PLACES)
    driven = timing.compute_shares(times)[:, n - 1 : n + 1]
    curve = w - (1.0 - driven[:, :1]) * (w - before) + driven[:, 1:] * (after - w)
    ends = np.array([w - shares[0] * (w - before), w + shares[1] * (after - w)])
    own = chain.kept[node]
    place = space.compute_place(np.vstack([chain.nodes[own], w, ends, curve]))
    off = np.linalg.norm(place[4:] - place[0], axis=1)
    chain.nearest[node] = float(times[int(np.argmin(off))])
    height = measure_height(place[1:4], 1.0 / FAN_M), measure_height(np.vstack([w, ends])[:, :6], 1.0 / FAN_RAD)
    count = max(int(np.ceil(max(height))), 1)
    rows = [curve[::CURVE_STEP]]
    for k in [2] if count == 2 else range(count, 0, -1):  # of two chords the curve is about the inner one
        chord = w + k / count * (ends - w)
        rows.append(chord[::-1] if (count - k) % 2 == 0 else chord)
    passing = float(off.min()) if chain.limited[own] else 0.0  # no file asks for the way points of a detour
    return _Corner(chain, node, space.compute_true(np.vstack(rows)), passing)


def measure_height(triangle: Array, scale: float) -> float:
    """Return the distance of the first of three places (3, n) from the line between the others, in units of 1/scale."""
    corner, begin, end = triangle
    way = end - begin
    square = float(way @ way)
    share = float(np.clip((corner - begin) @ way / square, 0.0, 1.0)) if square > 0.0 else 0.0
    return scale * float(np.linalg.norm(corner - begin - share * way))


def _shrink_failed_corners(corners: list[_Corner], space: CornerSpace) -> list[RapidChain]:
    """Lower the shares of the corners that fail; return their chains."""
    failed: list[RapidChain] = []
    wide = [corner.off > space.deviation for corner in corners]
    for corner, too_wide in zip(corners, wide, strict=True):
        if too_wide:
            _lower(corner, max(min(0.9 * space.deviation / corner.off, 0.9), 0.3))
            failed.append(corner.chain)
    narrow = [corner for corner, too_wide in zip(corners, wide, strict=True) if not too_wide]
    for corner, hit in zip(narrow, _find_hits(narrow, space), strict=True):
        if hit or (space.barred is not None and space.barred(corner.fan)):
            _lower(corner, SMALLER)
            failed.append(corner.chain)
    return failed


def _lower(corner: _Corner, factor: float) -> None:
    chain, n = corner.chain, corner.node
    timing, k = next((t, n - first) for (first, last), t in chain.timings.items() if first < n < last and t is not None)
    share = factor * max(timing.get_rounded_shares(k))
    chain.most[n - 1] = share if share >= LEAST_SHARE else 0.0


def _find_hits(corners: list[_Corner], space: CornerSpace) -> list[bool]:
    """Return whether something collides at each corner, checked in one batch."""
    if space.collision is None or not corners:
        return [False] * len(corners)
    rows = np.vstack([corner.fan for corner in corners])
    ends = np.cumsum([0, *(len(corner.fan) for corner in corners)])
    starts: Bools = np.zeros(len(rows), bool)
    starts[ends[:-1]] = True
    hit = space.collision.check_motion(rows, np.zeros(len(rows), bool), space.step, starts=starts).hit
    return [bool(hit[a:b].any()) for a, b in itertools.pairwise(ends.tolist())]


def _resample(legs: list[MotionSegment], chain: RapidChain, space: CornerSpace) -> None:
    """Give the legs of a chain their samples, the rows of their way points, and the shares that are rounded."""
    timing, pieces, corners = space.timing, list[Array](), chain.corners
    shares = np.zeros((len(chain.nodes), 2))
    shares[chain.placement.passed] = HALF
    for (first, last), found in chain.timings.items():
        nodes = corners[first : last + 1]
        if found is None:
            for pair in itertools.pairwise(nodes):
                pieces.append(retime_straight_segments(np.array(pair), timing.limits, timing.scale, timing.sample))
            continue
        rows = _find_rows(found, timing.sample, [chain.nearest[n] for n in range(first + 1, last)])
        x = nodes[0] + found.compute_shares(np.linspace(0.0, found.duration, rows[-1] + 1)) @ np.diff(nodes, axis=0)
        x[0], x[-1] = nodes[0], nodes[-1]
        pieces += [x[a : b + 1] for a, b in itertools.pairwise(rows)]
        for n in range(1, last - first):
            driven = found.get_rounded_shares(n)
            if measure_height(corners[[first + n, first + n - 1, first + n + 1]], 1.0) <= STRAIGHT:
                driven = HALF, HALF
            shares[chain.kept[first + n]] = np.maximum(chain.compute_shares(first + n, driven), STATED_SHARE)
    steps = [
        part
        for piece, (a, b) in zip(pieces, itertools.pairwise(chain.kept), strict=True)
        for part in _split_at_passed(piece, chain.placement.nodes[[a, b]], chain.placement.share[a + 1 : b])
    ]
    for k in sorted({leg for leg, _ in chain.of}):
        own = [n for n, (leg, _) in enumerate(chain.of) if leg == k]
        ends = [n + 1 for n in own]
        legs[k] = _replace_samples(legs[k], [steps[n] for n in own], chain.placement.nodes[ends], shares[ends])


def _split_at_passed(x: Array, ends: Array, share: Array) -> list[Array]:
    """Return the samples (S, n) of a straight move in parts: to each passed node, at its share of the move, and on."""
    way = ends[1] - ends[0]
    along = (x - ends[0]) @ way / float(way @ way)
    rows = [0]
    for n, f in enumerate(share):
        rows.append(int(np.clip(np.argmin(np.abs(along - f)), rows[-1] + 1, len(x) - 1 - (len(share) - n))))
    rows.append(len(x) - 1)
    return [x[a : b + 1] for a, b in itertools.pairwise(rows)]


def _replace_samples(leg: MotionSegment, pieces: list[Array], targets: Array, shares: Array) -> MotionSegment:
    x = np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])])
    ends = np.cumsum([len(piece) - 1 for piece in pieces])
    standing_rows, n = count_standing_rows(leg), len(x)
    moved = replace(
        leg,
        q=x[:, :6],
        external=x[:, 6:],
        index=np.linspace(leg.index[0], leg.index[-1], n),
        move=np.full(n, leg.move[-1], np.int8),
        operation=np.full(n, leg.operation[-1], np.int32),
        gamma=np.full(n, np.nan),
        waypoints=targets[:, :6],
        waypoint_external=targets[:, 6:],
        waypoint_row=ends,
        rounded=shares,
    )
    return moved.standing(0, standing_rows[0]).standing(-1, standing_rows[1])


def list_rounded_corners(legs: Sequence[MotionSegment]) -> RapidCorners | None:
    """Return the rounded corners of a motion; None where there are none.

    Args:
        legs: legs of the motion in order, each beginning with the last sample of the one before.
    """
    targets: list[tuple[int, int, Array, Array]] = []  # row where the move begins and ends, joints, shares
    first = 0
    for leg in legs:
        if leg.waypoint_row is not None and leg.rounded is not None:
            ends = [first, *(first + leg.waypoint_row).tolist()]
            joints = np.hstack([leg.waypoints, leg.waypoint_external])
            targets += zip(ends[:-1], ends[1:], joints, leg.rounded, strict=True)
        first += len(leg.q) - 1
    found = [n for n, target in enumerate(targets) if target[3].any()]
    if not found:
        return None
    x = np.array([targets[n][2] for n in found])
    return RapidCorners(
        sample=np.array([targets[n][1] for n in found]),
        before=np.array([targets[n][0] for n in found]),
        after=np.array([targets[n + 1][1] for n in found]),
        q=x[:, :6],
        external=x[:, 6:],
        share=np.array([targets[n][3] for n in found]),
    )
