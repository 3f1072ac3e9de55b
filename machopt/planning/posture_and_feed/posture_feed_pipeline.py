"""Stages of the joint optimisation of one tool's plan."""

from __future__ import annotations

import numpy as np

from machopt.data_types.posture_feed_result import WindowOutcome
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Bools
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.posture_and_feed.linearized_constraints import LimitSources
from machopt.planning.posture_and_feed.node_loads import MilledTargets
from machopt.planning.posture_and_feed.symbolic_machine import SymbolicMachine, build_symbolic_machine
from machopt.planning.posture_and_feed.window_builder import RunState, Window, build_window_data, list_windows
from machopt.planning.posture_and_feed.window_problem import solve_window
from machopt.planning.posture_and_feed.window_trial import (
    TrialRefusal,
    compare_states,
    measure_run,
    try_solution,
)
from machopt.planning.stability.depth_ratio import StabilityModel

ITERATES = 2  # of a window at most
TRUST = np.radians(20.0)  # rad, first trust region of the rotation
SHRINK = 0.35  # of the trust region after a refusal
LEAST_TRUST = np.radians(1.0)


def optimize_windows(plan: Plan, toolpath: Toolpath) -> tuple[Plan, tuple[WindowOutcome, ...]]:
    """Return the plan with every accepted window, and the outcome of each.

    Args:
        plan: Plan of one tool with the feeds of the file.
        toolpath: Its toolpath.
    """
    machine = build_symbolic_machine(plan.setup.arm.machine, plan.setup.arm.T_flange_tcp)
    milled = MilledTargets.build(plan, toolpath)
    outcomes = []
    for window in list_windows(plan):
        plan, outcome = _optimize_window(plan, toolpath, window, milled, machine)
        outcomes.append(outcome)
    return plan, tuple(outcomes)


def _optimize_window(
    plan: Plan, toolpath: Toolpath, window: Window, milled: MilledTargets | None, machine: SymbolicMachine
) -> tuple[Plan, WindowOutcome]:
    best = measure_run(plan, toolpath, window.run)
    if isinstance(best, TrialRefusal):
        return plan, _conclude(window, best.reason, np.nan, np.nan)
    start, trust, reason = best.seconds, TRUST, ""
    is_free = find_free_axes(plan)
    for _ in range(ITERATES):
        sources = LimitSources(best.plan, _build_stability(best.plan, toolpath))
        data = build_window_data(best, window, milled, sources, machine, is_free, trust)
        solution = solve_window(machine, data)
        trial = try_solution(best, toolpath, window, solution)
        why = trial.reason if isinstance(trial, TrialRefusal) else compare_states(best, trial)
        if isinstance(trial, RunState) and not why:
            best = trial
            continue
        reason, trust = reason or why, SHRINK * trust
        if trust < LEAST_TRUST:
            break
    return best.plan, _conclude(window, "" if best.seconds < start else reason, start, best.seconds)


def _conclude(window: Window, reason: str, before: float, after: float) -> WindowOutcome:
    return WindowOutcome(
        window=window.name,
        nodes=len(window.points),
        is_accepted=not reason,
        reason=reason,
        seconds_before=before,
        seconds_after=after,
    )


def _build_stability(plan: Plan, toolpath: Toolpath) -> StabilityModel | None:
    s = plan.setup
    return StabilityModel.build(s.cell, toolpath, plan.path, s.arm, s.robot, plan.directions)


def find_free_axes(plan: Plan) -> Bools:
    """Return (E,) external joints that may move in every operation.

    Args:
        plan: Plan of one tool.
    """
    axes = resolve_axis_options(plan.setup.cell, plan.options)
    return np.array([axis.moves and not axis.locks and not axis.operations for axis in axes], bool)
