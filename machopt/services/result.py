"""result.json of optimize: what was asked, what came out, and the hash of everything it belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import machopt
from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestProgram, with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.results import optimize as told
from machopt.domain.toolpath import Toolpath
from machopt.formats.options import options_as_user, without_effect
from machopt.output.hashes import sha256_of
from machopt.output.manifest import listed
from machopt.plan.breaks import Break
from machopt.plan.certificate import certificate
from machopt.plan.compensate import residual
from machopt.plan.explain import all_breaks, help_of, hints
from machopt.plan.pipeline import Plan, Scored
from machopt.plan.retime import Dip
from machopt.plan.timeline import Timeline
from machopt.plan.uncertainty import Gain, gains
from machopt.postprocess.written import Written, read_back
from machopt.recheck.scope import done, not_run
from machopt.services.front import Point, left_out
from machopt.services.inputs import hashes_of
from machopt.services.points import PointResults, reason_of
from machopt.verify import Verification


@dataclass(frozen=True, kw_only=True)
class Made:
    """Everything one run came to, before it is told."""

    cell: Cell
    toolpath: Toolpath
    options: PlanOptions
    plan: Plan
    points: PointResults
    timeline: Timeline | None
    verification: Verification | None
    programs: tuple[Written, ...]
    front: tuple[Point, ...] = ()  # the trade-off, where it was asked for
    manifest: Manifest  # without files; names inputs, reading options and what is not checked

    @property
    def exit_code(self) -> int:
        """0 done, 3 no feasible answer, 4 verification failed."""
        if self.timeline is None or self.timeline.trajectory is None:
            return 3
        held = self.verification is None or self.verification.ok
        return 0 if held and all(p.ok for p in self.programs) else 4

    @property
    def verdict(self) -> str:
        """The verdict with what it does not cover."""
        word = {3: "infeasible", 4: "verification failed"}.get(self.exit_code)
        word = word or self._gaps
        return with_scope(word, self.unchecked)

    @property
    def unchecked(self) -> tuple[str, ...]:
        """What the verdict does not cover."""
        return (*self.manifest.unchecked, *(not_run(self.verification.checks) if self.verification else ()))

    @property
    def _gaps(self) -> str:
        """How much of the toolpath is done."""
        path, missing = self.plan.path, self.plan.missing
        points = missing[path.is_point[missing]]
        cut = int(path.counted[points].sum())
        return done(cut, len(points) - cut)

    def with_programs(self, programs: tuple[Written, ...]) -> Made:
        """The same with these programs, in the manifest too; one that is withheld has no files."""
        named = tuple(ManifestProgram(p.label, p.files) for p in programs if p.files)
        said = tuple(f"{p.files[0]}: {text}" for p in programs if p.files for text in (*p.unstarted, *p.assumed))
        return replace(self, programs=programs, manifest=replace(self.manifest, programs=named, warnings=said))

    def verified(self, found: Verification) -> Made:
        """The same with what the verification found, of each program too."""
        return replace(self, verification=found, programs=read_back(self.programs, found))


def result_of(made: Made, folder: Path, seconds: dict[str, float]) -> told.OptimizeResult:
    """The result as result.json has it; ``outputs`` are the files that lie in ``folder`` by now."""
    cell, toolpath, the_plan, points = made.cell, made.toolpath, made.plan, made.points
    timeline, verification = made.timeline, made.verification
    trajectory = timeline.trajectory if timeline else None
    stopped = timeline.obstructions if timeline else ()
    return told.OptimizeResult(
        machopt_result=1,
        version=machopt.__version__,
        verdict=made.verdict,
        exit_code=made.exit_code,
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
        objective=told.Objectives(
            cam_default=_objective(the_plan.cam_default),
            jiao2022=_objective(the_plan.jiao2022),
            grid=told.ObjectiveParts.from_fields(the_plan.grid),
            search=_search(the_plan),
            chosen=_objective(the_plan.chosen),
            gain=tuple(_gain(g) for g in gains(the_plan)),
        ),
        front=tuple(told.FrontPlan.from_fields(p) for p in made.front) or None,
        worst_point=_worst(the_plan, points),
        compensation=_compensation(the_plan) if trajectory is not None else None,
        infeasible_points=tuple(_infeasible(the_plan, points)),
        breaks=tuple(_break(b) for b in all_breaks(the_plan, stopped)),
        cycle_time_s=float(trajectory.time[-1]) if trajectory else None,
        feed_held_share=timeline.held_share if trajectory and timeline else None,
        feed_dips=tuple(_dip(d) for d in (timeline.dips if timeline else ())),
        rapid_detours=timeline.detours if timeline else (),
        obstructions=tuple(told.Obstruction(before=o.before, after=o.after, reason=o.text) for o in stopped),
        verification=None
        if verification is None
        else told.VerificationTold(
            passed=verification.ok, checks=tuple(told.CheckTold.from_fields(c) for c in verification.checks)
        ),
        programs=tuple(p.as_result() for p in made.programs),
        notes=tuple(cell.notes),
        warnings=(
            *cell.warnings,
            *toolpath.warnings,
            *without_effect(the_plan.options),
            *left_out(made.front, the_plan.options),
            *hints(the_plan),
        ),
        timings_s={name: round(value, 3) for name, value in seconds.items()},
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


def _infeasible(the_plan: Plan, points: PointResults) -> Iterator[told.InfeasiblePoint]:
    for p in the_plan.missing:
        if the_plan.path.is_point[p]:
            row = round(the_plan.path.index[p])
            yield told.InfeasiblePoint(
                point=row,
                status=reason_of(the_plan, p).word,
                reason=points.table.reason[row],
                help=help_of(the_plan, p),
            )


def _break(b: Break) -> told.BreakTold:
    """Two places that no motion joins; the model writes what is not finite as null."""
    return told.BreakTold(
        from_point=b.before,
        to_point=b.after,
        code=b.code,
        reason=b.text,
        help=b.help,
        joint=b.joint or None,
        value_deg=b.value,
        limit_deg=b.limit,
        pair=b.pair or None,
    )


def _dip(d: Dip) -> told.FeedDip:
    return told.FeedDip(
        first_point=d.first, last_point=d.last, lowest_ratio=d.ratio, where=d.where, axis=d.joint, limit=d.limit
    )


def _objective(scored: Scored) -> told.ChoiceObjective:
    feasible = int((scored.assignment.reason == 0).sum())
    return told.ChoiceObjective(**vars(scored.objective), feasible_share=feasible / len(scored.assignment.reason))


def _search(the_plan: Plan) -> told.SearchBound | None:
    """How good the plan is at least, against the grid; null where it has breaks or gaps to go round."""
    found = certificate(the_plan)
    if found is None:
        return None
    return told.SearchBound(
        sequence=found.sequence,
        lower_bound=found.bound,
        gap_percent=100.0 * found.gap,
        beyond_grid_percent=100.0 * found.beyond,
    )


def _gain(gain: Gain) -> told.MeanGain:
    """How much less the mean cost is: of deflection, or of compliance where no force is given; null where unknown."""
    low, high = gain.interval
    return told.MeanGain(
        over=gain.over,
        mean_percent=100.0 * gain.mean,
        std_percent=100.0 * gain.std,
        ci90=(100.0 * low, 100.0 * high) if np.isfinite(gain.std) else None,
        distinguishable=gain.distinguishable if np.isfinite(gain.mean) else None,
    )


def _compensation(the_plan: Plan) -> told.CompensationTold | None:
    found = residual(the_plan)
    if found is None:
        return None
    length = the_plan.compensation.length if the_plan.compensation else float("nan")
    return told.CompensationTold(
        length_mm=1e3 * length,
        max_mm=1e3 * found.shift_worst,
        mean_mm=1e3 * found.shift_mean,
        uncompensated_mean_mm=1e3 * found.uncompensated,
        residual_max_mm=1e3 * found.worst,
        residual_mean_mm=1e3 * found.mean,
    )


def _worst(the_plan: Plan, points: PointResults) -> told.WorstPoint | None:
    cost = np.where(the_plan.path.counted, the_plan.chosen.cost, np.nan)[points.rows]
    if not np.isfinite(cost).any():
        return None
    i = int(np.nanargmax(cost))
    t = points.table
    return told.WorstPoint(
        point=i,
        k_axial_N_mm=t.k_axial[i] / 1e3,
        k_normal_N_mm=t.k_normal[i] / 1e3,
        deflection_mm=t.deflection[i] * 1e3,
        gamma_deg=float(np.degrees(t.gamma[i])),
        k_jiao_x_N_mm=t.k_jiao_x[i] / 1e3,
        q_deg=np.degrees(t.q[i]).round(4),
    )
