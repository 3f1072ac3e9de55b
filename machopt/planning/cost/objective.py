"""J, the objective: what one plan costs, the only place where its terms are written.

J = w_mean·mean(c)/c₀ + w_worst·max(c)/c₀ + w_travel·Σ a·b|Δq|/π + w_rotation·Σ a|Δφ|/π + w_feed·t_lost/t
+ w_preferred·mean((1 − cos(γ − γ_preferred))/2) + w_clearance·mean(max(0, 1 − d/d_full)), d the distance of the nearest
two bodies, with c₀ the median cost over the feasible candidates
(:mod:`machopt.planning.cost.stiffness_index`), means over the length cut
(:attr:`machopt.planning.stations.planning_path.PlanningPath.weight`) and a the
run's share of that length. Travel and rotation are total variations, so they do not depend on how finely a path is
sampled. b is 1 inside runs; over a rapid move of length d it is 1 + NEAR/(d + NEAR/10): the arm turns over on long
ones, far from the part. t_lost is the time by which the axes, at AXIS_SPEED of their velocity limits, are slower than
the programmed feed.

The search over the grid prices vertices (:func:`compute_node_cost`) and steps (:func:`compute_transition_cost`), the
smooth curve its
stations, a finished plan all planning points: the same terms on what each of them has. The formulas take numbers
and arrays alike. (:mod:`machopt.planning.smoothing.newton_solver` rounds and derives them; tests hold that it is the
same J,
but for clearance, which lies on a cubic between the grid's rotations there.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.steering import select_steered_rows
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.stations.planning_path import PlanningPath

AXIS_SPEED = 0.8  # share of the velocity limits; accelerations need the rest
NEAR = 0.5  # m: rapid moves shorter than this should not turn the arm over


@dataclass(frozen=True, kw_only=True)
class PlanObjective:
    """J and its parts, dimensionless; times c₀, ``mean`` and ``worst`` are the index's own."""

    total: float
    mean: float
    worst: float
    travel: float
    rotation: float
    feed: float
    preferred: float
    clearance: float = 0.0  # mean crowding; 0 where it does not count


# --- the formulas --------------------------------------------------------------------------------------------------


def compute_node_cost(cost: Any, liked: Any, mean: Any) -> Any:
    """A place's part of J for each unit of its share: cost is c/c₀, ``liked`` the price of its rotation."""
    return mean * cost + liked


def compute_transition_cost(length: Any, turn: Any, late: Any, travel: Any, rotation: Any, feed: Any) -> Any:
    """A step's part of J.

    Args:
        length: rad, Σ|Δq| over the axes.
        turn: rad, |Δφ| about the tool axis; none counts over rapid moves.
        late: s, :func:`compute_delay`.
        travel, rotation, feed: prices per rad, rad and s.
    """
    return travel * length + rotation * turn + feed * late


def compute_delay(slow: Any, seconds: Any) -> Any:
    """Seconds by which the ``slow`` s that the slowest axis needs exceed the ``seconds`` that the feed leaves."""
    return np.maximum(slow - seconds, 0.0)


edge_price_compiled, late_compiled = (
    jit_compile(compute_transition_cost),
    jit_compile(compute_delay),
)  # for the compiled search


@dataclass(frozen=True)
class RotationPreference:
    """The rotation that is preferred at each place, and the price of leaving it."""

    rotation: Array  # (n,) rad
    weight: Array  # (n,) 0 where none is preferred

    @classmethod
    def along(cls, path: PlanningPath, options: PlanOptions) -> RotationPreference | None:
        """At every planning point; None where none is preferred anywhere. Wishes about places go before the path's."""
        wishes = [w for w in options.steer if w.prefer is not None]
        if options.preferred_rotation is None and not wishes:
            return None
        n, everywhere = len(path.index), options.preferred_rotation is not None
        rotation = np.full(n, options.preferred_rotation if everywhere else 0.0)
        weight = np.full(n, options.preferred_weight if everywhere else 0.0)
        for wish in wishes:
            rows = select_steered_rows(wish, path.index)
            rotation[rows], weight[rows] = wish.prefer, wish.weight
        return cls(rotation, weight)

    def take(self, rows: NDArray[Any]) -> RotationPreference:
        """Of some of the places."""
        return RotationPreference(self.rotation[rows], self.weight[rows])

    def price(self, gamma: Array) -> Array:
        """Price (…, n) of rotations gamma (…, n) rad, dimensionless."""
        return np.asarray(compute_preference_cost(np.cos(gamma - self.rotation), self.weight))


def compute_crowding(distance: Any, full: float) -> Any:
    """How near the nearest two bodies are: 1 in contact, 0 from the distance ``full`` (m) on."""
    return np.maximum(0.0, 1.0 - np.maximum(distance, 0.0) / full)


def compute_preference_cost(cosine: Any, weight: Any) -> Any:
    """Price of a rotation whose angle from the preferred one has this cosine."""
    return weight * (1.0 - cosine) / 2.0


# --- what they are applied to --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ObjectiveTerms:
    """What J counts along a row of n places: the planning points, or some of them."""

    options: PlanOptions
    share: Array  # (n,) weight of each in the means, in all 1
    counted: NDArray[np.bool_]  # (n,) the worst index counts here
    travel: Array  # (n,) 1/rad of Σ|Δq| on the way into each: a·b/π
    rotation: Array  # (n,) 1/rad of |Δφ| on the way into each: a/π, 0 over rapid moves
    lost: Array  # (n,) 1/s of time lost on the way into each: 1/t, 0 over rapid moves
    seconds: Array  # (n,) s, time from the place before at the programmed feed
    slowness: Array  # (6,) s/rad, each axis at AXIS_SPEED of its velocity limit
    offset: Array  # (n,) rad, gamma − phi
    liking: RotationPreference | None = None  # None: no rotation is preferred

    @classmethod
    def of(cls, path: PlanningPath, velocity: Array, options: PlanOptions) -> ObjectiveTerms:
        """At every planning point.

        Args:
            velocity: (6,) rad/s, joint velocity limits.
        """
        n = len(path.index)
        flown = np.r_[True, path.run[1:] != path.run[:-1]]
        a = path.motion_share
        d = np.r_[np.inf, np.linalg.norm(np.diff(path.position, axis=0), axis=1)]
        swing = np.where(flown, 1.0 + NEAR / (d + 0.1 * NEAR), 1.0)
        return cls(
            options=options,
            share=path.weight,
            counted=path.counted,
            travel=a * swing / np.pi,
            rotation=np.where(flown, 0.0, a / np.pi),
            lost=np.where(flown, 0.0, np.full(n, 1.0 / max(float(path.time[-1]), 1e-9))),
            seconds=np.diff(path.time, prepend=path.time[0]),
            slowness=1.0 / (AXIS_SPEED * velocity),
            offset=path.offset,
            liking=RotationPreference.along(path, options),
        )

    @classmethod
    def at_stations(cls, path: PlanningPath, velocity: Array, options: PlanOptions) -> ObjectiveTerms:
        """At the stations of the choice, with the shares of the points between them.

        Both ends of a run are stations, so that rapid moves lead from station to station.
        """
        st = path.stations
        return replace(
            cls.of(path, velocity, options).take(st),
            share=path.station_weight,
            seconds=np.diff(path.time[st], prepend=path.time[st[0]]),
        )

    def take(self, rows: NDArray[Any]) -> ObjectiveTerms:
        """The terms of some of the places."""
        names = ("share", "counted", "travel", "rotation", "lost", "seconds", "offset")
        taken = {name: getattr(self, name)[rows] for name in names}
        return replace(self, liking=None if self.liking is None else self.liking.take(rows), **taken)

    @property
    def weights(self) -> ObjectiveWeights:
        return self.options.weights

    def liked(self, phi: Array) -> Array:
        """Price (…, n) of the rotations phi (…, n) rad, against the preferred ones."""
        return (
            np.zeros_like(phi) if self.liking is None else self.liking.price(np.asarray(wrap_angle(phi + self.offset)))
        )

    def nodes(self, cost: Array, phi: Array, crowded: Array | float = 0.0) -> Array:
        """Price (…, n) of the places by costs (…, n), in units of c₀, rotations (…, n) rad and
        :func:`compute_crowding`."""
        liked = self.liked(phi) + self.weights.clearance * crowded
        return np.asarray(self.share * compute_node_cost(cost, liked, self.weights.mean))

    def steps(self, q: Array, phi: Array) -> Array:
        """Price (…, n − 1) of the steps between places with joints (…, n, 6) and rotations (…, n) in rad."""
        length, turn, slow = self.motion(q, phi)
        w = self.weights
        return np.asarray(
            compute_transition_cost(
                length,
                turn,
                compute_delay(slow, self.seconds[1:]),
                w.travel * self.travel[1:],
                w.rotation * self.rotation[1:],
                w.feed * self.lost[1:],
            )
        )

    def motion(self, q: Array, phi: Array) -> tuple[Array, Array, Array]:
        """(…, n − 1) each: rad of all axes, rad about the tool axis, and s that the slowest axis needs."""
        dq = np.abs(np.diff(q, axis=-2))
        return dq.sum(axis=-1), np.abs(np.diff(phi, axis=-1)), (dq * self.slowness).max(axis=-1)


def compute_objective(
    path: PlanningPath,
    cost: Array,
    q: Array,
    phi: Array,
    scale: float,
    velocity: Array,
    options: PlanOptions,
    crowded: Array | None = None,
    elsewhere: float = 0.0,
) -> PlanObjective:
    """J of one assignment at all planning points; infinite where a counted point has no cost.

    Args:
        cost: (P,) c of the chosen configurations.
        q: (P, 6) rad.
        phi: (P,) rad, continuous inside each run.
        scale: c₀, in the unit of the cost.
        velocity: (6,) rad/s, joint velocity limits.
        crowded: (P,) :func:`compute_crowding`, NaN where it is not known; None: it does not count.
        elsewhere: worst index of what is planned beside the path, in units of c₀: a lower one is worth nothing.
    """
    terms, w = ObjectiveTerms.of(path, velocity, options), options.weights
    counted = path.counted
    share, c = terms.share[counted], np.where(np.isfinite(cost[counted]), cost[counted], np.inf) / scale
    if not len(c):
        c, share = np.zeros(1), np.ones(1)
    mean, worst = float(share @ c) if np.isfinite(c).all() else float("inf"), float(c.max())
    known = np.isfinite(q).all(axis=1)
    travel = float(terms.travel[known][1:] @ np.abs(np.diff(q[known], axis=0)).sum(axis=1))
    with np.errstate(invalid="ignore"):
        _, turn, slow = terms.motion(q, phi)
        behind = compute_delay(slow, terms.seconds[1:])
    turned, both = np.isfinite(turn), np.isfinite(behind)
    rotation = float(terms.rotation[1:][turned] @ turn[turned])
    lost = float(terms.lost[1:][both] @ behind[both])
    price = terms.liked(phi)[counted]
    rated = np.isfinite(price)
    preferred = float(terms.share[counted][rated] @ price[rated] / max(terms.share[counted][rated].sum(), 1e-300))
    near = np.zeros(len(path.index)) if crowded is None else crowded
    there = counted & np.isfinite(near)
    clearance = float(terms.share[there] @ near[there] / max(terms.share[there].sum(), 1e-300))
    parts = PlanObjective(
        total=np.nan,
        mean=mean,
        worst=worst,
        travel=travel,
        rotation=rotation,
        feed=lost,
        preferred=preferred,
        clearance=clearance,
    )
    return replace(parts, total=compute_total(parts, w, elsewhere))


def compute_total(parts: PlanObjective, w: ObjectiveWeights, elsewhere: float = 0.0) -> float:
    """J of its parts by these weights; ``elsewhere`` as in :func:`compute_objective`."""
    total = compute_node_cost(parts.mean, parts.preferred + w.clearance * parts.clearance, w.mean)
    total += w.worst * max(parts.worst, elsewhere)
    return float(
        total + compute_transition_cost(parts.travel, parts.rotation, parts.feed, w.travel, w.rotation, w.feed)
    )
