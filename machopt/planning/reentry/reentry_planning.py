"""Plan with at most a given number of re-entries in closed contours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.reentry_result import ReentryResult
from machopt.data_types.toolpath import Toolpath
from machopt.planning.motion.trajectory_builder import has_motion
from machopt.planning.pipeline.path_planner import PathVariant, plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.reentry.closed_contours import find_reentry_points
from machopt.planning.stations.planning_path import SAME_INDEX

COARSE = 6  # places over all contours that are planned first
HALVINGS = 2  # of their distance: one place more to either side of the best one each time
APART = 0.05  # share of the points of all contours between two lifts: nearer ones are one place to the user
POSTURE = np.radians(2.0)  # rad, of the joint that differs most across a lift
LEAST_GAIN = 0.01  # share of J that a re-entry has to save: below, no user would accept a mark for it


@dataclass(frozen=True)
class _Candidate:
    plan: Plan
    toolpath: Toolpath


def plan_with_reentries(plan: Plan, toolpath: Toolpath) -> Plan:
    """Return the plan with the re-entries that pay, at most ``options.max_reentries``, and what was found.

    External joints stay where the plan without re-entries has them.

    Args:
        plan: plan of one tool without re-entries.
        toolpath: its toolpath.
    """
    if plan.found is None or plan.breaks or len(plan.missing):
        return _conclude(plan, plan, "the plan without re-entry is not complete")
    points = np.unique(find_reentry_points(plan.path, toolpath))
    if not len(points):
        return _conclude(plan, plan, "no cut is a closed contour or winds around")
    best, reason = _Candidate(plan, toolpath), ""
    while len(best.toolpath.reentries) < plan.options.max_reentries:
        better = _add_best_place(best, points, partial(_replan, plan))
        if better is None:
            reason = f"no other place lowers J by {100 * LEAST_GAIN:g} %"
            break
        best = better
    return _conclude(best.plan, plan, reason)


def _replan(plan: Plan, toolpath: Toolpath) -> Plan:
    """Plan a toolpath with re-entries, with the external joints of the plan without."""
    index, external = plan.path.index, plan.path.external
    after = np.searchsorted(index, np.array(toolpath.reentries, float) + SAME_INDEX)
    return plan_path(
        plan.setup.cell,
        toolpath,
        plan.options,
        setup=plan.setup,
        variant=PathVariant(
            external=np.insert(external, after, external[after - 1], axis=0) if external.shape[1] else None
        ),
        scale=plan.scores.scale,
    )


def _add_best_place(
    best: _Candidate, points: NDArray[np.int64], replan: Callable[[Toolpath], Plan]
) -> _Candidate | None:
    """One re-entry more, at the best of the places planned; None where none of them pays.

    Args:
        best: with the re-entries so far.
        points: toolpath points at which the tool may be lifted, ascending.
        replan: plans the same tool on a toolpath with re-entries.
    """
    taken = best.toolpath.reentries
    if taken:
        apart = np.abs(points[:, None] - np.array(taken)).min(axis=1)
        points = points[apart > APART * len(points)]
    if not len(points):
        return None
    found: dict[int, _Candidate | None] = {}

    def measure(nth: int) -> float:
        if nth not in found:
            toolpath = replace(best.toolpath, reentries=tuple(sorted({*taken, int(points[nth])})))
            plan = replan(toolpath)
            is_sound = not plan.breaks and not len(plan.missing) and _changes_posture(plan)
            found[nth] = _Candidate(plan, toolpath) if is_sound else None
        candidate = found[nth]
        return np.inf if candidate is None else candidate.plan.chosen.objective.total

    step = len(points) / COARSE
    tried = {int((n + 0.5) * step) for n in range(COARSE)} if step >= 1.0 else set(range(len(points)))
    nearest = min(tried, key=measure)
    for _ in range(HALVINGS):
        step /= 2.0
        around = {max(round(nearest - step), 0), nearest, min(round(nearest + step), len(points) - 1)}
        nearest = min(sorted(around), key=measure)
    limit = (1.0 - LEAST_GAIN) * best.plan.chosen.objective.total
    for candidate in sorted((c for c in found.values() if c is not None), key=_get_objective):
        if _get_objective(candidate) > limit:
            break
        if has_motion(candidate.plan, candidate.toolpath):  # else there is no room above the cut, or no way around
            return candidate
    return None


def _get_objective(candidate: _Candidate) -> float:
    return float(candidate.plan.chosen.objective.total)


def _changes_posture(plan: Plan) -> bool:
    """Whether the arm enters in another posture at every re-entry: only then a lift is needed."""
    again, q = np.flatnonzero(plan.path.is_reentry), plan.chosen.assignment.q
    return bool((np.abs(q[again] - q[again - 1]).max(axis=1, initial=0.0) > POSTURE).all())


def _conclude(plan: Plan, without: Plan, reason: str) -> Plan:
    before = without.chosen.objective
    result = ReentryResult(
        reason=reason,
        objective_without=float(before.total),
        mean_without=float(before.mean),
        worst_without=float(before.worst),
    )
    return replace(plan, reentry=result)
