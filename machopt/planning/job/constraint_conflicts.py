"""Conflicts between user constraints: a minimal set of constraints that cannot be satisfied together.

A constraint is a pin, a zone, a branch or a position of an external joint; preferences forbid nothing. The minimal set
is found by leaving constraints out, in halves where there are many (Junker, QuickXplain: preferred explanations and
relaxations for over-constrained problems, AAAI 2004). Every constraint in it is needed for the conflict, so removing
any one of them resolves it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import degrees

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, FixedRotation, PlanOptions, SteeringRule
from machopt.data_types.steering_rules import format_steering_rule, list_steered_stretches
from machopt.data_types.toolpath import Toolpath
from machopt.planning.external_axis_optimization.single_toolpath_planning import find_best_plan
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.sequence_breaks import SequenceBreak

NEAREST = 3  # number of constraints reported near a place that cannot be driven
MOST = 60  # maximum number of plans; with more constraints the reported set may not be minimal


@dataclass(frozen=True)
class AxisPositionPin:
    """Required position of an external joint in an operation."""

    joint: str
    operation: str
    value: float  # m or rad
    unit: str


Wish = FixedRotation | SteeringRule | AxisPositionPin


def add_constraint_conflict(
    plan: Plan, cell: Cell, toolpath: Toolpath, options: PlanOptions, timings: StageTimings
) -> Plan:
    """Return the plan with the conflicting constraints; unchanged where it is complete, or incomplete without them too.

    Args:
        plan: plan of the job.
        cell: robot cell.
        toolpath: toolpath of the job.
        options: as the user gave them.
        timings: receives the duration of the stages.
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
    description = ", ".join(describe_constraint(w) for w in least)
    alone = "No plan keeps" if len(least) == 1 else "No plan keeps together:"
    end = "without it there is one." if len(least) == 1 else "without any one of them this conflict ends."
    return replace(plan, conflict=f"{alone} {description}; {end}")


def add_undrivable_conflict(
    plan: Plan, stops: Sequence[SequenceBreak], toolpath: Toolpath, options: PlanOptions
) -> Plan:
    """Return the plan with the constraints nearest to the place where its motion fails; unchanged where it does not
    fail.

    Its points are complete, so no set of constraints is known to conflict: the failure occurs between points.

    Args:
        plan: plan of the job.
        stops: causes of the failure of the motion.
        toolpath: toolpath of the job.
        options: as the user gave them.
    """
    if not stops or plan.conflict:
        return plan
    stop = stops[0]
    ends = [v for v in (stop.before, stop.after) if np.isfinite(v)]
    wishes = sorted(list_constraints(options), key=lambda w: _compute_distance(w, ends, toolpath))[:NEAREST]
    if not wishes:
        return plan
    return replace(
        plan,
        conflict=f"The points can be cut as requested, but the motion between them cannot be driven {stop.where}: "
        f"{stop.text}. "
        f"Nearest requests: {', '.join(describe_constraint(w) for w in wishes)}; without one of them, or "
        f"with more points "
        "between them, it may be driven.",
    )


def _compute_distance(wish: Wish, ends: Sequence[float], toolpath: Toolpath) -> float:
    """Return the number of toolpath points between a constraint and a place."""
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
    """Return whether no cut point is missing and the sequence has no break.

    Args:
        plan: plan to check.
    """
    missing = plan.missing
    return not plan.path.may_touch[missing].any() and not plan.breaks


def list_constraints(options: PlanOptions) -> tuple[Wish, ...]:
    """Return all user constraints that may make a plan infeasible.

    Args:
        options: plan options.
    """
    steer = [w for w in options.steer if w.forbids]
    pins = [
        AxisPositionPin(a.joint, label, value, a.unit) for a in options.external for label, value in a.at_operations
    ]
    return (*options.fixed, *steer, *pins)


def restrict_to_constraints(options: PlanOptions, wishes: Sequence[Wish]) -> PlanOptions:
    """Return the options with the given constraints only; preferences remain.

    Args:
        options: plan options.
        wishes: constraints to keep.
    """
    allowed = set(wishes)

    def keep_allowed_positions(axis: ExternalJointOptions) -> ExternalJointOptions:
        at = tuple((k, v) for k, v in axis.at_operations if AxisPositionPin(axis.joint, k, v, axis.unit) in allowed)
        return replace(axis, at_operations=at)

    return replace(
        options,
        fixed=tuple(f for f in options.fixed if f in allowed),
        steer=tuple(w for w in options.steer if w in allowed or w not in list_constraints(options)),
        external=tuple(keep_allowed_positions(axis) for axis in options.external),
    )


def find_minimal_conflict(wishes: Sequence[Wish], possible: Callable[[Sequence[Wish]], bool]) -> list[Wish]:
    """Return a minimal infeasible set of constraints, in their order; every proper subset is feasible.

    Args:
        wishes: constraints that are infeasible together.
        possible: whether some of them are feasible; called at most MOST times, after which the rest counts as needed.
    """
    found = _ConflictSearch(possible).find_minimal([], False, list(wishes))
    return [w for w in wishes if w in found]


class _ConflictSearch:
    """Divide and conquer (QuickXplain) for a minimal set of wishes that is not possible; plans are limited.

    Args:
        possible: whether there is a plan with some wishes.
    """

    def __init__(self, possible: Callable[[Sequence[Wish]], bool]) -> None:
        self._possible = possible
        self._plans = 0

    def _is_failing(self, some: Sequence[Wish]) -> bool:
        self._plans += 1
        return self._plans <= MOST and not self._possible(some)

    def find_minimal(self, given: list[Wish], new: bool, left: list[Wish]) -> list[Wish]:
        """Return a minimal subset of ``left`` that is not possible together with ``given``.

        Args:
            given: wishes that stay.
            new: ``given`` changed since it was last tried.
            left: wishes to reduce.
        """
        if new and self._is_failing(given):
            return []
        if len(left) == 1:
            return left
        half = len(left) // 2
        first, second = left[:half], left[half:]
        of_second = self.find_minimal(given + first, bool(first), second)
        of_first = self.find_minimal(given + of_second, bool(of_second), first)
        return of_first + of_second


def describe_constraint(wish: Wish) -> str:
    """Return a constraint in the words of the options.

    Args:
        wish: constraint.
    """
    if isinstance(wish, FixedRotation):
        return f"the rotation {degrees(wish.gamma):.6g}° at point {wish.point}"
    if isinstance(wish, AxisPositionPin):
        value = wish.value * 1e3 if wish.unit == "mm" else degrees(wish.value)
        return f"{wish.joint} at {value:.6g} {wish.unit} for operation {wish.operation!r}"
    return format_steering_rule(wish)
