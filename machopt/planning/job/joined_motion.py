"""Motion and points of a job with tool changes, joined from those of its stretches
(:mod:`machopt.planning.job.joined_plan`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process_columns import join_process_columns, shift_summary
from machopt.data_types.rapid_corners import join_rapid_corners
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.data_types.trajectory import Trajectory
from machopt.numerics.array_types import Array
from machopt.planning.job.joined_plan import ToolSegmentPlan, shift_break_indices
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.plan_output.point_table import PointResults, list_dwells


@dataclass(frozen=True)
class DrivenToolSegment:
    """One tool's stretch with its plan and motion."""

    segment_plan: ToolSegmentPlan
    points: PointResults
    timeline: MotionTimeline | None


def join_point_tables(parts: Sequence[DrivenToolSegment], toolpath: Toolpath) -> PointResults:
    """Return one table for the whole toolpath.

    Args:
        parts: stretches in order.
        toolpath: the whole toolpath.
    """
    tables = [p.points.table for p in parts]
    columns: dict[str, Any] = {}
    for f in fields(PointsTable):
        values_of_parts = [getattr(t, f.name) for t in tables]
        if f.name in ("operations", "external_prismatic"):
            columns[f.name] = values_of_parts[0]
        elif f.name == "process":
            columns[f.name] = join_process_columns(values_of_parts)
        elif isinstance(values_of_parts[0], tuple):
            columns[f.name] = tuple(value for one in values_of_parts for value in one)
        elif all(one is not None for one in values_of_parts):
            columns[f.name] = np.concatenate(values_of_parts)
        elif f.name in ("lead", "side") and any(one is not None for one in values_of_parts):
            columns[f.name] = np.concatenate(
                [np.zeros(len(t)) if o is None else o for o, t in zip(values_of_parts, tables, strict=True)]
            )
        elif f.name == "compensation" and any(one is not None for one in values_of_parts):
            zeros = [np.zeros((len(t), 3)) for t in tables]
            columns[f.name] = np.concatenate(
                [z if o is None else o for o, z in zip(values_of_parts, zeros, strict=True)]
            )
        else:
            columns[f.name] = None
    columns["position"], columns["axis"] = toolpath.position, toolpath.axis
    columns["dwell"] = list_dwells(toolpath)  # a dwell before a tool change belongs to the last point before it
    before = np.cumsum([0, *(len(p.segment_plan.plan.path.index) for p in parts)])
    rows = np.concatenate([p.points.rows + n for p, n in zip(parts, before, strict=False)])
    return PointResults(
        PointsTable(**columns),
        rows,
        tuple(name for p in parts for name in p.points.nearest_pair),
        tuple(shift_summary(summary, p.segment_plan.first) for p in parts for summary in p.points.process),
    )


def join_timelines(parts: Sequence[DrivenToolSegment]) -> MotionTimeline | None:
    """Return the whole motion, if every stretch has one; the machine rests for one sample at a tool change.

    Args:
        parts: stretches in order.
    """
    found = [(p, p.timeline) for p in parts if p.timeline is not None]
    if not found:
        return None
    obstructions = tuple(shift_break_indices(b, p.segment_plan) for p, one in found for b in one.obstructions)
    driven = [one.trajectory for _, one in found if one.trajectory is not None]
    whole = len(driven) == len(parts)
    if not whole and not obstructions:
        return None  # points are missing; their own messages say so
    before = np.cumsum([0, *(len(p.segment_plan.plan.path.index) for p in parts)]).tolist()
    row = dict(zip([id(p) for p in parts], before, strict=False))
    cut = np.array([float((t.move == MoveKind.CUT).sum()) for t in driven]) if whole else np.ones(1)
    held_shares = np.array([one.held_share for _, one in found]) if whole else np.ones(1)
    return MotionTimeline(
        trajectory=_concatenate_motions(parts, driven) if whole else None,
        dips=tuple(d.at(np.array([d.first, d.last]) + p.segment_plan.first) for p, one in found for d in one.dips),
        obstructions=obstructions,
        detours=tuple(
            f"with tool {p.segment_plan.tool}, points counted from {p.segment_plan.first}: {text}"
            for p, one in found
            for text in one.detours
        ),
        legs=(),
        held_share=float(cut @ held_shares / cut.sum()) if cut.sum() > 0 else 1.0,
        phi=np.concatenate([one.phi for _, one in found]),
        driven=tuple((a + row[id(p)], b + row[id(p)]) for p, one in found for a, b in one.driven),
        given_up={(a + row[id(p)], b + row[id(p)]): text for p, one in found for (a, b), text in one.given_up.items()},
    )


def _concatenate_motions(parts: Sequence[DrivenToolSegment], motions: Sequence[Trajectory]) -> Trajectory:
    """Concatenate all rows; the last of one and the first of the next are at the same place with another tool."""
    sample = float(motions[0].time[1] - motions[0].time[0])
    lengths = [len(m.time) for m in motions]
    count = sum(lengths)
    columns = {
        name: np.concatenate([getattr(m, name) for m in motions])
        for name in ("q", "external", "move", "operation", "gamma", "feed")
    }
    return replace(
        motions[0],
        time=np.arange(count, dtype=float) * sample,
        point=np.concatenate([m.point + p.segment_plan.first for m, p in zip(motions, parts, strict=True)]),
        tool=np.concatenate([np.full(len(m.time), k, np.int32) for k, m in enumerate(motions)]),
        corners=join_rapid_corners(
            [(m.corners, first) for m, first in zip(motions, np.cumsum([0, *lengths[:-1]]).tolist(), strict=True)]
        ),
        **columns,
        **_join_tilts(motions),
    )


def _join_tilts(motions: Sequence[Trajectory]) -> dict[str, Any]:
    """Return lead and side of all rows; zero on the path of a tool that does not tilt, none where no tool tilts."""
    if all(m.lead is None for m in motions):
        return {}

    def of(m: Trajectory, name: str) -> Array:
        tilt: Array | None = getattr(m, name)
        return np.where(np.isfinite(m.point) & (m.move != MoveKind.RAPID), 0.0, np.nan) if tilt is None else tilt

    return {name: np.concatenate([of(m, name) for m in motions]) for name in ("lead", "side")}
