"""result.json of optimize: what was asked, what came out, and the hash of everything it belongs to."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.domain.results import optimize as told
from machopt.domain.toolpath import Toolpath
from machopt.formats.options import options_as_user, without_effect
from machopt.output.hashes import sha256_of
from machopt.output.manifest import listed
from machopt.plan.certainty.uncertainty import gains
from machopt.plan.job.pareto import better_by_its_own_weights, left_out
from machopt.plan.pipeline.planned import Plan
from machopt.plan.written.explain import all_breaks, hints
from machopt.plan.written.points import PointResults
from machopt.plan.written.told import (
    break_told,
    compensation_told,
    dip_told,
    gain_told,
    infeasible_told,
    objective_told,
    position_told,
    search_told,
    tools_told,
    worst_told,
)
from machopt.services.inputs import hashes_of
from machopt.services.made import Made
from machopt.version import __version__


def result_of(made: Made, folder: Path, seconds: dict[str, float]) -> told.OptimizeResult:
    """The result as result.json has it; ``outputs`` are the files that lie in ``folder`` by now."""
    cell, toolpath, the_plan, points = made.cell, made.toolpath, made.plan, made.points
    timeline, verification = made.timeline, made.verification
    trajectory = timeline.trajectory if timeline else None
    stopped = timeline.obstructions if timeline else ()
    return told.OptimizeResult(
        machopt_result=1,
        version=__version__,
        verdict=made.verdict,
        exit_code=made.exit_code,
        production_blockers=made.production_blockers,
        unchecked=made.unchecked,
        inputs=hashes_of(made.manifest.inputs),
        outputs={name: sha256_of(folder / name) for name in sorted(listed(folder))},
        options=options_as_user(made.options),
        reading=dict(made.manifest.reading),
        cell=cell.name,
        toolpath=_toolpath(toolpath),
        index=the_plan.scores.index,
        index_scale=the_plan.scores.scale,
        chosen_from=the_plan.chosen_from,
        objective=objectives_of(the_plan),
        front=tuple(told.FrontPlan.from_fields(p) for p in made.front) or None,
        tools=tools_told(the_plan, [s.stint for s in made.stints]),
        worst_point=worst_told(the_plan, points),
        compensation=compensation_told(the_plan, toolpath) if trajectory is not None else None,
        position_error=position_told(the_plan),
        infeasible_points=tuple(infeasible_told(the_plan, points)),
        breaks=tuple(break_told(b) for b in all_breaks(the_plan, stopped)),
        cycle_time_s=float(trajectory.time[-1]) if trajectory else None,
        dwell_s=_dwelt(toolpath, points) if trajectory else None,
        feed_held_share=timeline.held_share if trajectory and timeline else None,
        feed_dips=tuple(dip_told(d) for d in (timeline.dips if timeline else ()) if d.lost),
        feed_stops=tuple(dip_told(d) for d in (timeline.dips if timeline else ()) if not d.lost),
        rapid_detours=timeline.detours if timeline else (),
        obstructions=tuple(told.Obstruction(before=o.before, after=o.after, reason=o.text) for o in stopped),
        verification=None
        if verification is None
        else told.VerificationTold(
            passed=verification.ok,
            checks=tuple(told.CheckTold.from_fields(c) for c in verification.checks),
            information=tuple(told.InformationTold.from_fields(i) for i in verification.information),
        ),
        programs=tuple(p.as_result() for p in made.programs),
        notes=tuple(cell.notes),
        warnings=(
            *cell.warnings,
            *toolpath.warnings,
            *without_effect(the_plan.options),
            *left_out(made.front, the_plan.options),
            *better_by_its_own_weights(made.front),
            *hints(the_plan),
        ),
        timings_s={name: round(value, 3) for name, value in seconds.items()},
    )


def _dwelt(toolpath: Toolpath, points: PointResults) -> float:
    """s that the file waits before its first point and at those that are driven."""
    waits, driven = toolpath.dwells, np.array([word == "ok" for word in points.table.status])
    return float(waits[0] + waits[1:][driven].sum())


def objectives_of(the_plan: Plan) -> told.Objectives:
    """What the plan comes to, and what it is compared with."""
    return told.Objectives(
        cam_default=objective_told(the_plan.cam_default),
        jiao2022=objective_told(the_plan.jiao2022),
        grid=told.ObjectiveParts.from_fields(the_plan.grid),
        search=search_told(the_plan),
        chosen=objective_told(the_plan.chosen),
        gain=tuple(gain_told(g) for g in gains(the_plan)),
    )


def _toolpath(toolpath: Toolpath) -> told.ToolpathRead:
    return told.ToolpathRead(
        source=toolpath.source,
        format=toolpath.format,
        points=len(toolpath),
        cutting_points=int(toolpath.cutting.sum()),
        operations=tuple(o.label for o in toolpath.operations),
        ignored=tuple(told.IgnoredWord.from_fields(w) for w in toolpath.ignored),
    )
