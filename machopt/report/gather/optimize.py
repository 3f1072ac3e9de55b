"""The report's data from the plan, the motion and the verification."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.reason import Reason
from machopt.domain.results.optimize import WorstPoint
from machopt.domain.toolpath import Move, Toolpath
from machopt.formats.options import without_effect
from machopt.plan.certainty.certificate import certificate, with_external
from machopt.plan.certainty.uncertainty import gains
from machopt.plan.compensation.compensate import residual
from machopt.plan.compensation.removal import removals
from machopt.plan.feed.slowdowns import Dip
from machopt.plan.job.pareto import Point
from machopt.plan.motion.timeline import Timeline
from machopt.plan.pipeline.planned import Plan
from machopt.plan.pipeline.setup import Scored
from machopt.plan.written.contact_map import Mapped, mapped
from machopt.plan.written.explain import all_breaks, help_of, hints, misfit_words, shortfall_of
from machopt.plan.written.points import PointResults, reason_of
from machopt.plan.written.told import worst_told
from machopt.report import data as page
from machopt.report import verdict as told
from machopt.report.gather.optimize_map import rotation_map
from machopt.report.gather.optimize_scene import view_of
from machopt.report.gather.optimize_series import along, cut_length, motion_series, path_series
from machopt.report.gather.optimize_worst import worst_points
from machopt.verify import Verification
from machopt.verify.check import Check
from machopt.verify.limits import axis_name
from machopt.version import __version__

ROUNDING = 1e-3  # of what a check allows: 5.7e−14 s tells a reader nothing
_YARDSTICKS = {"cam default": "the CAM's default rotation", "jiao2022": "Jiao 2022"}
_WORDS = {
    Reason.UNREACHABLE: "unreachable",
    Reason.LIMIT: "joint limit",
    Reason.SINGULAR_WRIST: "wrist singularity",
    Reason.SINGULAR_ELBOW: "elbow singularity",
    Reason.SINGULAR_SHOULDER: "shoulder singularity",
    Reason.COLLIDING: "collision",
    Reason.BOUNDS: "outside the rotation range",
    Reason.NO_PATH: "no continuous way",
    Reason.GAP: "left out at a gap",
    Reason.SHIFT: "shift refused",
    Reason.GOUGING: "gouges the finished part",
}


def report_data(
    plan: Plan,
    toolpath: Toolpath,
    points: PointResults,
    timeline: Timeline | None,
    verification: Verification | None,
    programs: Sequence[page.Program] = (),
    *,
    front: Sequence[Point] = (),
    shown: Mapped | None = None,
    before: Plan | None = None,
    unchecked: tuple[str, ...] = (),
    blockers: tuple[str, ...] = (),
    hashes: dict[str, str],
    options: dict[str, object],
    timings: dict[str, float],
) -> page.ReportData:
    """Collect everything the page shows; parts that were not reached stay empty.

    Args:
        blockers: what has to be settled before production.
        before: a plan to compare with, on the map.
    """
    index = plan.scores.index
    quantity: page.Quantity = index if index in ("deflection", "stiffness") else "index"
    series = {name: _shown(plan, s) for name, s in _assignments(plan)}
    s = cut_length(toolpath, plan.path.counted[points.rows])
    shift = _shift(plan, toolpath)
    summary = _summary(plan, points, timeline, verification, quantity, float(s[-1]), shift)
    summary = replace(summary, unchecked=unchecked, blockers=blockers)
    models = [p.setup.collision for p in ([part.plan for part in plan.parts] or [plan]) if p.setup.collision]
    shown = shown or mapped(plan)
    return page.ReportData(
        title=f"{plan.setup.cell.name}: {toolpath.source}",
        cell=plan.setup.cell.name,
        toolpath=toolpath.source,
        version=__version__,
        summary=summary,
        hashes=tuple(hashes.items()),
        options=tuple((k, str(v)) for k, v in options.items()),
        map=rotation_map(plan, shown, s, before),
        view=view_of(plan, toolpath, points, timeline, shown, series["chosen"]),
        path=path_series(plan, toolpath, points, series),
        motion=motion_series(plan, toolpath, points, timeline),
        dips=_dips(plan, timeline, s),
        feed_stops=_feed_stops(timeline),
        worst=worst_points(plan, toolpath, points, series),
        infeasible=_infeasible(plan, toolpath, points),
        operations=_operations(plan, toolpath, points, timeline, series),
        ignored=toolpath.ignored,
        notes=tuple(plan.setup.cell.notes),
        warnings=(
            *plan.setup.cell.warnings,
            *toolpath.warnings,
            *without_effect(plan.options),
            *hints(plan),
            *((f"rapid move {d}" for d in timeline.detours) if timeline else ()),
        ),
        breaks=tuple(
            page.Break(*b.ends, b.text, b.help) for b in all_breaks(plan, timeline.obstructions if timeline else ())
        ),
        excluded_pairs=_once(page.ExcludedPair(e.a, e.b, e.reason) for model in models for e in model.excluded),
        adjacent_pairs=_once(page.ExcludedPair(e.a, e.b, e.reason) for model in models for e in model.adjacent),
        checks=_checks(verification),
        information=tuple(
            page.Information(i.name, f"{i.value:.4g} {i.unit}", i.where)
            for i in (verification.information if verification else ())
        ),
        programs=tuple(programs),
        front=tuple(_front_point(p) for p in front),
        timings=tuple(timings.items()),
        events=toolpath.events,
    )


def _infeasible(plan: Plan, toolpath: Toolpath, points: PointResults) -> tuple[page.InfeasiblePoint, ...]:
    """Points of the file that have no answer, each with what would help."""
    return tuple(
        page.InfeasiblePoint(
            point=round(plan.path.index[p]),
            operation=_label(toolpath, plan, p),
            position=plan.path.position[p],
            status=_WORDS.get(reason_of(plan, int(p)), reason_of(plan, int(p)).word),
            reason=points.table.reason[int(plan.path.index[p])],
            shortfall=_length(shortfall_of(plan, int(p))),
            help=help_of(plan, int(p)),
        )
        for p in plan.missing
        if plan.path.is_point[p]
    )


def _checks(verification: Verification | None) -> tuple[page.Check, ...]:
    return tuple(
        page.Check(c.name, c.passed, found(c), measured(c.limit, c), c.where)
        for c in (verification.checks if verification else ())
    )


def _front_point(p: Point) -> page.FrontPoint:
    return page.FrontPoint(
        name=p.plan,
        changed=p.changed,
        mean=p.mean_index,
        worst=p.worst_index,
        cycle=p.cycle_time_s,
        travel=p.joint_travel_deg,
        clearance=p.clearance_mm,
        dominated=p.dominated,
    )


def _once(pairs: Iterable[page.ExcludedPair]) -> tuple[page.ExcludedPair, ...]:
    """Each pair once: of the tools of a job most have the same."""
    return tuple(dict.fromkeys(pairs))


def _assignments(plan: Plan) -> tuple[tuple[str, Scored], ...]:
    return ("default", plan.cam_default), ("jiao2022", plan.jiao2022), ("chosen", plan.chosen)


def _shown(plan: Plan, scored: Scored) -> Array:
    """(N,) cost at toolpath points as deflection in m or stiffness in N/m; NaN where it cannot be driven."""
    at = np.where(scored.assignment.reason == Reason.OK, scored.cost, np.nan)[plan.path.is_point]
    return at if plan.scores.index == "deflection" else 1.0 / at


def _summary(
    plan: Plan,
    points: PointResults,
    timeline: Timeline | None,
    verification: Verification | None,
    quantity: page.Quantity,
    length: float,
    shift: page.Shift | None,
) -> page.Summary:
    figures = {name: _figures(plan, scored) for name, scored in _assignments(plan)}
    clearance = points.table.clearance
    nearest = int(np.nanargmin(clearance)) if np.isfinite(clearance).any() else -1
    if nearest >= 0 and not points.nearest_pair[nearest]:
        nearest = -1  # what is told there is how far was looked, and nobody stands within it
    trajectory = timeline.trajectory if timeline else None
    feasible = trajectory is not None
    outcome = (
        "infeasible" if not feasible else ("done" if verification is None or verification.ok else "verification_failed")
    )
    return page.Summary(
        outcome=outcome,  # type: ignore[arg-type]
        verification="not run" if verification is None else ("passed" if verification.ok else "failed"),
        quantity=quantity,
        worst_default=figures["default"][0],
        worst_jiao2022=figures["jiao2022"][0],
        worst_chosen=figures["chosen"][0],
        mean_default=figures["default"][1],
        mean_chosen=figures["chosen"][1],
        feed_held=timeline.held_share if timeline and feasible else float("nan"),
        cycle_time=float(trajectory.time[-1]) if trajectory else float("nan"),
        cutting_time=float((trajectory.move == Move.CUT).sum() * plan.options.sample) if trajectory else float("nan"),
        path_length=length,
        points=len(points.rows),
        infeasible_points=int(plan.path.is_point[plan.missing].sum()),
        nearest_miss=float(clearance[nearest]) if nearest >= 0 else float("nan"),
        nearest_pair=points.nearest_pair[nearest] if nearest >= 0 else "",
        nearest_point=nearest,
        worst_parts=deflection_words(worst_told(plan, points)),
        gains=tuple(
            page.Gain(_YARDSTICKS[g.over], g.mean, g.std, g.interval, g.distinguishable)
            for g in gains(plan)
            if g.over != plan.chosen_from
        ),
        shift=shift if feasible else None,
        certificate=_certificate(plan),
        misfit=misfit_words(plan),
        note="" if feasible else plan.conflict,
    )


def deflection_words(worst: WorstPoint | None) -> str:
    """The worst point's deflection along and across the tool axis, as the terminal shows it too."""
    if worst is None or worst.deflection_along_mm is None or worst.deflection_across_mm is None:
        return ""

    def text(value: float, interval: tuple[float, float] | None) -> str:
        around = "" if interval is None else f" (90 %: {interval[0]:.3f} to {interval[1]:.3f})"
        return f"{value:.3f}{around}".replace("-", "−")

    whole = worst.deflection_ci90_mm
    parts = [] if whole is None else [f"90 %: {whole[0]:.3f} to {whole[1]:.3f}".replace("-", "−")]
    parts.append(f"along the tool axis {text(worst.deflection_along_mm, worst.deflection_along_ci90_mm)}")
    parts.append(f"across it {text(worst.deflection_across_mm, worst.deflection_across_ci90_mm)}")
    return ", ".join(parts)


def _certificate(plan: Plan) -> page.Certificate | None:
    found = certificate(plan)
    if found is None:
        return None
    return page.Certificate(
        objective=found.objective,
        bound=found.bound,
        gap=found.gap,
        beyond=found.beyond,
        above=found.above,
        external=_over_external(plan),
    )


def _over_external(plan: Plan) -> str:
    """What holds when the values of the external joints are free too, in words; empty where none was."""
    found = with_external(plan)
    if found is None:
        return ""
    if found.why:
        return f"no bound over external joints: {found.why}"
    over = f"{found.values} values of the external joints, too"
    if found.gap is None:
        return f"between these less than any over {over}; no bound over what lies between"
    return f"gap {100 * found.gap:.2f} % over {over}"


def _shift(plan: Plan, toolpath: Toolpath) -> page.Shift | None:
    found = residual(plan)
    if found is None:
        return None
    out = page.Shift(worst=found.shift_worst, mean=found.shift_mean, left_worst=found.worst, left_mean=found.mean)
    whole = removals(plan, toolpath.operation, tuple(o.label for o in toolpath.operations))[:1]
    for r in whole:
        out = replace(out, left_worst90=r.worst90, left_mean90=r.left90, removed90=r.removed90)
    return out


def _figures(plan: Plan, scored: Scored) -> tuple[float, float]:
    """Worst and mean of the objective itself, as deflection in m or stiffness in N/m; NaN where it is not feasible.

    The mean is over the length cut. A mean stiffness is that of the mean compliance, as the objective has it.
    """
    found = [plan.scores.scale * v for v in (scored.objective.worst, scored.objective.mean)]
    shown = found if plan.scores.index == "deflection" else [1.0 / v if v else float("nan") for v in found]
    worst, mean = (v if np.isfinite(v) and v > 0 else float("nan") for v in shown)
    return worst, mean


def _dips(plan: Plan, timeline: Timeline | None, s: Array) -> tuple[page.FeedDip, ...]:
    if timeline is None or timeline.trajectory is None:
        return ()
    t = timeline.trajectory
    cut = np.flatnonzero((t.move != Move.RAPID) & np.isfinite(t.point))
    index = t.point[cut]  # once: a job of many holes has a dip and more in each
    out = []
    for dip in (d for d in timeline.dips if d.lost):
        known = len(cut) > 0 and dip.first <= index[-1]  # where the machine stood before: the last row of that
        at = cut[max(int(np.searchsorted(index, dip.first + 1e-9, side="right")) - 1, 0)] if known else None
        end = cut[min(int(np.searchsorted(index, dip.last)), len(cut) - 1)] if len(cut) else 0
        programmed = float(
            plan.path.feed[min(int(np.searchsorted(plan.path.index, dip.last)), len(plan.path.feed) - 1)]
        )
        out.append(
            page.FeedDip(
                point=dip.first,
                s=float(along(s, np.array(dip.first))),
                time=float(t.time[at]) if at is not None else float("nan"),
                duration=max(float(t.time[end] - t.time[at]), 0.0) if at is not None else float("nan"),
                feed_programmed=programmed,
                feed_lowest=dip.ratio * programmed,
                cause=cause(dip),
            )
        )
    return tuple(out)


def _feed_stops(timeline: Timeline | None) -> tuple[tuple[str, int], ...]:
    """How many ramps there are from and to each kind of stop that the path demands."""
    words = {
        "reversal": "at reversals",
        "start": "at the start of cuts",
        "stop": "at the end of cuts",
        "rest": "at dwells",
    }
    dips = timeline.dips if timeline is not None and timeline.trajectory is not None else ()
    ramps = Counter(str(d.where) for d in dips if not d.lost)
    return tuple((text, ramps[where]) for where, text in words.items() if ramps[where])


def cause(dip: Dip) -> str:
    """What slowed the feed, in words."""
    where = " while the tool turns on the spot" if dip.where == "reorientation" else ""
    return f"{axis_name(dip.joint - 1)} {dip.limit}{where}"


def _operations(
    plan: Plan, toolpath: Toolpath, points: PointResults, timeline: Timeline | None, series: dict[str, Array]
) -> tuple[page.OperationRow, ...]:
    counted = plan.path.counted[points.rows]
    worst_of = np.nanmax if plan.scores.index == "deflection" else np.nanmin
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)]
    t = timeline.trajectory if timeline else None
    tool = _tools(plan, points, toolpath)
    out = []
    for k, operation in enumerate(toolpath.operations):
        mine = toolpath.operation == k
        cut = mine & counted

        def worst(name: str, cut: NDArray[np.bool_] = cut) -> float:
            values = series[name][cut]
            whole = np.isfinite(values).all() or (name == "chosen" and np.isfinite(values).any())
            return (
                float(worst_of(values)) if len(values) and whole else float("nan")
            )  # of one path, not of its good half

        miss = points.table.clearance[mine]
        bad = int((np.array(points.table.status)[mine] != "ok").sum())
        out.append(
            page.OperationRow(
                label=operation.label,
                kind=operation.kind,
                points=int(mine.sum()),
                length=float(step[cut].sum()),
                time=float((t.operation == k).sum() * plan.options.sample) if t else float("nan"),
                worst_default=worst("default"),
                worst_chosen=worst("chosen"),
                nearest_miss=float(np.nanmin(miss)) if np.isfinite(miss).any() else float("nan"),
                feed_held=float("nan"),
                status="ok" if not bad else f"{told.counted(bad, 'point')} infeasible",
                tool=tool.get(k, ""),
            )
        )
    return tuple(out)


def _tools(plan: Plan, points: PointResults, toolpath: Toolpath) -> dict[int, str]:
    """The tools of each operation, where the job changes them."""
    out: dict[int, dict[str, None]] = {}
    for own, mine in plan.among(points.rows) if plan.parts else ():
        for k in dict.fromkeys(toolpath.operation[mine].tolist()):
            out.setdefault(k, {})[str(own.setup.cell.tool_name)] = None
    return {k: ", ".join(names) for k, names in out.items()}


def _label(toolpath: Toolpath, plan: Plan, row: int) -> str:
    return str(toolpath.operations[toolpath.operation[int(np.ceil(plan.path.index[row] - 1e-9))]].label)


def measured(value: float, check: Check) -> str:
    """A value of a check as it is read aloud: what is not beyond a limit is within it, and by how much."""
    if check.beyond and value <= 0.0:
        return "at the limit" if value == 0.0 else f"{-value:.4g} {check.beyond} within the limit"
    number = f"{value + 0.0:.4g}"
    if "e-" in number and abs(value) >= 1e-6:  # 0.000005 s is read more easily than 5e−06 s
        number = np.format_float_positional(float(number), trim="-")
    return f"{number} {check.unit}".replace("-", "−", 1)


def found(check: Check) -> str:
    """What a check found; of what is mere rounding beside what it allows result.json has the number."""
    if check.passed and not check.beyond and 0.0 < abs(check.value) < ROUNDING * check.limit:
        return "< 0.1 % of allowed"
    return measured(check.value, check)


def _length(metres: float) -> str:
    if not metres > 0:
        return ""
    return f"{1e3 * metres:.0f} mm out of reach" if 1e3 * metres >= 0.5 else "less than 1 mm out of reach"
