"""Time that a configuration costs because its axes cannot accelerate as the programmed feed requires.

Between two points the tool moves straight and its axis turns evenly; at the points it turns, rounded within the
tolerances of the path. With the joints' derivatives q', q'', q''' with respect to the time at the programmed feed, and
the change Δ of q' at a point that is rounded over 2τ, the axes hold the shares

    f = min(1, v/|q'|, √(A·a/|q''|), ∛(B·j/|q'''|)),      f_c = min(1, √(A·a·τ/(C·|Δ|)), ∛(B·j·τ²/(D·|Δ|)))

of the feed along a segment and at a point. v, a and j are the limits in use while cutting, A and B the shares of
:func:`machopt.planning.retiming.time_law.compute_node_speed_limits`, C and D the peaks of the rounding of
:mod:`machopt.planning.retiming.path_curve`, of which consecutive ones overlap where points are dense. A segment of t s
loses t·(1/f − 1/f_v), f_v by the velocities at :data:`machopt.planning.cost.objective.AXIS_SPEED` alone, which the
objective's steps contain already. A point loses (1 − f_c) times the time in which the slowest axis changes its speed by
(1 − f_c)·|q'|: half of it while braking and half while speeding up. Near a singularity both q' and Δ are large, long
before a velocity limit is reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import JointLimits
from machopt.data_types.plan_options import PlanOptions
from machopt.kinematics.inverse.newton_iteration import _compute_pose_and_jacobian
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.parallel_map import map_in_threads
from machopt.planning.cost.objective import AXIS_SPEED
from machopt.planning.retiming.joint_derivatives import differentiate
from machopt.planning.retiming.time_law import ACCELERATION_SHARE, JERK_SHARE
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import PlanningPath

CHUNK = 8_192  # configurations at a time
BLOCK = 512  # stations at a time
MOST = 1e3  # largest share of time lost: the retiming is slower only at a singularity, which the margins exclude
BENDING = 8.0  # q'' and q''' of an arm stay below this times the square and cube of its largest joint speed
DEVIATION = 0.15625  # of a rounded corner, per half-width and change of direction
PEAKS = 15.0 / 16.0, 1.4434  # C and D
WIDEST = 0.1  # s, half-width of the widest rounding
STRIDE = 6  # of the rotations whose lost time is computed on the grid


@dataclass(frozen=True, kw_only=True)
class FeedMotion:
    """Motion of the tool at the programmed feed at some places, in base_link."""

    twist: Array  # (N, 6) m/s and rad/s of the TCP
    turn: Array  # (N, 6) m/s and rad/s, its change at the corner
    rounding: Array  # (N,) s, half-width of the rounded corner
    spacing: Array  # (N,) s, distance of the corners
    count: Array  # (N,) number of corners like it
    seconds: Array  # (N,) s of the path that the place represents

    @classmethod
    def build(cls, path: PlanningPath, arm: PlanningArm, options: PlanOptions) -> FeedMotion:
        """Return the motion at every planning point, without spin about the tool axis.

        The segment that leaves a point counts, at the end of a run the one that arrives.

        Args:
            path: planning points.
            arm: arm model with the base pose for the external joints.
            options: plan options with the tolerances of the path.
        """
        p, axis = arm.places(path.external, path.position), arm.directions(path.external, path.axis)
        seconds = np.diff(path.time)
        led = (path.run[1:] == path.run[:-1]) & (seconds > 0)
        seconds = np.where(led, seconds, 0.0)
        per = np.where(led, 1.0 / np.where(led, seconds, 1.0), 0.0)
        across = np.cross(axis[:-1], axis[1:])
        sine = np.linalg.norm(across, axis=1)
        angle = np.arctan2(sine, np.sum(axis[:-1] * axis[1:], axis=1))
        rate = across * (angle / np.maximum(sine, 1e-300))[:, None]
        step = np.hstack([np.diff(p, axis=0), rate]) * per[:, None]
        n = len(p)
        leaves, arrives = np.zeros((n, 6)), np.zeros((n, 6))
        leaves[:-1], arrives[1:] = step, step
        inner = np.zeros(n, bool)
        inner[1:-1] = led[1:] & led[:-1]
        turn = np.where(inner[:, None], leaves - arrives, 0.0)
        bend = np.maximum(
            np.linalg.norm(turn[:, :3], axis=1) / options.path_tolerance,
            np.linalg.norm(turn[:, 3:], axis=1) / options.axis_tolerance,
        )
        before, after = np.r_[0.0, seconds], np.r_[seconds, 0.0]
        return cls(
            twist=np.where((after > 0)[:, None], leaves, arrives),
            turn=turn,
            rounding=np.minimum(1.0 / (DEVIATION * np.maximum(bend, 1e-12)), WIDEST),
            spacing=np.where(inner, np.minimum(before, after), WIDEST),
            count=(np.abs(turn).max(axis=1) > 0).astype(float),
            seconds=0.5 * (before + after),
        )

    def at_stations(self, path: PlanningPath) -> FeedMotion:
        """Return the motion at the stations; each has the sharpest corner near it, as often as the others add up to.

        Args:
            path: planning points.
        """
        st, rows = path.stations, np.arange(len(path.index))
        nearest = np.searchsorted(0.5 * (st[1:] + st[:-1]), rows)
        size = np.linalg.norm(self.turn * np.r_[1.0, 1.0, 1.0, 0.5, 0.5, 0.5], axis=1)
        order = np.lexsort((size, nearest))
        sharpest = order[np.searchsorted(nearest[order], np.arange(len(st)), side="right") - 1]
        total = np.bincount(nearest, size, len(st))
        return FeedMotion(
            twist=self.twist[st],
            turn=self.turn[sharpest],
            rounding=self.rounding[sharpest],
            spacing=self.spacing[sharpest],
            count=total / np.maximum(size[sharpest], 1e-12),
            seconds=np.asarray(np.bincount(nearest, self.seconds, len(st)), float),
        )


@dataclass(frozen=True)
class ArmDrives:
    """An arm and the limits of its drives."""

    arm: PlanningArm
    robot: Robot
    limits: JointLimits

    def compute_excess(
        self, options: PlanOptions, q: Array, motion: FeedMotion, row: NDArray[np.integer[Any]]
    ) -> Array:
        """Return the (M,) time in s that configurations lose.

        Args:
            options: plan options.
            q: (M, 6) rad, joints.
            motion: motion at N places.
            row: (M,) place of each configuration.
        """
        return compute_excess(self.robot, self.arm.T_flange_tcp, self.limits, options, q, motion, row)


def compute_lost_time(path: PlanningPath, drives: ArmDrives, options: PlanOptions, q: Array, phi: Array) -> float:
    """Return the time in s that an assignment loses; 0 where lost time has no price.

    Args:
        path: planning points.
        drives: arm and the limits of its drives.
        options: plan options.
        q: (P, 6) rad, joints, NaN where there are none.
        phi: (P,) rad, rotation.
    """
    if options.weights.feed == 0.0:
        return 0.0
    motion = FeedMotion.build(path, drives.arm, options)
    seconds = np.diff(path.time)
    known = (path.run[1:] == path.run[:-1]) & (seconds > 0) & np.isfinite(phi[1:]) & np.isfinite(phi[:-1])
    spin = np.zeros(len(phi))
    spin[:-1][known] = (np.diff(phi)[known]) / seconds[known]
    twist = motion.twist.copy()
    twist[:, 3:] -= spin[:, None] * drives.arm.directions(path.external, path.axis)
    rows = np.flatnonzero((motion.seconds > 0) & np.isfinite(q).all(axis=1))
    return float(drives.compute_excess(options, q[rows], replace(motion, twist=twist), rows).sum())


def compute_grid_price(
    path: PlanningPath, drives: ArmDrives, options: PlanOptions, candidates: CandidateGrid
) -> Array | None:
    """Return the (S, R, B) price in J of the time that each configuration loses with its rotation held; None without
    one.

    Args:
        path: planning points.
        drives: arm and the limits of its drives.
        options: plan options.
        candidates: candidate grid.
    """
    if options.weights.feed == 0.0:
        return None
    motion = FeedMotion.build(path, drives.arm, options).at_stations(path)
    usable = candidates.usable & (motion.seconds > 0)[:, None, None]
    out = np.empty(usable.shape)
    price_per_second = options.weights.feed / max(float(path.time[-1]), 1e-9)
    for first in range(0, len(usable), BLOCK):
        rows = slice(first, first + BLOCK)
        lost = _compute_lost_seconds(drives, options, candidates, motion, usable[rows], first)
        out[rows] = np.where(usable[rows], price_per_second * lost, 0.0)
    return out


def _compute_lost_seconds(
    drives: ArmDrives, options: PlanOptions, candidates: CandidateGrid, motion: FeedMotion, usable: Bools, first: int
) -> Array:
    """Return (n, R, B) s that usable configurations of n stations from ``first`` on lose, NaN elsewhere."""
    out = np.full(usable.shape, np.nan)

    def evaluate(wanted: Bools) -> None:
        s, r, b = np.nonzero(wanted)
        out[s, r, b] = drives.compute_excess(options, candidates.q[first + s, r, b], motion, first + s)

    R = usable.shape[1]
    if R % STRIDE == 0:  # some rotations, and the mean of their neighbours between them
        some = np.zeros(usable.shape, bool)
        some[:, ::STRIDE] = usable[:, ::STRIDE]
        evaluate(some)
        low = out[:, ::STRIDE]
        high = np.roll(low, -1, axis=1)
        for k in range(1, STRIDE):
            between = low + k / STRIDE * (high - low)
            out[:, k::STRIDE] = np.where(np.isnan(between), np.where(np.isnan(low), high, low), between)
    evaluate(usable & np.isnan(out))
    return out


def compute_excess(
    robot: Robot,
    T_flange_tcp: Array,
    limits: JointLimits,
    options: PlanOptions,
    q: Array,
    motion: FeedMotion,
    row: NDArray[np.integer[Any]],
) -> Array:
    """Return the (M,) time in s that configurations lose.

    Args:
        robot: kinematic model of the arm.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        limits: of the joints.
        options: plan options.
        q: (M, 6) rad, joints.
        motion: motion at N places.
        row: (M,) place of each configuration.
    """
    end = robot.T_base_flange_zero @ T_flange_tcp
    back = np.eye(6) if robot.coupling is None else np.ascontiguousarray(np.linalg.inv(robot.coupling))
    bounds = np.stack([limits.velocity[:6], limits.acceleration[:6], limits.jerk[:6]]) * options.limit_scale
    bounds *= np.array([[1.0], [ACCELERATION_SHARE], [JERK_SHARE]])
    usable = AXIS_SPEED * limits.velocity[:6]
    theta, rows = np.ascontiguousarray(robot.compute_line_angles(q)), np.ascontiguousarray(row, np.int64)
    place = np.column_stack([motion.rounding, motion.spacing, motion.count, motion.seconds])
    V = np.ascontiguousarray(np.stack([motion.twist, motion.turn], axis=1))

    def some(start: int) -> Array:
        part = slice(start, start + CHUNK)
        return np.asarray(
            _compute_excess(robot.axis, robot.point, end, back, theta[part], V, place, rows[part], bounds, usable)
        )

    return np.concatenate([np.empty(0), *map_in_threads(some, range(0, len(q), CHUNK))])


@jit_compile
def _compute_excess(
    axis: Any, point: Any, end: Any, back: Any, theta: Any, motion: Any, place: Any, row: Any, bounds: Any, usable: Any
) -> Any:  # numba infers
    """Return the (M,) time lost in s.

    ``motion`` (N, 2, 6) holds twist and turn, ``place`` (N, 4) rounding, spacing, count and seconds of
    :class:`FeedMotion`; ``bounds`` (3, 6) and ``usable`` (6,) are as in :func:`compute_excess`.
    """
    n = len(theta)
    out = np.zeros(n)
    J, T = np.empty((6, 6)), np.zeros((4, 4))
    S, A = np.empty((3, 6, 6)), np.empty((6, 6))
    d, V, rates = np.empty((4, 6)), np.zeros((3, 6)), np.empty((4, 6))
    for m in range(n):
        _compute_pose_and_jacobian(axis, point, end, theta[m], J, T)
        rounding, spacing, count, seconds = place[row[m], 0], place[row[m], 1], place[row[m], 2], place[row[m], 3]
        lost = 0.0
        if count > 0.0:
            _take_spatial(motion[row[m], 1], T, V)
            if not differentiate(J, T, V, d, 0, S, A):
                out[m] = MOST * seconds
                continue
            for k in range(6):
                rates[3, k] = d[1, k]
        _take_spatial(motion[row[m], 0], T, V)
        if not differentiate(J, T, V, d, 0, S, A):
            out[m] = MOST * seconds
            continue
        fastest = 0.0
        for k in range(6):
            fastest = max(fastest, abs(d[1, k]))
        near = False  # a limit of acceleration or jerk may be reached along the segment
        for k in range(6):
            near = near or BENDING * fastest**2 > bounds[1, k] or BENDING * fastest**3 > bounds[2, k]
        if near and not (differentiate(J, T, V, d, 1, S, A) and differentiate(J, T, V, d, 2, S, A)):
            out[m] = MOST * seconds
            continue
        slow, slow_v, feed_share = 1.0, 1.0, 1.0
        for k in range(6):
            first, second, third, jump = 0.0, 0.0, 0.0, 0.0
            for i in range(6):
                first += back[k, i] * d[1, i]
                if near:
                    second += back[k, i] * d[2, i]
                    third += back[k, i] * d[3, i]
                if count > 0.0:
                    jump += back[k, i] * rates[3, i]
            rates[0, k] = abs(first)
            slow_v = max(slow_v, abs(first) / usable[k])
            slow = max(slow, abs(first) / bounds[0, k], np.sqrt(abs(second) / bounds[1, k]))
            slow = max(slow, np.cbrt(abs(third) / bounds[2, k]))
            if abs(jump) > 0.0:
                feed_share = min(feed_share, np.sqrt(bounds[1, k] * min(rounding / PEAKS[0], spacing) / abs(jump)))
                feed_share = min(feed_share, np.cbrt(bounds[2, k] * rounding**2 / (PEAKS[1] * abs(jump))))
        lost = min(max(slow - slow_v, 0.0), MOST) * seconds
        if feed_share < 1.0:
            longest = _compute_longest_change(rates[0], bounds, 1.0 - feed_share)
            lost += min(count * (1.0 - feed_share) * longest, MOST * seconds)
        out[m] = lost
    return out


@jit_compile
def _compute_longest_change(rates: Any, bounds: Any, share: float) -> float:
    """Return the time in s in which the slowest axis changes its speed by a share of ``rates`` (6,) rad/s."""
    longest = 0.0
    for k in range(6):
        change = share * rates[k]
        a, j = bounds[1, k], bounds[2, k]
        longest = max(longest, change / a + a / j if change * j > a * a else 2.0 * np.sqrt(change / j))
    return longest


@jit_compile
def _take_spatial(v: Any, T: Any, V: Any) -> None:
    """Fill the spatial twist V (3, 6) and its derivatives, of a TCP at constant velocity v (6,) that turns evenly."""
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        V[0, k] = v[k] - (v[3 + a] * T[b, 3] - v[3 + b] * T[a, 3])
        V[0, 3 + k] = v[3 + k]
        V[1, k] = -(v[3 + a] * v[b] - v[3 + b] * v[a])
