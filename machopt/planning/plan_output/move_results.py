"""What happens between two points, told at the one where the move ends: that row of points.csv, of JSON and report.

A row stands for a move as much as for a place. So a point that is feasible by itself is given up where the way to it
is not: a collision or a gouge on the way, a jump of a joint, a stretch that the axes cannot follow. Where the way is
driven, but not at the programmed feed, the row stays as it is and says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.points_table import PointsTable
from machopt.data_types.slow_moves import SlowStretch, describe_slow_points
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.sequence_breaks import CHANGE, HOME, SequenceBreak
from machopt.planning.plan_output.infeasibility_reasons import list_breaks
from machopt.planning.plan_output.point_table import find_reason
from machopt.planning.retiming.slowdowns import FeedSlowdown
from machopt.planning.stations.planning_path import PlanningPath

ON_POINT = 1e-9  # of the fractional toolpath index
_OF_CODE = {"joint_limit": InfeasibilityReason.LIMIT} | dict.fromkeys(
    ("collision", "home_collides", "rapid_collides"), InfeasibilityReason.COLLIDING
)


def mark_undriven_points(plan: Plan, obstructions: Sequence[SequenceBreak] = ()) -> Plan:
    """A plan that is not driven, with every point marked whose way fails though it has a pose itself.

    Args:
        plan: one tool's.
        obstructions: what kept its motion from being driven.
    """
    path, a = plan.path, plan.chosen.assignment
    begin, end = (HOME if at is None else CHANGE for at in (plan.begin, plan.end))
    found: dict[int, SequenceBreak] = {}
    for b in list_breaks(plan, tuple(obstructions)):
        row = _ends_at(path, b)
        if a.reason[row] == InfeasibilityReason.OK:
            found.setdefault(row, replace(b, begin=begin, end=end))
    if not found:
        return plan
    reason, cost, notes = a.reason.copy(), plan.chosen.cost.copy(), dict(plan.notes)
    for row, b in found.items():
        reason[row], cost[row], notes[row] = _reason(plan, b), np.nan, f"{b.where}: {b.text}"
    marked = replace(plan.chosen, assignment=replace(a, reason=reason), cost=cost)
    return replace(plan, chosen=marked, notes=notes, ways=found)


def _ends_at(path: PlanningPath, b: SequenceBreak) -> int:
    """Planning row of the toolpath point where the move ends; of the one it begins at where it leads home."""
    points = np.flatnonzero(path.is_point)
    at = b.after if np.isfinite(b.after) else np.floor(b.before + ON_POINT) if np.isfinite(b.before) else 0.0
    return int(points[min(int(np.searchsorted(path.index[points], at - ON_POINT)), len(points) - 1)])


def _reason(plan: Plan, b: SequenceBreak) -> InfeasibilityReason:
    """Of a place between two points its own reason, else what the break's code says."""
    if b.code != "no_pose":
        return _OF_CODE.get(b.code, InfeasibilityReason.NO_PATH)
    index = plan.path.index
    inner = plan.missing[(index[plan.missing] > b.before) & (index[plan.missing] < b.after)]
    return find_reason(plan, int(inner[0])) if len(inner) else InfeasibilityReason.NO_PATH


def add_slowdown_notes(table: PointsTable, dips: Sequence[FeedSlowdown]) -> PointsTable:
    """The table with a sentence at every driven point on the way to which the programmed feed is not held.

    Ramps from and to rest are no fault of a plan, and are left out.

    Args:
        table: of a plan that is driven.
        dips: of its motion.
    """
    stretches = [
        SlowStretch(first=d.first, last=d.last, ratio=d.ratio, where=d.where, axis=d.joint, limit=d.limit) for d in dips
    ]
    said = list(table.reason)
    for k, words in describe_slow_points(stretches, len(table)).items():
        if table.status[k] == InfeasibilityReason.OK.word:
            said[k] = words
    return replace(table, reason=tuple(said))
