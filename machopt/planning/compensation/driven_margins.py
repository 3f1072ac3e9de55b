"""What driving a plan takes of the margins that it keeps.

Where the rotation bends it is rounded in time, as the path is, so at a planning point the arm stands a little elsewhere
than planned. A pose that stood on a margin (joint limits, singularities) then falls short of it. The margin is a
promise about what is driven, so such a plan is made again with that much more of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.sampling.configurations import PlanningArm
from machopt.planning.sampling.joint_path import solve_joint_path

ROUNDING = np.radians(
    1e-5
)  # of joint angles; requested_choices.MARGIN_TOLERANCE_DEG of the verification allows 2e-5° for it
FACTOR, LEAST = 2.0, np.radians(0.001)  # of what was short is kept beside the margin, and how much at least


def apply_driven_rotation(plan: Plan, phi: Array) -> Plan:
    """The plan with the rotation the retimed motion really takes at the planning points, (P,) rad.

    A point counts as lost to a joint limit where it is nearer than the margin by more than :data:`ROUNDING`.
    """
    before, arm = plan.chosen.assignment, plan.setup.arm
    arm = replace(arm, lower=arm.lower - ROUNDING, upper=arm.upper + ROUNDING)
    after = solve_joint_path(plan.path, arm, plan.setup.robot, phi, before.q)
    return rescore_plan(
        plan, after.marked(before.reason != InfeasibilityReason.OK, before.reason)
    )  # what was ruled out stays so


def find_lost_margin(planned: Plan, driven: Plan) -> SequenceBreak | None:
    """The first point that is planned, and falls short of a margin as it is driven; None where none does."""
    rows = _lost(planned, driven)
    if not len(rows):
        return None
    at = float(planned.path.index[rows[0]])
    which = (
        "limit_margin_deg"
        if driven.chosen.assignment.reason[rows[0]] == InfeasibilityReason.LIMIT
        else "a singularity margin"
    )
    return SequenceBreak(
        before=at,
        after=at,
        code="not_driven",
        text=f"the rotation, rounded where it bends, stands nearer than {which} allows",
        help=f"a smaller value of {which}, or one rotation for all of the operation (steer), would help",
    )


def find_runs_with_lost_margins(planned: Plan, driven: Plan) -> set[int]:
    """The runs with points that are planned, and fall short of a margin as they are driven."""
    return set(planned.path.run[_lost(planned, driven)].tolist())


def add_margin_reserve(options: PlanOptions, planned: Plan, driven: Plan) -> PlanOptions:
    """Margins by so much larger that what driving takes of them is spared."""
    rows, a, arm = _lost(planned, driven), driven.chosen.assignment, driven.setup.arm
    m, q = arm.margins, a.q[rows]

    def more(short: Array) -> float:
        worst = float(np.nan_to_num(short, nan=0.0).max(initial=0.0))
        return FACTOR * worst + LEAST if worst > 0 else 0.0

    return replace(
        options,
        limit_margin=options.limit_margin + more(np.maximum(arm.lower - q, q - arm.upper)),
        singularity_wrist=options.singularity_wrist + more(m.wrist - a.wrist[rows]),
        singularity_elbow=options.singularity_elbow + more(m.elbow - a.elbow[rows]),
        singularity_shoulder=options.singularity_shoulder + more(m.shoulder - a.shoulder[rows]),
    )


def restore_requested_margins(spared: Plan, options: PlanOptions, arm: PlanningArm) -> Plan:
    """A plan that was made with spare, as an answer to the margins that the user asked (those of ``arm``)."""
    return replace(spared, options=options, setup=replace(spared.setup, arm=arm))


def _lost(planned: Plan, driven: Plan) -> NDArray[np.intp]:
    """Rows of points that are planned, and not there as driven."""
    before, after = (p.chosen.assignment.reason for p in (planned, driven))
    return np.flatnonzero((before == InfeasibilityReason.OK) & (after != InfeasibilityReason.OK))
