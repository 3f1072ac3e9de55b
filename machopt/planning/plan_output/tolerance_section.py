"""Section ``process`` of result.json: tolerances of the job, and the headline of terminal and report."""

from __future__ import annotations

import math

from machopt.data_types.documents.process_entries import (
    AdvisedFeedSection,
    OutcomeCountsSection,
    ProcessSection,
    StockComparisonSection,
    StockSection,
    ToleranceEntry,
)
from machopt.data_types.process import CuttingProcess
from machopt.data_types.process_columns import (
    ProcessSummary,
    ToleranceSummary,
    find_worst_tolerance,
    merge_process_summaries,
)
from machopt.data_types.stock import StockComparison, StockSummary
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.plan_output.stability_section import build_stability_section


def build_process_section(
    process: CuttingProcess | None,
    points: PointResults,
    stock: StockSummary | None = None,
    plan: Plan | None = None,
) -> ProcessSection | None:
    """Return the section; None where the cell has no process.

    Args:
        process: Content of process.yaml.
        points: Results of the points.
        stock: What the job does to its stock; None where no engagement comes from there.
        plan: The plan, for what its options request; None: nothing is requested.
    """
    summary = merge_process_summaries(points.process)
    if process is None or summary is None:
        return None
    return ProcessSection(
        headline=format_headline(summary),
        quantile=process.quantile,
        in_tolerance=OutcomeCountsSection(
            before=dict(summary.before["cam_default"]),
            before_jiao2022=dict(summary.before["jiao2022"]),
            after=dict(summary.after),
        ),
        tolerances=tuple(_build_entry(row) for row in summary.tolerances),
        variance_shares=dict(summary.variance_shares),
        sources=dict(summary.sources),
        validity=summary.validity,
        stability=build_stability_section(
            points.table.process, None if plan is None else plan.options.min_stability_ratio, points.table.status
        ),
        advised_feed=None if plan is None else _build_advised_feed_section(plan),
        stock=None if stock is None else _build_stock_section(stock),
    )


def _build_advised_feed_section(plan: Plan) -> AdvisedFeedSection | None:
    """Return the feeds below those of the file, of all tools together; None where they are those of the file."""
    plans = [part.plan for part in plan.parts] if plan.parts else [plan]
    known = [one.advised_feed for one in plans if one.advised_feed is not None]
    if not known:
        return None
    return AdvisedFeedSection(
        share=known[0].share,
        slowed=sum(one.slowed for one in known),
        needed=sum(one.needed for one in known),
        file_feed_s=sum(one.file_feed_seconds for one in known),
    )


def _build_stock_section(stock: StockSummary) -> StockSection:
    return StockSection(
        cell_mm=1e3 * stock.cell_size,
        volume_mm3=1e9 * stock.volume,
        removed_mm3=1e9 * stock.removed,
        removed_by_other_moves_mm3=1e9 * stock.removed_by_other_moves,
        cut_moves=stock.cut_moves,
        air_cuts=stock.air_cuts,
        finished=None if stock.finished is None else _build_comparison_section(stock.finished),
    )


def _build_comparison_section(stock_comparison: StockComparison) -> StockComparisonSection:
    return StockComparisonSection(
        gouge_depth_mm=1e3 * stock_comparison.gouge_depth,
        gouge_at_mm=_convert_place(stock_comparison.gouge_place),
        gouge_volume_mm3=1e9 * stock_comparison.gouge_volume,
        left_depth_mm=1e3 * stock_comparison.left_depth,
        left_at_mm=_convert_place(stock_comparison.left_place),
        left_volume_mm3=1e9 * stock_comparison.left_volume,
    )


def _convert_place(place: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
    return None if place is None else (1e3 * place[0], 1e3 * place[1], 1e3 * place[2])


def format_headline(summary: ProcessSummary) -> str:
    """Return one sentence: how many holes and points are in tolerance, and which is the worst.

    Args:
        summary: Tolerances of the job.
    """
    if not summary.tolerances:
        return "no operation states a tolerance"
    parts = []
    for is_hole, noun in ((True, "hole"), (False, "point")):
        rows = [row for row in summary.tolerances if row.is_hole == is_hole]
        if rows:
            parts.append(_format_part(rows, noun))
    return "; ".join(parts)


def _format_part(rows: list[ToleranceSummary], noun: str) -> str:
    counts = {word: sum(row.counts[word] for row in rows) for word in rows[0].counts}
    total = sum(counts.values())
    text = f"{counts['pass']} of {total} {noun}s in tolerance"
    text += "".join(f", {counts[word]} {word}" for word in ("marginal", "fail", "unknown") if counts[word])
    worst = find_worst_tolerance(rows)
    if worst is not None and math.isfinite(worst.worst_error):
        number = worst.worst_number if worst.is_hole else worst.worst_point
        error = f"{math.degrees(worst.worst_error):.3g}°" if worst.is_angle else f"{1e3 * worst.worst_error:.3g} mm"
        text += f", worst {noun} {number}: {error}"
        if worst.worst_cause:
            name, share = worst.worst_cause.rsplit(" ", 1)
            text += f", {name.replace(':', ' ')} {100 * float(share):.0f} %"
    return text


def _build_entry(row: ToleranceSummary) -> ToleranceEntry:
    return ToleranceEntry(
        operation=row.operation,
        kind="holes" if row.is_hole else "surface",
        limits=dict(row.limits),
        reference=row.reference,
        counts=dict(row.counts),
        worst_point=row.worst_point,
        worst_error_mm=1e3 * row.worst_error if math.isfinite(row.worst_error) and not row.is_angle else None,
        worst_p_in=row.worst_p_in if math.isfinite(row.worst_p_in) else None,
        worst_cause=row.worst_cause,
    )
