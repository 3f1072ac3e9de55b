"""Margins of a plan that its driven motion uses up.

Where the rotation changes its rate, the motion is rounded in time, as the path is. At a planning point the arm is
therefore slightly off the planned pose. A pose planned exactly on a margin (joint limits, singularities) then violates
it. The margin applies to the driven motion, so such a plan is repeated with a margin that is larger by this amount.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.sampling.joint_path import solve_joint_path
from machopt.planning.sampling.planning_arm import PlanningArm

ROUNDING = np.radians(
    1e-5
)  # of joint angles; requested_choices.MARGIN_TOLERANCE_DEG of the verification allows 2e-5° for it
FACTOR, LEAST = 2.0, np.radians(0.001)  # added margin: multiple of the violation, and its minimum
_MARGIN_NAMES = {
    InfeasibilityReason.LIMIT: "limit_margin_deg",
    InfeasibilityReason.UNSTABLE: "min_stability_ratio",
}


def apply_driven_rotation(plan: Plan, phi: Array) -> Plan:
    """Return the plan with the rotation that the retimed motion has at the planning points.

    A point counts as lost to a joint limit where it is nearer than the margin by more than :data:`ROUNDING`.

    Args:
        plan: plan as chosen.
        phi: (P,) rad, rotation of the retimed motion at the planning points.
    """
    before, arm = plan.chosen.assignment, plan.setup.arm
    arm = replace(arm, lower=arm.lower - ROUNDING, upper=arm.upper + ROUNDING)
    after = solve_joint_path(plan.path, arm, plan.setup.robot, phi, before.q)
    return rescore_plan(
        plan, after.marked(before.reason != InfeasibilityReason.OK, before.reason)
    )  # excluded points stay excluded


def find_lost_margin(planned: Plan, driven: Plan) -> SequenceBreak | None:
    """Return the first feasible point that violates a margin in the driven motion; None where none does.

    Args:
        planned: plan as chosen.
        driven: the same plan with the driven rotation.
    """
    rows = _find_lost_points(planned, driven)
    if not len(rows):
        return None
    at = float(planned.path.index[rows[0]])
    why = InfeasibilityReason(int(driven.chosen.assignment.reason[rows[0]]))
    which = _MARGIN_NAMES.get(why, "a singularity margin")
    return SequenceBreak(
        before=at,
        after=at,
        code="not_driven",
        text=f"the rotation, rounded where it bends, does not keep {which}",
        help=f"a smaller value of {which}, or one rotation for all of the operation (steer), would help",
    )


def find_runs_with_lost_margins(planned: Plan, driven: Plan) -> set[int]:
    """Return the runs with feasible points that violate a margin in the driven motion.

    Args:
        planned: plan as chosen.
        driven: the same plan with the driven rotation.
    """
    return set(planned.path.run[_find_lost_points(planned, driven)].tolist())


def add_margin_reserve(options: PlanOptions, planned: Plan, driven: Plan) -> PlanOptions:
    """Return the options with margins enlarged by the amount that the driven motion uses.

    Args:
        options: options of the plan.
        planned: plan as chosen.
        driven: the same plan with the driven rotation.
    """
    rows, a, arm = _find_lost_points(planned, driven), driven.chosen.assignment, driven.setup.arm
    m, q = arm.margins, a.q[rows]

    def more(short: Array) -> float:
        worst = float(np.nan_to_num(short, nan=0.0).max(initial=0.0))
        return FACTOR * worst + LEAST if worst > 0 else 0.0

    least = options.min_stability_ratio
    if least is not None and arm.stability is not None:
        ratio = arm.stability.compute_ratios(arm, driven.path, rows, q)
        least += more(arm.stability.ratio - ratio)
    return replace(
        options,
        min_stability_ratio=least,
        limit_margin=options.limit_margin + more(np.maximum(arm.lower - q, q - arm.upper)),
        singularity_wrist=options.singularity_wrist + more(m.wrist - a.wrist[rows]),
        singularity_elbow=options.singularity_elbow + more(m.elbow - a.elbow[rows]),
        singularity_shoulder=options.singularity_shoulder + more(m.shoulder - a.shoulder[rows]),
    )


def restore_requested_margins(reserved: Plan, options: PlanOptions, arm: PlanningArm) -> Plan:
    """Return a plan made with enlarged margins as the result for the requested margins.

    Args:
        reserved: plan made with enlarged margins.
        options: options as requested.
        arm: arm model with the requested margins.
    """
    return replace(reserved, options=options, setup=replace(reserved.setup, arm=arm))


def _find_lost_points(planned: Plan, driven: Plan) -> NDArray[np.intp]:
    """Return the rows of points that are feasible as planned and infeasible as driven."""
    before, after = (p.chosen.assignment.reason for p in (planned, driven))
    return np.flatnonzero((before == InfeasibilityReason.OK) & (after != InfeasibilityReason.OK))
