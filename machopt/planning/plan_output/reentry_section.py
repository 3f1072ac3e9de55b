"""Section ``reentry`` of result.json: lifts inside of closed contours, and what they change."""

from __future__ import annotations

import math

from machopt.data_types.documents.optimize_document import ReentryEntry
from machopt.planning.pipeline.plan_data_types import Plan


def build_reentry_section(plan: Plan) -> tuple[ReentryEntry, ...] | None:
    """Return one entry a tool; None where re-entries are not permitted.

    Args:
        plan: plan of the job.
    """
    plans = [part.plan for part in plan.parts] if plan.parts else [plan]
    return tuple(_build_entry(one) for one in plans if one.reentry is not None) or None


def list_reentry_points(plan: Plan) -> tuple[int, ...]:
    """Return the toolpath points at which the tool is lifted inside of a cut, counted in the whole job.

    Args:
        plan: plan of the job, or of one tool in it.
    """
    path = plan.path
    return tuple(round(float(path.index[row])) for row in path.is_reentry.nonzero()[0])


def _build_entry(plan: Plan) -> ReentryEntry:
    result, objective = plan.reentry, plan.chosen.objective
    assert result is not None  # only such plans have an entry
    return ReentryEntry(
        points=list_reentry_points(plan),
        reason=result.reason,
        objective_without=_convert_nan_to_null(result.objective_without),
        objective=_convert_nan_to_null(objective.total),
        mean_percent=_compute_change(result.mean_without, objective.mean),
        worst_percent=_compute_change(result.worst_without, objective.worst),
    )


def _compute_change(before: float, after: float) -> float | None:
    return _convert_nan_to_null(100.0 * (after / before - 1.0)) if before > 0.0 else None


def _convert_nan_to_null(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
