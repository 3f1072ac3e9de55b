"""Another rotation where the path shifted against its deflection cannot be driven at the one that was chosen.

The choice knows nothing of the shift, which follows from what is chosen. Where it is lost to a contact or a margin, or
refused, the plan is made again without the rotations around the one taken there, a few times and each time wider.
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
from machopt.planning.compensation.added_points import compensate_plan
from machopt.planning.compensation.driven_margins import restore_requested_margins
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.infeasibility_reasons import compute_gamma

TRIES = 4  # plans made again
NARROWEST = np.radians(
    10.0
)  # to either side of the rotation that was taken, doubled from try to try; or the grid's step
WIDEST = 0.95 * pi  # to either side: some rotation has to be left
MOST = 200  # points the shift is lost at: where it is more, no rotation here and there is what lacks


def compensate_with_retries(
    stint: ToolSegment, planned: Plan, whole: PlanOptions, timings: StageTimings, again: Callable[[PlanOptions], Plan]
) -> Plan:
    """The plan shifted against its deflection, with other rotations where that alone makes it whole.

    Args:
        planned: before the shift.
        whole: options it was planned with, for the whole job.
        again: plans the same with other options for the whole job.

    Returns:
        The shifted plan; the first one where no other loses fewer points.
    """
    asked, arm = planned.options, planned.setup.arm

    def shifted(plan: Plan) -> Plan:
        with timings.stage("compensate"):
            return compensate_plan(plan, stint.toolpath)

    best = found = shifted(planned)
    options, avoided = whole, set[int]()
    for n in range(TRIES if asked.method == "global" else 0):
        zones = _zones(found, stint.first, min(max(whole.rotation_step, NARROWEST) * 2**n, WIDEST))
        if not zones:
            break
        options = replace(options, steer=(*options.steer, *zones))
        avoided |= {zone.points[0] for zone in zones if zone.points is not None}
        other = again(options)
        if _missing(other) > _missing(planned):  # these rotations are needed
            break
        found = shifted(restore_requested_margins(other, asked, arm))
        if _missing(found) < _missing(best):
            best = replace(found, elsewhere=tuple(sorted(avoided)))
    return best


def _zones(plan: Plan, first: int, half: float) -> tuple[SteeringRule, ...]:
    """What not to choose where the shift is lost, at toolpath points of the whole job; none where that is no remedy."""
    if plan.compensation is None:
        return ()
    rows = np.flatnonzero(plan.compensation.lost)
    if len(rows) > MOST:
        return ()
    taken = compute_gamma(plan)
    out: dict[tuple[int, int], tuple[float, float]] = {}
    for p in rows.tolist():
        ends = first + floor(plan.path.index[p] + 1e-9), first + ceil(plan.path.index[p] - 1e-9)
        low, high = out.get(ends, (taken[p], taken[p]))
        g = low + float(wrap_angle(taken[p] - low))
        out[ends] = min(low, g), max(high, g)
    return tuple(
        SteeringRule(points=ends, forbid=(low - half, high + half))
        for ends, (low, high) in out.items()
        if high - low + 2.0 * half < 2.0 * WIDEST
    )


def _missing(plan: Plan) -> int:
    """How many planning points are not planned, and how often the sequence breaks off."""
    return int((plan.chosen.assignment.reason != InfeasibilityReason.OK).sum()) + len(plan.breaks)
