"""The commanded path shifted against the predicted deflection, so that the loaded tool is at the programmed position.

jiao2022 section 5.1: the deflection d = J_v K_θ⁻¹ J_vᵀ f under the process force (eq. 41, here with every term of the
stiffness) is subtracted from the commanded position. Rotation and tool axis are unchanged.

The force is F of :mod:`machopt.planning.cost.process_force_direction`, which has no jumps. The shift δ = −d(F) fades
in and out over the length λ along approach and retract. It is zero where nothing cuts, and changes direction at a sharp
corner over 2ℓ. With S = max |d(f)|,

    |δ(s₁) − δ(s₂)| ≤ (S/ℓ + S/λ + |dC/ds| |f|) |s₁ − s₂|

(C the compliance, which changes with the pose). ℓ and λ begin with the shortest of LENGTHS. While a step exceeds
STEEPEST, λ grows where the steepest one lies in a fade, else ℓ.
A run that begins or ends with a cut (a hole drilled straight from a rapid move) is shifted from its first point on: the
rapid move goes to the shifted point, and the drill enters straight.

A shift is refused, with point and numbers, if it is larger than ``compensation_max``, larger than the deflection it
corrects (the greatest within twice the longer of ℓ and λ), or steeper than STEEPEST at the last lengths.
:func:`compute_residual` returns the residual that a shift without jumps leaves at corners.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.planning.collision_handling.path_check import PathCollisionChecker
from machopt.planning.cost.clearance_cost import compute_path_crowding
from machopt.planning.cost.lost_feed_time import compute_lost_time
from machopt.planning.cost.objective import AssignmentCosts, PlanObjective, compute_objective
from machopt.planning.cost.process_force_direction import compute_engaged_force
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.pipeline.plan_data_types import PathCompensation, Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.pipeline.tolerance_and_stability_prices import price_places
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.stations.planning_path import ARM, PlanningPath

NOTHING = 1e-6  # m; a smaller shift is not refused
STILL = 1e-8  # m; a smaller change of the shift counts as zero
PASSES = 2  # iterations of −d and its configuration; the second changes |d| by |d|/reach, a third by its square
KEPT = 0.8  # share of the singularity margins that a shifted point must still keep
LENGTHS = (0.005, 0.010, 0.020, 0.040)  # m, ℓ: the shorter, the smaller the residual at corners
STEEPEST = 0.1  # m/m: the path deviates by less than 6° from the programmed direction
CORRECTION_MARGIN = 1.05  # times the deflection it is compared with: the pose changes slightly within 2ℓ
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a segment, where the residual is computed


def compute_offset_slope(path: PlanningPath, offset: Array) -> Array:
    """Return the (P,) slope of the shift in m/m on the way into each point; 0 after a rapid move.

    A rotation of the tool axis counts as a length of ARM m/rad, because the pose and the compliance change with it.

    Args:
        path: planning points.
        offset: (P, 3) m, shift at each planning point, in the workpiece frame.
    """
    joined = path.run[1:] == path.run[:-1]
    change = np.linalg.norm(np.diff(offset, axis=0), axis=1)
    way = np.hypot(*(np.linalg.norm(np.diff(of, axis=0), axis=1) for of in (path.position, ARM * path.axis)))
    ratio = np.where(change > STILL, change / np.maximum(way, STILL), 0.0)
    return np.concatenate([[0.0], np.where(joined, ratio, 0.0)])


def shift_path(plan: Plan, length: float, fade: float | None = None) -> Plan:
    """Return the plan for the shifted path.

    Args:
        plan: plan without compensation, with points added at corners.
        length: m, ℓ over which the engaged force changes.
        fade: m, λ over which the shift fades in and out; None: ℓ.
    """
    before, path = plan.chosen.assignment, plan.path
    force = compute_engaged_force(path, plan.options.force, length, fade)
    known = np.flatnonzero((before.reason == InfeasibilityReason.OK) & force.any(axis=1))
    setup = _with_room(plan.setup)
    offset = np.zeros_like(path.position)
    moved, after = path, before
    for _ in range(PASSES):
        q = np.where(np.isfinite(after.q), after.q, before.q)[known]  # no pose in the first pass: use the old one
        push = setup.arm.directions(path.external[known], force[known])
        bent = plan.directions.elastic(plan.setup.elasticity, q, known).compute_deflection(push)
        offset[known] = -setup.arm.back(path.external[known], bent)
        offset = _fill_offsets(path, offset, before.reason == InfeasibilityReason.OK)
        moved = path.shift_positions(offset)
        after = solve_joint_path(moved, setup.arm, setup.robot, before.phi, before.q)
    reason, check, notes = after.reason.copy(), plan.check, dict(plan.notes)
    keep = before.reason != InfeasibilityReason.OK  # excluded points stay excluded
    for p, why in _find_refused_points(plan, offset, length, length if fade is None else fade).items():
        if reason[p] == InfeasibilityReason.OK:
            reason[p], notes[p] = InfeasibilityReason.SHIFT, why
    reason[keep] = before.reason[keep]
    if setup.collision is not None:
        checker = PathCollisionChecker.build(moved, setup.arm, setup.robot, setup.collision, plan.options)
        check = checker.whole(after.phi, np.where((reason == InfeasibilityReason.OK)[:, None], after.q, np.nan))
        reason[check.hit & (reason == InfeasibilityReason.OK)] = InfeasibilityReason.COLLIDING
    after = replace(after, reason=reason)
    found = PathCompensation(
        offset=offset,
        force=force,
        length=length,
        fade=length if fade is None else fade,
        lost=(reason != InfeasibilityReason.OK) & ~keep,
    )
    out = rescore_plan(replace(plan, setup=setup, path=moved, check=check, compensation=found, notes=notes), after)
    # the baselines with the same lengths, which the shift changes by some micrometres
    weighed = [
        replace(s, objective=_compute_shifted_objective(out, s.assignment, s.cost))
        for s in (plan.jiao2022, plan.cam_default)
    ]
    return replace(out, jiao2022=weighed[0], cam_default=weighed[1])


def _fill_offsets(path: PlanningPath, offset: Array, there: NDArray[np.bool_]) -> Array:
    """Return the offsets, interpolated linearly where a point of the run has no configuration."""
    out = offset.copy()
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path.position, axis=0), axis=1))])
    for first, last in path.runs:
        rows = np.arange(first, last + 1)
        own = rows[there[rows]]
        if len(own) and not there[rows].all():
            for c in range(3):
                out[rows, c] = np.where(there[rows], offset[rows, c], np.interp(way[rows], way[own], offset[own, c]))
    return out


def _find_refused_points(plan: Plan, offset: Array, length: float, fade: float) -> dict[int, str]:
    """Return the planning points whose shift is refused, with the reason."""
    path, most = plan.path, plan.options.compensation_max
    size, slope = np.linalg.norm(offset, axis=1), compute_offset_slope(path, offset)
    deflection = _compute_greatest_nearby(path, plan, 2.0 * max(length, fade))
    out = {}
    for p in np.flatnonzero((size > most) | (slope > STEEPEST) | (size > CORRECTION_MARGIN * deflection + NOTHING)):
        message = f"the shift against the deflection is refused: it is {1e3 * size[p]:.3f} mm"
        if size[p] > most:
            out[int(p)] = f"{message}, more than compensation_max_mm {1e3 * most:g}"
        elif size[p] > CORRECTION_MARGIN * deflection[p] + NOTHING:
            out[int(p)] = f"{message}, more than the {1e3 * deflection[p]:.3f} mm that it corrects"
        else:
            out[int(p)] = f"{message} and changes by {slope[p]:.3f} mm per mm of path, more than {STEEPEST:g}"
    return out


def _compute_greatest_nearby(path: PlanningPath, plan: Plan, reach: float) -> Array:
    """Return the (P,) greatest deflection in m within a reach in m of each point, along its run."""
    q, ok = plan.chosen.assignment.q, np.isfinite(plan.chosen.assignment.q).all(axis=1)
    bent = np.zeros(len(q))
    rows = np.flatnonzero(ok)
    bent[rows] = np.linalg.norm(
        plan.directions.elastic(plan.setup.elasticity, q[rows], rows).compute_deflection(plan.directions.force[rows]),
        axis=1,
    )
    out = np.zeros(len(q))
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path.position, axis=0), axis=1))]
    for first, last in path.runs:
        s = way[first : last + 1]
        a, b = np.searchsorted(s, s - reach), np.searchsorted(s, s + reach, side="right")
        a, b = np.maximum(a - 1, 0), np.minimum(b + 1, len(s))  # and the points just outside, for interpolation
        out[first : last + 1] = [bent[first + i : first + j].max() for i, j in zip(a, b, strict=True)]
    return out


def rescore_plan(plan: Plan, assignment: JointAssignment) -> Plan:
    """Return the plan with another assignment, its cost and objective.

    Args:
        plan: plan whose chosen assignment is replaced.
        assignment: rotation and joints at all planning points.
    """
    cost = np.full(len(assignment.phi), np.nan)
    ok = np.flatnonzero(assignment.reason == InfeasibilityReason.OK)
    cost[ok] = compute_configuration_cost(
        plan.setup.elasticity, plan.directions, ok, assignment.q[ok], plan.scores.index
    )
    value = _compute_shifted_objective(plan, assignment, cost)
    return replace(plan, chosen=replace(plan.chosen, assignment=assignment, cost=cost, objective=value))


def _compute_shifted_objective(plan: Plan, a: JointAssignment, cost: Array) -> PlanObjective:
    pricing = None if plan.pricing is None else plan.pricing.with_path(plan.path, plan.directions)
    x, rapid = plan.setup.in_rad(plan.path, a.q), plan.scores.rapid
    costs = AssignmentCosts(
        cost=cost,
        q=x,
        phi=a.phi,
        crowded=compute_path_crowding(plan.path, plan.setup.collision, a.q, plan.options),
        places=price_places(pricing, a.q),
        rapids=(0.0, 0.0) if rapid is None else rapid.measure(plan.path, x, a.branch),
        late=compute_lost_time(plan.path, plan.setup.drives, plan.options, a.q, a.phi),
    )
    return compute_objective(plan.path, costs, plan.scores.scale, plan.setup.velocity, plan.options)


@dataclass(frozen=True)
class CompensationResidual:
    """Size of the shift over the cut length, and the predicted residual."""

    shift_worst: float  # m
    shift_mean: float  # m, over the length cut
    worst: float  # m
    mean: float  # m, over the length cut
    uncompensated: float  # m, mean deflection without the shift, over the same places


def compute_residual(plan: Plan) -> CompensationResidual | None:
    """Return the distance of the bent tool from the programmed path, at five places per segment; None without
    compensation.

    Between two planning points, configuration and shift are interpolated linearly. The force is that
    of the segment, which at a corner differs from that of the point.

    Args:
        plan: compensated plan.
    """
    if plan.compensation is None:
        return None
    if plan.parts:
        return _join_residuals(
            [(part.share, found) for part in plan.parts if (found := compute_residual(part.plan)) is not None]
        )
    path, arm = plan.path, plan.setup.arm
    q, ok = plan.chosen.assignment.q, plan.chosen.assignment.reason == InfeasibilityReason.OK
    pushed = plan.directions.force[1:].any(axis=1)  # on the way out of a hole there is nothing to correct
    end = 1 + np.flatnonzero(path.counted[1:] & pushed & ok[1:] & ok[:-1] & (path.run[1:] == path.run[:-1]))
    if not len(end):
        return None
    length = np.linalg.norm(path.position[end] - path.position[end - 1], axis=1)
    left, bent = np.empty((len(SHARES), len(end))), np.empty((len(SHARES), len(end)))
    for row, f in enumerate(SHARES):
        between = q[end - 1] + f * (q[end] - q[end - 1])
        offset = plan.compensation.offset[end - 1] + f * (
            plan.compensation.offset[end] - plan.compensation.offset[end - 1]
        )
        elastic = plan.directions.elastic(plan.setup.elasticity, between, end - 1)
        d = arm.back(path.external[end - 1], elastic.compute_deflection(get_segment_force(plan, end)))
        left[row], bent[row] = np.linalg.norm(offset + d, axis=1), np.linalg.norm(d, axis=1)
    rule = np.array([0.125, 0.25, 0.25, 0.25, 0.125])  # trapezoids
    weight = length / length.sum() if length.sum() > 0 else np.full(len(end), 1.0 / len(end))
    size = np.linalg.norm(plan.compensation.offset, axis=1) * path.counted
    return CompensationResidual(
        float(size.max()),
        float(path.weight @ size),
        float(left.max()),
        float(rule @ left @ weight),
        float(rule @ bent @ weight),
    )


def get_segment_force(plan: Plan, end: NDArray[np.intp]) -> Array:
    """Return (S, 3) N, the force on the segments that end at given planning points, in base_link.

    The direction is that of the point where a segment begins. On the way into a hole there is no force at that point,
    and that of its end holds.

    Args:
        plan: compensated plan.
        end: (S,) planning points.
    """
    begin = plan.directions.force[end - 1]
    return np.where(begin.any(axis=1, keepdims=True), begin, plan.directions.force[end])


def _join_residuals(parts: list[tuple[float, CompensationResidual]]) -> CompensationResidual | None:
    """Return the residual of a whole job from its stretches, each with its share of the length cut."""
    if not parts:
        return None
    return CompensationResidual(
        max(r.shift_worst for _, r in parts),
        sum(share * r.shift_mean for share, r in parts),
        max(r.worst for _, r in parts),
        sum(share * r.mean for share, r in parts),
        sum(share * r.uncompensated for share, r in parts),
    )


def _with_room(setup: PlanningSetup) -> PlanningSetup:
    """Return the setup with the limits a shifted point must keep: the joint limits and most of the singularity margins.

    The margins that the choice must keep are a reserve for later steps. A point chosen exactly on its margin would
    otherwise be lost for a shift of a few tenths of a millimetre.
    """
    limits, m = setup.driven.limits, setup.arm.margins
    margins = replace(m, wrist=KEPT * m.wrist, elbow=KEPT * m.elbow, shoulder=KEPT * m.shoulder)
    arm: PlanningArm = replace(setup.arm, lower=limits.lower[:6], upper=limits.upper[:6], margins=margins)
    return replace(setup, arm=arm)
