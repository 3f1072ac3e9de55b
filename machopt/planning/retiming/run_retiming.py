"""Retiming of a run of toolpath points: from rest to rest at the programmed feed wherever the axes permit it.

    points ─blend─► curve ─follow─► joints and derivatives at nodes ─feedrate─► u(t) ─► samples ─► checked here

The exported data are samples, so the limits are checked on differences between samples. Where they are exceeded
the speed is reduced near that place and the run is timed again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import JointLimits
from machopt.data_types.slow_moves import is_turn_back
from machopt.kinematics.encoder_corrections import EncoderCorrection
from machopt.kinematics.machine import Machine
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.planning.retiming.joint_derivatives import (
    compute_joints_at_nodes,
    compute_poses_along_curve,
    solve_joints_near_seeds,
)
from machopt.planning.retiming.path_curve import (
    SPIN_TOLERANCE,
    CornerTolerances,
    PathCurve,
    RunPoints,
    build_curves,
    compute_path_parameter,
)
from machopt.planning.retiming.slowdowns import (
    HELD,
    ON_THE_SPOT,
    FeedSlowdown,
    NodeBounds,
    SampledSpeeds,
    Where,
    find_slowdowns,
)
from machopt.planning.retiming.time_law import SpeedBounds, TimeLaw, compute_node_speed_limits, compute_time_law

STEPS_PER_SAMPLE = 3
ROUNDS = 8  # maximum number of speed reductions where samples exceed a limit
SLACK = 1.01  # samples may exceed the scaled limits by this (limit_scale leaves more room)
NO_FEED = 1e3  # m/s: means "no feed limit" where the TCP does not travel
NEAR = 1e-5  # m of path: points nearer than this do not define the motion of external joints between them


@dataclass(frozen=True, kw_only=True)
class RunInput:
    """n points of one run, driven on straight lines in one IK branch."""

    position: Array  # (n, 3) m, in workpiece
    axis: Array  # (n, 3) unit, tip to shank
    reference: Array  # (n, 3) direction of TCP x at phi = 0
    phi: Array  # (n,) rad, continuous
    q: Array  # (n, 6) rad, true angles, continuous
    feed: Array  # (n,) m/s of the move that ends here; feed[0] is not used
    machine: Machine
    external: Array  # (n, E) m or rad, external joints
    T_flange_tcp: Array
    robot: Robot
    limits: JointLimits
    sample: float = 0.012  # s
    path_tolerance: float = 15e-6  # m
    axis_tolerance: float = float(np.radians(0.03))
    spin_tolerance: float = SPIN_TOLERANCE  # rad, of the rotation about the axis
    limit_scale: float = 0.97
    phi_curve: Callable[[Array], Array] | None = None  # phi as a smooth function of blend.path_parameter
    correction: EncoderCorrection | None = None  # limits hold for encoder angles; None: those are the true ones
    rests: tuple[int, ...] = ()  # points to come to rest at, rising

    @property
    def points(self) -> RunPoints:
        """The points as far as the geometry of the run needs them."""
        return RunPoints(
            position=self.position,
            axis=self.axis,
            reference=self.reference,
            phi=self.phi,
            feed=self.feed,
            phi_curve=self.phi_curve,
            rests=self.rests,
        )

    @cached_property
    def moves(self) -> bool:
        """Whether the external joints move along the run."""
        return bool(np.ptp(self.external, axis=0).any())

    @property
    def axes(self) -> int:
        """Number of axes that move along the run, those of the arm first."""
        return 6 + self.external.shape[1] if self.moves else 6

    @cached_property
    def _external_curve(self) -> Callable[..., Array]:
        """The external joints by the parameter of :mod:`.blend`, twice differentiable, through every point."""
        from scipy.interpolate import CubicSpline

        u = compute_path_parameter(self.position, self.axis, self.reference, self.phi)
        keep = np.r_[True, np.diff(u) > NEAR]
        keep[-1] = True
        at = np.flatnonzero(keep)
        if len(at) > 2 and u[at[-1]] - u[at[-2]] <= NEAR:
            at = np.delete(at, -2)
        curve: Callable[..., Array] = CubicSpline(u[at], self.external[at], bc_type="natural")
        return curve

    def external_along(self, u: Array) -> Array:
        """Return the (M, 4, E) external joints and their derivatives.

        Args:
            u: (M,) m, path parameter.
        """
        if not self.moves:
            out = np.zeros((len(u), 4, self.external.shape[1]))
            out[:, 0] = self.external[0]
            return out
        return np.stack([self._external_curve(u, order) for order in range(4)], axis=1)

    def compute_workpiece_poses(self, u: Array) -> Array:
        """Return T_base_workpiece (4, 4), or its jets (M, 4, 4, 4) where external joints move.

        Args:
            u: (M,) m, path parameter.
        """
        machine = self.machine
        if self.moves:
            return machine.compute_T_base_workpiece_jets(self.external_along(u))
        return (
            machine.compute_T_base_workpiece(self.external[:1])[0]
            if machine.external_count
            else machine.T_base_workpiece_zero
        )

    def name(self, axis: int) -> str:
        """Return the name of an axis.

        Args:
            axis: its number from 0 on.
        """
        return f"axis {axis + 1}" if axis < 6 else f"external joint e{axis - 5}"

    def convert_to_encoder_angles(self, q: Array) -> Array:
        """Return (S, 6) encoder angles in rad.

        Args:
            q: (S, 6) rad, true angles.
        """
        return q if self.correction is None else self.correction.compute_encoder_angles(q)


@dataclass(frozen=True, kw_only=True)
class RunTrajectory:
    """S samples, the first at rest at point 0 and the last at rest at point n − 1."""

    q: Array  # (S, 6) rad by encoder
    point: Array  # (S,) fractional point index
    speed: Array  # (S,) m/s of the TCP at the sample
    phi: Array  # (S,) rad
    held: NDArray[np.bool_]  # (S,) the step that ends here was driven at HELD times the programmed feed or faster
    dips: tuple[FeedSlowdown, ...]
    external: Array  # (S, E) m or rad
    duration: float  # s
    held_share: float  # of the duration
    rests: tuple[int, ...] = ()  # sample at which the run is at rest for each of the points it was to rest at


@dataclass(frozen=True)
class RunFailure:
    """Reason why a run cannot be driven."""

    point: float  # fractional point index
    reason: str


@dataclass(frozen=True, kw_only=True)
class _Part:
    """Between two stops."""

    q: Array
    point: Array
    speed: Array
    phi: Array
    ratio: Array  # (S,) of the programmed feed, step that ends here; the first is NaN
    dips: list[FeedSlowdown]
    external: Array  # (S, E) m or rad


def retime_run(run: RunInput) -> RunTrajectory | RunFailure:
    """Round the corners within tolerance and drive the run as fast as feed and joint limits allow.

    Args:
        run: points, robot and limits.

    Raises:
        ValueError: a move has no feed above zero.
    """
    n = len(run.position)
    if n and not (np.isfinite(run.feed[1:]).all() and (run.feed[1:] > 0).all()):
        raise ValueError("every move of a run needs a feed above zero")
    curves = build_curves(run.points, CornerTolerances(run.path_tolerance, run.axis_tolerance, run.spin_tolerance))
    if isinstance(curves, int):
        return RunFailure(curves, f"the tool axis turns by more than 170° between points {curves - 1} and {curves}")
    if not curves:
        return _rest_for_one_sample(run)
    parts: list[_Part] = []
    ends = [int(curves[0].last[0]), *(int(curve.last[-1]) for curve in curves)]  # the last point of each stop's vertex
    stop_of = [int(np.searchsorted(ends, k)) for k in run.rests]  # 0: where the run begins
    back = [is_turn_back(run.position, run.axis, k) for k in ends]  # otherwise only the chosen rotation reverses there
    why: list[Where] = ["rest" if k in stop_of else "reversal" if back[k] else "path" for k in range(len(ends))]
    why[0], why[-1] = "start", "stop"
    for k, curve in enumerate(curves):
        part = _drive(run, curve, why[k], why[k + 1])
        if isinstance(part, RunFailure):
            return part
        parts.append(part)
    return _join_parts(run, parts, stop_of)


def _rest_for_one_sample(run: RunInput) -> RunTrajectory:
    """Return the trajectory of a run without length."""
    ends = [0, len(run.position) - 1]
    none = np.zeros(2)
    return RunTrajectory(
        q=run.convert_to_encoder_angles(run.q[ends]),
        point=np.array(ends, float),
        speed=none,
        phi=run.phi[ends],
        held=none > 0,
        dips=(),
        external=run.external[ends],
        duration=run.sample,
        held_share=0.0,
        rests=(1,) * len(run.rests),
    )


def _join_parts(run: RunInput, parts: list[_Part], stop_of: list[int]) -> RunTrajectory:
    """Return the trajectory of consecutive parts; ``stop_of``: the part that ends at each rest point, from 1 on."""

    def join(name: str) -> Array:
        return np.concatenate([getattr(p, name)[min(k, 1) :] for k, p in enumerate(parts)])

    point, q = join("point"), join("q")
    point[0], point[-1] = 0.0, len(run.position) - 1.0
    is_feed_kept = np.nan_to_num(join("ratio")) >= HELD
    dips = tuple(dip for part in parts for dip in part.dips)
    sample_of = np.cumsum([0, *(len(part.q) - 1 for part in parts)]).tolist()
    return RunTrajectory(
        q=q,
        point=point,
        speed=join("speed"),
        phi=join("phi"),
        held=is_feed_kept,
        dips=dips,
        external=join("external"),
        duration=(len(q) - 1) * run.sample,
        held_share=float(is_feed_kept[1:].mean()),
        rests=tuple(sample_of[k] for k in stop_of),
    )


@dataclass(frozen=True, kw_only=True)
class _DrivenCurve:
    """Joints and speed limits at the M nodes of a curve, for J axes."""

    curve: PathCurve
    D: Array  # (M, 4, 6) rad, true joint angles and their derivatives
    bounds: SpeedBounds
    slope: Array  # (M,) m of the TCP per m of path parameter
    feed_cap: Array  # (M,) largest du/dt that the feed allows
    single: Array  # (M, J, 3) largest du/dt by each limit of each axis alone


@dataclass(frozen=True, kw_only=True)
class _TimedSamples:
    """S samples of a curve by a time law."""

    law: TimeLaw
    u: Array  # (S,) m, path parameter
    place: Array  # (S, 3) m, TCP where the feed is measured
    q: Array  # (S, J) rad or m, by encoder
    phi: Array  # (S,) rad


def _drive(run: RunInput, curve: PathCurve, begin: Where, finish: Where) -> _Part | RunFailure:
    """Return the trajectory along one curve, from rest to rest."""
    driven = _follow_curve(run, curve)
    if isinstance(driven, RunFailure):
        return driven
    timed = _time_samples(run, driven)
    if isinstance(timed, RunFailure):
        return timed
    return _rate_samples(run, driven, timed, begin, finish)


def _follow_curve(run: RunInput, curve: PathCurve) -> _DrivenCurve | RunFailure:
    """Return the joints along a curve; a failure where the arm cannot follow it."""
    u = curve.nodes()
    index = curve.index(u)
    pose, twist, _, p1 = compute_poses_along_curve(curve, u, run.compute_workpiece_poses(u))
    k = np.clip(index.astype(int), 0, len(run.q) - 2)
    rough = run.q[k] + (index - k)[:, None] * (run.q[k + 1] - run.q[k])
    share = np.clip(index - k, 0.0, 1.0)
    D, failed = compute_joints_at_nodes(run.robot, run.T_flange_tcp, u, pose, twist, rough, share)
    if failed >= 0:
        return RunFailure(
            float(index[failed]), "the pose cannot be reached in the branch chosen at the points around it"
        )
    E = D if run.correction is None else run.correction.compute_encoder_path(D)
    if run.moves:
        E = np.concatenate([E, run.external_along(u)], axis=2)
    axes = run.axes
    out = (E[:, 0] < run.limits.lower[:axes] - 1e-9) | (E[:, 0] > run.limits.upper[:axes] + 1e-9)
    if out.any():
        node, joint = np.argwhere(out)[0]
        return RunFailure(float(index[node]), f"{run.name(int(joint))} leaves its range between the points")
    v, a, j = (run.limit_scale * x[:axes] for x in (run.limits.velocity, run.limits.acceleration, run.limits.jerk))
    derivatives = np.ascontiguousarray(E[:, 1:].transpose(0, 2, 1))
    feed_cap = _feed_cap(run, curve, u, p1)
    cap, single = compute_node_speed_limits(derivatives, feed_cap, v, a, j)
    bounds = SpeedBounds(u=u, derivatives=derivatives, cap=cap, velocity=v, acceleration=a, jerk=j)
    return _DrivenCurve(curve=curve, D=D, bounds=bounds, slope=p1, feed_cap=feed_cap, single=single)


def _time_samples(run: RunInput, driven: _DrivenCurve) -> _TimedSamples | RunFailure:
    """Return samples that keep the limits: the speed is reduced near those that do not, and in the end everywhere."""
    bounds, u = driven.bounds, driven.bounds.u
    cap = bounds.cap
    for attempt in range(ROUNDS + 1):
        law = compute_time_law(replace(bounds, cap=cap), run.sample / STEPS_PER_SAMPLE)
        steps = max(int(np.ceil(law.duration / run.sample - 1e-6)), 1)
        sampled = _sample_law(run, driven, law, steps)
        if isinstance(sampled, RunFailure):
            return sampled
        timed = sampled
        excess = _excess(timed.q, bounds, run.sample)
        worst = float(excess.max())
        if worst <= SLACK or attempt == ROUNDS:
            break
        at = timed.u
        for s in np.flatnonzero(excess > SLACK):
            near = (u >= at[max(int(s) - 3, 0)]) & (u <= at[min(int(s) + 1, len(at) - 1)])
            near |= np.convolve(near, np.ones(3), "same") > 0
            cap = np.where(near, np.minimum(cap, 0.9 * _speed_there(timed.law, at, int(s))), cap)
    if worst > SLACK:  # slower by the root of the order of the limit; velocity needs most
        return _sample_law(run, driven, timed.law, int(np.ceil(steps * worst)))
    return timed


def _sample_law(run: RunInput, driven: _DrivenCurve, law: TimeLaw, steps: int) -> _TimedSamples | RunFailure:
    """Return the samples of a law that is made slower, so that it takes a whole number of samples."""
    u, D, curve = driven.bounds.u, driven.D, driven.curve
    law = law.slower(steps * run.sample / law.duration)
    t = np.minimum(np.arange(steps + 1) * run.sample, law.duration)
    at = np.maximum.accumulate(np.clip(law.at(t)[0], u[0], u[-1]))
    at[0], at[-1] = u[0], u[-1]
    workpiece_jets = run.compute_workpiece_poses(at)
    pose, _, phi, _ = compute_poses_along_curve(curve, at, workpiece_jets)
    k = np.clip(np.searchsorted(u, at, side="right") - 1, 0, len(u) - 2)
    h = (at - u[k])[:, None]
    seed = D[k, 0] + h * (D[k, 1] + h * (0.5 * D[k, 2] + h / 6.0 * D[k, 3]))
    q, failed = solve_joints_near_seeds(run.robot, run.T_flange_tcp, pose, seed)
    if failed >= 0:
        return RunFailure(
            float(curve.index(at[failed : failed + 1])[0]), "the pose between the points cannot be reached"
        )
    if not run.moves:
        return _TimedSamples(law=law, u=at, place=pose[:, :3, 3], q=run.convert_to_encoder_angles(q), phi=phi)
    place = np.einsum(
        "mij,mi->mj", workpiece_jets[:, 0, :3, :3], pose[:, :3, 3] - workpiece_jets[:, 0, :3, 3]
    )  # in the workpiece
    whole = np.hstack([run.convert_to_encoder_angles(q), run.external_along(at)[:, 0]])
    return _TimedSamples(law=law, u=at, place=place, q=whole, phi=phi)


def _rate_samples(run: RunInput, driven: _DrivenCurve, timed: _TimedSamples, begin: Where, finish: Where) -> _Part:
    """Return the trajectory of the samples, with the share of the programmed feed and the slowdowns."""
    u, at = driven.bounds.u, timed.u
    t = np.asarray(np.arange(len(at)) * run.sample, float)
    t[-1] = timed.law.duration
    _, speed, acceleration, jerk = timed.law.at(t)
    point = driven.curve.index(at)
    travel = np.linalg.norm(np.diff(timed.place, axis=0), axis=1)
    samples = SampledSpeeds(
        ratio=np.r_[np.nan, travel / run.sample / compute_programmed_feed(run, point[1:])],
        u=at,
        point=point,
        speed=speed,
        slope=np.interp(at, u, driven.slope),
        use=_compute_limit_use(driven.bounds, at, speed, acceleration, jerk),
    )
    programmed = np.where(driven.slope >= ON_THE_SPOT, driven.feed_cap, np.nan)
    nodes = NodeBounds(u=u, single=driven.single, programmed=programmed)
    return _Part(
        q=timed.q[:, :6],
        point=point,
        speed=speed * samples.slope,
        phi=timed.phi,
        ratio=samples.ratio,
        dips=find_slowdowns(samples, nodes, begin, finish),
        external=run.external_along(at)[:, 0],
    )


def _excess(q: Array, bounds: SpeedBounds, sample: float) -> Array:
    """(S,) largest ratio of joint differences to their limits around each sample, at rest before and after."""
    x = np.concatenate([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
    worst = np.zeros(len(q))
    for order, limit in enumerate((bounds.velocity, bounds.acceleration, bounds.jerk), start=1):
        x = np.diff(x, axis=0) / sample
        ratio = (np.abs(x) / limit).max(axis=1)  # row r uses padded samples r … r + order
        worst = np.maximum(worst, ratio[3 : 3 + len(q)] if order < 3 else ratio[2 : 2 + len(q)])
        worst[0], worst[-1] = max(worst[0], ratio[:3].max()), max(worst[-1], ratio[3 + len(q) - order :].max())
    return worst


def _speed_there(law: TimeLaw, at: Array, s: int) -> float:
    return float(law.at(np.array([law.duration * s / max(len(at) - 1, 1)]))[1][0]) + 1e-5


def compute_programmed_feed(run: RunInput, point: Array) -> Array:
    """Return the programmed feed in m/s at fractional indices: that of the move to the next point, over its whole
    length.

    Args:
        run: points of the run.
        point: (S,) fractional point index.
    """
    return np.asarray(run.feed[np.clip(np.ceil(point - 1e-12).astype(int), 1, len(run.position) - 1)])


def _feed_cap(run: RunInput, curve: PathCurve, u: Array, slope: Array) -> Array:
    """Return the largest du/dt (M,) the feed allows at the nodes.

    Each move has its own feed from end to end. A higher one applies immediately behind its first point. A lower one is
    reached a sample earlier, because the step between two samples is assessed by the move it ends on.
    """
    feed = run.feed[
        np.ceil(curve.first[1:] - 1e-9).astype(int)
    ]  # of the piece between two vertices: the move to the point it leads to
    i = np.clip(np.searchsorted(curve.u, u, side="right") - 1, 0, len(feed) - 1)
    cap = feed[i]
    vertex = np.minimum(np.r_[feed[0], feed], np.r_[feed, feed[-1]])
    before = np.clip(np.searchsorted(u, curve.u, side="right") - 1, 0, len(u) - 1)
    np.minimum.at(cap, before, vertex)
    inside = curve.u > u[before]
    np.minimum.at(cap, np.minimum(before[inside] + 1, len(u) - 1), vertex[inside])
    for d in np.flatnonzero(np.diff(cap) < -1e-9) + 1:
        reach = cap[d] * run.sample / max(slope[d], 0.1)
        first = max(int(np.searchsorted(u, u[d] - reach, side="right")) - 1, 0)
        cap[first:d] = np.minimum(cap[first:d], cap[d])
    steepest = np.maximum(slope, np.maximum(np.r_[slope[1:], 0.0], np.r_[0.0, slope[:-1]]))
    return np.asarray(cap / np.maximum(steepest, cap / NO_FEED))


def _compute_limit_use(bounds: SpeedBounds, at: Array, speed: Array, acceleration: Array, jerk: Array) -> Array:
    """Return the (S, J, 3) use of each axis's limits at the samples, by u and its derivatives with respect to time."""
    u, D = bounds.u, bounds.derivatives
    k = np.clip(np.searchsorted(u, at, side="right") - 1, 0, len(u) - 2)
    w = ((at - u[k]) / (u[k + 1] - u[k]))[:, None, None]
    g1, g2, g3 = np.moveaxis(D[k] + w * (D[k + 1] - D[k]), -1, 0)
    v, a, j = speed[:, None], acceleration[:, None], jerk[:, None]
    use = [
        g1 * v / bounds.velocity,
        (g2 * v**2 + g1 * a) / bounds.acceleration,
        (g3 * v**3 + 3 * g2 * v * a + g1 * j) / bounds.jerk,
    ]
    return np.asarray(np.abs(np.stack(use, axis=-1)))
