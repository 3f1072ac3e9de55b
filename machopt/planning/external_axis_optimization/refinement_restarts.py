"""Restarts of the refinement from better sequences over grids of values, and from other starts where these stall.

The bound over sequences (:mod:`machopt.planning.external_axis_optimization.external_axis_bound`) finds a sequence
around a refined plan. Where it saves enough, the refinement begins there again. Where such a sequence is known, but no
refinement from it is better, the plan is in a local optimum that is not the only one: the other starts of the search
are refined then, until the bound leaves little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.planning.continuous_refinement.plan_improvement import RefinementJob, refine_plan
from machopt.planning.continuous_refinement.refinement import TRUST
from machopt.planning.continuous_refinement.starting_point import RefinementStart
from machopt.planning.external_axis_optimization.external_axis_bound import BoundSearch
from machopt.planning.external_axis_optimization.value_grid import VALUES
from machopt.planning.pipeline.plan_data_types import Plan

SHORT = 600  # planning points: a longer path counts as long
LEAPS = 4, 1  # maximum number, for short paths and for long ones
# rad, trust regions of the refinement from a sequence, tried in turn on short paths: the sequence is free of contacts
# at the stations, and a curve that stays near it is more often free between them
TRUSTS = TRUST, np.radians(5.0)
WORTH_IT = 1e-3  # share of J: a sequence that saves less is not used as a start
STALLED = 0.01  # share of J that a known sequence would save; benchmarks/external_axis_gap.py aims at this
OTHERS = 1  # further starts that are refined: a second one saved 0.3 % of J for a fifth of the time, in one cell


def leap_to_better_sequences(best: Plan, job: RefinementJob) -> list[Plan]:
    """Return a local optimum and its improvements by better sequences over grids around it, until one leads no further.

    The lower bound over such sequences is stored with each plan.

    Args:
        best: refined plan.
        job: toolpath, operation groups and ranking of the plans.
    """
    if count_lost_points(best) or best.found is None:
        return [best]
    most, out = LEAPS[len(best.path.index) > SHORT], [best]
    for leap in range(most + 1):
        with job.clock.stage("external"):
            around = BoundSearch.build(out[-1], job.groups, VALUES)
            if isinstance(around, str):
                break
            found = around.best()
            out[-1] = replace(out[-1], over_external=around.bound(found))
            if found is None or leap == most or found.total > (1.0 - WORTH_IT) * around.own:
                break
            start = around.start(found.vertex, out[-1])
        further = _refine_from_sequence(out[-1], job, start)
        if further is out[-1]:
            break
        out.append(further)
    return out


def _refine_from_sequence(plan: Plan, job: RefinementJob, start: RefinementStart) -> Plan:
    """Return the refinement of a plan from a better sequence; the plan itself where none is better."""
    for trust in TRUSTS if len(plan.path.index) <= SHORT else TRUSTS[:1]:
        further = refine_plan(plan, job, trust=trust, start=start)
        if further is not plan:
            return further
    return plan


def has_stalled(plan: Plan) -> bool:
    """Return whether a much better sequence of external joints is known than the plan.

    Args:
        plan: last plan of :func:`leap_to_better_sequences`.
    """
    over = plan.over_external
    return over is not None and not over.why and over.sequence < (1.0 - STALLED) * over.plan


def refine_other_starts(starts: Sequence[Plan], job: RefinementJob, trust: float) -> list[Plan]:
    """Return refined plans from other starts, until one has not stalled.

    Args:
        starts: plans, best first.
        job: toolpath, operation groups and ranking of the plans.
        trust: rad, trust region of the refinement.
    """
    out: list[Plan] = []
    for start in starts[:OTHERS]:
        out += leap_to_better_sequences(refine_plan(start, job, trust=trust), job)
        if not has_stalled(out[-1]):
            break
    return out


def count_lost_points(plan: Plan) -> float:
    """Return the number of points without a configuration plus the number of breaks.

    Args:
        plan: Plan to count in.
    """
    return float(count_unreached_points(plan) + len(plan.breaks))


def count_unreached_points(plan: Plan) -> int:
    """Return the number of points without a configuration where contacts count.

    Args:
        plan: Plan to count in.
    """
    return int(plan.path.may_touch[plan.missing].sum())
