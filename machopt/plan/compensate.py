"""The commanded path shifted against the predicted deflection, so that the bent tool is where it should be.

jiao2022 section 5.1: the deflection d = J_v K_θ⁻¹ J_vᵀ f under the process force (eq. 41, here with every term of the
stiffness) is subtracted from the commanded position. Rotation and tool axis stay as they are.

* At points that are cut to, and where a cut begins, the shift is −d, d in the configuration that is then driven.
* Along approach, retract and link moves it fades in and out in proportion to their length, so nothing jumps.
* Rapid moves go to where the runs now begin and end.

The force turns with the direction of travel, so at a sharp corner −d jumps. The commanded path cannot: it goes over
from one to the other on the stretch before the corner, and :func:`residual` says what that leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.domain.reason import Reason
from machopt.plan.candidates import Arm
from machopt.plan.check import Checker
from machopt.plan.path import Path
from machopt.plan.realise import Assignment, realise
from machopt.plan.score import configuration_cost, objective

if TYPE_CHECKING:
    from machopt.plan.pipeline import Plan, Setup

Array = NDArray[np.float64]
PASSES = 2  # of −d and the configuration it leads to; the second changes |d| by |d|/reach, a third by its square
KEPT = 0.8  # share of the singularity margins that a shifted point must still keep
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a segment, where the residual is looked at


@dataclass(frozen=True)
class Compensation:
    """What is added to the planning points."""

    offset: Array  # (P, 3) m in workpiece
    force: Array  # (P, 3) N in workpiece, of the process on the tool
    full: NDArray[np.bool_]  # (P,) the offset is −d; elsewhere it fades
    lost: NDArray[np.bool_]  # (P,) feasible as programmed, not as shifted


def compensate(plan: Plan) -> Plan:
    """The plan for the shifted path, with the same rotation; points it cannot reach carry their reason."""
    before, path = plan.chosen.assignment, plan.path
    R = plan.setup.arm.T_base_workpiece[:3, :3]
    full = _full(path) & (before.reason == Reason.OK)
    setup = _with_room(plan.setup)
    offset = np.zeros_like(path.position)
    shifted, after = path, before
    for _ in range(PASSES):
        known = np.flatnonzero(full)
        q = np.where(np.isfinite(after.q), after.q, before.q)[known]  # where the first pass leads nowhere, so be it
        d = plan.setup.elasticity.at(q, plan.directions.k[known]).deflection(plan.directions.force[known])
        wanted = np.full_like(offset, np.nan)
        wanted[known] = -d @ R
        offset = _faded(path, wanted)
        shifted = replace(path, position=path.position + offset)
        after = realise(shifted, setup.arm, setup.robot, before.phi, before.q)
    reason, check = after.reason.copy(), plan.check
    keep = before.reason != Reason.OK  # what was ruled out stays so
    reason[keep] = before.reason[keep]
    if setup.collision is not None:
        checker = Checker.of(shifted, setup.arm, setup.robot, setup.collision, plan.options)
        check = checker.whole(after.phi, np.where((reason == Reason.OK)[:, None], after.q, np.nan))
        reason[check.hit & (reason == Reason.OK)] = Reason.COLLIDING
    after = replace(after, reason=reason)
    found = Compensation(offset, plan.directions.force @ R, full, (reason != Reason.OK) & ~keep)
    return rescored(replace(plan, setup=setup, path=shifted, check=check, compensation=found), after)


def rescored(plan: Plan, assignment: Assignment) -> Plan:
    """The plan with another assignment, its cost and objective."""
    cost = np.full(len(assignment.phi), np.nan)
    ok = np.flatnonzero(assignment.reason == Reason.OK)
    d, velocity = plan.directions, plan.setup.cell.limits.velocity[:6]
    cost[ok] = configuration_cost(plan.setup.elasticity, d, ok, assignment.q[ok], plan.scores.index)
    value = objective(plan.path, cost, assignment.q, assignment.phi, plan.scores.scale, velocity, plan.options)
    return replace(plan, chosen=replace(plan.chosen, assignment=assignment, cost=cost, objective=value))


@dataclass(frozen=True)
class Residual:
    """How far the path is shifted where it is cut, and what that is predicted to leave."""

    shift_worst: float  # m
    shift_mean: float  # m, over the length cut
    worst: float  # m
    mean: float  # m, over the length cut
    uncompensated: float  # m, mean deflection without the shift, over the same places


def residual(plan: Plan) -> Residual | None:
    """Distance of the bent tool from the programmed path, at five places a segment; None without a compensation.

    Between two planning points the configuration and the shift are on the line between theirs, and the force is that
    of the segment, which at a corner is not that of the point.
    """
    if plan.compensation is None:
        return None
    path, R = plan.path, plan.setup.arm.T_base_workpiece[:3, :3]
    q, ok = plan.chosen.assignment.q, plan.chosen.assignment.reason == Reason.OK
    end = 1 + np.flatnonzero(path.counted[1:] & ok[1:] & ok[:-1] & (path.run[1:] == path.run[:-1]))
    if not len(end):
        return None
    length = np.linalg.norm(path.position[end] - path.position[end - 1], axis=1)
    left, bent = np.empty((len(SHARES), len(end))), np.empty((len(SHARES), len(end)))
    for row, f in enumerate(SHARES):
        between = q[end - 1] + f * (q[end] - q[end - 1])
        offset = plan.compensation.offset[end - 1] + f * (
            plan.compensation.offset[end] - plan.compensation.offset[end - 1]
        )
        elastic = plan.setup.elasticity.at(between, plan.directions.k[end - 1])
        d = elastic.deflection(plan.directions.force[end - 1]) @ R
        left[row], bent[row] = np.linalg.norm(offset + d, axis=1), np.linalg.norm(d, axis=1)
    rule = np.array([0.125, 0.25, 0.25, 0.25, 0.125])  # trapezoids
    weight = length / length.sum() if length.sum() > 0 else np.full(len(end), 1.0 / len(end))
    size = np.linalg.norm(plan.compensation.offset, axis=1) * path.counted
    return Residual(
        float(size.max()), float(path.weight @ size), float(left.max()), float(rule @ left @ weight),
        float(rule @ bent @ weight),
    )  # fmt: skip


def _full(path: Path) -> NDArray[np.bool_]:
    """(P,) points cut to, and those a cut begins at."""
    begins = np.r_[path.counted[1:] & (path.run[1:] == path.run[:-1]), False]
    return np.asarray(path.counted | begins)


def _faded(path: Path, wanted: Array) -> Array:
    """(P, 3) the wanted offsets where there are any (else NaN), to zero at the ends of each run, linear in between."""
    out = np.zeros_like(wanted)
    for first, last in path.runs:
        rows = np.arange(first, last + 1)
        known = rows[np.isfinite(wanted[rows, 0])]
        if not len(known):
            continue
        ends = [r for r in (first, last) if r not in (known[0], known[-1])]
        nodes = np.sort(np.r_[known, np.array(ends, int)])
        value = np.where(np.isfinite(wanted[nodes]), wanted[nodes], 0.0)
        for c in range(3):
            out[rows, c] = np.interp(path.s[rows], path.s[nodes], value[:, c])
        out[nodes] = value  # points at one place, an approach without length: each its own
    return out


def _with_room(setup: Setup) -> Setup:
    """The cell as a shifted point must keep to it: the joint limits themselves and most of the singularity margins.

    The margins asked of the choice are there to be used by what comes after it; a point chosen on its margin would
    otherwise be lost for a shift of a few tenths of a millimetre.
    """
    limits, m = setup.driven.limits, setup.arm.margins
    margins = replace(m, wrist=KEPT * m.wrist, elbow=KEPT * m.elbow, shoulder=KEPT * m.shoulder)
    arm: Arm = replace(setup.arm, lower=limits.lower[:6], upper=limits.upper[:6], margins=margins)
    return replace(setup, arm=arm)
