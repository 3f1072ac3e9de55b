"""Data of the optimize report from plan, motion and verification."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.documents.optimize_document import WorstPointSection
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.stock import StockSummary
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.options.plan_option_reader import find_options_without_effect
from machopt.planning.compensation.expected_deflection_reduction import predict_removals
from machopt.planning.compensation.shifted_path import compute_residual
from machopt.planning.job.pareto_front import FrontPlan
from machopt.planning.motion.trajectory_builder import MotionTimeline
from machopt.planning.optimality_certificate import compute_certificate, find_external_axis_bound
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.plan_output.collision_map import CollisionMap
from machopt.planning.plan_output.document_sections import build_worst_point_entry
from machopt.planning.plan_output.infeasibility_reasons import compute_reach_shortfall, list_breaks
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy
from machopt.planning.plan_output.plan_remarks import describe_model_misfit, list_hints
from machopt.planning.plan_output.point_table import PointResults, find_reason
from machopt.planning.plan_output.posture_feed_section import build_joint_section
from machopt.planning.uncertainty.stiffness_uncertainty import compute_gains
from machopt.report.page_data.optimize_feed_dips import count_feed_stops, list_feed_dips
from machopt.report.page_data.optimize_operations import list_operations
from machopt.report.page_data.optimize_rotation_map import build_rotation_map
from machopt.report.page_data.optimize_scene import build_optimize_scene
from machopt.report.page_data.optimize_series import build_motion_series, build_path_series, compute_cut_length
from machopt.report.page_data.optimize_stability_map import build_stability_map
from machopt.report.page_data.optimize_tolerances import build_tolerance_data
from machopt.report.page_data.optimize_worst_points import list_worst_points
from machopt.report.page_types import optimize_page_data as page
from machopt.verification import Verification
from machopt.verification.check_results import VerificationCheck
from machopt.version import __version__

ROUNDING_SHARE = 1e-3  # of what a check allows: 5.7e−14 s is of no use to a reader
_BASELINE_NAMES = {"cam default": "the CAM's default rotation", "jiao2022": "Jiao 2022"}
_REASON_TEXTS = {
    InfeasibilityReason.UNREACHABLE: "unreachable",
    InfeasibilityReason.LIMIT: "joint limit",
    InfeasibilityReason.SINGULAR_WRIST: "wrist singularity",
    InfeasibilityReason.SINGULAR_ELBOW: "elbow singularity",
    InfeasibilityReason.SINGULAR_SHOULDER: "shoulder singularity",
    InfeasibilityReason.UNSTABLE: "unstable cut",
    InfeasibilityReason.COLLIDING: "collision",
    InfeasibilityReason.BOUNDS: "outside the rotation range",
    InfeasibilityReason.NO_PATH: "no continuous way",
    InfeasibilityReason.GAP: "left out at a gap",
    InfeasibilityReason.SHIFT: "shift refused",
    InfeasibilityReason.GOUGING: "gouges the finished part",
}


@dataclass(frozen=True, kw_only=True)
class PlanEvidence:
    """What the page shows beside the plan and its motion."""

    shown: CollisionMap  # feasible rotations and branches
    hashes: dict[str, str]  # SHA-256 of the input files by name
    options: dict[str, object]  # planning options in force
    timings: dict[str, float]  # s, computing time of each stage
    verification: Verification | None = None  # None where there is none
    programs: Sequence[page.ProgramRow] = ()  # exported programs
    front: Sequence[FrontPlan] = ()  # plans of the trade-off front
    before: Plan | None = None  # a plan to compare with, on the rotation map
    unchecked: tuple[str, ...] = ()  # names of what was not checked
    blockers: tuple[str, ...] = ()  # what has to be settled before production
    stock: StockSummary | None = None  # what the job does to its stock; None where no engagement comes from there


def build_report_data(
    plan: Plan,
    toolpath: Toolpath,
    points: PointResults,
    timeline: MotionTimeline | None,
    evidence: PlanEvidence,
) -> page.ReportData:
    """Collect everything that the page shows; stages that were not reached stay empty.

    Args:
        plan: The plan.
        toolpath: The toolpath, points in the workpiece frame, SI.
        points: Results at the toolpath's points.
        timeline: The motion over time; None where there is no motion.
        evidence: Verification, programs, options and the rest of the page.
    """
    index = plan.scores.index
    quantity: page.Quantity = index if index in ("deflection", "stiffness") else "index"
    series = {name: _convert_cost(plan, s) for name, s in _list_assignments(plan)}
    s = compute_cut_length(toolpath, plan.path.counted[points.rows])
    shift = _build_shift(plan, toolpath)
    summary = _build_summary(plan, points, timeline, evidence.verification, quantity, float(s[-1]), shift)
    return page.ReportData(
        title=f"{plan.setup.cell.name}: {toolpath.source}",
        cell=plan.setup.cell.name,
        toolpath=toolpath.source,
        version=__version__,
        summary=replace(summary, unchecked=evidence.unchecked, blockers=evidence.blockers),
        hashes=tuple(evidence.hashes.items()),
        options=tuple((k, str(v)) for k, v in evidence.options.items()),
        map=build_rotation_map(plan, evidence.shown, s, evidence.before),
        view=build_optimize_scene(plan, toolpath, points, timeline, evidence.shown, series["chosen"]),
        path=build_path_series(plan, toolpath, points, series),
        motion=build_motion_series(plan, toolpath, points, timeline),
        dips=list_feed_dips(plan, timeline, s),
        feed_stops=count_feed_stops(timeline),
        worst=list_worst_points(plan, toolpath, points, series),
        infeasible=_list_infeasible_points(plan, toolpath, points),
        operations=list_operations(plan, toolpath, points, timeline, series),
        ignored=toolpath.ignored,
        notes=tuple(plan.setup.cell.notes),
        warnings=_list_warnings(plan, toolpath, timeline),
        breaks=_list_motion_breaks(plan, timeline),
        excluded_pairs=_remove_duplicate_pairs(
            page.ExcludedPairRow(e.a, e.b, e.reason) for model in _list_collision_models(plan) for e in model.excluded
        ),
        adjacent_pairs=_remove_duplicate_pairs(
            page.ExcludedPairRow(e.a, e.b, e.reason) for model in _list_collision_models(plan) for e in model.adjacent
        ),
        checks=_list_checks(evidence.verification),
        information=_list_information(evidence.verification),
        programs=tuple(evidence.programs),
        front=tuple(_build_trade_off_point(p) for p in evidence.front),
        joint_method=build_joint_section(plan) or (),
        timings=tuple(evidence.timings.items()),
        events=toolpath.events,
        tolerances=build_tolerance_data(
            points, build_stability_map(plan, toolpath, s), evidence.stock, plan.options.min_stability_ratio
        ),
    )


def _list_warnings(plan: Plan, toolpath: Toolpath, timeline: MotionTimeline | None) -> tuple[str, ...]:
    return (
        *plan.setup.cell.warnings,
        *toolpath.warnings,
        *find_options_without_effect(plan.options),
        *list_hints(plan),
        *((f"rapid move {d}" for d in timeline.detours) if timeline else ()),
    )


def _list_motion_breaks(plan: Plan, timeline: MotionTimeline | None) -> tuple[page.MotionBreak, ...]:
    breaks = list_breaks(plan, timeline.obstructions if timeline else ())
    return tuple(page.MotionBreak(*b.ends, b.text, b.help) for b in breaks)


def _list_collision_models(plan: Plan) -> list[CollisionModel]:
    """Return the collision models of the tools of a plan."""
    return [p.setup.collision for p in ([part.plan for part in plan.parts] or [plan]) if p.setup.collision]


def _list_information(verification: Verification | None) -> tuple[page.InformationRow, ...]:
    return tuple(
        page.InformationRow(i.name, f"{i.value:.4g} {i.unit}", i.where)
        for i in (verification.information if verification else ())
    )


def _list_infeasible_points(
    plan: Plan, toolpath: Toolpath, points: PointResults
) -> tuple[page.InfeasiblePointRow, ...]:
    """Points of the file that have no answer, each with what would help."""
    return tuple(
        page.InfeasiblePointRow(
            point=round(plan.path.index[p]),
            operation=_get_label(toolpath, plan, p),
            position=plan.path.position[p],
            status=_REASON_TEXTS.get(find_reason(plan, int(p)), find_reason(plan, int(p)).word),
            reason=points.table.reason[int(plan.path.index[p])],
            shortfall=_format_length(compute_reach_shortfall(plan, int(p))),
            help=describe_remedy(plan, int(p)),
        )
        for p in plan.missing
        if plan.path.is_point[p]
    )


def _list_checks(verification: Verification | None) -> tuple[page.CheckRow, ...]:
    return tuple(
        page.CheckRow(c.name, c.passed, format_found_value(c), format_measured_value(c.limit, c), c.where)
        for c in (verification.checks if verification else ())
    )


def _build_trade_off_point(p: FrontPlan) -> page.TradeOffPoint:
    return page.TradeOffPoint(
        name=p.plan,
        changed=p.changed,
        mean=p.mean_index,
        worst=p.worst_index,
        cycle=p.cycle_time_s,
        travel=p.joint_travel_deg,
        clearance=p.clearance_mm,
        in_tolerance=p.in_tolerance,
        others=None if p.in_tolerance is None else (p.marginal or 0, p.fail or 0, p.unknown or 0),
        mean_error=p.mean_error_mm,
        worst_error=p.worst_error_mm,
        least_stability=p.least_stability_ratio,
        changes=p.posture_changes,
        dominated=p.dominated,
    )


def _remove_duplicate_pairs(pairs: Iterable[page.ExcludedPairRow]) -> tuple[page.ExcludedPairRow, ...]:
    """Each pair once: of the tools of a job most have the same."""
    return tuple(dict.fromkeys(pairs))


def _list_assignments(plan: Plan) -> tuple[tuple[str, ScoredAssignment], ...]:
    return ("default", plan.cam_default), ("jiao2022", plan.jiao2022), ("chosen", plan.chosen)


def _convert_cost(plan: Plan, scored: ScoredAssignment) -> Array:
    """(N,) cost at toolpath points as deflection in m or stiffness in N/m; NaN where it cannot be driven."""
    at = np.where(scored.assignment.reason == InfeasibilityReason.OK, scored.cost, np.nan)[plan.path.is_point]
    return at if plan.scores.index == "deflection" else 1.0 / at


def _build_summary(
    plan: Plan,
    points: PointResults,
    timeline: MotionTimeline | None,
    verification: Verification | None,
    quantity: page.Quantity,
    length: float,
    shift: page.ShiftSummary | None,
) -> page.ResultSummary:
    figures = {name: _compute_worst_and_mean(plan, scored) for name, scored in _list_assignments(plan)}
    clearance = points.table.clearance
    nearest = int(np.nanargmin(clearance)) if np.isfinite(clearance).any() else -1
    if nearest >= 0 and not points.nearest_pair[nearest]:
        nearest = -1  # the value is the search distance; no body is within it
    trajectory = timeline.trajectory if timeline else None
    feasible = trajectory is not None
    outcome = (
        "infeasible" if not feasible else ("done" if verification is None or verification.ok else "verification_failed")
    )
    return page.ResultSummary(
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
        cutting_time=float((trajectory.move == MoveKind.CUT).sum() * plan.options.sample)
        if trajectory
        else float("nan"),
        path_length=length,
        points=len(points.rows),
        infeasible_points=int(plan.path.is_point[plan.missing].sum()),
        nearest_miss=float(clearance[nearest]) if nearest >= 0 else float("nan"),
        nearest_pair=points.nearest_pair[nearest] if nearest >= 0 else "",
        nearest_point=nearest,
        worst_parts=describe_deflection(build_worst_point_entry(plan, points)),
        gains=tuple(
            page.GainOverBaseline(_BASELINE_NAMES[g.over], g.mean, g.std, g.interval, g.distinguishable)
            for g in compute_gains(plan)
            if g.over != plan.chosen_from
        ),
        shift=shift if feasible else None,
        certificate=_build_certificate(plan),
        misfit=describe_model_misfit(plan),
        note="" if feasible else plan.conflict,
    )


def describe_deflection(worst: WorstPointSection | None) -> str:
    """Return the worst point's deflection along and across the tool axis, in the words of the terminal.

    Args:
        worst: The worst point; None where there is none.
    """
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


def _build_certificate(plan: Plan) -> page.BoundCertificate | None:
    found = compute_certificate(plan)
    if found is None:
        return None
    return page.BoundCertificate(
        objective=found.objective,
        bound=found.bound,
        gap=found.gap,
        beyond=found.beyond,
        above=found.above,
        external=_describe_external_bound(plan),
    )


def _describe_external_bound(plan: Plan) -> str:
    """What holds when the values of the external joints are free too, in words; empty where none was."""
    found = find_external_axis_bound(plan)
    if found is None:
        return ""
    if found.why:
        return f"no bound over external joints: {found.why}"
    over = f"{found.values} values of the external joints, too"
    if found.gap is None:
        return f"between these less than any over {over}; no bound over what lies between"
    return f"gap {100 * found.gap:.2f} % over {over}"


def _build_shift(plan: Plan, toolpath: Toolpath) -> page.ShiftSummary | None:
    found = compute_residual(plan)
    if found is None:
        return None
    out = page.ShiftSummary(
        worst=found.shift_worst, mean=found.shift_mean, left_worst=found.worst, left_mean=found.mean
    )
    whole = predict_removals(
        plan, toolpath.operation, tuple(o.label for o in toolpath.operations), toolpath.process_operation
    )[:1]
    for r in whole:
        out = replace(out, left_worst90=r.worst90, left_mean90=r.left90, removed90=r.removed90)
    return out


def _compute_worst_and_mean(plan: Plan, scored: ScoredAssignment) -> tuple[float, float]:
    """Worst and mean of the objective itself, as deflection in m or stiffness in N/m; NaN where it is not feasible.

    The mean is over the length cut. A mean stiffness is that of the mean compliance, as the objective has it.
    """
    found = [plan.scores.scale * v for v in (scored.objective.worst, scored.objective.mean)]
    shown = found if plan.scores.index == "deflection" else [1.0 / v if v else float("nan") for v in found]
    worst, mean = (v if np.isfinite(v) and v > 0 else float("nan") for v in shown)
    return worst, mean


def _get_label(toolpath: Toolpath, plan: Plan, row: int) -> str:
    return str(toolpath.operations[toolpath.operation[int(np.ceil(plan.path.index[row] - 1e-9))]].label)


def format_measured_value(value: float, check: VerificationCheck) -> str:
    """Return a value of a check for reading: within its limit, or beyond it and by how much.

    Args:
        value: Value of the check, in its unit.
        check: The check.
    """
    if check.beyond and value <= 0.0:
        return "at the limit" if value == 0.0 else f"{-value:.4g} {check.beyond} within the limit"
    number = f"{value + 0.0:.4g}"
    if "e-" in number and abs(value) >= 1e-6:  # 0.000005 s is read more easily than 5e−06 s
        number = np.format_float_positional(float(number), trim="-")
    return f"{number} {check.unit}".replace("-", "−", 1)


def format_found_value(check: VerificationCheck) -> str:
    """Return the value that a check found; rounding errors are shortened, result.json has the number.

    Args:
        check: The check.
    """
    if check.passed and not check.beyond and 0.0 < abs(check.value) < ROUNDING_SHARE * check.limit:
        return "< 0.1 % of allowed"
    return format_measured_value(check.value, check)


def _format_length(metres: float) -> str:
    if not metres > 0:
        return ""
    return f"{1e3 * metres:.0f} mm out of reach" if 1e3 * metres >= 0.5 else "less than 1 mm out of reach"
