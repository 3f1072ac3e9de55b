"""J, the objective of a plan. Its terms are defined only here.

J = w_mean·mean(c)/c₀ + w_worst·max(c)/c₀ + w_travel·Σ a·b|Δq|/π + w_rotation·Σ a|Δφ|/π + w_feed·t_lost/t
+ w_preferred·mean((1 − cos(γ − γ_preferred))/2) + w_clearance·mean(max(0, 1 − d/d_full)) + w_rapid·t_rapid/t_job
+ w_reorientation·m·J₀, the last two as in :mod:`machopt.planning.cost.rapid_time`, d the distance of the nearest two
bodies, with c₀ the median cost over the feasible candidates
(:mod:`machopt.planning.cost.stiffness_index`), means over the length cut
(:attr:`machopt.planning.stations.planning_path.PlanningPath.weight`) and a the
run's share of that length. Travel and rotation are total variations, so they do not depend on how finely a path is
sampled. b is 1 inside runs. Over a rapid move of length d it is 1 + NEAR/(d + NEAR/10), so that large reorientations
happen on long rapid moves, far from the part. t_lost is the time by which the axes are slower than the programmed feed:
at AXIS_SPEED of their velocity limits, and at their limits of acceleration and jerk
(:mod:`machopt.planning.cost.lost_feed_time`).

The grid search prices vertices (:func:`compute_node_cost`) and steps (:func:`compute_transition_cost`), the
smooth curve its stations, and a finished plan all planning points: the same terms on different samples. The formulas
accept numbers and arrays. (:mod:`machopt.planning.smoothing.newton_solver` smooths and differentiates them. Tests check
that it computes the same J, except for clearance, which is a cubic between the grid's rotations there.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.steering_rules import select_steered_rows
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.stations.planning_path import PlanningPath

AXIS_SPEED = 0.8  # share of the velocity limits; accelerations need the rest
NEAR = 0.5  # m: rapid moves shorter than this should not reorient the arm


@dataclass(frozen=True, kw_only=True)
class PlanObjective:
    """J and its terms, dimensionless; ``mean`` and ``worst`` times c₀ are in the unit of the index."""

    total: float
    mean: float
    worst: float
    travel: float
    rotation: float
    feed: float
    preferred: float
    clearance: float = 0.0  # mean crowding; 0 where it does not count
    tolerance: float = 0.0  # price of the points out of tolerance; 0 where it does not count
    stability: float = 0.0  # weighted mean shortfall of the stable depth of cut; 0 where it does not count
    rapid: float = 0.0  # time of the rapid moves as a share; 0 where it does not count
    reorientation: float = 0.0  # branch changes and whole turns times J₀; 0 where they do not count


# --- the formulas --------------------------------------------------------------------------------------------------


def compute_node_cost(cost: Any, preference_price: Any, mean: Any) -> Any:
    """Return the contribution of a place to J per unit of its share.

    Args:
        cost: c/c₀, dimensionless.
        preference_price: price of the rotation and of crowding at the place.
        mean: weight of the mean index.
    """
    return mean * cost + preference_price


def compute_transition_cost(length: Any, turn: Any, late: Any, travel: Any, rotation: Any, feed: Any) -> Any:
    """Return the contribution of a step to J.

    Args:
        length: rad, Σ|Δq| over the axes.
        turn: rad, |Δφ| about the tool axis; 0 over rapid moves.
        late: s, :func:`compute_delay`.
        travel: price per rad of the axes.
        rotation: price per rad about the tool axis.
        feed: price per s.
    """
    return travel * length + rotation * turn + feed * late


def compute_delay(slow: Any, seconds: Any) -> Any:
    """Return the time in s by which a step is slower than the feed; 0 where it is not.

    Args:
        slow: s, time that the slowest axis needs.
        seconds: s, time at the programmed feed.
    """
    return np.maximum(slow - seconds, 0.0)


edge_price_compiled, late_compiled = (
    jit_compile(compute_transition_cost),
    jit_compile(compute_delay),
)  # for the compiled search


@dataclass(frozen=True)
class RotationPreference:
    """Preferred rotation at each place, and the weight of a deviation."""

    rotation: Array  # (n,) rad
    weight: Array  # (n,) 0 where none is preferred

    @classmethod
    def along(cls, path: PlanningPath, options: PlanOptions) -> RotationPreference | None:
        """Return the preference at every planning point; None where none is stated. Steering rules override the general
        one.

        Args:
            path: planning points.
            options: plan options with the preferred rotation and the steering rules.
        """
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
        """Return the preference at some of the places.

        Args:
            rows: (k,) indices of the places, or a mask (n,).
        """
        return RotationPreference(self.rotation[rows], self.weight[rows])

    def price(self, gamma: Array) -> Array:
        """Return the (…, n) price of rotations, dimensionless.

        Args:
            gamma: (…, n) rad, rotations.
        """
        return np.asarray(compute_preference_cost(np.cos(gamma - self.rotation), self.weight))


def compute_crowding(distance: Any, full: float) -> Any:
    """Return how near the nearest two bodies are: 1 in contact, 0 from the full distance on.

    Args:
        distance: m, between the nearest two bodies.
        full: m, distance from which clearance has no price.
    """
    return np.maximum(0.0, 1.0 - np.maximum(distance, 0.0) / full)


def compute_preference_cost(cosine: Any, weight: Any) -> Any:
    """Return the price of a deviation from the preferred rotation.

    Args:
        cosine: cosine of the angle between the rotation and the preferred one.
        weight: price of the opposite rotation.
    """
    return weight * (1.0 - cosine) / 2.0


# --- what they are applied to --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class ObjectiveTerms:
    """Coefficients of J along a row of n places: the planning points, or some of them."""

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
    def build(cls, path: PlanningPath, velocity: Array, options: PlanOptions) -> ObjectiveTerms:
        """Return the terms at every planning point.

        Args:
            path: planning points.
            velocity: (6,) rad/s, joint velocity limits.
            options: plan options with the weights.
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
        """Return the terms at the stations of the search, with the shares of the points between them.

        Both ends of a run are stations, so that rapid moves lead from station to station.

        Args:
            path: planning points.
            velocity: (6,) rad/s, joint velocity limits.
            options: plan options with the weights.
        """
        st = path.stations
        return replace(
            cls.build(path, velocity, options).take(st),
            share=path.station_weight,
            seconds=np.diff(path.time[st], prepend=path.time[st[0]]),
        )

    def take(self, rows: NDArray[Any]) -> ObjectiveTerms:
        """Return the terms of some of the places.

        Args:
            rows: (k,) indices of the places, or a mask (n,).
        """
        names = ("share", "counted", "travel", "rotation", "lost", "seconds", "offset")
        columns = {name: getattr(self, name)[rows] for name in names}
        return replace(self, liking=None if self.liking is None else self.liking.take(rows), **columns)

    @property
    def weights(self) -> ObjectiveWeights:
        """Weights of the plan options."""
        return self.options.weights

    def liked(self, phi: Array) -> Array:
        """Return the (…, n) price of rotations relative to the preferred ones.

        Args:
            phi: (…, n) rad, rotations.
        """
        return (
            np.zeros_like(phi) if self.liking is None else self.liking.price(np.asarray(wrap_angle(phi + self.offset)))
        )

    def nodes(self, cost: Array, phi: Array, crowded: Array | float = 0.0) -> Array:
        """Return the (…, n) price of the places.

        Args:
            cost: (…, n) index in units of c₀.
            phi: (…, n) rad, rotations.
            crowded: (…, n) :func:`compute_crowding`.
        """
        preference_price = self.liked(phi) + self.weights.clearance * crowded
        return np.asarray(self.share * compute_node_cost(cost, preference_price, self.weights.mean))

    def steps(self, q: Array, phi: Array) -> Array:
        """Return the (…, n − 1) price of the steps between places.

        Args:
            q: (…, n, 6) rad, joints.
            phi: (…, n) rad, rotations.
        """
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
        """Return per step (…, n − 1): rad of all axes, rad about the tool axis, and s that the slowest axis needs.

        Args:
            q: (…, n, 6) rad, joints.
            phi: (…, n) rad, rotations.
        """
        dq = np.abs(np.diff(q, axis=-2))
        return dq.sum(axis=-1), np.abs(np.diff(phi, axis=-1)), (dq * self.slowness).max(axis=-1)


@dataclass(frozen=True, kw_only=True)
class AssignmentCosts:
    """One assignment at the P planning points, and the costs that its points have beside their motion."""

    cost: Array  # (P,) c of the configurations, in the unit of the index
    q: Array  # (P, n) rad, joints of the arm, or of the machine in equivalent rad
    phi: Array  # (P,) rad, continuous inside each run
    crowded: Array | None = None  # (P,) :func:`compute_crowding`, NaN where it is not known; None: it does not count
    places: tuple[float, float] = (0.0, 0.0)  # prices of the points out of tolerance, and of instability
    rapids: tuple[float, float] = (0.0, 0.0)  # time of the rapid moves as a share, and changes times J₀
    late: float = 0.0  # s, lost by limits of acceleration and jerk (:mod:`machopt.planning.cost.lost_feed_time`)


def compute_objective(
    path: PlanningPath,
    assignment: AssignmentCosts,
    scale: float,
    velocity: Array,
    options: PlanOptions,
    elsewhere: float = 0.0,
) -> PlanObjective:
    """Return J of one assignment at all planning points; infinite where a counted point has no cost.

    Args:
        path: planning points.
        assignment: configurations, rotation and costs at the planning points.
        scale: c₀, in the unit of the cost.
        velocity: (n,) rad/s, velocity limits of these joints.
        options: plan options with the weights.
        elsewhere: worst index of the other tools of the job, in units of c₀; a lower worst index brings no gain.
    """
    terms = ObjectiveTerms.build(path, velocity, options)
    mean, worst = _compute_index_terms(terms, assignment.cost, scale)
    travel, rotation, lost = _compute_motion_terms(terms, assignment)
    preferred, clearance = _compute_place_terms(terms, assignment)
    parts = PlanObjective(
        total=np.nan,
        mean=mean,
        worst=worst,
        travel=travel,
        rotation=rotation,
        feed=lost + assignment.late / max(float(path.time[-1]), 1e-9),
        preferred=preferred,
        clearance=clearance,
        tolerance=assignment.places[0],
        stability=assignment.places[1],
        rapid=assignment.rapids[0],
        reorientation=assignment.rapids[1],
    )
    return replace(parts, total=compute_total(parts, options.weights, elsewhere))


def _compute_index_terms(terms: ObjectiveTerms, cost: Array, scale: float) -> tuple[float, float]:
    """Return the mean and the worst index over the counted points, in units of c₀, from c (P,)."""
    share, c = terms.share[terms.counted], cost[terms.counted]
    c = np.where(np.isfinite(c), c, np.inf) / scale
    if not len(c):
        c, share = np.zeros(1), np.ones(1)
    return float(share @ c) if np.isfinite(c).all() else float("inf"), float(c.max())


def _compute_motion_terms(terms: ObjectiveTerms, assignment: AssignmentCosts) -> tuple[float, float, float]:
    """Return travel, rotation and the share of time lost at the velocity limits, over the steps that are known."""
    q, phi = assignment.q, assignment.phi
    known = np.isfinite(q).all(axis=1)
    travel = float(terms.travel[known][1:] @ np.abs(np.diff(q[known], axis=0)).sum(axis=1))
    with np.errstate(invalid="ignore"):
        _, turn, slow = terms.motion(q, phi)
        behind = compute_delay(slow, terms.seconds[1:])
    turned, both = np.isfinite(turn), np.isfinite(behind)
    rotation = float(terms.rotation[1:][turned] @ turn[turned])
    return travel, rotation, float(terms.lost[1:][both] @ behind[both])


def _compute_place_terms(terms: ObjectiveTerms, assignment: AssignmentCosts) -> tuple[float, float]:
    """Return the mean price of the rotation and the mean crowding over the counted points."""
    counted, share = terms.counted, terms.share
    price = terms.liked(assignment.phi)[counted]
    rated = np.isfinite(price)
    preferred = float(share[counted][rated] @ price[rated] / max(share[counted][rated].sum(), 1e-300))
    near = np.zeros(len(share)) if assignment.crowded is None else assignment.crowded
    there = counted & np.isfinite(near)
    return preferred, float(share[there] @ near[there] / max(share[there].sum(), 1e-300))


def compute_total(parts: PlanObjective, w: ObjectiveWeights, elsewhere: float = 0.0) -> float:
    """Return J from its terms with given weights.

    Args:
        parts: terms of J.
        w: weights.
        elsewhere: as in :func:`compute_objective`.
    """
    total = compute_node_cost(parts.mean, parts.preferred + w.clearance * parts.clearance, w.mean)
    total += w.worst * max(parts.worst, elsewhere) + parts.tolerance + parts.stability
    total += w.rapid * parts.rapid + w.reorientation * parts.reorientation
    return float(
        total + compute_transition_cost(parts.travel, parts.rotation, parts.feed, w.travel, w.rotation, w.feed)
    )
