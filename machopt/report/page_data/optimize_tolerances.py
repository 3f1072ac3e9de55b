"""Data of the report about tolerances: outcomes, the worst holes and points, forces and errors along the path."""

from __future__ import annotations

import numpy as np

from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process_columns import (
    ERROR_NAMES,
    OUTCOMES,
    ProcessColumns,
    ProcessSummary,
    ToleranceSummary,
    merge_process_summaries,
)
from machopt.data_types.stock import StockSummary
from machopt.planning.plan_output.point_table import PointResults
from machopt.planning.plan_output.stability_section import build_stability_section
from machopt.planning.plan_output.tolerance_section import format_headline
from machopt.report.page_types import optimize_page_data as page

MAX_ROWS = 200
_LIMIT_NAMES = {"position_mm": "position", "axis_deg": "axis", "depth_mm": "depth", "surface_mm": "surface"}


def build_tolerance_data(
    points: PointResults,
    stability: page.StabilityMap | None,
    stock: StockSummary | None = None,
    least: float | None = None,
) -> page.ToleranceData | None:
    """Return the data of the tolerances; None where the cell has no process.

    Args:
        points: Results at the toolpath's points.
        stability: The stability map; None where there is none.
        stock: What the job does to its stock; None where no engagement comes from there.
        least: ``min_stability_ratio``; None: not requested.
    """
    summary, columns = merge_process_summaries(points.process), points.table.process
    if summary is None or columns is None:
        return None
    rows = _list_rows(points.table, columns, summary)
    found = build_stability_section(columns, least, points.table.status)
    total = sum(summary.after.values())
    return page.ToleranceData(
        headline=format_headline(summary),
        counts=tuple(
            (word, summary.before["cam_default"][word], summary.before["jiao2022"][word], summary.after[word])
            for word in OUTCOMES
        ),
        operations=tuple(_describe_operation(row) for row in summary.tolerances),
        rows=tuple(rows),
        hidden=max(total - len(rows), 0),
        shares=tuple(summary.variance_shares.items()),
        sources=tuple(summary.sources.items()),
        validity=summary.validity,
        series=_build_series(columns),
        stability=stability,
        stability_words="" if found is None else found.describe(),
        stock=() if stock is None else tuple(_list_stock_rows(stock)),
    )


def _list_stock_rows(stock: StockSummary) -> list[tuple[str, str]]:
    rows = [
        ("Cell size of the stock", f"{1e3 * stock.cell_size:g} mm"),
        ("Volume before the job", f"{1e9 * stock.volume:.0f} mm³"),
        ("Removed by all moves", f"{1e9 * stock.removed:.0f} mm³"),
        ("Removed by moves that are no cuts", f"{1e9 * stock.removed_by_other_moves:.0f} mm³"),
        ("Cuts that remove nothing", f"{stock.air_cuts} of {stock.cut_moves}"),
    ]
    if stock.finished is None:
        return [*rows, ("Finished part", "not compared: the workpiece is not one closed mesh")]
    found = stock.finished
    return [
        *rows,
        ("Deepest gouge of the finished part", _format_depth(found.gouge_depth, found.gouge_place)),
        ("Volume of gouges, cells at walls included", f"{1e9 * found.gouge_volume:.0f} mm³"),
        ("Largest height of material left", _format_depth(found.left_depth, found.left_place)),
        ("Volume of material left, cells at walls included", f"{1e9 * found.left_volume:.0f} mm³"),
    ]


def _format_depth(depth: float, place: tuple[float, float, float] | None) -> str:
    if place is None:
        return "none"
    x, y, z = (1e3 * value for value in place)
    return f"{1e3 * depth:.3f} mm at x {x:.1f}, y {y:.1f}, z {z:.1f} mm"


def _describe_operation(row: ToleranceSummary) -> tuple[str, str, str, str, str]:
    counts = ", ".join(f"{count} {word}" for word, count in row.counts.items() if count)
    shown = f"{np.degrees(row.worst_error):.3f}°" if row.is_angle else f"{1e3 * row.worst_error:.3f} mm"
    worst = shown if np.isfinite(row.worst_error) else "–"
    return row.operation, _format_limits(dict(row.limits)), row.reference, counts, worst


def _format_limits(limits: dict[str, float]) -> str:
    texts = []
    for key, value in limits.items():
        unit = "°" if key.endswith("deg") else " mm"
        texts.append(f"{_LIMIT_NAMES[key]} ± {value:g}{unit}")
    return ", ".join(texts)


def _list_rows(table: PointsTable, columns: ProcessColumns, summary: ProcessSummary) -> list[page.TolerancePointRow]:
    """Return one row per hole or milled point, worst first: by probability, then by error over tolerance."""
    at = np.flatnonzero(np.array([bool(word) for word in columns.outcome]))
    known = np.isfinite(columns.p_in[at])
    probability = np.where(known, columns.p_in[at], columns.p_in_deflection_only[at])
    size = np.nanmax(np.abs([columns.errors[name][at] for name in ("across", "along", "normal")]), axis=0, initial=0.0)
    order = np.lexsort((-np.nan_to_num(size), np.nan_to_num(probability, nan=1.0)))
    limits = {row.operation: _format_limits(dict(row.limits)) for row in summary.tolerances}
    has_holes = {row.operation: row.is_hole for row in summary.tolerances}
    labels = [table.operations[table.operation[row]] for row in at]
    is_hole = np.array([has_holes.get(label, has_holes.get("default", False)) for label in labels], bool)
    number = np.where(is_hole, np.cumsum(is_hole), 0)
    out = []
    for n in order[:MAX_ROWS].tolist():
        row = int(at[n])
        label = labels[n]
        out.append(
            page.TolerancePointRow(
                number=int(number[n]),
                point=row,
                operation=label,
                outcome=columns.outcome[row],
                probability=float(probability[n]),
                deflection_only=not known[n],
                errors=tuple(
                    (
                        name,
                        float(columns.errors[name][row]),
                        float(columns.lower[name][row]),
                        float(columns.upper[name][row]),
                    )
                    for name in ERROR_NAMES
                    if np.isfinite(columns.errors[name][row])
                ),
                tolerance=limits.get(label, limits.get("default", "")),
                cause=columns.cause[row],
            )
        )
    return out


def _build_series(columns: ProcessColumns) -> page.ToleranceSeries:
    is_hole = np.isfinite(columns.errors["across"])
    error, lower, upper = (
        np.where(is_hole, values["across"], values["normal"])
        for values in (columns.errors, columns.lower, columns.upper)
    )
    return page.ToleranceSeries(
        error=error,
        lower=lower,
        upper=upper,
        limit=columns.tolerance,
        force=columns.force,
    )
