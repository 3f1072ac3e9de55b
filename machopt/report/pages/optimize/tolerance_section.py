"""Section of the optimize report about tolerances: outcomes, worst holes and points, errors and forces on the path."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.report.page_shell import build_section
from machopt.report.page_types.optimize_page_data import ReportData, ToleranceData, TolerancePointRow
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_pair_table, build_table
from machopt.report.svg.stability_picture import draw_stability_map
from machopt.report.template_rendering import join_markup, render_macro, render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

_TONES = {"pass": "pass", "fail": "fail"}
_NAMES = {"along": "Along axis", "across": "Across axis", "normal": "Normal to surface", "axis": "Axis angle"}
_CHARTS = ("c-error", "c-force")


def build_tolerance_section(data: ReportData, charts: set[str]) -> Body:
    """Return the section; nothing where the cell has no process.

    Args:
        data: Data of the report.
        charts: Names of the charts on the page.
    """
    found = data.tolerances
    if found is None:
        return ""
    body: Body = ""
    if found.operations:
        body += _build_outcomes(found)
        body += render_part("heading", "Holes and points, worst first") + _build_points(data, found)
    body += join_markup(render_part("chart", name) for name in _CHARTS if name in charts)
    if found.stability_words:
        body += render_part("heading", "Stability over the rotation: stable depth of cut over the planned depth")
        body += render_part("lead", found.stability_words)
    if found.stability is not None:
        body += render_part("scrolled", draw_stability_map(found.stability))
    if found.stock:
        body += render_part("heading", "Stock and finished part") + build_pair_table("Quantity", "Value", found.stock)
    body += _build_basis(found)
    lead = (
        "Predicted errors under the cutting force at the feed that the motion reaches, against the tolerances of "
        "process.yaml. The intervals are 5 and 95 % of all draws of stiffness, force, and position of the arm."
    )
    return build_section("tolerances", found.headline, lead, body)


def _build_outcomes(tolerance_data: ToleranceData) -> Body:
    counts = build_table(
        [TableColumn("Outcome"), *(TableColumn(name, "n") for name in ("CAM default", "Jiao 2022", "This plan"))],
        [row for row in tolerance_data.counts if any(row[1:])],
    )
    operations = build_table(
        [TableColumn(t) for t in ("Operation", "Limits", "Reference", "Outcomes", "Error of the worst")],
        tolerance_data.operations,
    )
    return counts + render_part("heading", "Operations with a tolerance") + operations


def _build_points(data: ReportData, tolerance_data: ToleranceData) -> Body:
    columns = [
        TableColumn("Hole", "n"),
        TableColumn("Point", "n"),
        TableColumn("Operation"),
        TableColumn("Outcome", "html"),
        TableColumn("Probability", "n"),
        *(TableColumn(f"{title} ({_find_unit(name)})", "n") for name, title in _NAMES.items()),
        TableColumn("Limits"),
        TableColumn("Main cause"),
    ]
    table = build_table(columns, [_format_row(data, row) for row in tolerance_data.rows])
    more = render_part("lead", f"… and {tolerance_data.hidden} more in points.csv.") if tolerance_data.hidden else ""
    return table + more


def _format_row(data: ReportData, row: TolerancePointRow) -> tuple[object, ...]:
    errors = {name: _format_error(name, values) for name, *values in row.errors}
    probability = "–" if math.isnan(row.probability) else f"{100 * row.probability:.1f} %"
    if row.deflection_only and probability != "–":
        probability += " (deflection only)"
    return (
        row.number or "–",
        row.point if data.view is None else render_macro("report.html", "place", row.point),
        row.operation,
        render_part("toned", _TONES.get(row.outcome, "none"), row.outcome),
        probability,
        *(errors.get(name, "–") for name in _NAMES),
        row.tolerance,
        _format_cause(row.cause),
    )


def _find_unit(name: str) -> str:
    return "deg" if name == "axis" else "mm"


def _format_error(name: str, values: list[float]) -> str:
    factor = 180.0 / math.pi if name == "axis" else 1e3
    nominal, low, high = (v * factor for v in values)
    text = f"{nominal:.3f}"
    if math.isfinite(low) and math.isfinite(high):
        text += f" ({low:.3f} … {high:.3f})"
    return text.replace("-", "−")


def _format_cause(cause: str) -> str:
    if not cause:
        return "–"
    name, share = cause.rsplit(" ", 1)
    return f"{name.replace(':', ' ')}, {100 * float(share):.0f} %"


def _build_basis(tolerance_data: ToleranceData) -> Body:
    out: Body = ""
    if tolerance_data.shares:
        words = ", ".join(f"{name} {100 * share:.0f} %" for name, share in tolerance_data.shares)
        out += render_part(
            "note", f"Mean shares of the variance of the error: {words}. The largest is worth measuring."
        )
    if tolerance_data.validity:
        out += render_part("heading", "What the prediction assumes") + render_part("bullets", tolerance_data.validity)
    if tolerance_data.sources:
        out += build_folded_block(
            "Sources", len(tolerance_data.sources), build_pair_table("Number", "Source", tolerance_data.sources)
        )
    return out
