"""The report's data from the plan, the motion and the verification."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import machopt
from machopt.domain.reason import Reason
from machopt.domain.toolpath import Move, Toolpath
from machopt.formats.options import without_effect
from machopt.plan.breaks import place
from machopt.plan.certificate import certificate
from machopt.plan.compensate import residual
from machopt.plan.explain import all_breaks, gamma, help_of, hints, shortfall_of
from machopt.plan.mapped import Mapped, mapped
from machopt.plan.pipeline import Plan, Scored
from machopt.plan.retime import Dip
from machopt.plan.timeline import Timeline
from machopt.plan.uncertainty import gains
from machopt.postprocess.written import Written
from machopt.report import data as page
from machopt.se3 import wrap
from machopt.services.points import PointResults, reason_of
from machopt.verify import Verification

Array = NDArray[np.float64]
WORST = 8  # rows of the table of worst points
_YARDSTICKS = {"cam default": "the CAM's default rotation", "jiao2022": "Jiao 2022"}
_STATUS = {Reason.BOUNDS: 2, Reason.NO_PATH: 7}  # the page's codes where they differ from Reason's
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
}


def report_data(
    plan: Plan,
    toolpath: Toolpath,
    points: PointResults,
    timeline: Timeline | None,
    verification: Verification | None,
    programs: Sequence[Written] = (),
    *,
    shown: Mapped | None = None,
    unchecked: tuple[str, ...] = (),
    hashes: dict[str, str],
    options: dict[str, object],
    timings: dict[str, float],
) -> page.ReportData:
    """Collect everything the page shows; parts that were not reached stay empty."""
    index = plan.scores.index
    quantity: page.Quantity = index if index in ("deflection", "stiffness") else "index"
    series = {name: _shown(plan, s) for name, s in _assignments(plan)}
    summary = replace(_summary(plan, points, timeline, verification, quantity), unchecked=unchecked)
    infeasible = tuple(
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
    model = plan.setup.collision
    return page.ReportData(
        title=f"{plan.setup.cell.name}: {toolpath.source}",
        cell=plan.setup.cell.name,
        toolpath=toolpath.source,
        version=machopt.__version__,
        summary=summary,
        hashes=tuple(hashes.items()),
        options=tuple((k, str(v)) for k, v in options.items()),
        map=_map(plan, shown or mapped(plan)),
        path=_path_series(plan, toolpath, points, series),
        motion=_motion(plan, toolpath, timeline),
        dips=_dips(plan, timeline),
        worst=_worst_points(plan, toolpath, points, series),
        infeasible=infeasible,
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
            page.Break(place(b.before), place(b.after), b.text, b.help)
            for b in all_breaks(plan, timeline.obstructions if timeline else ())
        ),
        excluded_pairs=tuple(page.ExcludedPair(e.a, e.b, e.reason) for e in (model.excluded if model else ())),
        adjacent_pairs=tuple(page.ExcludedPair(e.a, e.b, e.reason) for e in (model.adjacent if model else ())),
        checks=tuple(
            page.Check(c.name, c.passed, f"{c.value:.4g} {c.unit}", f"{c.limit:.4g} {c.unit}", c.where)
            for c in (verification.checks if verification else ())
        ),
        programs=tuple(map(_program, programs)),
        timings=tuple(timings.items()),
        events=toolpath.events,
    )


def _program(p: Written) -> page.Program:
    c = p.checked
    held = p.feed
    said = page.Program(
        p.label,
        p.files,
        p.lines,
        p.added,
        p.tolerance,
        assumed=p.assumed,
        unstarted=p.unstarted,
        withheld=p.withheld,
        feed_mean=float("nan") if held is None else held.mean_share,
        feed_lowest=float("nan") if held is None else held.lowest_share,
        feed_deviation=float("nan") if held is None else held.deviation,
    )
    if c is None or not c.readable:
        return replace(said, checked=False)
    return replace(
        said,
        moves=c.moves,
        position_error=c.worst("CAM points") / 1e3,
        angle_error=math.radians(c.worst("orientation at targets")),
        joint_error=math.radians(c.worst("joints at targets")),
        feed_error=c.worst("CAM feed") / 6e4,
        path_error=c.worst("lines along the motion") / 1e3,
        axis_error=math.radians(c.worst("tool axis along lines")),
        turn_error=math.radians(c.worst("orientation along lines")),
        events_equal=c.passed("events") is not False,
        differences=c.differences,
        configuration_equal=c.passed("configuration"),
    )


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
) -> page.Summary:
    figures = {name: _figures(plan, scored) for name, scored in _assignments(plan)}
    clearance = points.table.clearance
    nearest = int(np.nanargmin(clearance)) if np.isfinite(clearance).any() else -1
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
        mean_jiao2022=figures["jiao2022"][1],
        mean_chosen=figures["chosen"][1],
        feed_held=timeline.held_share if timeline and feasible else float("nan"),
        cycle_time=float(trajectory.time[-1]) if trajectory else float("nan"),
        cutting_time=float((trajectory.move == Move.CUT).sum() * plan.options.sample) if trajectory else float("nan"),
        path_length=_cut_length(plan),
        points=len(points.rows),
        infeasible_points=int(plan.path.is_point[plan.missing].sum()),
        nearest_miss=float(clearance[nearest]) if nearest >= 0 else float("nan"),
        nearest_pair=points.nearest_pair[nearest] if nearest >= 0 else "",
        nearest_point=nearest,
        gains=tuple(
            page.Gain(_YARDSTICKS[g.over], g.mean, g.std, g.interval, g.distinguishable)
            for g in gains(plan)
            if g.over != plan.chosen_from
        ),
        shift=_shift(plan) if feasible else None,
        certificate=_certificate(plan),
    )


def _certificate(plan: Plan) -> page.Certificate | None:
    found = certificate(plan)
    return None if found is None else page.Certificate(found.objective, found.bound, found.gap, found.beyond)


def _shift(plan: Plan) -> page.Shift | None:
    found = residual(plan)
    return None if found is None else page.Shift(found.shift_worst, found.shift_mean, found.worst, found.mean)


def _figures(plan: Plan, scored: Scored) -> tuple[float, float]:
    """Worst and mean of the objective itself, as deflection in m or stiffness in N/m; NaN where it is not feasible.

    The mean is over the length cut. A mean stiffness is that of the mean compliance, as the objective has it.
    """
    found = [plan.scores.scale * v for v in (scored.objective.worst, scored.objective.mean)]
    shown = found if plan.scores.index == "deflection" else [1.0 / v if v else float("nan") for v in found]
    worst, mean = (v if np.isfinite(v) and v > 0 else float("nan") for v in shown)
    return worst, mean


def _cut_length(plan: Plan) -> float:
    step = np.linalg.norm(np.diff(plan.path.position, axis=0), axis=1)
    return float(step[plan.path.counted[1:]].sum())


def _map(plan: Plan, shown: Mapped) -> page.RotationMap | None:
    """Best branch per station and rotation, marked where its pose was not looked at for collisions.

    Rotation is shown as gamma's carried reference, phi.
    """
    st, c = plan.path.stations, shown.candidates
    cut = np.flatnonzero(plan.path.counted[st])
    if not len(cut):
        return None
    cost = plan.scores.cost[cut]
    usable = c.feasible[cut].any(axis=-1)
    rated = np.where(usable, cost, np.inf)
    first = rated.argmin(axis=2)[:, :, None]
    best = np.take_along_axis(rated, first, axis=2)[:, :, 0]
    known = np.take_along_axis(shown.known[cut], first, axis=2)[:, :, 0]
    value = np.where(np.isfinite(best), best, np.nan)
    if plan.scores.index != "deflection":
        value = 1.0 / value
    status = c.reason_of_rotation()[cut].copy()
    status[(status == Reason.OK) & ~known] = Reason.NO_PATH
    for reason, code in _STATUS.items():
        status[status == reason] = code
    travelled = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(plan.path.position, axis=0), axis=1)] * plan.path.counted)

    def line(scored: Scored) -> Array:
        ok = scored.assignment.reason == Reason.OK
        return np.asarray(wrap(np.where(ok, scored.assignment.phi, np.nan)[st[cut]]))

    return page.RotationMap(
        s=travelled[st[cut]],
        point=plan.path.index[st[cut]],
        rotation=c.phi,
        index=value,
        status=status.astype(np.uint8),
        chosen=line(plan.chosen),
        jiao2022=line(plan.jiao2022),
        cam_default=line(plan.cam_default),
        collisions=_looked_for(plan, shown),
    )


def _looked_for(plan: Plan, shown: Mapped) -> str:
    """How much of the map has been checked for collisions, in words."""
    if plan.setup.collision is None:
        return "Collisions were not looked for."
    known, left = shown.looked_at, shown.open
    some = f"{known:,} of {known + left:,} configurations within reach, limits and margins were checked for collisions"
    if not shown.asked:
        return (
            f"{some}, where the choice wanted to go; dotted places are reachable, but not proven free "
            "(--map-collisions full checks them all)."
        )
    if left:
        return (
            f"{some} in the {shown.seconds:.0f} s that --map-collisions full may take; dotted places were left and "
            "are not proven free."
        )
    return f"{some} (--map-collisions full, {shown.seconds:.1f} s)."


def _path_series(plan: Plan, toolpath: Toolpath, points: PointResults, series: dict[str, Array]) -> page.PathSeries:
    t, counted = points.table, plan.path.counted[points.rows]

    def only_cut(values: Array) -> Array:
        return np.where(counted, values, np.nan)

    return page.PathSeries(
        s=_distance(toolpath),
        operation=toolpath.operation,
        cutting=counted,
        index_default=only_cut(series["default"]),
        index_jiao2022=only_cut(series["jiao2022"]),
        index_chosen=only_cut(series["chosen"]),
        k_axial=only_cut(t.k_axial),
        k_normal=only_cut(t.k_normal),
        k_jiao2022=only_cut(t.k_jiao_x),
        deflection=only_cut(t.deflection),
        tolerance=toolpath.tolerance,
        clearance=t.clearance,
        nearest_pair=points.nearest_pair,
        singularity=t.singularity,
        limit_margin=t.limit_margin,
        shift=t.compensation,
    )


def _distance(toolpath: Toolpath) -> Array:
    return np.asarray(np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1))])


def _motion(plan: Plan, toolpath: Toolpath, timeline: Timeline | None) -> page.MotionSeries | None:
    t = timeline.trajectory if timeline else None
    if t is None:
        return None
    limits, dt = plan.setup.cell.limits, plan.options.sample
    v = np.diff(t.q, axis=0, prepend=t.q[:1]) / dt
    a = np.diff(v, axis=0, prepend=v[:1]) / dt
    j = np.diff(a, axis=0, append=a[-1:]) / dt
    known = np.isfinite(t.point)
    s = np.where(known, np.interp(np.where(known, t.point, 0), np.arange(len(toolpath)), _distance(toolpath)), np.nan)
    ends = np.where(known, np.ceil(np.where(known, t.point, 0) - 1e-9), 0).astype(int)
    programmed = np.where(known & (t.move != Move.RAPID), toolpath.feed[ends], np.nan)
    return page.MotionSeries(
        time=t.time,
        s=s,
        q=t.q,
        velocity_ratio=np.abs(v) / limits.velocity[:6],
        joint_names=plan.setup.cell.arm_joints,
        prismatic=(False,) * 6,
        lower=limits.lower[:6],
        upper=limits.upper[:6],
        feed_programmed=programmed,
        feed_actual=t.feed,
        cutting=np.asarray(t.move == Move.CUT),
        acceleration_ratio=np.abs(a) / limits.acceleration[:6],
        jerk_ratio=np.abs(j) / limits.jerk[:6],
    )


def _dips(plan: Plan, timeline: Timeline | None) -> tuple[page.FeedDip, ...]:
    if timeline is None or timeline.trajectory is None:
        return ()
    t = timeline.trajectory
    cut = np.flatnonzero((t.move != Move.RAPID) & np.isfinite(t.point))
    s = plan.path.s
    out = []
    for dip in timeline.dips:
        at = cut[np.searchsorted(t.point[cut], dip.first)] if len(cut) and dip.first <= t.point[cut[-1]] else None
        end = cut[min(int(np.searchsorted(t.point[cut], dip.last)), len(cut) - 1)] if len(cut) else 0
        programmed = float(
            plan.path.feed[min(int(np.searchsorted(plan.path.index, dip.last)), len(plan.path.feed) - 1)]
        )
        out.append(
            page.FeedDip(
                point=dip.first,
                s=float(np.interp(dip.first, plan.path.index, s)),
                time=float(t.time[at]) if at is not None else float("nan"),
                duration=max(float(t.time[end] - t.time[at]), 0.0) if at is not None else float("nan"),
                feed_programmed=programmed,
                feed_lowest=dip.ratio * programmed,
                cause=cause(dip),
            )
        )
    return tuple(out)


def cause(dip: Dip) -> str:
    """What slowed the feed, in words."""
    where = {
        "path": "",
        "start": " while starting",
        "stop": " while stopping",
        "reversal": " at a reversal",
        "reorientation": " while the tool turns on the spot",
    }[dip.where]
    return f"axis {dip.joint} {dip.limit}{where}"


def _worst_points(
    plan: Plan, toolpath: Toolpath, points: PointResults, series: dict[str, Array]
) -> tuple[page.WorstPoint, ...]:
    values = np.where(plan.path.counted[points.rows], series["chosen"], np.nan)
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(values[known], kind="stable")]
    if plan.scores.index == "deflection":
        order = order[::-1]
    t, turned = points.table, gamma(plan)[points.rows]
    picked: list[int] = []
    for i in order:  # not eight neighbours of the same valley
        if all(abs(int(i) - j) > 0.02 * len(values) for j in picked):
            picked.append(int(i))
        if len(picked) == WORST:
            break
    return tuple(
        page.WorstPoint(
            point=i,
            operation=toolpath.operations[toolpath.operation[i]].label,
            value=float(values[i]),
            value_default=float(series["default"][i]),
            gamma=float(turned[i]),
            deflection=float(t.deflection[i]),
            tolerance=float(toolpath.tolerance[i]),
            k_axial=float(t.k_axial[i]),
            clearance=float(t.clearance[i]),
            reason=_carrier(plan, int(points.rows[i])),
            deflection_std=float(t.deflection_std[i]) if t.deflection_std is not None else float("nan"),
        )
        for i in picked
    )


def _carrier(plan: Plan, row: int) -> str:
    """The joint or term that carries most of the compliance along the force or the tool axis, and how much of it."""
    elasticity, d = plan.setup.elasticity, plan.directions
    elastic = elasticity.at(plan.chosen.assignment.q[row][None], d.k[row][None])
    direction = d.force[row] if plan.options.force.given else d.axial[row]
    wrench = np.concatenate([direction, np.zeros(3)])[None]
    part = dict(
        zip((f"joint {i}" for i in range(1, 7)), (elastic.state.J[0, :3].T @ direction) ** 2 / d.k[row], strict=True)
    )
    for term in elasticity.terms:
        twist = elastic.twist_of(term, wrench, small=not plan.options.force.given)[0, :3]
        part[f"{term.effect.replace('_', ' ')} of {term.location.replace(':', ' ')}"] = float(direction @ twist)
    most = max(part, key=lambda name: part[name])
    along = "the force" if plan.options.force.given else "the tool axis"
    return f"{most} causes {100 * part[most] / sum(part.values()):.0f} % of the deflection along {along}"


def _operations(
    plan: Plan, toolpath: Toolpath, points: PointResults, timeline: Timeline | None, series: dict[str, Array]
) -> tuple[page.OperationRow, ...]:
    counted = plan.path.counted[points.rows]
    worst_of = np.nanmax if plan.scores.index == "deflection" else np.nanmin
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)]
    t = timeline.trajectory if timeline else None
    out = []
    for k, operation in enumerate(toolpath.operations):
        mine = toolpath.operation == k
        cut = mine & counted

        def worst(name: str, cut: NDArray[np.bool_] = cut) -> float:
            values = series[name][cut]
            return float(worst_of(values)) if np.isfinite(values).any() else float("nan")

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
                status="ok" if not bad else f"{bad} points infeasible",
            )
        )
    return tuple(out)


def _label(toolpath: Toolpath, plan: Plan, row: int) -> str:
    return str(toolpath.operations[toolpath.operation[int(np.ceil(plan.path.index[row] - 1e-9))]].label)


def _length(metres: float) -> str:
    return f"{1e3 * metres:.0f} mm out of reach" if metres > 0 else ""
