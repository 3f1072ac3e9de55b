"""The page of ``machopt identify``: which joints the data see, how well, and what to distrust."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.display import fixed
from machopt.report.identification import Coefficient, IdentificationPage
from machopt.report.identification_charts import (
    ARCMIN,
    ELLIPSES,
    MOST_HALF,
    charts_of,
)
from machopt.report.shell import page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_identification(path: Path, data: IdentificationPage) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show; parts that are missing leave no gap.
    """
    path.write_text(identification_html(data), encoding="utf-8", newline="\n")


def identification_html(data: IdentificationPage) -> str:
    """The page as text; the same data give the same bytes."""
    charts = charts_of(data)
    have = {c["id"] for c in charts}
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("joints", "Joints", _joints(data, have)),
        ("fit", "Measured and predicted", _fit(data, have)),
        ("uncertainty", "Uncertainty", _uncertainty(data, have)),
        ("grid", "Grid", _grid(data, have)),
        ("models", "Models", _models(data)),
        ("readings", "Readings", _readings(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
        data.title,
        (("Cell", data.cell), ("Recording", data.recording)),
        sections,
        {"xy": charts},
        scripts=("chart.js", "xy.js", "start_xy.js"),
        footer=f"machopt {data.version}. Lengths mm, angles mrad, stiffness N·m/rad. Bars of "
        f"stiffness are {100 * data.level:g} % intervals, ellipses 90 % regions. Click a legend entry to hide it.",
    )


def stiffness_text(k: float, digits: int = 3) -> str:
    """N·m/rad with so many digits: 3.80e6."""
    if not math.isfinite(k):
        return "∞" if k > 0 else "–"
    if k < 1e4:
        return f"{k:.0f}" if k >= 1e3 else f"{k:.{digits}g}"
    return f"{k / 10 ** math.floor(math.log10(k)):.{digits - 1}f}e{math.floor(math.log10(k))}"


def _verdict(data: IdentificationPage) -> Body:
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
    return part("verdict", "verdict", data.tone, data.badge, data.sentence, data.cautions, cards)


def _coefficient_rows(rows: tuple[Coefficient, ...], *, arcmin: bool) -> list[list[Body]]:
    out = []
    for c in rows:
        spread = f"{stiffness_text(c.low)} … {stiffness_text(c.high)}"
        half = 50.0 * (c.high - c.low) / c.value if math.isfinite(c.high) and c.value else math.nan
        half = half if half <= MOST_HALF else math.nan  # so wide that the two sides are nothing alike
        name = c.name.replace(" ", "\u00a0", 1)  # "joint 1" on one line
        out.append(
            [
                name,
                stiffness_text(c.value),
                *([stiffness_text(c.value * ARCMIN)] if arcmin else [c.unit]),
                spread,
                f"± {half:.1f} %" if math.isfinite(half) else "–",
                stiffness_text(c.prior),
                part("toned", "pass", "yes") if c.identified else part("toned", "fail", "no"),
                c.reason,
            ]
        )
    return out


def _joints(data: IdentificationPage, have: set[str]) -> Body:
    columns = [
        Column("Joint"),
        Column("k (N·m/rad)", "n"),
        Column("N·m/arcmin", "n"),
        Column(f"{100 * data.level:g} % interval", "n"),
        Column("Half of it", "n"),
        Column("Before (N·m/rad)", "n"),
        Column("Identified", "html"),
        Column("Why", "why"),
    ]
    body: Body = table(columns, _coefficient_rows(data.joints, arcmin=True))
    if data.terms:
        columns = [Column("Further physics"), Column("Value", "n"), Column("Unit"), *columns[3:]]
        body += table(columns, _coefficient_rows(data.terms, arcmin=False))
    body += _host("i-joints", have)
    lead = (
        "A joint that no reading loads, or whose effect cannot be told from another's, is not fitted to noise: it is "
        "marked, and keeps the value it had before or a stated bound."
    )
    return section("joints", "Joint stiffness", lead, body)


def _fit(data: IdentificationPage, have: set[str]) -> Body:
    both = [part("chart", name) for name in ("i-parity", "i-parity-rot") if name in have]
    body: Body = part("grid", 2, both) if "i-parity-rot" in have else both[0]
    body += _host("i-residual", have) + _host("i-residual-rot", have)
    body += part("grid", 2, [_host("i-load", have), _host("i-heldout", have)])
    lead = "Points on the diagonal are explained; the bars are the standard uncertainty of the reading."
    return section("fit", "Measured and predicted", lead, body)


def _uncertainty(data: IdentificationPage, have: set[str]) -> Body:
    body: Body = ""
    for name, count, title in (
        ("i-ellipse", ELLIPSES, "Pairs of joints with the strongest correlation, 90 % ellipses of the compliances"),
        ("i-subset", 6, "Random subsets of the tests: median and 5–95 % of the identified stiffness"),
    ):
        small = [part("chart", f"{name}{n}") for n in range(count) if f"{name}{n}" in have]
        body += part("heading", title) + part("grid", 3, small) if small else ""
    if data.monte_carlo is not None:
        rows = [
            [c.name, f"± {100 * s:.1f} %" if math.isfinite(s) else "–"]
            for c, s in zip(data.joints, data.monte_carlo, strict=True)
        ]
        body += part("heading", "Repeated with measurement errors drawn anew: one standard deviation of the stiffness")
        body += part(
            "lead",
            "Errors as the recording states them, and the same fit: what the model lacks is not in it. Where the "
            "readings scatter more than stated, the intervals above are the ones to trust.",
        )
        body += table([Column("Joint"), Column("Spread", "n")], rows)
    return section("uncertainty", "Uncertainty", "What other readings of the same quality would have given.", body)


def _grid(data: IdentificationPage, have: set[str]) -> Body:
    if data.grid is None:
        return ""
    small = [_host(f"i-grid{j}", have) for j in range(6)]
    g = data.grid
    rows = [
        [
            str(n),
            *(f"{v * 1e3:.0f}" for v in g.centre[n]),
            f"{g.readings[n]:.1f}",
            *(f"{stiffness_text(g.k[n, j])} ± {100 * g.std[n, j] / g.k[n, j]:.0f} %" for j in range(6)),
        ]
        for n in range(len(g.k))
    ]
    columns = [
        Column("Cell", "n"),
        *(Column(f"{a} (mm)", "n") for a in "xyz"),
        Column("Readings", "n"),
        *(Column(f"k{j + 1}", "n") for j in range(6)),
    ]
    body = part("grid", 3, small) + folded("Cells", len(rows), table(columns, rows))
    lead = (
        f"{g.shape[0]} × {g.shape[1]} × {g.shape[2]} cells. A cell with few readings stays near the constant value "
        "(dashed) and its bar grows to the spread found between cells."
    )
    return section("grid", "Stiffness per grid cell", lead, body)


def _models(data: IdentificationPage) -> Body:
    if not data.comparisons:
        return ""
    rows = [
        [c.name, str(c.coefficients), f"{c.rmse * 1e3:.4f}", f"{c.heldout * 1e3:.4f}", "taken" if c.chosen else ""]
        for c in data.comparisons
    ]
    columns = [
        Column("Model"),
        Column("Unknowns", "n"),
        Column("Fit error (mm)", "n"),
        Column("Held-out error (mm)", "n"),
        Column("Verdict"),
    ]
    return section("models", "Models tried", "Judged by poses they did not see.", table(columns, rows))


def _readings(data: IdentificationPage) -> Body:
    residual = data.measured - data.predicted
    shown = np.abs(residual[:, :3] / data.sigma[:, :3]).max(axis=1)
    order = np.argsort(-shown, kind="stable")[:60]
    rows = [
        [
            str(data.line[n]),
            str(data.pose[n]),
            f"{data.load[n]:.0f}",
            *(fixed(float(data.measured[n, a]) * 1e3, 3) for a in range(3)),
            *(fixed(float(residual[n, a]) * 1e3, 3, signed=True) for a in range(3)),
            f"{shown[n]:.1f}",
            fixed(float(data.leverage[n]), 2),
            "left out as an outlier" if data.outlier[n] else "",
        ]
        for n in order
    ]
    columns = [
        Column("Line", "n"),
        Column("Pose", "n"),
        Column("Force (N)", "n"),
        Column("dx (mm)", "n"),
        Column("dy", "n"),
        Column("dz", "n"),
        Column("residual x (mm)", "n"),
        Column("y", "n"),
        Column("z", "n"),
        Column("largest / σ", "n"),
        Column("Leverage", "n"),
        Column("Note"),
    ]
    lead = "The readings that fit worst, with the line of the data file each stands on."
    return section("readings", "Readings", lead, table(columns, rows))


def _run(data: IdentificationPage) -> Body:
    body = table([Column("What"), Column("Value")], data.facts) if data.facts else ""
    return section("run", "This run", "What it was made from, with what settings.", body)


def _host(name: str, have: set[str]) -> Body:
    return part("chart", name) if name in have else ""
