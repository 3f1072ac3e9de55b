"""``--front``: what more stiffness costs in time, joint travel and clearance, as a handful of whole plans.

Each plan has other weights or another clearance, is driven in full and held against the cell by the same checks as the
main one. A plan that another is nowhere worse than is no trade.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.formats.tables import write_points_csv, write_trajectory_csv
from machopt.plan.external import best_plan
from machopt.plan.front import Point, measured, variants, weighed
from machopt.plan.gaps import told
from machopt.plan.made import Plan
from machopt.plan.pipeline import as_driven
from machopt.plan.points import point_results
from machopt.plan.setup import Timings
from machopt.plan.timeline import Timeline
from machopt.recheck.folder import content_checks
from machopt.services.tell import tool_names

FILE = "front.csv"
HEAD = ("plan", "changed", "mean_index", "worst_index", "cycle_time_s", "joint_travel_deg", "clearance_mm")
Motion = Callable[[Plan, Toolpath, PlanOptions, Timings], Timeline | None]


def front(cell: Cell, toolpath: Toolpath, options: PlanOptions, own: Point, drive: Motion) -> list[Point]:
    """The plan that was asked for, and every further one that can be driven and passes the checks.

    Args:
        own: what the plan asked for comes to.
        drive: from a plan to its motion.
    """
    found = [own]
    for name, changed, other in variants(options):
        quiet = Timings()
        the_plan = best_plan(cell, toolpath, other, quiet)
        timeline = drive(the_plan, toolpath, other, quiet)
        if timeline is None or timeline.trajectory is None:
            continue
        the_plan = told(as_driven(the_plan, timeline.phi), list(timeline.driven), timeline.given_up)
        points = point_results(the_plan, toolpath)
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            write_points_csv(folder / "points.csv", points.table)
            labels, kinds = [o.label for o in toolpath.operations], cell.external_prismatic
            table = folder / "trajectory.csv"
            write_trajectory_csv(table, timeline.trajectory, labels, kinds, tool_names(the_plan))
            if not content_checks(cell, toolpath, folder, options=other, manifest=None).ok:
                continue
        found.append(measured(name, changed, the_plan, timeline, points))
    return weighed(found)


def write_front(path: Path, points: list[Point]) -> None:
    """Write ``front.csv``: the plans that no other is nowhere worse than."""
    lines = [",".join(HEAD)]
    lines += [",".join(_word(getattr(p, name)) for name in HEAD) for p in points if not p.dominated]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _word(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    text = "" if value is None else str(value)
    return f'"{text}"' if "," in text else text
