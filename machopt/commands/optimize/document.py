"""result.json of optimize: request, result, and the hashes of all files it belongs to."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.commands.input_hashes import map_hashes_by_name
from machopt.commands.optimize.job_result import OptimizeJobResult
from machopt.data_types.documents import optimize_document as doc
from machopt.data_types.documents.verification_entries import VerificationSection
from machopt.data_types.toolpath import Toolpath
from machopt.options.plan_option_reader import find_options_without_effect, format_user_options
from machopt.output.file_hashes import compute_sha256
from machopt.output.manifest_file import list_folder_files
from machopt.planning.job.pareto_front import describe_better_plans, describe_missing_plans
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.document_sections import (
    build_break_entry,
    build_compensation_section,
    build_gain_section,
    build_objective_section,
    build_position_error_section,
    build_search_section,
    build_slowdown_entry,
    build_tool_sections,
    build_worst_point_entry,
    list_infeasible_entries,
)
from machopt.planning.plan_output.infeasibility_reasons import list_breaks
from machopt.planning.plan_output.move_results import describe_low_feed
from machopt.planning.plan_output.plan_remarks import list_hints
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.plan_output.posture_feed_section import build_joint_section
from machopt.planning.plan_output.reentry_section import build_reentry_section
from machopt.planning.plan_output.stability_section import list_unchecked_stability
from machopt.planning.plan_output.tilt_section import build_tilt_section
from machopt.planning.plan_output.tolerance_section import build_process_section
from machopt.planning.uncertainty.stiffness_uncertainty import compute_gains
from machopt.version import __version__


def build_optimize_document(result: OptimizeJobResult, folder: Path, seconds: dict[str, float]) -> doc.OptimizeDocument:
    """Return the content of result.json; ``outputs`` are the files that lie in the folder at the time.

    Args:
        result: Result of the run.
        folder: The output folder.
        seconds: Computing time of each stage, s.
    """
    cell, toolpath, the_plan, points = result.cell, result.toolpath, result.plan, result.points
    timeline, checked = result.timeline, result.verification
    trajectory = timeline.trajectory if timeline else None
    stopped = timeline.obstructions if timeline else ()
    return doc.OptimizeDocument(
        machopt_result=1,
        version=__version__,
        verdict=result.verdict,
        exit_code=result.exit_code,
        production_blockers=result.production_blockers,
        unchecked=result.unchecked,
        inputs=map_hashes_by_name(result.manifest.inputs),
        outputs={name: compute_sha256(folder / name) for name in sorted(list_folder_files(folder))},
        options=format_user_options(result.options),
        reading=dict(result.manifest.reading),
        cell=cell.name,
        toolpath=_build_toolpath_section(toolpath),
        index=the_plan.scores.index,
        index_scale=the_plan.scores.scale,
        chosen_from=the_plan.chosen_from,
        objective=build_objectives_section(the_plan),
        front=tuple(doc.ParetoPlanEntry.from_fields(p) for p in result.front) or None,
        tools=build_tool_sections(the_plan, [s.segment for s in result.segments]),
        worst_point=build_worst_point_entry(the_plan, points),
        compensation=build_compensation_section(the_plan, toolpath) if trajectory is not None else None,
        tilt=build_tilt_section(the_plan, points),
        joint=build_joint_section(the_plan),
        reentry=build_reentry_section(the_plan),
        position_error=build_position_error_section(the_plan),
        process=build_process_section(cell.process, points, result.stock, the_plan),
        infeasible_points=tuple(list_infeasible_entries(the_plan, points)),
        breaks=tuple(build_break_entry(b) for b in list_breaks(the_plan, stopped)),
        cycle_time_s=float(trajectory.time[-1]) if trajectory else None,
        dwell_s=_compute_dwell_time(toolpath, points) if trajectory else None,
        feed_held_share=timeline.held_share if trajectory and timeline else None,
        feed_dips=tuple(build_slowdown_entry(d) for d in (timeline.dips if timeline else ()) if d.lost),
        feed_stops=tuple(build_slowdown_entry(d) for d in (timeline.dips if timeline else ()) if not d.lost),
        rapid_detours=timeline.detours if timeline else (),
        obstructions=tuple(doc.ObstructedRapidEntry(before=o.before, after=o.after, reason=o.text) for o in stopped),
        verification=None
        if checked is None
        else VerificationSection.from_results(checked.ok, checked.checks, checked.information),
        programs=tuple(p.to_document() for p in result.programs),
        notes=tuple(cell.notes),
        warnings=_list_warnings(result),
        timings_s={name: round(value, 3) for name, value in seconds.items()},
    )


def _list_warnings(result: OptimizeJobResult) -> tuple[str, ...]:
    timeline, jobs = result.timeline, [(s.segment.cell, s.segment.toolpath) for s in result.segments]
    return (
        *result.cell.warnings,
        *result.toolpath.warnings,
        *find_options_without_effect(result.plan.options),
        *describe_missing_plans(result.front, result.plan.options, jobs),
        *describe_better_plans(result.front),
        *describe_low_feed(timeline.dips if timeline and timeline.trajectory else ()),
        *list_unchecked_stability(
            result.points.table.process, result.plan.options.min_stability_ratio, result.points.table.status
        ),
        *list_hints(result.plan),
    )


def _compute_dwell_time(toolpath: Toolpath, points: PointResults) -> float:
    """s that the file waits before its first point and at those that are driven."""
    waits, driven = toolpath.dwells, np.array([word == "ok" for word in points.table.status])
    return float(waits[0] + waits[1:][driven].sum())


def build_objectives_section(the_plan: Plan) -> doc.ObjectivesSection:
    """Return the objective values of the plan and of its baselines.

    Args:
        the_plan: The plan.
    """
    return doc.ObjectivesSection(
        cam_default=build_objective_section(the_plan.cam_default),
        jiao2022=build_objective_section(the_plan.jiao2022),
        grid=doc.ObjectivePartsSection.from_fields(the_plan.grid),
        search=build_search_section(the_plan),
        chosen=build_objective_section(the_plan.chosen),
        gain=tuple(build_gain_section(g) for g in compute_gains(the_plan)),
    )


def _build_toolpath_section(toolpath: Toolpath) -> doc.ToolpathSection:
    return doc.ToolpathSection(
        source=toolpath.source,
        format=toolpath.format,
        points=len(toolpath),
        cutting_points=int(toolpath.cutting.sum()),
        operations=tuple(o.label for o in toolpath.operations),
        ignored=tuple(doc.IgnoredWordEntry.from_fields(w) for w in toolpath.ignored),
    )
