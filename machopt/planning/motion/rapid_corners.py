"""Rounded corners between the straight legs of rapid moves, in place of exact stops.

Data flow, after all legs of a motion are planned and free:

1. Consecutive rapid legs make chains of straight steps. A corner of a chain may be rounded unless the machine rests or
   acts there (dwell, stop, spindle, coolant, tool).
2. :mod:`machopt.planning.motion.corner_timing` times each chain with corners rounded over at most half of either leg.
3. Each corner is checked: the tool passes the point within ``rapid_blend_mm``; the curve and a fan of chords over the
   whole triangle of corner, begin and end of the rounding are free, with the clearance of rapid moves; no place of them
   is under a cut. So any other curve in that triangle, such as that of a controller, is as free as a straight leg.
4. A corner that fails is rounded over less, in the end not at all, and its chain is timed again.
5. The legs get new samples, the shares of their ends that are rounded, and the rows nearest to their ends.

The retracts, approaches and cuts before and after a chain are not touched: it begins and ends at rest.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.planning.motion.corner_timing import CornerTiming, time_legs
from machopt.planning.motion.motion_segment import MotionSegment
from machopt.planning.motion.rapid_moves import STILL, RapidTiming, retime_straight_segments

HALF = 0.5  # of a leg, at most, is rounded at either end: no controller begins before
LEAST_SHARE = 0.02  # of a leg; a corner rounded over less is a stop
SMALLER = 0.6  # of the share, where the corner collides
ROUNDS = 8  # of checking and timing
CURVE_PLACES, CURVE_STEP = 17, 2  # of the curve of a corner; every second one is checked, and between them straight
FAN_M, FAN_RAD = 5e-3, float(np.radians(2.5))  # distance of the chords over the triangle, at the tool and in the joints
SILENT = "comment"  # events of this kind act on nothing


@dataclass(frozen=True, kw_only=True)
class CornerSpace:
    """What a rounded corner has to keep."""

    timing: RapidTiming  # limits by encoder, and the control sample
    collision: CollisionModel | None  # None leaves collisions unchecked
    step: float  # rad, greatest joint step between collision checks
    deviation: float  # m by which the tool may pass the point
    compute_tcp: Callable[[Array], Array]  # (S, 6 + E) true angles → (S, 4, 4) in the workpiece
    compute_true: Callable[[Array], Array]  # (S, 6 + E) encoder angles → true angles
    barred: Callable[[Array], bool] | None  # whether true angles (S, 6 + E) are under a cut


@dataclass
class _Chain:
    """Straight steps without a stop that has to be: K of them, K + 1 nodes."""

    nodes: Array  # (K + 1, n) rad or m by encoder
    of: list[tuple[int, int]]  # leg and way point that each step leads to
    most: Array  # (K − 1,) largest share at each corner; 0: a stop
    timings: dict[tuple[int, int], CornerTiming | None] = field(default_factory=dict)  # of its groups
    nearest: dict[int, float] = field(
        default_factory=dict
    )  # s of its group's time, where the tool is nearest to a node

    def list_groups(self) -> list[tuple[int, int]]:
        """Return first and last node of the steps between two stops."""
        stops = [0, *(n + 1 for n in np.flatnonzero(self.most <= 0.0).tolist()), len(self.nodes) - 1]
        return list(itertools.pairwise(stops))


@dataclass(frozen=True)
class _Corner:
    """One rounded corner of a chain."""

    chain: _Chain
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
    chains = _find_chains(legs, toolpath)
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
        if any(timing is not None for timing in chain.timings.values()):
            _resample(out, chain, space)
    return out


def _find_chains(legs: Sequence[MotionSegment], toolpath: Toolpath) -> list[_Chain]:
    """Return the chains of at least two steps."""
    acting = {event.index - 1 for event in toolpath.events if event.kind != SILENT}
    chains: list[_Chain] = []
    nodes: list[Array] = []
    of: list[tuple[int, int]] = []
    most: list[float] = []

    def close() -> None:
        if len(of) > 1 and any(most[1:]):
            chains.append(_Chain(np.array(nodes), list(of), np.array(most[1:])))
        nodes.clear()
        of.clear()
        most.clear()

    for k, leg in enumerate(legs):
        x = np.hstack([leg.q, leg.external])
        targets = np.hstack([leg.waypoints, leg.waypoint_external])
        steps = np.diff(np.vstack([x[:1], targets]), axis=0)
        if leg.name != "rapid" or (np.abs(steps).max(axis=1) < STILL).any():
            close()
            continue
        if not of:
            nodes.append(x[0])
        stands = count_standing_rows(leg)
        place = legs[k - 1].index[-1] if k else np.nan
        joined = bool(of) and not stands[0] and np.isfinite(place) and round(float(place)) not in acting
        for n, target in enumerate(targets):
            most.append(HALF if n or joined else 0.0)
            nodes.append(target)
            of.append((k, n))
        if stands[1]:
            close()
    close()
    return chains


def count_standing_rows(leg: MotionSegment) -> tuple[int, int]:
    """Return how many additional rows a leg stands at its begin and at its end.

    Args:
        leg: leg that moves.
    """
    x = np.hstack([leg.q, leg.external])
    moved_first, moved_last = (np.flatnonzero((x != x[end]).any(axis=1)) for end in (0, -1))
    if not len(moved_first):
        return 0, 0
    return int(moved_first[0]) - 1, len(x) - 2 - int(moved_last[-1])


def _time_chain(chain: _Chain, space: CornerSpace) -> None:
    """Time the groups of a chain; where rounding saves nothing, its corners become stops."""
    timing, axes = space.timing, chain.nodes.shape[1]
    bounds = (timing.limits.velocity, timing.limits.acceleration, timing.limits.jerk)
    limits = timing.scale * np.array([np.asarray(bound)[:axes] for bound in bounds])
    steps = np.diff(chain.nodes, axis=0)
    chain.timings, chain.nearest = {}, {}
    for first, last in chain.list_groups():
        chain.timings[first, last] = None
        if last - first < 2:
            continue
        found = time_legs(steps[first:last], limits, chain.most[first : last - 1])
        if found is not None and _has_rows(found, timing.sample):
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


def _list_corners(chain: _Chain, space: CornerSpace) -> list[_Corner]:
    out = []
    for (first, _), timing in chain.timings.items():
        for n in range(1, len(timing.weight)) if timing is not None else ():
            out.append(_build_corner(chain, first + n, timing, n, space))  # type: ignore[arg-type]  # not None here
    return out


def _build_corner(chain: _Chain, node: int, timing: CornerTiming, n: int, space: CornerSpace) -> _Corner:
    w, before, after = chain.nodes[node], chain.nodes[node - 1], chain.nodes[node + 1]
    shares = timing.get_rounded_shares(n)
    m = timing.get_curve(n)
    times = timing.start[m] + np.linspace(0.0, timing.length[m], CURVE_PLACES)
    driven = timing.compute_shares(times)[:, n - 1 : n + 1]
    curve = w - (1.0 - driven[:, :1]) * (w - before) + driven[:, 1:] * (after - w)
    ends = np.array([w - shares[0] * (w - before), w + shares[1] * (after - w)])
    place = space.compute_tcp(space.compute_true(np.vstack([w, ends, curve])))[:, :3, 3]
    off = np.linalg.norm(place - place[0], axis=1)
    chain.nearest[node] = float(times[int(np.argmin(off[3:]))])
    height = measure_height(place[:3], 1.0 / FAN_M), measure_height(np.vstack([w, ends])[:, :6], 1.0 / FAN_RAD)
    count = max(int(np.ceil(max(height))), 1)
    rows = [curve[::CURVE_STEP]]
    for k in [2] if count == 2 else range(count, 0, -1):  # of two chords the curve is about the inner one
        chord = w + k / count * (ends - w)
        rows.append(chord[::-1] if (count - k) % 2 == 0 else chord)
    return _Corner(chain, node, space.compute_true(np.vstack(rows)), float(off[3:].min()))


def measure_height(triangle: Array, scale: float) -> float:
    """Return the distance of the first of three places (3, n) from the line between the others, in units of 1/scale."""
    corner, begin, end = triangle
    way = end - begin
    square = float(way @ way)
    share = float(np.clip((corner - begin) @ way / square, 0.0, 1.0)) if square > 0.0 else 0.0
    return scale * float(np.linalg.norm(corner - begin - share * way))


def _shrink_failed_corners(corners: list[_Corner], space: CornerSpace) -> list[_Chain]:
    """Lower the shares of the corners that fail; return their chains."""
    failed: list[_Chain] = []
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


def _resample(legs: list[MotionSegment], chain: _Chain, space: CornerSpace) -> None:
    """Give the legs of a chain their samples, the rows of their way points, and the shares that are rounded."""
    timing, pieces = space.timing, dict[int, Array]()
    shares = np.zeros((len(chain.nodes), 2))
    for (first, last), found in chain.timings.items():
        nodes = chain.nodes[first : last + 1]
        if found is None:
            for n, pair in enumerate(itertools.pairwise(nodes)):
                pieces[first + n] = retime_straight_segments(np.array(pair), timing.limits, timing.scale, timing.sample)
            continue
        rows = _find_rows(found, timing.sample, [chain.nearest[n] for n in range(first + 1, last)])
        x = nodes[0] + found.compute_shares(np.linspace(0.0, found.duration, rows[-1] + 1)) @ np.diff(nodes, axis=0)
        x[0], x[-1] = nodes[0], nodes[-1]
        for n, (a, b) in enumerate(itertools.pairwise(rows)):
            pieces[first + n] = x[a : b + 1]
        for n in range(1, last - first):
            shares[first + n] = found.get_rounded_shares(n)
    for k in sorted({leg for leg, _ in chain.of}):
        steps = [n for n, (leg, _) in enumerate(chain.of) if leg == k]
        legs[k] = _replace_samples(legs[k], [pieces[n] for n in steps], shares[[n + 1 for n in steps]])


def _replace_samples(leg: MotionSegment, pieces: list[Array], shares: Array) -> MotionSegment:
    x = np.vstack([pieces[0], *(piece[1:] for piece in pieces[1:])])
    ends = np.cumsum([len(piece) - 1 for piece in pieces])
    stands, n = count_standing_rows(leg), len(x)
    moved = replace(
        leg,
        q=x[:, :6],
        external=x[:, 6:],
        index=np.linspace(leg.index[0], leg.index[-1], n),
        move=np.full(n, leg.move[-1], np.int8),
        operation=np.full(n, leg.operation[-1], np.int32),
        gamma=np.full(n, np.nan),
        waypoint_row=ends,
        rounded=shares,
    )
    return moved.standing(0, stands[0]).standing(-1, stands[1])


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
