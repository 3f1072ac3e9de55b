"""Page of ``machopt process``: coefficients with intervals, measured against predicted forces, cuts left out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.coefficients_page_data import CoefficientsPageData
from machopt.report.pages.report_tables import TableColumn, build_table
from machopt.report.pages.run_section import build_run_section
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

SHOWN_CUTS = 6  # of a waveform recording: further ones look alike
COLORS = (("travel", "#1552b8"), ("normal", "#d9730d"), ("axial", "#2c8a57"))


def write_coefficients_page(path: Path, data: CoefficientsPageData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show.
    """
    path.write_text(build_coefficients_html(data), encoding="utf-8", newline="\n")


def build_coefficients_html(data: CoefficientsPageData) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: what to show.
    """
    document = data.document
    sections = [
        ("coefficients", "Coefficients", _build_coefficients(data)),
        ("waveform", "Waveform", _build_waveform(data)),
        ("forces", "Forces", _build_forces()),
        ("cuts", "Cuts left out", _build_excluded(data)),
        ("run", "This run", build_run_section(data.document.warnings, data.document.inputs)),
    ]
    return build_page_html(
        f"Cutting coefficients of {document.material}",
        (("Cell", document.cell), ("Recording", document.recording)),
        sections,
        {"xy": [*_build_waveform_charts(data), _build_force_chart(data), _build_parity_chart(data)]},
        scripts=("chart.js", "xy.js", "start_xy.js"),
        footer=f"machopt {document.version}. Forces N, on the tool. Intervals {100 * document.interval_level:g} %.",
    )


def _build_coefficients(data: CoefficientsPageData) -> Body:
    document = data.document
    columns = [
        TableColumn("Coefficient"),
        TableColumn("Value", "n"),
        TableColumn("Unit"),
        TableColumn(f"{100 * document.interval_level:g} % interval", "n"),
        TableColumn("Note"),
    ]
    rows = []
    for entry in document.coefficients:
        low, high = entry.interval
        spread = "–" if low is None or high is None else f"{low:.4g} … {high:.4g}"
        note = "set to 0: negative within its interval" if entry.fixed else ""
        note = note or ("not determined" if low is not None and low < 0.0 else "")
        rows.append([entry.name, f"{entry.value:.4g}", entry.unit, spread, note])
    quality = [
        [
            entry.component,
            f"{entry.residual_N:.3g}" if entry.residual_N is not None else "–",
            f"{100 * entry.explained_share:.1f} %" if entry.explained_share is not None else "–",
        ]
        for entry in document.components
    ]
    body: Body = build_table(columns, rows)
    body += build_table(
        [TableColumn("Component"), TableColumn("Residual, 1 σ (N)", "n"), TableColumn("Explained", "n")], quality
    )
    low, high = document.feed_per_tooth_mm
    lead = (
        f"From {document.used} of {document.cuts} cuts with {low:.3g} to {high:.3g} mm per tooth. "
        f"Spread of a predicted mean force: {document.spread_percent:.1f} %. The coefficients reproduce means over "
        "a revolution. Measured peaks may be higher: run-out and the dynamometer add to them."
    )
    return build_section("coefficients", "Coefficients", lead, body)


def _build_waveform(data: CoefficientsPageData) -> Body:
    section = data.document.waveform
    if section is None or data.waveform is None:
        return ""
    facts = []
    if section.runout is not None:
        low, high = section.runout.interval_mm
        facts.append(["Radial run-out", f"{section.runout.amplitude_mm:.4f} mm ({low:.4f} … {high:.4f})"])
        first, last = section.runout.angle_interval_deg
        angle = section.runout.angle_deg
        text = "not determined" if angle is None else f"{angle:.1f}° from tooth 0 ({first:.1f} … {last:.1f})"
        facts.append(["Angle of the run-out", text])
    facts.append(["Samples", str(section.samples)])
    facts.append(["Order of the autoregression of the residuals", str(section.noise_order)])
    text = "significant" if section.misfit_significant else "not significant"
    facts.append(["Repeatable part of the residuals over noise", f"{section.misfit_ratio:.2f}, {text}"])
    columns = [TableColumn("Cut"), TableColumn("Spindle (rpm)", "n"), TableColumn("Offset of tooth 0 (°)", "n")]
    rows = [
        [cut.place, f"{cut.spindle_rpm:.1f}", f"{cut.offset_deg:.2f} ± {cut.offset_sigma_deg:.2f}"]
        for cut in section.cuts
    ]
    body: Body = build_table([TableColumn("What"), TableColumn("Value")], facts) + build_table(columns, rows)
    ids = [f"c-waveform-{n}" for n in range(min(len(data.waveform.folded), SHOWN_CUTS))]
    body += render_part("grid", 2, [render_part("chart", name) for name in ids])
    lead = (
        "Marks are the measured forces, averaged at each rotation of tooth 0; lines are the fit. "
        f"Intervals {100 * data.document.interval_level:g} %, offsets ± 1 σ."
    )
    return build_section("waveform", "Measured and fitted waveforms", lead, body)


def _build_waveform_charts(data: CoefficientsPageData) -> list[dict[str, Any]]:
    charts: list[dict[str, Any]] = []
    for n, cut in enumerate(() if data.waveform is None else data.waveform.folded[:SHOWN_CUTS]):
        angle, layers = round_for_json(np.degrees(cut.angle)), []
        for f, (name, color) in enumerate(COLORS):
            layers.append(
                {"type": "points", "name": name, "color": color, "x": angle, "y": round_for_json(cut.measured[:, f])}
            )
            layers.append({"type": "line", "color": color, "x": angle, "y": round_for_json(cut.predicted[:, f])})
        charts.append(
            {
                "id": f"c-waveform-{n}",
                "title": f"Cut {n + 1}: {1e3 * data.feed_per_tooth[n]:.3g} mm per tooth",
                "xlabel": "Rotation of tooth 0 (°)",
                "ylabel": "Force (N)",
                "height": 380,
                "layers": layers,
            }
        )
    return charts


def _build_forces() -> Body:
    body = render_part("grid", 2, [render_part("chart", "c-feed"), render_part("chart", "c-parity")])
    lead = "Filled marks are measured, hollow ones the model. Points on the diagonal are explained."
    return build_section("forces", "Measured and predicted mean forces", lead, body)


def _build_excluded(data: CoefficientsPageData) -> Body:
    rows = [[entry.place, entry.reason] for entry in data.document.excluded]
    if not rows:
        return ""
    body = build_table([TableColumn("Cut"), TableColumn("Reason")], rows)
    return build_section("cuts", "Cuts left out", "They take no part in the coefficients.", body)


def _build_force_chart(data: CoefficientsPageData) -> dict[str, Any]:
    layers: list[dict[str, Any]] = []
    for n, (name, color) in enumerate(COLORS):
        for text, values, style in (
            (name, data.measured, {}),
            (f"{name}, model", data.predicted, {"mark": "diamond", "hollow": True}),
        ):
            place = {
                "x": round_for_json(1e3 * data.feed_per_tooth[data.used]),
                "y": round_for_json(values[data.used, n]),
            }
            layers.append({"type": "points", "name": text, "color": color, **style, **place})
    return {
        "id": "c-feed",
        "title": "Mean force over feed per tooth",
        "xlabel": "Feed per tooth (mm)",
        "ylabel": "Mean force (N)",
        "height": 380,
        "layers": layers,
    }


def _build_parity_chart(data: CoefficientsPageData) -> dict[str, Any]:
    both = np.concatenate([data.measured[data.used].ravel(), data.predicted[data.used].ravel()])
    ends = [float(both.min()), float(both.max())]
    layers: list[dict[str, Any]] = [{"type": "line", "color": "#7a8490", "dash": "5 4", "x": ends, "y": ends}]
    for n, (name, color) in enumerate(COLORS):
        layers.append(
            {
                "type": "points",
                "name": name,
                "color": color,
                "x": round_for_json(data.predicted[data.used, n]),
                "y": round_for_json(data.measured[data.used, n]),
            }
        )
    return {
        "id": "c-parity",
        "title": "Measured against predicted",
        "xlabel": "Predicted (N)",
        "ylabel": "Measured (N)",
        "equal": True,
        "height": 380,
        "layers": layers,
    }
