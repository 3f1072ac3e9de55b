"""Continuous refinement of rotation and external joints together, along the path, after both are chosen.

The choice determines the external joints coarse to fine and the rotation after them
(:mod:`machopt.planning.external_axis_optimization.coarse_to_fine_search`). Here
both change at once. With z_k = (Δφ, Δe) at station k, the joints of the arm and their margins are linear in z_k, and
the
index is quadratic, from differences of exact poses. J (:mod:`machopt.planning.cost.objective`) of that model is
reduced inside a trust region of each station
(:mod:`machopt.planning.continuous_refinement.quadratic_model`). Then the
poses are solved for. A step is accepted where J itself has decreased and no station has lost its pose or touches
anything. Otherwise the trust regions of the failed stations, or of all, shrink. This is sequential quadratic
programming
with the merit function J (Nocedal & Wright 2006, chapter 18).

The offsets z lie on a curve: a cubic spline along each run where the quantity may move, one value where it may not, one
value for all of a group for a joint that keeps one for an operation. The result is a proposal
(:mod:`machopt.planning.continuous_refinement.plan_improvement` tries it on the whole path).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.steering_rules import select_steered_rows
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.continuous_refinement.bordered_system import BorderedSystem
from machopt.planning.continuous_refinement.distance_constraints import add_distance_constraints
from machopt.planning.continuous_refinement.offset_curves import OffsetCurves
from machopt.planning.continuous_refinement.quadratic_model import (
    LocalModel,
    OffsetBounds,
    TransitionTerms,
    minimize_quadratic_model,
)
from machopt.planning.continuous_refinement.starting_point import (
    RefinementStart,
    compute_transition_weights,
    find_nearby_seeds,
)
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import compute_configuration_cost, compute_load_directions
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.external_axes.plan_ranking import PREFERRED, AxisPlanRanking
from machopt.planning.external_axes.position_constraints import compute_allowed_side
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.joint_path import JointAssignment, interpolate_between_stations, solve_joint_path
from machopt.planning.stations.fixed_rotations import find_fixed_rotations
from machopt.planning.stations.path_subset import select_path_runs

FITS, CLOSER = 4, 100.0  # attempts, and weight of points near those that lost their pose
STATIONS = 200  # about as many as the steps of :mod:`machopt.planning.external_axes.moving_axis_search`
STENCIL = np.radians(1.0)  # of rotation and of external joints as they count, for the derivatives
TRUST = np.radians(12.0)  # rad of each, initial and maximum value by default
LEAST_TRUST = np.radians(0.1)
ROUNDS = 8  # of the model
TRIES = 4  # of its region
ENOUGH = 2e-4  # share of J: a smaller gain ends the iteration
NEAR = 4  # stations to either side of a lost pose whose trust region also shrinks
NEVER = 1e3  # m or rad: a margin that is never active
SPARE = 0.02  # reserve to limits (rad) and margins (share), for the error of the linear model
ROOM = 0.001  # share of a range that a moving joint keeps from its ends: a curve may overshoot between stations


@dataclass(frozen=True, kw_only=True)
class StationState:
    """Rotation, external joints, poses and cost at the stations."""

    phi: Array  # (n,) rad
    e: Array  # (n, E) m or rad
    found: JointAssignment  # at all points of the path, known at the stations
    q: Array  # (n, 6) rad
    cost: Array  # (n,) in units of c₀
    merit: float  # J plus the cost of the user's requests for external joints

    @property
    def margins(self) -> Array:
        """(n, 3) singularity margins of shoulder, elbow and wrist."""
        return _compute_margins(self.found)


def _compute_margins(joint_assignment: JointAssignment) -> Array:
    """(n, 3) of shoulder, elbow and wrist, :data:`NEVER` where an arm without a spherical wrist has one at infinity."""
    return np.minimum(
        np.column_stack([joint_assignment.shoulder, joint_assignment.elbow, joint_assignment.wrist]), NEVER
    )


@dataclass(frozen=True)
class RefinementResult:
    """Proposed rotation and external joints at all planning points."""

    phi: Array  # (P,) rad
    external: Array  # (P, E) m or rad
    seed: Array  # (P, 6) rad, for the joints
    saved: float  # of J at the stations


class PlanRefinement:
    """Refinement of one plan without gaps or breaks."""

    def __init__(
        self, plan: Plan, groups: Sequence[OperationGroup], worth: AxisPlanRanking, trust: float = TRUST
    ) -> None:
        self.trust = trust  # rad
        self.plan, self.setup, self.options = plan, plan.setup, plan.options
        self.path = select_path_runs(plan.path, range(len(plan.path.runs)), STATIONS)
        self.rows = self.path.stations
        own = [np.isin(plan.path.run, group.runs) for group in groups]
        groups = [g.around(plan.path.external[rows][0]) for g, rows in zip(groups, own, strict=True)]
        self.range = np.empty_like(plan.path.external), np.empty_like(plan.path.external)  # (P, E) each, m or rad
        room, is_fixed = (
            np.zeros_like(plan.path.external),
            np.zeros((len(plan.path.index), 1 + plan.path.external.shape[1]), bool),
        )
        is_fixed[list(find_fixed_rotations(plan.path, plan.options)), 0] = True
        for group, rows in zip(groups, own, strict=True):
            self.range[0][rows], self.range[1][rows] = group.low, group.high
            room[rows] = np.where(group.moving, ROOM, 0.0) * (group.high - group.low)
            self._apply_wishes(group, rows, is_fixed)
        self.held = is_fixed
        self.inner = self.range[0] + room, self.range[1] - room
        self.low, self.high = (bound[self.rows] for bound in self.inner)
        self.curves = OffsetCurves.build(self.path, groups, is_fixed)
        self.tied = BorderedSystem(self.curves.at_stations, 1 + plan.path.external.shape[1], self.curves.shared)
        self.terms = ObjectiveTerms.at_stations(self.path, plan.setup.velocity, plan.options)
        self.across = compute_sideways_directions(self.path)
        self.per, self.worth = plan.setup.per_rad[6:], worth
        self.touching = np.zeros(len(self.rows), bool)  # (n,) stations where a step has led to a contact

    def _apply_wishes(self, group: OperationGroup, own: Bools, is_fixed: Bools) -> None:
        """Apply the user's requests about moving joints of a group: pins fix a value, a zone keeps them on one side."""
        at = np.arange(len(own))
        for wish in group.position_wishes:
            k = wish.joint
            rows = own & (at >= wish.rows[0]) & (at <= wish.rows[1])
            if not group.moving[k] or not rows.any():
                continue  # fixed joints are restricted by ``allowed``
            if wish.at is not None:
                is_fixed[rows, 1 + k] = True
                self.range[0][rows, k] = self.range[1][rows, k] = self.plan.path.external[rows, k]
                continue
            low, high = compute_allowed_side(wish, self.plan.path.external[rows, k])
            self.range[0][rows, k] = np.maximum(self.range[0][rows, k], low)
            self.range[1][rows, k] = np.minimum(self.range[1][rows, k], high)

    def found(self, start: RefinementStart | None = None) -> RefinementResult | None:
        """Return offsets that reduce J at the stations; None where none do.

        Args:
            start: starting point in place of the plan.
        """
        plan, rows = self.plan, self.rows
        phi, external, q = plan.chosen.assignment.phi, plan.path.external, plan.chosen.assignment.q
        here = self._state(phi[rows], external[rows], q[rows])
        if here is None:
            return None
        first, trust = here.merit, np.full((len(rows), 1 + len(self.per)), self.trust)
        initial = self._build_start_state(RefinementStart(phi, external, q) if start is None else start)
        if initial is not None:
            here, phi, external = initial
        elif start is not None:
            return None
        coefficients = np.zeros(self.curves.at_points.shape[1])
        for _ in range(ROUNDS):
            local = self._build_local_model(here)
            there, first_try = None, True
            for _ in range(TRIES):
                bounds = self._build_bounds(here, local, trust)
                step = minimize_quadratic_model(local, self._build_transition_terms(here, local), bounds, self.tied)
                there = self._try_step(here, step, trust)
                if there is not None or trust.max() < LEAST_TRUST:
                    break
                first_try = False
            if there is None:
                break
            gained, here, coefficients = here.merit - there.merit, there, coefficients + step
            if first_try:  # a larger step that has just failed would fail again
                trust = np.minimum(1.5 * trust, self.trust)
            if gained < ENOUGH * abs(here.merit):
                break
        if here.merit >= first:
            return None
        moved = (self.curves.at_points @ coefficients).reshape(len(phi), -1)
        external = np.clip(external + moved[:, 1:] / self.per, *(self.range if initial is None else self.inner))
        return RefinementResult(
            phi + moved[:, 0], external, interpolate_between_stations(self.path, here.q), first - here.merit
        )

    def _build_start_state(self, start: RefinementStart) -> tuple[StationState, Array, Array] | None:
        """Return the state at the curves nearest to a start, nearer to the plan where a pose is lost; None if that
        fails too.

        Details of a start that are finer than the curves are dropped; no offset could remove them.
        """
        if self.held.any() or self.options.steer:  # no curve changes fixed values
            return None
        rows, left = self.rows, np.zeros(len(self.rows), bool)
        for n in range(FITS):
            share = compute_transition_weights(left, NEAR * 2**n)
            share = np.interp(np.arange(len(start.phi)), rows, share)
            there = start.nearer(self.plan.chosen.assignment.phi, self.plan.path.external, share)
            phi, e = there.fitted(self.curves, self.per, np.where(share < 1.0, CLOSER, 1.0))
            e = np.clip(e, *self.inner)
            if not self._is_within_bounds(phi):
                return None
            seed = find_nearby_seeds(self.path, self.setup.arm, rows, phi[rows], e[rows], start.seed[rows])
            found, cost = self._solve_stations(phi[rows], e[rows], seed)
            lost = self._find_lost_stations(found, e[rows]) | ~np.isfinite(cost)
            if not lost.any():
                merit = self._compute_merit(phi[rows], e[rows], found.q, cost)
                return StationState(phi=phi[rows], e=e[rows], found=found, q=found.q, cost=cost, merit=merit), phi, e
            left |= lost
        return None

    def _is_within_bounds(self, phi: Array) -> bool:
        """Return whether the user's rotation bounds hold at all planning points (P,) rad."""
        low, high = self.options.rotation_range
        gamma = np.asarray(wrap_angle(phi + self.path.offset))
        return high - low >= 2 * np.pi - 1e-6 or bool(((gamma >= low) & (gamma <= high)).all())

    # --- exact --------------------------------------------------------------------------------------------------------

    def _solve_stations(self, phi: Array, e: Array, seed: Array) -> tuple[JointAssignment, Array]:
        """Return the poses at the stations, and their index in units of c₀, NaN where there is none."""
        rows, setup = self.rows, self.setup
        external = self.path.external.copy()
        external[rows] = e
        path = replace(self.path, external=external)
        at, near = np.full(len(path.index), np.nan), np.full((len(path.index), 6), np.nan)
        at[rows], near[rows] = phi, seed
        a = solve_joint_path(path, setup.arm, setup.robot, at, near)
        d = compute_load_directions(path, setup.arm, setup.elasticity, self.options.force, self.across)
        known = rows[np.isfinite(a.q[rows]).all(axis=1)]
        cost = np.full(len(path.index), np.nan)
        cost[known] = compute_configuration_cost(setup.elasticity, d, known, a.q[known], self.plan.scores.index)
        few = {name: getattr(a, name)[rows] for name in vars(a)}
        return JointAssignment(**few), cost[rows] / self.plan.scores.scale

    def _state(self, phi: Array, e: Array, seed: Array) -> StationState | None:
        """Return the state if all stations have a pose without contact; else None."""
        found, cost = self._solve_stations(phi, e, seed)
        if self._find_lost_stations(found, e).any() or not np.isfinite(cost).all():
            return None
        return StationState(
            phi=phi, e=e, found=found, q=found.q, cost=cost, merit=self._compute_merit(phi, e, found.q, cost)
        )

    def _find_lost_stations(self, joint_assignment: JointAssignment, e: Array) -> Bools:
        """Return the (n,) stations without a pose, or whose pose has a contact."""
        lost = np.asarray(joint_assignment.reason != InfeasibilityReason.OK)
        if self.setup.collision is not None and not lost.all():
            there = np.flatnonzero(~lost)
            x = np.hstack([joint_assignment.q[there], e[there]])
            lost[there] |= self.setup.collision.check_configurations(x, self.path.may_touch[self.rows][there]).hit
        return lost

    def _compute_merit(self, phi: Array, e: Array, q: Array, cost: Array) -> float:
        terms, w = self.terms, self.options.weights
        x = np.hstack([q, e * self.per])
        total = terms.nodes(cost, phi).sum() + terms.steps(x, phi).sum()
        total += w.worst * float(cost[terms.counted].max(initial=0.0))
        return float(total) + self.worth.wished(x[:, 6:], terms)

    # --- the model ----------------------------------------------------------------------------------------------------

    def _build_local_model(self, here: StationState) -> LocalModel:
        """Return joints and margins to first order and the index to second, from differences around the poses."""
        n, d = len(here.phi), 1 + len(self.per)
        free = np.flatnonzero(np.r_[True, (self.high > self.low).any(axis=0)])

        def at(z: Array) -> tuple[Array, Array, Array]:
            found, cost = self._solve_stations(here.phi + z[0], here.e + z[1:] / self.per, here.q)
            return found.q, _compute_margins(found), cost

        h, unit = STENCIL, np.eye(d)
        q, margins, cost = (np.zeros((n, k, d)) for k in (6, 3, 1))
        hessian = np.zeros((n, d, d))
        ahead = {}
        for i in free:
            (qa, ma, ca), (qb, mb, cb) = at(h * unit[i]), at(-h * unit[i])
            ahead[i] = ca
            q[:, :, i], margins[:, :, i], cost[:, 0, i] = (qa - qb) / (2 * h), (ma - mb) / (2 * h), (ca - cb) / (2 * h)
            hessian[:, i, i] = (ca + cb - 2 * here.cost) / h**2
        for i in free:
            for j in free[free > i]:
                both = at(h * (unit[i] + unit[j]))[2]
                hessian[:, i, j] = hessian[:, j, i] = (both - ahead[i] - ahead[j] + here.cost) / h**2
        every = np.concatenate([q, margins, cost, hessian], axis=1)
        known: Bools = np.isfinite(every.sum(axis=(1, 2)))
        q[~known], margins[~known], cost[~known], hessian[~known] = 0.0, 0.0, 0.0, 0.0
        value, turned = np.linalg.eigh(hessian)
        hessian = (turned * np.maximum(value, 0.0)[:, None]) @ np.swapaxes(turned, 1, 2)
        w, share, preferred = self.options.weights, self.terms.share, self.worth.preferred
        gradient, own = w.mean * share[:, None] * cost[:, 0], w.mean * share[:, None, None] * hessian
        away = np.nan_to_num(here.e * self.per - preferred)
        is_preferred = np.isfinite(preferred).astype(float)
        gradient[:, 1:] += 2 * PREFERRED * share[:, None] * away
        own[:, 1:, 1:] += 2 * PREFERRED * share[:, None, None] * np.diag(is_preferred)
        if self.terms.liking is not None:
            off = here.phi + self.terms.offset - self.terms.liking.rotation
            half = 0.5 * self.terms.liking.weight * share
            gradient[:, 0] += half * np.sin(off)
            own[:, 0, 0] += half * np.maximum(np.cos(off), 0.0)
        return LocalModel(
            q=q, margins=margins, known=known, gradient=gradient, hessian=own, cost=here.cost, slope=cost[:, 0],
            bend=hessian, counted=self.terms.counted, worst=w.worst,
        )  # fmt: skip

    def _build_transition_terms(self, here: StationState, local: LocalModel) -> TransitionTerms:
        """Return all absolute values along the stations: joints, external joints and rotation."""
        n, d = local.gradient.shape
        terms, w, E = self.terms, self.options.weights, d - 1
        lean = np.zeros((n, 7 + E, d))
        lean[:, :6] = local.q
        lean[:, 6:] = np.r_[np.eye(d)[1:], np.eye(d)[:1]]
        x = np.hstack([here.q, here.e * self.per, here.phi[:, None]])
        price = np.tile(w.travel * terms.travel[1:, None], (1, 7 + E))
        price[:, 6 : 6 + E] *= self.worth.weight
        price[:, -1] = w.rotation * terms.rotation[1:]
        slowness = np.r_[terms.slowness, 0.0]
        return TransitionTerms(
            jump=np.diff(x, axis=0),
            lean=lean,
            price=price,
            lost=w.feed * terms.lost[1:],
            seconds=terms.seconds[1:],
            slowness=slowness,
        )

    def _build_bounds(self, here: StationState, local: LocalModel, trust: Array) -> OffsetBounds:
        """Return the bounds of z: trust region, ranges, limits of the arm and its singularity margins."""
        arm, low, high = self.setup.arm, -trust.copy(), trust.copy()
        low[~local.known] = high[~local.known] = 0.0
        low[:, 1:] = np.maximum(low[:, 1:], (self.low - here.e) * self.per)
        high[:, 1:] = np.minimum(high[:, 1:], (self.high - here.e) * self.per)
        gamma = np.asarray(wrap_angle(here.phi + self.path.offset[self.rows]))
        first, last = self.options.rotation_range
        if last - first < 2 * np.pi - 1e-6:
            low[:, 0], high[:, 0] = np.maximum(low[:, 0], first - gamma), np.minimum(high[:, 0], last - gamma)
        for wish in self.options.steer:
            if wish.forbid is not None:
                rows = select_steered_rows(wish, self.plan.path.index[self.rows])
                down, up = _turn(gamma[rows] - wish.forbid[1]), _turn(wish.forbid[0] - gamma[rows])
                low[rows, 0], high[rows, 0] = np.maximum(low[rows, 0], -down), np.minimum(high[rows, 0], up)
        fixed = np.isin(self.rows, list(find_fixed_rotations(self.plan.path, self.options)))
        low[fixed, 0] = high[fixed, 0] = 0.0
        m = arm.margins
        least = (1.0 + SPARE) * np.array([m.shoulder, m.elbow, m.wrist])
        lean = np.concatenate([local.q, local.margins], axis=1)
        under = np.hstack([arm.lower + SPARE - here.q, least - here.margins])
        over = np.hstack([arm.upper - SPARE - here.q, np.full((len(gamma), 3), np.inf)])
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        bounds = OffsetBounds(low, high, lean, np.minimum(under, 0.0), np.maximum(over, 0.0))
        model, E = self.setup.collision, len(self.per)
        if model is None:
            return bounds
        ahead = np.zeros((len(gamma), 6 + E, 1 + E))
        ahead[:, :6] = local.q
        ahead[:, 6:, 1:] = np.diag(1.0 / self.per)
        may_touch = self.path.may_touch[self.rows]
        return add_distance_constraints(bounds, model, np.hstack([here.q, here.e]), ahead, may_touch, self.touching)

    def _try_step(self, here: StationState, step: Array, trust: Array) -> StationState | None:
        """Return the state after a step if J is smaller there; else None, with a smaller ``trust`` on failure."""
        z = (self.curves.at_stations @ step).reshape(trust.shape)
        low, high = (bound[self.rows] for bound in self.range)
        phi, e = here.phi + z[:, 0], np.clip(here.e + z[:, 1:] / self.per, low, high)
        found, cost = self._solve_stations(phi, e, here.q)
        lost = self._find_lost_stations(found, e) | ~np.isfinite(cost)
        self.touching |= lost & (found.reason == InfeasibilityReason.OK)
        if lost.any():
            run = self.path.run[self.rows]
            for k in np.flatnonzero(lost):
                neighbours = slice(max(k - NEAR, 0), k + NEAR + 1)
                rows = np.arange(len(run))[neighbours][run[neighbours] == run[k]]
                trust[rows] = np.minimum(trust[rows], 0.3 * np.abs(z[rows]).max(initial=LEAST_TRUST))
            return None
        merit = self._compute_merit(phi, e, found.q, cost)
        if merit < here.merit:
            return StationState(phi=phi, e=e, found=found, q=found.q, cost=cost, merit=merit)
        trust *= 0.3
        return None


def _turn(angle: Array) -> Array:
    """Return angles in [0, 2π); values below 0 by rounding become 0."""
    turned = angle % (2 * np.pi)
    return np.asarray(np.where(turned > 2 * np.pi - 1e-6, 0.0, turned))
