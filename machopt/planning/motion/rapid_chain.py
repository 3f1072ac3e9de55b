"""Chains of straight rapid moves without a stop that has to be, and which of their points are passed.

A point of the file may be passed (:mod:`machopt.planning.motion.rapid_node_placement`). Beside a move at the feed this
is so only where its end is above all cuts near it, and a cut begins or ends there along the tool axis. Elsewhere the
straight way along the tool axis is kept, because material that the cell does not state may be beside it. Straight moves
that are new have to be free, with the clearance of rapid moves, and above the cuts; else no point between their ends is
passed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.planning.motion.corner_timing import CornerTiming
from machopt.planning.motion.motion_segment import MotionSegment
from machopt.planning.motion.rapid_moves import LOOKS, STILL, RapidTiming
from machopt.planning.motion.rapid_node_placement import HALF, NodePlacement, PassingReach, place_nodes

SILENT = "comment"  # events of this kind act on nothing
ALONG_M, ALONG = 5e-4, float(np.cos(np.radians(5.0)))  # m of a cut whose direction is compared with the axis
LEAST_ROWS = 6  # samples of each part of a move between passed points


@dataclass(frozen=True, kw_only=True)
class CornerSpace:
    """What a rounded corner has to keep."""

    timing: RapidTiming  # limits by encoder, and the control sample
    collision: CollisionModel | None  # None leaves collisions unchecked
    step: float  # rad, greatest joint step between collision checks
    deviation: float  # m by which the tool may pass a point of the file
    compute_tcp: Callable[[Array], Array]  # (S, 6 + E) true angles → (S, 4, 4) in the workpiece
    compute_true: Callable[[Array], Array]  # (S, 6 + E) encoder angles → true angles
    barred: Callable[[Array], bool] | None  # whether true angles (S, 6 + E) are under a cut
    is_above_cuts: Callable[[Array], bool] | None = None  # true angles (S, 6 + E), of all cuts near them; None: all are

    def compute_place(self, x: Array) -> Array:
        """Return (S, 3) m, the tool in the workpiece.

        Args:
            x: (S, 6 + E) encoder angles.
        """
        return self.compute_tcp(self.compute_true(x))[:, :3, 3]

    def build_limits(self, axes: int) -> Array:
        """Return (3, n) speed, acceleration and jerk in rapid moves.

        Args:
            axes: n.
        """
        timing = self.timing
        bounds = (timing.limits.velocity, timing.limits.acceleration, timing.limits.jerk)
        return timing.scale * np.array([np.asarray(bound)[:axes] for bound in bounds])


@dataclass(kw_only=True)
class RapidChain:
    """K straight steps, K + 1 nodes. Corners and groups count the nodes that are kept."""

    nodes: Array  # (K + 1, n) rad or m by encoder, where the file or a detour has them
    of: list[tuple[int, int]]  # leg and way point that each step leads to
    allowed: Array  # (K − 1,) largest share at each inner node; 0: a stop
    movable: Bools  # (K + 1,) nodes that may be passed
    limited: Bools  # (K + 1,) points of the file, which the tool passes within the deviation
    placement: NodePlacement = field(init=False)
    most: Array = field(init=False)  # largest share at each corner; 0: a stop
    timings: dict[tuple[int, int], CornerTiming | None] = field(default_factory=dict)  # of its groups
    nearest: dict[int, float] = field(default_factory=dict)  # s of its group, where the tool is nearest to a node

    def __post_init__(self) -> None:
        self.place(NodePlacement.build(self.nodes))

    def place(self, placement: NodePlacement) -> None:
        """Set where the nodes are.

        Args:
            placement: of the nodes.
        """
        self.placement, self.most = placement, placement.limit_shares(self.allowed)

    @property
    def kept(self) -> list[int]:
        """Nodes that are corners, stops or ends."""
        return self.placement.kept

    @property
    def corners(self) -> Array:
        """Joints at the nodes that are kept, rad or m."""
        return np.asarray(self.placement.nodes[self.kept])

    def list_groups(self) -> list[tuple[int, int]]:
        """Return first and last kept node of the steps between two stops."""
        stops = [0, *(n + 1 for n in np.flatnonzero(self.most <= 0.0).tolist()), len(self.kept) - 1]
        return list(itertools.pairwise(stops))

    def compute_shares(self, corner: int, shares: tuple[float, float]) -> tuple[float, float]:
        """Return shares of the steps between nodes from those of the straight moves between kept nodes.

        Args:
            corner: number of the kept node.
            shares: of the straight moves before and behind it.
        """
        before, here, after = self.kept[corner - 1 : corner + 2]
        along = self.placement.share
        last = 1.0 - float(along[here - 1]) if here - 1 > before else 1.0
        first = float(along[here + 1]) if here + 1 < after else 1.0
        return min(shares[0] / last, HALF), min(shares[1] / first, HALF)


def find_chains(legs: Sequence[MotionSegment], toolpath: Toolpath, space: CornerSpace) -> list[RapidChain]:
    """Return the chains of at least two steps.

    Args:
        legs: legs of the motion in order; rapid ones are straight between their way points.
        toolpath: with its events.
        space: what the corners have to keep.
    """
    acting = {event.index - 1 for event in toolpath.events if event.kind != SILENT}
    chains: list[RapidChain] = []
    nodes: list[Array] = []
    of: list[tuple[int, int]] = []
    most: list[float] = []

    def close() -> None:
        if len(of) > 1 and any(most[1:]):
            chains.append(_build_chain(np.array(nodes), list(of), np.array(most[1:]), legs, space))
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
        standing_rows = count_standing_rows(leg)
        place = legs[k - 1].index[-1] if k else np.nan
        joined = bool(of) and not standing_rows[0] and np.isfinite(place) and round(float(place)) not in acting
        for n, target in enumerate(targets):
            most.append(HALF if n or joined else 0.0)
            nodes.append(target)
            of.append((k, n))
        if standing_rows[1]:
            close()
    close()
    return chains


def count_standing_rows(leg: MotionSegment) -> tuple[int, int]:
    """Return the numbers of additional rows at rest at the begin and at the end of a leg.

    Args:
        leg: leg that moves.
    """
    x = np.hstack([leg.q, leg.external])
    moved_first, moved_last = (np.flatnonzero((x != x[end]).any(axis=1)) for end in (0, -1))
    if not len(moved_first):
        return 0, 0
    return int(moved_first[0]) - 1, len(x) - 2 - int(moved_last[-1])


def _build_chain(
    nodes: Array, of: list[tuple[int, int]], allowed: Array, legs: Sequence[MotionSegment], space: CornerSpace
) -> RapidChain:
    limited = np.zeros(len(nodes), bool)
    limited[1:] = [n == len(legs[k].waypoints) - 1 and bool(np.isfinite(legs[k].index[-1])) for k, n in of]
    movable = limited & np.r_[False, allowed > 0.0, False]
    first, last = of[0][0] - 1, of[-1][0] + 1
    for leg, inner in ((first, 1), (last, -2)):
        if 0 <= leg < len(legs) and movable[inner]:
            movable[inner] = _is_clear_end(legs[leg], inner < 0, space)
    return RapidChain(nodes=nodes, of=of, allowed=allowed, movable=movable, limited=limited)


def _is_clear_end(leg: MotionSegment, begins: bool, space: CornerSpace) -> bool:
    """Return whether a leg beside a chain begins, or ends, above all cuts near it, and not sideways in a cut."""
    x = space.compute_true(np.hstack([leg.q, leg.external])[:: 1 if begins else -1])
    if space.is_above_cuts is not None and not space.is_above_cuts(x[:1]):
        return False
    own = leg.move[min(1, len(leg.move) - 1)] if begins else leg.move[-1]
    if leg.name == "rapid" or own != MoveKind.CUT:
        return True
    T = space.compute_tcp(x)
    way = T[:, :3, 3] - T[0, :3, 3]
    length = np.linalg.norm(way, axis=1)
    moved = np.flatnonzero(length > ALONG_M)
    return bool(len(moved)) and float(way[moved[0]] @ T[0, :3, 2]) > ALONG * float(length[moved[0]])


def place_chain_nodes(chains: Sequence[RapidChain], space: CornerSpace) -> None:
    """Pass nodes of chains where that is faster and the new straight moves are free.

    Args:
        chains: chains with their nodes where the file has them.
        space: what the moves have to keep.
    """
    pending = [chain for chain in chains if chain.movable.any()]
    while pending:
        for chain in pending:
            limits = space.build_limits(chain.nodes.shape[1])
            reach = PassingReach(space.deviation, LEAST_ROWS * space.timing.sample, space.compute_place)
            chain.place(place_nodes(chain.nodes, chain.movable, chain.allowed, limits, reach))
        moves = [(chain, step) for chain in pending for step in _list_new_moves(chain)]
        blocked = _find_blocked_moves([chain.corners[n : n + 2] for chain, n in moves], space)
        failed = [move for move, hit in zip(moves, blocked, strict=True) if hit]
        for chain, n in failed:
            chain.movable[chain.kept[n] : chain.kept[n + 1]] = False
        pending = [chain for chain in pending if any(chain is bad for bad, _ in failed)]


def _list_new_moves(chain: RapidChain) -> list[int]:
    """Return the straight moves between kept nodes with passed ones in between."""
    return [n for n, (a, b) in enumerate(itertools.pairwise(chain.kept)) if b > a + 1]


def _find_blocked_moves(moves: list[Array], space: CornerSpace) -> list[bool]:
    """Return whether straight moves (2, n) by encoder collide or are under a cut; contacts are checked in one batch."""
    if not moves:
        return []
    rows = space.compute_true(np.vstack(moves))
    hit: Bools = np.zeros(len(moves), bool)
    if space.collision is not None:
        starts = np.arange(len(rows)) % 2 == 0
        hit = space.collision.check_motion(rows, np.zeros(len(rows), bool), space.step, starts=starts).hit[~starts]
    out: list[bool] = hit.tolist()
    if space.barred is not None:
        for n, move in enumerate(moves):
            count = max(int(np.ceil(LOOKS * float(np.abs(move[1] - move[0]).max()) / space.step)), 1)
            along = move[0] + np.linspace(0.0, 1.0, count + 1)[:, None] * (move[1] - move[0])
            out[n] = out[n] or space.barred(space.compute_true(along))
    return out
