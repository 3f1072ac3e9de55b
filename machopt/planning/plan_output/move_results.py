"""Results of moves between points, reported at the end point of the move: in points.csv, result.json and the report.

A row represents a move as well as a place. A point that is feasible by itself is therefore marked infeasible where the
move to it is not: a collision or a gouge on the way, a joint jump, a stretch that the axes cannot follow. Where the
move is driven, but not at the programmed feed, the row remains and has a note.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.slow_moves import SlowStretch, describe_slow_points
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import CHANGE, HOME, SequenceBreak
from machopt.planning.plan_output.infeasibility_reasons import list_breaks
from machopt.planning.plan_output.point_table import find_reason
from machopt.planning.retiming.slowdowns import FeedSlowdown
from machopt.planning.stations.planning_path import PlanningPath

ON_POINT = 1e-9  # of the fractional toolpath index
WARNED = 0.8  # share of the programmed feed, as requested by users
_OF_CODE = {"joint_limit": InfeasibilityReason.LIMIT} | dict.fromkeys(
    ("collision", "home_collides", "rapid_collides"), InfeasibilityReason.COLLIDING
)


def mark_undriven_points(plan: Plan, obstructions: Sequence[SequenceBreak] = ()) -> Plan:
    """Return an undriven plan with every feasible point marked whose move fails.

    Args:
        plan: plan of one tool.
        obstructions: causes why its motion is not driven.
    """
    path, a = plan.path, plan.chosen.assignment
    begin, end = (HOME if at is None else CHANGE for at in (plan.begin, plan.end))
    found: dict[int, SequenceBreak] = {}
    for b in list_breaks(plan, tuple(obstructions)):
        row = _find_end_row(path, b)
        if a.reason[row] == InfeasibilityReason.OK:
            found.setdefault(row, replace(b, begin=begin, end=end))
    if not found:
        return plan
    reason, cost, notes = a.reason.copy(), plan.chosen.cost.copy(), dict(plan.notes)
    for row, b in found.items():
        reason[row], cost[row], notes[row] = _find_place_reason(plan, b), np.nan, f"{b.where}: {b.text}"
    marked = replace(plan.chosen, assignment=replace(a, reason=reason), cost=cost)
    return replace(plan, chosen=marked, notes=notes, ways=found)


def _find_end_row(path: PlanningPath, b: SequenceBreak) -> int:
    """Return the planning row of the toolpath point at the end of the move; of its start point where it leads home."""
    points = np.flatnonzero(path.is_point)
    at = b.after if np.isfinite(b.after) else np.floor(b.before + ON_POINT) if np.isfinite(b.before) else 0.0
    return int(points[min(int(np.searchsorted(path.index[points], at - ON_POINT)), len(points) - 1)])


def _find_place_reason(plan: Plan, b: SequenceBreak) -> InfeasibilityReason:
    """Return the own reason of a place between two points, else the reason of the break's code."""
    if b.code != "no_pose":
        return _OF_CODE.get(b.code, InfeasibilityReason.NO_PATH)
    index = plan.path.index
    inner = plan.missing[(index[plan.missing] > b.before) & (index[plan.missing] < b.after)]
    return find_reason(plan, int(inner[0])) if len(inner) else InfeasibilityReason.NO_PATH


def describe_low_feed(dips: Sequence[FeedSlowdown]) -> tuple[str, ...]:
    """Return one warning where the axes hold less than WARNED of the programmed feed; none where they hold it.

    Args:
        dips: slowdowns of a motion.
    """
    low = sorted((d for d in dips if d.lost and d.ratio < WARNED), key=lambda d: d.ratio)
    if not low:
        return ()
    worst = low[0]
    return (
        f"The feed falls below {100 * WARNED:.0f} % of the programmed one at {len(low)} "
        f"place{'' if len(low) == 1 else 's'}, lowest at point {worst.first:.0f} with {100 * worst.ratio:.1f} % "
        f"(limit: {worst.limit} of axis {worst.joint}). A lower programmed feed, rounder corners or a larger "
        "singularity margin would help.",
    )


def add_slowdown_notes(table: PointsTable, dips: Sequence[FeedSlowdown]) -> PointsTable:
    """Return the table with a note at every driven point whose move is slower than the programmed feed.

    Ramps from and to rest are normal and left out.

    Args:
        table: of a plan that is driven.
        dips: slowdowns of its motion.
    """
    stretches = [
        SlowStretch(first=d.first, last=d.last, ratio=d.ratio, where=d.where, axis=d.joint, limit=d.limit) for d in dips
    ]
    reasons = list(table.reason)
    for k, words in describe_slow_points(stretches, len(table)).items():
        if table.status[k] == InfeasibilityReason.OK.word:
            reasons[k] = words
    return replace(table, reason=tuple(reasons))
