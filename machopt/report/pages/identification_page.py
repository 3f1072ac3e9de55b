"""Page of ``machopt identify``: identified joints, their uncertainty, and warnings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.charts.identification_charts import (
    ARCMIN,
    MAX_ELLIPSES,
    MAX_HALF_WIDTH,
    build_identification_charts,
)
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.display_units import format_fixed
from machopt.report.page_types.identification_page_data import IdentificationPageData, IdentifiedCoefficient
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_identification_page(path: Path, data: IdentificationPageData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing leave no gap.
    """
    path.write_text(build_identification_html(data), encoding="utf-8", newline="\n")


def build_identification_html(data: IdentificationPageData) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: The data of the page.
    """
    charts = build_identification_charts(data)
    have = {c["id"] for c in charts}
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("joints", "Joints", _build_joints(data, have)),
        ("fit", "Measured and predicted", _build_fit(data, have)),
        ("uncertainty", "Uncertainty", _build_uncertainty(data, have)),
        ("grid", "Grid", _build_grid(data, have)),
        ("models", "Models", _build_models(data)),
        ("readings", "Readings", _build_readings(data)),
        ("run", "This run", _build_run(data)),
    ]
    return build_page_html(
        data.title,
        (("Cell", data.cell), ("Recording", data.recording)),
        sections,
        {"xy": charts},
        scripts=("chart.js", "xy.js", "start_xy.js"),
        footer=f"machopt {data.version}. Lengths mm, angles mrad, stiffness N·m/rad. Bars of "
        f"stiffness are {100 * data.level:g} % intervals, ellipses 90 % regions. Click a legend entry to hide it.",
    )


def format_stiffness(k: float, digits: int = 3) -> str:
    """Return a joint stiffness as text: 3.80e6.

    Args:
        k: Joint stiffness, N·m/rad.
        digits: Significant digits.
    """
    if not math.isfinite(k):
        return "∞" if k > 0 else "–"
    if k < 1e4:
        return f"{k:.0f}" if k >= 1e3 else f"{k:.{digits}g}"
    return f"{k / 10 ** math.floor(math.log10(k)):.{digits - 1}f}e{math.floor(math.log10(k))}"


def _build_verdict(data: IdentificationPageData) -> Body:
    unseen = 1.0 - (data.heldout_rmse / data.displacement) ** 2 if data.displacement > 0 else math.nan
    seen = f"of the squared displacements; {100 * max(data.explained, 0.0):.1f} % where the fit saw them"
    cards = [
        ("Held-out error", f"{data.heldout_rmse * 1e3:.3f}", "mm", "rms per axis, poses the fit did not see"),
        ("Fit error", f"{data.rmse * 1e3:.3f}", "mm", "rms per axis"),
        ("Measured", f"{data.displacement * 1e3:.3f}", "mm", "rms displacement per axis"),
        ("Explained at unseen poses", f"{100 * max(unseen, 0.0):.1f}" if math.isfinite(unseen) else "–", "%", seen),
        ("Condition number", f"{data.condition_number:.1f}", "", "of the scaled design"),
        ("Readings", str(len(data.measured)), "", f"{len(np.unique(data.pose))} poses"),
    ]
    return render_part("verdict", "verdict", data.tone, data.badge, data.sentence, data.cautions, cards)


def _build_coefficient_rows(rows: tuple[IdentifiedCoefficient, ...], *, arcmin: bool) -> list[list[Body]]:
    out = []
    for c in rows:
        spread = f"{format_stiffness(c.low)} … {format_stiffness(c.high)}"
        half = 50.0 * (c.high - c.low) / c.value if math.isfinite(c.high) and c.value else math.nan
        half = half if half <= MAX_HALF_WIDTH else math.nan  # so wide that the two sides are nothing alike
        name = c.name.replace(" ", "\u00a0", 1)  # "joint 1" on one line
        out.append(
            [
                name,
                format_stiffness(c.value),
                *([format_stiffness(c.value * ARCMIN)] if arcmin else [c.unit]),
                spread,
                f"± {half:.1f} %" if math.isfinite(half) else "–",
                format_stiffness(c.prior),
                render_part("toned", "pass", "yes") if c.identified else render_part("toned", "fail", "no"),
                c.reason,
            ]
        )
    return out


def _build_joints(data: IdentificationPageData, have: set[str]) -> Body:
    columns = [
        TableColumn("Joint"),
        TableColumn("k (N·m/rad)", "n"),
        TableColumn("N·m/arcmin", "n"),
        TableColumn(f"{100 * data.level:g} % interval", "n"),
        TableColumn("Half of it", "n"),
        TableColumn("Before (N·m/rad)", "n"),
        TableColumn("Identified", "html"),
        TableColumn("Why", "why"),
    ]
    body: Body = build_table(columns, _build_coefficient_rows(data.joints, arcmin=True))
    if data.terms:
        columns = [TableColumn("Further physics"), TableColumn("Value", "n"), TableColumn("Unit"), *columns[3:]]
        body += build_table(columns, _build_coefficient_rows(data.terms, arcmin=False))
    body += _build_chart_host("i-joints", have)
    lead = (
        "A joint that no reading loads, or whose effect cannot be distinguished from that of another joint, is not "
        "fitted to noise: it is "
        "marked, and keeps the value it had before or a stated bound."
    )
    return build_section("joints", "Joint stiffness", lead, body)


def _build_fit(data: IdentificationPageData, have: set[str]) -> Body:
    both = [render_part("chart", name) for name in ("i-parity", "i-parity-rot") if name in have]
    body: Body = render_part("grid", 2, both) if "i-parity-rot" in have else both[0]
    body += _build_chart_host("i-residual", have) + _build_chart_host("i-residual-rot", have)
    body += render_part("grid", 2, [_build_chart_host("i-load", have), _build_chart_host("i-heldout", have)])
    lead = "Points on the diagonal are explained; the bars are the standard uncertainty of the reading."
    return build_section("fit", "Measured and predicted", lead, body)


def _build_uncertainty(data: IdentificationPageData, have: set[str]) -> Body:
    body: Body = ""
    for name, count, title in (
        ("i-ellipse", MAX_ELLIPSES, "Pairs of joints with the strongest correlation, 90 % ellipses of the compliances"),
        ("i-subset", 6, "Random subsets of the tests: median and 5–95 % of the identified stiffness"),
    ):
        small = [render_part("chart", f"{name}{n}") for n in range(count) if f"{name}{n}" in have]
        body += render_part("heading", title) + render_part("grid", 3, small) if small else ""
    if data.monte_carlo is not None:
        rows = [
            [c.name, f"± {100 * s:.1f} %" if math.isfinite(s) else "–"]
            for c, s in zip(data.joints, data.monte_carlo, strict=True)
        ]
        body += render_part(
            "heading", "Repeated with measurement errors drawn anew: one standard deviation of the stiffness"
        )
        body += render_part(
            "lead",
            "Errors as the recording states them, and the same fit: what the model lacks is not in it. Where the "
            "readings scatter more than stated, the intervals above are the ones to trust.",
        )
        body += build_table([TableColumn("Joint"), TableColumn("Spread", "n")], rows)
    return build_section(
        "uncertainty", "Uncertainty", "What other readings of the same quality would have given.", body
    )


def _build_grid(data: IdentificationPageData, have: set[str]) -> Body:
    if data.grid is None:
        return ""
    g = data.grid
    small = [_build_chart_host(f"i-grid{j}", have) for j in range(g.k.shape[1])]
    rows = [
        [
            str(n),
            *(f"{v * 1e3:.0f}" for v in g.centre[n]),
            f"{g.readings[n]:.1f}",
            *(f"{format_stiffness(g.k[n, j])} ± {100 * g.std[n, j] / g.k[n, j]:.0f} %" for j in range(g.k.shape[1])),
        ]
        for n in range(len(g.k))
    ]
    columns = [
        TableColumn("Cell", "n"),
        *(TableColumn(f"{a} (mm)", "n") for a in "xyz"),
        TableColumn("Readings", "n"),
        *(TableColumn(f"k{j + 1}", "n") for j in range(g.k.shape[1])),
    ]
    body = render_part("grid", 3, small) + build_folded_block("Cells", len(rows), build_table(columns, rows))
    lead = (
        f"{g.shape[0]} × {g.shape[1]} × {g.shape[2]} cells. A cell with few readings stays near the constant value "
        "(dashed) and its bar grows to the spread found between cells."
    )
    return build_section("grid", "Stiffness per grid cell", lead, body)


def _build_models(data: IdentificationPageData) -> Body:
    if not data.comparisons:
        return ""
    rows = [
        [c.name, str(c.coefficients), f"{c.rmse * 1e3:.4f}", f"{c.heldout * 1e3:.4f}", "taken" if c.chosen else ""]
        for c in data.comparisons
    ]
    columns = [
        TableColumn("Model"),
        TableColumn("Unknowns", "n"),
        TableColumn("Fit error (mm)", "n"),
        TableColumn("Held-out error (mm)", "n"),
        TableColumn("Verdict"),
    ]
    return build_section("models", "Models tried", "Judged by poses they did not see.", build_table(columns, rows))


def _build_readings(data: IdentificationPageData) -> Body:
    residual = data.measured - data.predicted
    shown = np.abs(residual[:, :3] / data.sigma[:, :3]).max(axis=1)
    order = np.argsort(-shown, kind="stable")[:60]
    rows = [
        [
            str(data.line[n]),
            str(data.pose[n]),
            f"{data.load[n]:.0f}",
            *(format_fixed(float(data.measured[n, a]) * 1e3, 3) for a in range(3)),
            *(format_fixed(float(residual[n, a]) * 1e3, 3, signed=True) for a in range(3)),
            f"{shown[n]:.1f}",
            format_fixed(float(data.leverage[n]), 2),
            "left out as an outlier" if data.outlier[n] else "",
        ]
        for n in order
    ]
    columns = [
        TableColumn("Line", "n"),
        TableColumn("Pose", "n"),
        TableColumn("Force (N)", "n"),
        TableColumn("dx (mm)", "n"),
        TableColumn("dy", "n"),
        TableColumn("dz", "n"),
        TableColumn("residual x (mm)", "n"),
        TableColumn("y", "n"),
        TableColumn("z", "n"),
        TableColumn("largest / σ", "n"),
        TableColumn("Leverage", "n"),
        TableColumn("Note"),
    ]
    lead = "The readings that fit worst, with their lines in the data file."
    return build_section("readings", "Readings", lead, build_table(columns, rows))


def _build_run(data: IdentificationPageData) -> Body:
    body = build_table([TableColumn("What"), TableColumn("Value")], data.facts) if data.facts else ""
    return build_section("run", "This run", "What it was made from, with what settings.", body)


def _build_chart_host(name: str, have: set[str]) -> Body:
    return render_part("chart", name) if name in have else ""
