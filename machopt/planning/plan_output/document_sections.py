"""Sections of result.json that describe a plan."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from machopt.data_types.documents import optimize_document
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.planning.compensation.expected_deflection_reduction import DeflectionRemoval, predict_removals
from machopt.planning.compensation.shifted_path import compute_residual
from machopt.planning.error_probability.model_discrepancy import NINETY
from machopt.planning.optimality_certificate import compute_certificate, find_external_axis_bound
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.plan_output.deflection_components import split_deflection
from machopt.planning.plan_output.infeasibility_remedies import describe_remedy
from machopt.planning.plan_output.point_table import PointResults, find_reason
from machopt.planning.plan_output.stability_section import build_best_stability_entry
from machopt.planning.retiming.slowdowns import FeedSlowdown
from machopt.planning.uncertainty.measured_tcp_error import predict_position_error
from machopt.planning.uncertainty.stiffness_uncertainty import IndexGain


def list_infeasible_entries(the_plan: Plan, points: PointResults) -> Iterator[optimize_document.InfeasiblePointEntry]:
    """Yield one entry per infeasible toolpath point.

    Args:
        the_plan: plan of the job.
        points: its point results.
    """
    for p in the_plan.missing:
        if the_plan.path.is_point[p]:
            row = round(the_plan.path.index[p])
            yield optimize_document.InfeasiblePointEntry(
                point=row,
                status=find_reason(the_plan, p).word,
                reason=points.table.reason[row],
                help=describe_remedy(the_plan, p),
                best_stability=build_best_stability_entry(the_plan, p),
            )


def build_break_entry(b: SequenceBreak) -> optimize_document.MotionBreakEntry:
    """Return the entry of two places without a motion between them; values that are not finite become null.

    Args:
        b: break of the motion.
    """
    return optimize_document.MotionBreakEntry(
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


def build_slowdown_entry(d: FeedSlowdown) -> optimize_document.FeedDipEntry:
    """Return the entry of a stretch below the programmed feed.

    Args:
        d: slowdown with toolpath indices.
    """
    return optimize_document.FeedDipEntry(
        first_point=d.first, last_point=d.last, lowest_ratio=d.ratio, where=d.where, axis=d.joint, limit=d.limit
    )


def build_objective_section(scored: ScoredAssignment) -> optimize_document.ChoiceObjectiveSection:
    """Return the objective of an assignment with its share of feasible points.

    Args:
        scored: assignment with its objective.
    """
    feasible = int((scored.assignment.reason == 0).sum())
    return optimize_document.ChoiceObjectiveSection(
        **vars(scored.objective), feasible_share=feasible / len(scored.assignment.reason)
    )


def build_search_section(the_plan: Plan) -> optimize_document.SearchBoundSection | None:
    """Return the certificate of the search; None where the plan has breaks or gaps.

    Args:
        the_plan: plan of the job.
    """
    found = compute_certificate(the_plan)
    if found is None:
        return None
    return optimize_document.SearchBoundSection(
        sequence=found.sequence,
        lower_bound=found.bound,
        gap_percent=100.0 * found.gap,
        beyond_grid_percent=100.0 * found.beyond,
        plan_above_bound_percent=100.0 * found.above,
        external=_build_external_bound(the_plan),
    )


def _build_external_bound(the_plan: Plan) -> optimize_document.ExternalSearchBoundSection | None:
    """Return the bound over the values of the external joints, or the reason why there is none."""
    found = find_external_axis_bound(the_plan)
    if found is None:
        return None
    return optimize_document.ExternalSearchBoundSection(
        why_none=found.why,
        values=found.values,
        stations=found.stations,
        rotation_step_deg=round(float(np.degrees(found.step)), 9),
        sequence=found.sequence,
        lower_bound=found.bound,
        plan=found.plan,
        gap_percent=None if found.gap is None else 100.0 * found.gap,
        values_apart=tuple(_build_value_step(the_plan, name, step) for name, step in found.apart),
    )


def _build_value_step(the_plan: Plan, name: str, step: float) -> optimize_document.ValueStepEntry:
    """Return the distance of the values of one external joint in the grid of the bound."""
    cell = the_plan.setup.cell
    slides = cell.external_prismatic[cell.external_joints.index(name)]
    value = 1e3 * step if slides else float(np.degrees(step))
    return optimize_document.ValueStepEntry(joint=name, step=round(value, 6), unit="mm" if slides else "deg")


def build_tool_sections(
    the_plan: Plan, segments: Sequence[ToolSegment]
) -> tuple[optimize_document.ToolSegmentEntry, ...] | None:
    """Return the section of each stretch of a job with tool changes; None for a job with one tool.

    Args:
        the_plan: plan of the job.
        segments: toolpath of each tool.
    """
    if not the_plan.parts:
        return None
    out = []
    for segment, part in zip(segments, the_plan.parts, strict=True):
        cut, o = part.plan.path.counted.any(), part.plan.chosen.objective
        mean, worst = (part.plan.scores.scale * v if cut and np.isfinite(v) else None for v in (o.mean, o.worst))
        labels = dict.fromkeys(segment.toolpath.operation.tolist())
        out.append(
            optimize_document.ToolSegmentEntry(
                tool=segment.tool,
                first_point=segment.first,
                last_point=segment.stop - 1,
                operations=tuple(segment.toolpath.operations[k].label for k in labels),
                mean_index=mean,
                worst_index=worst,
            )
        )
    return tuple(out)


def build_gain_section(gain: IndexGain) -> optimize_document.MeanGainEntry:
    """Return the reduction of the mean cost: of deflection, or of compliance where no force is given; null where
    unknown.

    Args:
        gain: gain over one baseline.
    """
    low, high = gain.interval
    return optimize_document.MeanGainEntry(
        over=gain.over,
        mean_percent=100.0 * gain.mean,
        std_percent=100.0 * gain.std,
        ci90=(100.0 * low, 100.0 * high) if np.isfinite(gain.std) else None,
        distinguishable=gain.distinguishable if np.isfinite(gain.mean) else None,
    )


def build_position_error_section(the_plan: Plan) -> optimize_document.PositionErrorSection | None:
    """Return the predicted position error of the TCP from measured poses; None where the stiffness file has none.

    Args:
        the_plan: plan of the job.
    """
    found = predict_position_error(the_plan)
    if found is None:
        return None
    return optimize_document.PositionErrorSection(
        std_mm=1e3 * found.std,
        beyond_mm=1e3 * found.beyond,
        outside_percent=100.0 * found.uncovered,
        outside_joints=found.joints,
        corrected=found.corrected,
        noise_mm=1e3 * found.error.noise,
        poses=found.error.poses,
    )


def build_compensation_section(the_plan: Plan, toolpath: Toolpath) -> optimize_document.CompensationSection | None:
    """Return shift and residual of a compensated plan; None without a compensation.

    Args:
        the_plan: plan of the job.
        toolpath: its toolpath.
    """
    found = compute_residual(the_plan)
    removed = predict_removals(
        the_plan, toolpath.operation, tuple(o.label for o in toolpath.operations), toolpath.process_operation
    )
    if found is None:
        return None
    length, fade = (
        (the_plan.compensation.length, the_plan.compensation.fade) if the_plan.compensation else (np.nan, np.nan)
    )
    return optimize_document.CompensationSection(
        length_mm=1e3 * length,
        fade_mm=1e3 * fade,
        max_mm=1e3 * found.shift_worst,
        mean_mm=1e3 * found.shift_mean,
        uncompensated_mean_mm=1e3 * found.uncompensated,
        residual_max_mm=1e3 * found.worst,
        residual_mean_mm=1e3 * found.mean,
        removed=build_removal_entry(removed[0]) if removed else None,
        operations=tuple(build_removal_entry(r) for r in removed[1:]),
    )


def build_removal_entry(r: DeflectionRemoval) -> optimize_document.RemovedDeflectionEntry:
    """Return the removal of one stretch; sampled numbers are rounded to their statistical accuracy.

    Args:
        r: predicted removal.
    """

    def interval(ends: tuple[float, float] | None, factor: float) -> tuple[float, float] | None:
        return None if ends is None else (round(factor * ends[0], 5), round(factor * ends[1], 5))

    return optimize_document.RemovedDeflectionEntry(
        operation=r.label,
        removed_percent=100.0 * r.removed,
        removed_ci90_percent=interval(r.removed90, 100.0),
        residual_mean_mm=1e3 * r.left,
        residual_mean_ci90_mm=interval(r.left90, 1e3),
        residual_max_mm=1e3 * r.worst,
        residual_max_ci90_mm=interval(r.worst90, 1e3),
    )


def _convert_to_mm(interval: tuple[float, float] | None) -> tuple[float, float] | None:
    return None if interval is None else (1e3 * interval[0], 1e3 * interval[1])


def build_worst_point_entry(the_plan: Plan, points: PointResults) -> optimize_document.WorstPointSection | None:
    """Return the point with the worst index; None where no cut point is feasible.

    Args:
        the_plan: plan of the job.
        points: its point results.
    """
    there = the_plan.path.counted & (
        the_plan.chosen.assignment.reason == InfeasibilityReason.OK
    )  # one that collides has a cost, too
    cost = np.where(there, the_plan.chosen.cost, np.nan)[points.rows]
    bend = points.table.deflection
    if np.isfinite(bend).any():  # not where the force is unknown
        cost = np.where(np.isfinite(bend), cost, np.nan)
    if not np.isfinite(cost).any():
        return None
    i = int(np.nanargmax(cost))
    t, split = points.table, split_deflection(the_plan, int(points.rows[i]))
    std = np.nan if t.deflection_std is None else 1e3 * float(t.deflection_std[i])
    value = 1e3 * float(t.deflection[i])
    return optimize_document.WorstPointSection(
        point=i,
        k_axial_N_mm=t.k_axial[i] / 1e3,
        k_normal_N_mm=t.k_normal[i] / 1e3,
        deflection_mm=value,
        deflection_ci90_mm=(value - NINETY * std, value + NINETY * std) if np.isfinite(std) else None,
        deflection_along_mm=None if split is None else 1e3 * split.along,
        deflection_along_ci90_mm=_convert_to_mm(split.along90) if split else None,
        deflection_across_mm=None if split is None else 1e3 * split.across,
        deflection_across_ci90_mm=_convert_to_mm(split.across90) if split else None,
        gamma_deg=float(np.degrees(t.gamma[i])),
        k_jiao_x_N_mm=t.k_jiao_x[i] / 1e3,
        q_deg=np.degrees(t.q[i]).round(4),
    )
