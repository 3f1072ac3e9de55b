"""Driven parts of an incomplete plan (``allow_gaps``): stretches of a run, and the cuts that are left out.

A cut to a point is driven when the whole move from the previous point is driven. A point that cannot be reached
therefore costs two cuts, the one to it and the one from it, and a break costs the cut it lies on. The next stretch
starts at the point behind such a gap, and the cut to it is left out too (``Reason.GAP``). A stretch without any whole
cut is not driven.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Bools
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.stations.planning_path import PlanningPath

Stretch = tuple[int, int]  # first and last planning point


def find_driven_stretches(
    path: PlanningPath, reason: NDArray[np.uint8], breaks: tuple[SequenceBreak, ...]
) -> list[Stretch]:
    """Return the runs, divided at points without a configuration and at breaks.

    At such gaps a stretch ends at the last toolpath point before it, not between two points. Single rapid points
    without a
    configuration are skipped.

    Args:
        path: planning points.
        reason: (P,) infeasibility reason of each.
        breaks: breaks of the sequence.
    """
    ok = reason == InfeasibilityReason.OK
    begins = np.zeros(len(ok), bool)
    begins[[int(np.searchsorted(path.index, b.after - 1e-9)) for b in breaks if np.isfinite(b.after)]] = True
    out = []
    for first, last in path.runs:
        rows = first + np.flatnonzero(ok[first : last + 1])
        for part in np.split(rows, np.flatnonzero((np.diff(rows) != 1) | begins[rows[1:]]) + 1):
            begin = part if len(part) and part[0] == first else part[np.cumsum(path.is_point[part]) > 0]
            keep = np.flatnonzero(path.is_point[begin])
            whole = begin if len(begin) and begin[-1] == last else begin[: keep[-1] + 1 if len(keep) else 0]
            if len(whole) and is_worth_driving(path, int(whole[0]), int(whole[-1])):
                out.append((int(whole[0]), int(whole[-1])))
    return out


def is_worth_driving(path: PlanningPath, first: int, last: int) -> bool:
    """Return whether a stretch is a whole run, or contains a whole cut.

    Args:
        path: planning points.
        first: first planning point of the stretch.
        last: last planning point of the stretch.
    """
    if (first, last) in path.runs:
        return True
    return bool((path.move[first + 1 : last + 1][path.is_point[first + 1 : last + 1]] == MoveKind.CUT).any())


def find_uncut_points(path: PlanningPath, driven: list[Stretch]) -> Bools:
    """Return (P,) toolpath points whose cut is not driven.

    Args:
        path: planning points.
        driven: driven stretches.
    """
    is_driven = np.zeros(len(path.index), bool)
    for first, last in driven:
        is_driven[first + 1 : last + 1] = True
        is_driven[first] |= (first, last) in path.runs or any(first == a for a, _ in path.runs)
    return np.asarray(path.is_point & (path.move == MoveKind.CUT) & ~is_driven)


def mark_gaps(plan: Plan, driven: list[Stretch], given_up: Mapping[Stretch, str]) -> Plan:
    """Return the plan with every omitted cut marked, each with a message.

    Args:
        plan: plan of one tool.
        driven: driven stretches.
        given_up: message for each stretch that the motion left out.
    """
    path, a = plan.path, plan.chosen.assignment
    uncut = np.flatnonzero(find_uncut_points(path, driven) & (a.reason == InfeasibilityReason.OK))
    if not len(uncut):
        return plan
    reason, notes = a.reason.copy(), dict(plan.notes)
    for p in uncut.tolist():
        why = next((text for (first, last), text in given_up.items() if first <= p <= last), "")
        notes[p] = why or _describe_gap_behind(plan, p)
    reason[uncut] = InfeasibilityReason.GAP
    cost = plan.chosen.cost.copy()
    cost[uncut] = np.nan
    marked = replace(plan.chosen, assignment=replace(a, reason=reason), cost=cost)
    return replace(plan, chosen=marked, notes=notes)


def _describe_gap_behind(plan: Plan, p: int) -> str:
    """Return a description of the gap for which a cut is left out."""
    path, reason = plan.path, plan.chosen.assignment.reason
    before = p - 1
    while before > 0 and not path.is_point[before]:
        before -= 1
    for b in plan.breaks:
        if path.index[before] - 1e-9 <= b.before and b.after <= path.index[p] + 1e-9:
            return f"the cut to it is left out: {b.text}; the tool is lifted there"
    missing = [k for k in range(before, p) if reason[k] not in (InfeasibilityReason.OK, InfeasibilityReason.GAP)]
    if missing:
        near = int(np.ceil(path.index[missing[-1]] - 1e-9))
        what = f"point {near}" if near < path.index[p] else f"a place on the way from point {path.index[before]:g}"
        return (
            f"the cut to it is left out: {what} cannot be reached; the tool is lifted and comes down again "
            "behind the gap"
        )
    return "the cut to it is left out: it lies alone between two gaps"
