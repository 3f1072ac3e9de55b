"""Rapid moves: from rest to rest through free space, straight in joint space or around obstacles.

Tried in this order: the straight line, the caller's detours (retract, move across, approach), and a random tree
from both ends (RRT-Connect: Kuffner and LaValle 2000) with its corners cut. A detour is then shortened
(:mod:`machopt.planning.motion.rapid_shortcuts`). Each leg is a straight line in joint
space, and the checked line is the driven line: one jerk-limited profile times the place along
it (Ruckig with one degree of freedom), which keeps all joints in phase by construction.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import JointLimits
from machopt.numerics.array_types import Array
from machopt.planning.motion.rapid_shortcuts import shorten_detour
from machopt.planning.motion.search_budget import allow_extensions, count_in_vain

STILL = 1e-9  # rad, joints that differ by less do not move
REACH = 0.8  # rad, longest extension of the tree: benchmarks/rapid_moves_ompl.py
WIDE = np.pi / 3  # rad, initial sampling range beyond the two ends
ITERATIONS = 400  # extensions of the tree before giving up (a few ms each)
UNDER = "cutter ~ workpiece (no geometry: under a cut)"  # cause of a barred move without contact
LOOKS = 4  # checks of ``barred`` per collision step
SHORTCUTS = 60  # attempts to cut corners of the tree's path
MoveShape = Literal["direct", "retract", "sampled"]


@dataclass(frozen=True)
class RapidMove:
    """A collision-free motion at rest at both ends."""

    waypoints: Array  # (W, n) rad or m, first and last are the ends; straight in joint space and at rest at each
    kind: MoveShape
    q: Array  # (S, n) rad or m, one row a control sample, both ends included exactly


@dataclass(frozen=True)
class BlockedRapid:
    """Result of a search that found no free motion."""

    pair: str  # first contact on the straight line (or at an end), "a ~ b"
    where: Array  # (n,) rad or m, joints at that contact
    fraction: float  # of the straight line; 0 or 1 where an end itself is not free
    reason: Literal["start", "end", "way"]


@dataclass(frozen=True)
class RapidTiming:
    """Limits of a rapid move, for n joints."""

    limits: JointLimits  # position, velocity, acceleration, jerk
    scale: float  # share of the velocity, acceleration and jerk limits to use
    sample: float  # s, control sample
    rounded: bool = False  # whether corners will be rounded afterwards, which decides which detour is the fastest


@dataclass(frozen=True, kw_only=True)
class FreeSpace:
    """Configurations without collisions that are not forbidden for another reason."""

    collision: CollisionModel | None  # None leaves collisions unchecked
    step: float  # rad, greatest joint step between collision checks
    per_rad: Array | None = None  # (n,) factor from each joint to equivalent rad in the random tree; None: 1
    barred: Callable[[Array], bool] | None = None  # whether samples (S, n) of a collision-free move are forbidden

    def allows(self, move: RapidMove) -> bool:
        """Return whether a collision-free move is not forbidden for another reason."""
        return self.barred is None or not self.barred(move.q)

    def is_free(self, waypoints: Array) -> bool:
        """Return whether the straight legs between waypoints (W, n) are without collisions."""
        return self.collision is None or _free(self.collision, waypoints, self.step)


def plan_rapid(
    q_from: Array,
    q_to: Array,
    *,
    timing: RapidTiming,
    space: FreeSpace,
    detours: Callable[[], Iterable[Array]],
    rng: np.random.Generator,
    iterations: int = ITERATIONS,
    known_free: bool = False,
) -> RapidMove | BlockedRapid:
    """Plan and time a rapid move.

    Args:
        q_from: (n,) rad or m, start, of the arm and then of the external joints.
        q_to: (n,) rad or m, end.
        timing: limits of the same joints, and the control sample.
        space: collision model and what else forbids a move.
        detours: called only when the straight line is blocked; yields intermediate waypoints (W, n), best first.
        rng: for the random tree; the same state gives the same move.
        iterations: extensions of the random tree before giving up; 0 disables it.
        known_free: the straight line has been checked already and is free.

    Returns:
        The move, or the reason why none was found.
    """
    q_from, q_to = np.asarray(q_from, float), np.asarray(q_to, float)
    direct = np.array([q_from, q_to])
    blocked = (
        None if space.collision is None or known_free else _find_blocking_contact(space.collision, direct, space.step)
    )
    if blocked is None:
        straight = _time_move(direct, "direct", timing)
        if space.allows(straight):
            return straight
        blocked = BlockedRapid(UNDER, direct[0], 0.0, "way")
    if blocked.reason != "way":
        return blocked
    around = _find_detour(direct, timing, space, detours)
    return around or _find_sampled_move(direct, timing, space, blocked, rng, iterations)


def _time_move(waypoints: Array, kind: MoveShape, timing: RapidTiming) -> RapidMove:
    return RapidMove(waypoints, kind, retime_straight_segments(waypoints, timing.limits, timing.scale, timing.sample))


def _find_detour(
    direct: Array, timing: RapidTiming, space: FreeSpace, detours: Callable[[], Iterable[Array]]
) -> RapidMove | None:
    """Return the first free move over the waypoints of the caller, None where there is none."""
    n = direct.shape[1]
    low, high = timing.limits.lower[:n], timing.limits.upper[:n]
    for between in detours():
        waypoints = np.vstack([direct[0], np.asarray(between, float).reshape(-1, n), direct[1]])
        inside = (waypoints >= low - STILL).all() and (waypoints <= high + STILL).all()
        if inside and space.is_free(waypoints):
            around = _time_move(waypoints, "retract", timing)
            if space.allows(around):
                return _shorten(around, timing, space)
    return None


def _shorten(move: RapidMove, timing: RapidTiming, space: FreeSpace) -> RapidMove:
    """Return a detour with its corners cut where that is free and faster."""
    axes = move.waypoints.shape[1]
    bounds = (timing.limits.velocity, timing.limits.acceleration, timing.limits.jerk)
    limits = timing.scale * np.array([np.asarray(bound)[:axes] for bound in bounds])

    def is_free(waypoints: Array) -> bool:
        return space.is_free(waypoints) and space.allows(_time_move(waypoints, move.kind, timing))

    shorter = shorten_detour(move.waypoints, limits, timing.rounded, is_free)
    return move if shorter is move.waypoints else _time_move(shorter, move.kind, timing)


def _find_sampled_move(
    direct: Array,
    timing: RapidTiming,
    space: FreeSpace,
    blocked: BlockedRapid,
    rng: np.random.Generator,
    iterations: int,
) -> RapidMove | BlockedRapid:
    """Return a move by the random tree; without one, why the straight line is blocked."""
    measure = np.ones(direct.shape[1]) if space.per_rad is None else space.per_rad
    tree_space = _Space(collision=space.collision, barred=space.barred, step=space.step, measure=measure)
    extensions = allow_extensions(iterations)
    path = _connect(tree_space, direct, timing.limits, rng, iterations=extensions)
    if path is None:
        count_in_vain(extensions)
        return blocked
    for waypoints in (_cut_corners(tree_space, path, rng), path):  # between samples the shortened path may be barred
        sampled = _time_move(waypoints, "sampled", timing)
        if space.allows(sampled):
            return _shorten(sampled, timing, space)
    return BlockedRapid(UNDER, direct[0], 0.0, "way")


def retime_straight_segments(waypoints: Array, limits: JointLimits, scale: float, sample: float) -> Array:
    """Return (S, n) samples along straight legs, at rest at every waypoint, which all fall on a sample.

    With s ∈ [0, 1] along a leg Δq, joint i keeps its limits where |ds/dt| ≤ v_i / |Δq_i|, and so for the
    second and third derivative; the tightest joint decides. A leg's time is stretched to a whole number of
    samples, which lowers all three. Equal waypoints take no time.

    Args:
        waypoints: (W, n) rad or m.
        limits: velocity, acceleration and jerk of the joints.
        scale: share of these limits to use.
        sample: s, control sample.
    """
    waypoints = np.asarray(waypoints, float)
    rows = [waypoints[:1]]
    for a, b in itertools.pairwise(waypoints):
        delta = b - a
        if np.abs(delta).max() < STILL:
            if delta.any():  # one sample: far below any jerk limit, 1e-9 rad / (1 ms)³ = 1 rad/s³
                rows.append(b[None])
            continue
        share = _sample_profile(delta, limits, scale, sample)
        leg = a + share[1:, None] * delta
        leg[-1] = b
        rows.append(leg)
    return np.vstack(rows)


def _sample_profile(delta: Array, limits: JointLimits, scale: float, sample: float) -> Array:
    """Place along a leg, 0 … 1, at each sample."""
    import ruckig

    moving = np.abs(delta) > STILL * 1e-3
    size = np.abs(delta).max()  # the profile is in rad (or m) of the joint with the longest travel
    ratio = size / np.abs(delta[moving])
    command = ruckig.InputParameter(1)
    command.current_position, command.target_position = [0.0], [float(size)]
    bounds = (limits.velocity, limits.acceleration, limits.jerk)
    v, a, j = (float(scale * (np.asarray(bound)[: len(delta)][moving] * ratio).min()) for bound in bounds)
    command.max_velocity, command.max_acceleration, command.max_jerk = [v], [a], [j]
    trajectory = ruckig.Trajectory(1)
    result = ruckig.Ruckig(1).calculate(command, trajectory)
    if result != ruckig.Result.Working:
        raise ArithmeticError(f"no profile over {size} rad at {v} rad/s, {a} rad/s², {j} rad/s³: {result}")
    count = max(int(np.ceil(trajectory.duration / sample - 1e-9)), 1)
    times = np.linspace(0.0, trajectory.duration, count + 1)
    place = np.array([trajectory.at_time(float(t))[0][0] for t in times]) / size
    share: Array = np.clip(place, 0.0, 1.0)
    return share


def _free(collision: CollisionModel, waypoints: Array, step: float) -> bool:
    return not collision.check_motion(waypoints, np.zeros(len(waypoints), bool), step, first_only=True).any


@dataclass(frozen=True, kw_only=True)
class _Space:
    """Free space of the tree: without collisions, and not barred."""

    collision: CollisionModel | None
    barred: Callable[[Array], bool] | None
    step: float  # rad
    measure: Array  # (n,) per rad

    def free(self, a: Array, b: Array) -> bool:
        """Return whether the straight line between two places is free.

        Args:
            a: (n,) rad or m, start.
            b: (n,) rad or m, end.
        """
        if self.barred is not None:
            size = float(np.abs((b - a) * self.measure).max())
            count = max(int(np.ceil(LOOKS * size / self.step)), 1)
            if self.barred(a + np.linspace(0.0, 1.0, count + 1)[:, None] * (b - a)):
                return False
        return self.collision is None or _free(self.collision, np.array([a, b]), self.step)


def _find_blocking_contact(collision: CollisionModel, direct: Array, step: float) -> BlockedRapid | None:
    """Why the straight line is not free; an end that is not free comes first."""
    ends = collision.check_configurations(direct, np.zeros(2, bool))
    for n, reason in ((0, "start"), (1, "end")):
        if ends.hit[n]:
            pair = collision.pairs[ends.pair[n]].name
            return BlockedRapid(pair, direct[n], float(n), "start" if reason == "start" else "end")
    found = collision.check_motion(direct, np.zeros(2, bool), step)
    if not found.any:
        return None
    at = float(found.row[found.first])
    where = direct[0] + at * (direct[1] - direct[0])
    return BlockedRapid(collision.pairs[found.pair[found.first]].name, where, at, "way")


@dataclass
class _Tree:
    """Free joint positions, each reached by a free straight line from its parent."""

    q: list[Array]
    measure: Array  # (n,) per rad
    parent: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, q: Array) -> int:
        """Return the entry nearest to a position.

        Args:
            q: (n,) rad or m.
        """
        return int(np.argmin(np.abs((np.array(self.q) - q) * self.measure).max(axis=1)))

    def add(self, q: Array, parent: int) -> int:
        """Append a position and return its entry number.

        Args:
            q: (n,) rad or m.
            parent: entry it was reached from.
        """
        self.q.append(q)
        self.parent.append(parent)
        return len(self.q) - 1

    def branch(self, n: int) -> list[Array]:
        """Return the positions from the root to an entry.

        Args:
            n: number of the entry.
        """
        out = []
        while n >= 0:
            out.append(self.q[n])
            n = self.parent[n]
        return out[::-1]


def _connect(
    space: _Space, direct: Array, limits: JointLimits, rng: np.random.Generator, *, iterations: int
) -> Array | None:
    """(W, n) a free path by two trees growing towards each other, None if they did not meet."""
    measure = space.measure
    here, there = _Tree([direct[0]], measure), _Tree([direct[1]], measure)
    swapped = False
    low, high = limits.lower[: len(measure)], limits.upper[: len(measure)]
    for n in range(iterations):
        wide = WIDE * (1.0 + 4.0 * n / iterations) / measure
        box = np.maximum(low, direct.min(axis=0) - wide), np.minimum(high, direct.max(axis=0) + wide)
        target = box[0] + (box[1] - box[0]) * rng.random(len(measure))
        new = _extend(space, here, here.nearest(target), target)
        if new is not None:
            meet = there.nearest(here.q[new])
            while True:
                grown = _extend(space, there, meet, here.q[new])
                if grown is None:
                    break
                meet = grown
                if np.array_equal(there.q[meet], here.q[new]):
                    path = here.branch(new) + there.branch(meet)[::-1][1:]
                    return np.array(path[::-1] if swapped else path)
        here, there, swapped = there, here, not swapped
    return None


def _extend(space: _Space, tree: _Tree, near: int, target: Array) -> int | None:
    """One step of at most REACH from entry ``near`` towards the target; None if it is not free."""
    away = target - tree.q[near]
    distance = float(np.abs(away * tree.measure).max())
    q = target if distance <= REACH else tree.q[near] + away * (REACH / distance)
    if distance < STILL or not space.free(tree.q[near], q):
        return None if distance >= STILL else near
    return tree.add(q, near)


def _cut_corners(space: _Space, path: Array, rng: np.random.Generator) -> Array:
    """The path with corners cut where the straight line between two of its points is free."""
    points = list(path)
    for _ in range(SHORTCUTS):
        if len(points) <= 3:
            break
        i, j = sorted(rng.choice(len(points), size=2, replace=False))
        if j - i >= 2 and space.free(points[i], points[j]):
            del points[i + 1 : j]
    k = 0  # index of the remaining path
    while k + 2 < len(points):
        if space.free(points[k], points[k + 2]):
            del points[k + 1]
        else:
            k += 1
    return np.array(points)
