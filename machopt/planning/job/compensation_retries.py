"""Retries with another rotation where the path shifted against its deflection cannot be driven.

The choice of the rotation does not consider the shift, which follows from it. Where the shift leads to a contact,
violates a margin or is refused, the plan is repeated without the rotations around the chosen one, a few times with a
growing excluded range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import ceil, floor, pi

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions, SteeringRule
from machopt.data_types.tool_segments import ToolSegment
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.compensation.driven_margins import restore_requested_margins
from machopt.planning.compensation.plan_compensation import compensate_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma

TRIES = 4  # maximum number of new plans
NARROWEST = np.radians(10.0)  # to either side of the chosen rotation, doubled in each attempt; or the grid's step
WIDEST = 0.95 * pi  # to either side: some rotation has to remain
MOST = 200  # maximum number of points without shift: with more, other rotations do not help


def compensate_with_retries(
    segment: ToolSegment,
    planned: Plan,
    plan_options: PlanOptions,
    timings: StageTimings,
    replan: Callable[[PlanOptions], Plan],
) -> Plan:
    """Return the plan shifted against its deflection, with other rotations where these make it complete.

    Args:
        segment: toolpath of one tool.
        planned: plan before the shift.
        plan_options: options it was planned with, for the whole job.
        timings: receives the duration of the stages.
        replan: plans the same with other options for the whole job.

    Returns:
        The shifted plan; the first one where no other loses fewer points.
    """
    requested, arm = planned.options, planned.setup.arm

    def shifted(plan: Plan) -> Plan:
        with timings.stage("compensate"):
            return compensate_plan(plan, segment.toolpath)

    best = found = shifted(planned)
    options, avoided = plan_options, set[int]()
    for n in range(TRIES if requested.is_searched else 0):
        zones = _build_excluded_zones(
            found, segment.first, min(max(plan_options.rotation_step, NARROWEST) * 2**n, WIDEST)
        )
        if not zones:
            break
        options = replace(options, steer=(*options.steer, *zones))
        avoided |= {zone.points[0] for zone in zones if zone.points is not None}
        alternative = replan(options)
        if _count_missing(alternative) > _count_missing(planned):  # these rotations are needed
            break
        found = shifted(restore_requested_margins(alternative, requested, arm))
        if _count_missing(found) < _count_missing(best):
            best = replace(found, elsewhere=tuple(sorted(avoided)))
    return best


def _build_excluded_zones(plan: Plan, first: int, half: float) -> tuple[SteeringRule, ...]:
    """Return the rotation zones to exclude where the shift is lost, at toolpath points of the whole job; none if no
    remedy.
    """
    if plan.compensation is None:
        return ()
    rows = np.flatnonzero(plan.compensation.lost)
    if len(rows) > MOST:
        return ()
    gamma = compute_gamma(plan)
    out: dict[tuple[int, int], tuple[float, float]] = {}
    for p in rows.tolist():
        ends = first + floor(plan.path.index[p] + 1e-9), first + ceil(plan.path.index[p] - 1e-9)
        low, high = out.get(ends, (gamma[p], gamma[p]))
        g = low + float(wrap_angle(gamma[p] - low))
        out[ends] = min(low, g), max(high, g)
    return tuple(
        SteeringRule(points=ends, forbid=(low - half, high + half))
        for ends, (low, high) in out.items()
        if high - low + 2.0 * half < 2.0 * WIDEST
    )


def _count_missing(plan: Plan) -> int:
    """Return the number of planning points without a plan, and the number of breaks of the sequence."""
    return int((plan.chosen.assignment.reason != InfeasibilityReason.OK).sum()) + len(plan.breaks)
