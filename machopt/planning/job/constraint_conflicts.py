"""Which of the user's wishes cannot be kept together, where without them there is a plan.

A wish is a pin, zone, branch or place of an external joint; preferences forbid nothing. The least set that cannot be
kept is found by leaving wishes out, in halves where many are given (Junker, QuickXplain: preferred explanations and
relaxations for over-constrained problems, AAAI 2004): every wish in it is needed for the conflict, so any one of them
given up ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, FixedRotation, PlanOptions, SteeringRule
from machopt.data_types.steering import format_steering_rule, list_steered_stretches
from machopt.data_types.toolpath import Toolpath
from machopt.planning.external_axis_optimization.best_plan import find_best_plan
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak

NEAREST = 3  # wishes told beside a place that cannot be driven
MOST = 60  # plans that are made for it; with more wishes the set told may not be the least


@dataclass(frozen=True)
class AxisPositionPin:
    """An external joint that is to stand somewhere in an operation."""

    joint: str
    operation: str
    value: float  # m or rad
    unit: str


Wish = FixedRotation | SteeringRule | AxisPositionPin


def add_constraint_conflict(
    plan: Plan, cell: Cell, toolpath: Toolpath, options: PlanOptions, timings: StageTimings
) -> Plan:
    """The plan with the wishes that keep it from being one; the same where it is whole, or would not be without them.

    Args:
        options: as the user gave them.
    """
    wishes = list_constraints(options)
    if not wishes or options.allow_gaps or is_complete(plan):
        return plan

    def possible(some: Sequence[Wish]) -> bool:
        return is_complete(
            find_best_plan(cell, toolpath, restrict_to_constraints(options, some), StageTimings(), before=plan)
        )

    with timings.stage("conflict"):
        if not possible(()):
            return plan
        least = find_minimal_conflict(wishes, possible)
    told = ", ".join(describe_constraint(w) for w in least)
    alone = "No plan keeps" if len(least) == 1 else "No plan keeps together:"
    end = "without it there is one." if len(least) == 1 else "without any one of them this conflict ends."
    return replace(plan, conflict=f"{alone} {told}; {end}")


def add_undrivable_conflict(
    plan: Plan, stops: Sequence[SequenceBreak], toolpath: Toolpath, options: PlanOptions
) -> Plan:
    """The plan with the wishes nearest to where its motion cannot be driven; the same where it can, or none is given.

    Its points are whole, so no set of wishes is known to be in conflict: what lies between them is found in time only.

    Args:
        stops: what keeps the motion from being driven.
        options: as the user gave them.
    """
    if not stops or plan.conflict:
        return plan
    stop = stops[0]
    ends = [v for v in (stop.before, stop.after) if np.isfinite(v)]
    wishes = sorted(list_constraints(options), key=lambda w: _distance(w, ends, toolpath))[:NEAREST]
    if not wishes:
        return plan
    return replace(
        plan,
        conflict=f"The points can be cut as asked, the motion between them cannot be driven {stop.where}: {stop.text}. "
        f"Asked nearest to there: {', '.join(describe_constraint(w) for w in wishes)}; without one of them, or "
        f"with more points "
        "between them, it may be driven.",
    )


def _distance(wish: Wish, ends: Sequence[float], toolpath: Toolpath) -> float:
    """How many toolpath points a wish is from a place."""
    if isinstance(wish, FixedRotation):
        parts = [(wish.point, wish.point)]
    else:
        parts = list(
            list_steered_stretches(
                wish if isinstance(wish, SteeringRule) else SteeringRule(operation=wish.operation), toolpath
            )
        )
    return min((max(a - at, at - b, 0.0) for a, b in parts for at in ends), default=0.0)


def is_complete(plan: Plan) -> bool:
    """Nothing that is cut is missing, and no way breaks off."""
    missing = plan.missing
    return not plan.path.may_touch[missing].any() and not plan.breaks


def list_constraints(options: PlanOptions) -> tuple[Wish, ...]:
    """Everything the user decided that may forbid a plan."""
    steer = [w for w in options.steer if w.forbids]
    stands = [
        AxisPositionPin(a.joint, label, value, a.unit) for a in options.external for label, value in a.at_operations
    ]
    return (*options.fixed, *steer, *stands)


def restrict_to_constraints(options: PlanOptions, wishes: Sequence[Wish]) -> PlanOptions:
    """The options with these wishes only; preferences stay."""
    kept = set(wishes)

    def stands(axis: ExternalJointOptions) -> ExternalJointOptions:
        at = tuple((k, v) for k, v in axis.at_operations if AxisPositionPin(axis.joint, k, v, axis.unit) in kept)
        return replace(axis, at_operations=at)

    return replace(
        options,
        fixed=tuple(f for f in options.fixed if f in kept),
        steer=tuple(w for w in options.steer if w in kept or w not in list_constraints(options)),
        external=tuple(stands(axis) for axis in options.external),
    )


def find_minimal_conflict(wishes: Sequence[Wish], possible: Callable[[Sequence[Wish]], bool]) -> list[Wish]:
    """A least set of wishes that is not possible, in their order; no part of it is.

    Args:
        wishes: not possible together.
        possible: whether some of them are; asked MOST times at most, after which what is left counts as needed.
    """
    asked = 0

    def fails(some: Sequence[Wish]) -> bool:
        nonlocal asked
        asked += 1
        return asked <= MOST and not possible(some)

    def within(given: list[Wish], new: bool, left: list[Wish]) -> list[Wish]:
        if new and fails(given):
            return []
        if len(left) == 1:
            return left
        half = len(left) // 2
        first, second = left[:half], left[half:]
        of_second = within(given + first, bool(first), second)
        of_first = within(given + of_second, bool(of_second), first)
        return of_first + of_second

    found = within([], False, list(wishes))
    return [w for w in wishes if w in found]


def describe_constraint(wish: Wish) -> str:
    """A wish as the user would say it."""
    if isinstance(wish, FixedRotation):
        return f"the rotation {degrees(wish.gamma):.6g}° at point {wish.point}"
    if isinstance(wish, AxisPositionPin):
        value = wish.value * 1e3 if wish.unit == "mm" else degrees(wish.value)
        return f"{wish.joint} at {value:.6g} {wish.unit} for operation {wish.operation!r}"
    return format_steering_rule(wish)
