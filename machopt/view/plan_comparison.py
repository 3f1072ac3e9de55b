"""Comparison of two plans of one job, figure by figure."""

from __future__ import annotations

import numpy as np

from machopt.commands.optimize.job_result import OptimizeJobResult
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.report.page_types.steering_panel_data import PlanComparison

MISSING_VALUE = float("nan")


def compare_plans(now: OptimizeJobResult, before: OptimizeJobResult | None) -> tuple[PlanComparison, ...]:
    """Return objective, index, time and clearance of a plan and of the one before it, NaN where there is none.

    Args:
        now: The plan.
        before: The plan before it; None for the first plan.
    """
    deflects = now.plan.scores.index == "deflection"
    word, unit, factor = ("deflection", "mm", 1e3) if deflects else ("compliance", "µm/N", 1e6)
    scale = now.plan.scores.scale

    def row(name: str, unit: str, of: list[float], decimals: int, *, less: bool = True) -> PlanComparison:
        return PlanComparison(
            name=name,
            unit=unit,
            before=of[0] if len(of) > 1 else MISSING_VALUE,
            now=of[-1],
            decimals=decimals,
            less_is_better=less,
        )

    both = [now] if before is None else [before, now]
    return (
        row("Objective", "", [_compute_objective(m.plan, scale) for m in both], 4),
        row(f"Mean {word}", unit, [factor * m.plan.scores.scale * m.plan.chosen.objective.mean for m in both], 4),
        row(f"Worst {word}", unit, [factor * m.plan.scores.scale * m.plan.chosen.objective.worst for m in both], 4),
        row("Cycle time", "s", [_get_cycle_time(m) for m in both], 2),
        row("Least clearance", "mm", [_get_minimum_clearance(m) for m in both], 2, less=False),
    )


def _compute_objective(plan: Plan, scale: float) -> float:
    """Return J with given c₀ and without preferred rotations, so that plans with different rules are comparable."""
    o, w = plan.chosen.objective, plan.options.weights
    return float(o.total - o.preferred + (plan.scores.scale / scale - 1.0) * (w.mean * o.mean + w.worst * o.worst))


def _get_cycle_time(job_result: OptimizeJobResult) -> float:
    t = job_result.timeline.trajectory if job_result.timeline is not None else None
    return MISSING_VALUE if t is None else float(t.time[-1])


def _get_minimum_clearance(job_result: OptimizeJobResult) -> float:
    """mm"""
    values = job_result.points.table.clearance
    known = values[np.isfinite(values)]
    return 1e3 * float(known.min()) if len(known) else MISSING_VALUE
