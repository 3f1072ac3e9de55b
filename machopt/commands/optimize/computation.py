"""Computation of ``machopt optimize`` in memory, before it writes its first file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from machopt.commands.optimize.request import OptimizeInputs
from machopt.commands.optimize.stock_summary import summarise_stock
from machopt.planning.job.job_planner import plan_job
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.plan_output.collision_map import compute_collision_map

if TYPE_CHECKING:
    from machopt.commands.optimize.job_result import OptimizeJobResult


@dataclass(frozen=True)
class OptimizeComputation:
    """Result of a plan in memory, not written yet."""

    inputs: OptimizeInputs
    job_result: OptimizeJobResult  # without verification, programs and front, which are made of what is written
    timings: StageTimings


def compute_optimize_plan(
    inputs: OptimizeInputs, timings: StageTimings, before: Sequence[Plan] = (), refused: str = ""
) -> OptimizeComputation:
    """Return the plan, and its motion where there is one; tool after tool where the job changes it.

    Args:
        inputs: The loaded inputs.
        timings: Collects the computing time of each stage.
        before: Earlier plans of the same segments with other steering rules, whose unchanged steps are reused.
        refused: Why the joint result of method joint is not to be driven; empty: it is tried.
    """
    job = plan_job(inputs.segments, inputs.toolpath, inputs.options, timings, before, refused)
    with timings.stage("map"):
        shown = compute_collision_map(job.plan, inputs.map_all)
    shown = replace(shown, candidates=shown.candidates.without_joints())
    from machopt.commands.optimize.job_result import OptimizeJobResult, ToolSegmentResult
    from machopt.program_export.exported_programs import (
        list_omitted_programs,
    )  # late: loaded in parallel to the plan (machopt.commands.optimize.run)

    made = OptimizeJobResult(
        cell=inputs.cell,
        toolpath=inputs.toolpath,
        options=inputs.options,
        segments=tuple(
            ToolSegmentResult(s, p.segment_plan.plan.without_grid_joints(), p.timeline)
            for s, p in zip(inputs.segments, job.parts, strict=True)
        ),
        plan=job.plan.without_grid_joints(),
        points=job.points,
        shown=shown,
        timeline=job.timeline,
        verification=None,
        programs=list_omitted_programs(inputs.posts, inputs.tolerance, "there is no motion"),
        manifest=inputs.manifest,
        stock=summarise_stock(inputs.cell, inputs.segments),
    )
    return OptimizeComputation(inputs, made, timings)
