"""Rows of the page of a plan about the operations: length, time, worst index, tools."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import PointResults
from machopt.report.page_types import optimize_page_data as page
from machopt.report.wording.result_verdict import format_count


def _find_worst(values: Array, worst_of: Callable[[Array], Any], *, partly: bool) -> float:
    """Return the worst value along an operation; NaN where values are missing, unless ``partly`` are enough."""
    known = np.isfinite(values)
    return float(worst_of(values)) if len(values) and (known.all() or (partly and known.any())) else float("nan")


def list_operations(
    plan: Plan, toolpath: Toolpath, points: PointResults, timeline: MotionTimeline | None, series: dict[str, Array]
) -> tuple[page.OperationRow, ...]:
    """Return one row for each operation.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        timeline: The motion over time; None where there is no motion.
        series: Cost at each point by the name of the plan or baseline.
    """
    counted = plan.path.counted[points.rows]
    worst_of = np.nanmax if plan.scores.index == "deflection" else np.nanmin
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)]
    t = timeline.trajectory if timeline else None
    tool = _list_tools(plan, points, toolpath)
    out = []
    for k, operation in enumerate(toolpath.operations):
        mine = toolpath.operation == k
        cut = mine & counted

        miss = points.table.clearance[mine]
        bad = int((np.array(points.table.status)[mine] != "ok").sum())
        out.append(
            page.OperationRow(
                label=operation.label,
                kind=operation.kind,
                points=int(mine.sum()),
                length=float(step[cut].sum()),
                time=float((t.operation == k).sum() * plan.options.sample) if t else float("nan"),
                worst_default=_find_worst(series["default"][cut], worst_of, partly=False),
                worst_chosen=_find_worst(series["chosen"][cut], worst_of, partly=True),
                nearest_miss=float(np.nanmin(miss)) if np.isfinite(miss).any() else float("nan"),
                feed_held=float("nan"),
                status="ok" if not bad else f"{format_count(bad, 'point')} infeasible",
                tool=tool.get(k, ""),
            )
        )
    return tuple(out)


def _list_tools(plan: Plan, points: PointResults, toolpath: Toolpath) -> dict[int, str]:
    """The tools of each operation, where the job changes them."""
    out: dict[int, dict[str, None]] = {}
    for own, mine in plan.among(points.rows) if plan.parts else ():
        for k in dict.fromkeys(toolpath.operation[mine].tolist()):
            out.setdefault(k, {})[str(own.setup.cell.tool_name)] = None
    return {k: ", ".join(names) for k, names in out.items()}
