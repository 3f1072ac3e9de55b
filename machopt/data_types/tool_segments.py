"""Segments of a job with tool changes, one for each tool in use."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions, SteeringRule
from machopt.data_types.steering_rules import resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class ToolSegment:
    """Segment of a toolpath with one tool; a job with one tool has one segment.

    The machine is at ``begin`` before and at ``end`` after it: home, or the tool-change position.
    """

    cell: Cell  # with the tool that is on
    toolpath: Toolpath  # its points alone, counted from 0; its operations are those of the whole
    whole: Toolpath  # of the job
    first: int  # its first point in the whole
    begin: Array  # (6 + E,) rad or m by encoder
    end: Array  # (6 + E,)
    number: int = 0  # from 1 in the order of the job; 0 where it is the whole job

    @property
    def stop(self) -> int:
        """Point after its last one, in the whole toolpath."""
        return self.first + len(self.toolpath)

    @property
    def tool(self) -> str:
        """The name of its tool in the cell's table; empty where the cell has one tool only."""
        return self.cell.tool_name or ""

    def restrict_options(self, options: PlanOptions) -> PlanOptions:
        """Return the planning options with the steering rules of its points, counted from its first point, and with
        the weight of changes relative to its share of the length cut.

        Args:
            options: The planning options in force.

        Raises:
            InputError: a rule names a place that the toolpath does not have.
        """
        if not self.number:
            return options
        w = (
            options.weights
        )  # the job's J is the sum of the tools' by their shares, and a change counts for the whole job
        options = replace(options, weights=replace(w, reorientation=w.reorientation / self._compute_share()))
        if not (options.fixed or options.steer):
            return options
        laid = resolve_steering(options, self.whole)
        mine = (f for f in laid.fixed if self.first <= f.point < self.stop)
        fixed = tuple(replace(f, point=f.point - self.first) for f in mine)
        return replace(
            laid, fixed=fixed, steer=tuple(w for wish in laid.steer for w in self._shift_steering_rule(wish))
        )

    def _compute_share(self) -> float:
        """Its share of the length that the whole job cuts; 1 where nothing has a length."""
        own, every = (
            float(np.linalg.norm(np.diff(t.position, axis=0), axis=1) @ t.cutting[1:])
            for t in (self.toolpath, self.whole)
        )
        return own / every if own > 0 else 1.0

    def _shift_steering_rule(self, wish: SteeringRule) -> tuple[SteeringRule, ...]:
        """Return the part of a steering rule that concerns points of the segment."""
        if wish.points is None:
            return (wish,)
        first, last = max(wish.points[0], self.first), min(wish.points[1], self.stop - 1)
        return (replace(wish, points=(first - self.first, last - self.first)),) if first <= last else ()


def cut_toolpath(toolpath: Toolpath, first: int, stop: int) -> Toolpath:
    """Return some points of a toolpath as a separate toolpath.

    Events between the last point and the tool change (a spindle stop) belong to the tool before the change. So do
    events behind the toolpath's last point.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        first: First point.
        stop: Point behind the last one.
    """
    rows = slice(first, stop)
    events = [e for k, e in enumerate(toolpath.events) if first <= _find_event_point(toolpath, k) < stop]
    return replace(
        toolpath,
        position=toolpath.position[rows].copy(),
        axis=toolpath.axis[rows].copy(),
        move=toolpath.move[rows].copy(),
        feed=toolpath.feed[rows].copy(),
        operation=toolpath.operation[rows].copy(),
        reference=toolpath.reference[rows].copy(),
        tolerance=toolpath.tolerance[rows].copy(),
        line=toolpath.line[rows].copy(),
        surface_normal=None if toolpath.surface_normal is None else toolpath.surface_normal[rows].copy(),
        hole_depth=None if toolpath.hole_depth is None else toolpath.hole_depth[rows].copy(),
        process_operation=None if toolpath.process_operation is None else toolpath.process_operation[rows].copy(),
        force=None if toolpath.force is None else toolpath.force[rows].copy(),
        engagement=None if toolpath.engagement is None else toolpath.engagement.take_range(first, stop),
        events=tuple(replace(event, index=event.index - first) for event in events),
    )


def _find_event_point(toolpath: Toolpath, k: int) -> int:
    """The point whose tool event ``k`` belongs to: the one before where a tool is still to be called there."""
    at = toolpath.events[k].index
    called = any(e.kind == "tool" and e.index == at for e in toolpath.events[k + 1 :])
    return min(at, len(toolpath) - 1) - (called and at > 0)
