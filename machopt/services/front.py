"""``--front``: what more stiffness costs in time, joint travel and clearance, as a handful of whole plans.

Each plan has other weights or another clearance, is driven in full and held against the cell by the same checks as the
main one. A plan that another is nowhere worse than is no trade.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from machopt.formats.tables import write_points_csv, write_trajectory_csv
from machopt.plan.job.pareto import Point, measured, variants, weighed
from machopt.plan.job.run import plan_job
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Timings
from machopt.recheck.folder import content_checks
from machopt.services.load import Loaded
from machopt.services.tell import tool_names

FILE = "front.csv"
HEAD = ("plan", "changed", "mean_index", "worst_index", "cycle_time_s", "joint_travel_deg", "clearance_mm", "objective")


def front(given: Loaded, asked: Plan, own: Point) -> list[Point]:
    """The plan that was asked for, and every further one that can be driven and passes the checks.

    Args:
        given: the job; where it changes tools each plan is one of all of them.
        asked: the plan asked for.
        own: what it comes to.
    """
    found = [own]
    cell, toolpath = given.cell, given.toolpath
    for name, changed, other in variants(given.options):
        job = plan_job(given.stints, toolpath, other, Timings())
        timeline = job.timeline
        if timeline is None or timeline.trajectory is None:
            continue
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            write_points_csv(folder / "points.csv", job.points.table)
            labels, kinds = [o.label for o in toolpath.operations], cell.external_prismatic
            table = folder / "trajectory.csv"
            write_trajectory_csv(table, timeline.trajectory, labels, kinds, tool_names(job.plan))
            if not content_checks(cell, toolpath, folder, options=other, manifest=None).ok:
                continue
        found.append(measured(name, changed, job.plan, timeline, job.points, asked))
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
