"""``--front``: stiffness, tolerances and stability against time, as a small set of complete plans.

Each plan has other weights, another clearance, other feeds or another least stability.
Each gets a complete motion and the same checks as the main plan.
Dominated plans are dropped.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from machopt.commands.optimize.report_files import write_plan_tables
from machopt.commands.optimize.request import OptimizeInputs
from machopt.planning.job.job_planner import plan_job
from machopt.planning.job.pareto_front import (
    FrontPlan,
    list_front_variants,
    list_process_variants,
    list_reentry_variants,
    mark_dominated_plans,
    measure_front_plan,
)
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.verification.folder.folder_checks import check_contents

FRONT_FILE = "front.csv"
PROCESS_COLUMNS = {
    "in_tolerance",
    "marginal",
    "fail",
    "unknown",
    "mean_error_mm",
    "worst_error_mm",
    "least_stability_ratio",
}
"""Columns without values are left out."""

FRONT_COLUMNS = (
    "plan",
    "changed",
    "mean_index",
    "worst_index",
    "cycle_time_s",
    "joint_travel_deg",
    "clearance_mm",
    "in_tolerance",
    "marginal",
    "fail",
    "unknown",
    "mean_error_mm",
    "worst_error_mm",
    "least_stability_ratio",
    "posture_changes",
    "objective",
)


def compute_trade_off_front(inputs: OptimizeInputs, requested: Plan, front_plan: FrontPlan) -> list[FrontPlan]:
    """Return the requested plan, and every further one that is feasible and passes the checks.

    Args:
        inputs: the job; where it changes tools each plan is one of all of them.
        requested: the plan requested.
        front_plan: what it comes to.
    """
    found = [front_plan]
    cell, toolpath = inputs.cell, inputs.toolpath
    for name, changed, other in (
        *list_front_variants(inputs.options),
        *list_process_variants([(s.cell, s.toolpath) for s in inputs.segments], inputs.options),
        *list_reentry_variants(requested, toolpath, inputs.options),
    ):
        job = plan_job(inputs.segments, toolpath, other, StageTimings())
        timeline = job.timeline
        if other.max_reentries > inputs.options.max_reentries and not job.plan.path.is_reentry.any():
            continue  # none pays: it is the requested plan
        if timeline is None or timeline.trajectory is None:
            continue
        with tempfile.TemporaryDirectory() as text:
            folder = Path(text)
            write_plan_tables(folder, job.plan, job.points, timeline, toolpath.engagement)
            if not check_contents(cell, toolpath, folder, options=other, manifest=None).ok:
                continue
        found.append(measure_front_plan(name, changed, job.plan, timeline, job.points, requested))
    return mark_dominated_plans(found)


def write_trade_off_front(path: Path, points: list[FrontPlan]) -> None:
    """Write ``front.csv`` with the plans that no other plan dominates.

    Args:
        path: The file to write.
        points: All plans of the front.
    """
    columns = [c for c in FRONT_COLUMNS if c not in PROCESS_COLUMNS or any(getattr(p, c) is not None for p in points)]
    lines = [",".join(columns)]
    lines += [",".join(_format_value(getattr(p, name)) for name in columns) for p in points if not p.dominated]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _format_value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    text = "" if value is None else str(value)
    return f'"{text}"' if "," in text else text
