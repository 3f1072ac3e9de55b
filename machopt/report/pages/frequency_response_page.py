"""Page of ``machopt identify`` with frequency responses: joints, modes, measured against fitted responses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machopt.report.charts.point_reduction import round_for_json
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.frequency_response_page_data import FrequencyResponsePageData
from machopt.report.pages.report_tables import TableColumn, build_table
from machopt.report.pages.run_section import build_run_section
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

SHOWN_RESPONSES = 12  # charts; further ones stand in the table
MEASURED, FITTED = "#1552b8", "#d9730d"


def write_frequency_response_page(path: Path, data: FrequencyResponsePageData) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        data: what to show.
    """
    path.write_text(build_frequency_response_html(data), encoding="utf-8", newline="\n")


def build_frequency_response_html(data: FrequencyResponsePageData) -> str:
    """Return the page; the same data give the same bytes.

    Args:
        data: what to show.
    """
    document = data.document
    sections = [
        ("joints", "Joints", _build_joints(data)),
        ("modes", "Modes", _build_modes(data)),
        ("responses", "Responses", _build_responses(data)),
        ("run", "This run", build_run_section(data.document.warnings, data.document.inputs)),
    ]
    return build_page_html(
        f"Stiffness and damping of {document.cell} from frequency responses",
        (("Cell", document.cell), ("Recording", document.recording)),
        sections,
        {"xy": _build_charts(data)},
        scripts=("chart.js", "xy.js", "start_xy.js"),
        footer=f"machopt {document.version}. Intervals {100 * document.interval_level:g} %.",
    )


def _build_joints(data: FrequencyResponsePageData) -> Body:
    document = data.document
    unit = "N·m·s/rad" if document.damping_law == "viscous" else "loss factor"
    level = f"{100 * document.interval_level:g} % interval"
    columns = [
        TableColumn("Joint", "n"),
        TableColumn("Stiffness (N·m/rad)", "n"),
        TableColumn(level, "n"),
        TableColumn(f"Damping ({unit})", "n"),
        TableColumn(level, "n"),
        TableColumn("Note"),
    ]
    rows = []
    for j in document.joints:
        (low, high), (first, last) = j.interval, j.damping_interval
        spread = f"above {low:.3g}" if high is None else f"{low:.4g} … {high:.4g}"
        known = first is not None and last is not None
        damping = [f"{j.damping:.4g}", f"{first:.4g} … {last:.4g}"] if known else ["–", "not determined"]
        rows.append([str(j.joint), f"{j.k_Nm_per_rad:.4g}", spread, *damping, j.reason])
    lead = (
        f"From {len(document.responses)} responses in {document.poses} poses. Damping is {document.damping_law}: the "
        f"logarithm of its likelihood is {document.log_likelihood_gain:.3g} above that of the other law."
    )
    return build_section("joints", "Stiffness and damping of the joints", lead, build_table(columns, rows))


def _build_modes(data: FrequencyResponsePageData) -> Body:
    columns = [
        TableColumn("Mode", "n"),
        TableColumn("Frequency over the poses (Hz)", "n"),
        TableColumn("Damping (%)", "n"),
        TableColumn("Over the poses (%)", "n"),
        TableColumn("Note"),
    ]
    rows = []
    for mode in data.document.modes:
        sigma = "" if mode.sigma_percent is None else f" ± {mode.sigma_percent:.2g}"
        rows.append(
            [
                str(mode.mode),
                f"{mode.frequency_Hz[0]:.1f} … {mode.frequency_Hz[1]:.1f}",
                f"{mode.damping_percent:.2f}{sigma}",
                f"{mode.damping_range_percent[0]:.2f} … {mode.damping_range_percent[1]:.2f}",
                "" if mode.determined else "not determined",
            ]
        )
    lead = "Damping ratio: mean over the measured poses ± 1 σ. The first determined modes go into process.yaml."
    return build_section("modes", "Modes of the arm", lead, build_table(columns, rows))


def _build_responses(data: FrequencyResponsePageData) -> Body:
    columns = [
        TableColumn("Response"),
        TableColumn("Excitation", "n"),
        TableColumn("Sensor", "n"),
        TableColumn("Frequencies", "n"),
        TableColumn("Residual (µm/N)", "n"),
        TableColumn("Explained", "n"),
    ]
    rows = [
        [
            f"{n}: {one.place}",
            _format_direction(one.excitation),
            _format_direction(one.response),
            str(one.lines),
            f"{1e6 * one.residual_m_per_N:.3g}",
            f"{100 * one.explained_share:.1f} %",
        ]
        for n, one in enumerate(data.document.responses, 1)
    ]
    body: Body = build_table(columns, rows)
    shown = range(min(data.recording.responses, SHOWN_RESPONSES))
    body += render_part("grid", 2, [render_part("chart", f"c-response-{n}") for n in shown])
    lead = "Marks are measured, lines are the fit. Directions in the axes of direction_frame."
    return build_section("responses", "Measured and fitted responses", lead, body)


def _format_direction(direction: tuple[float, ...]) -> str:
    return ", ".join(f"{v:.3g}" for v in direction)


def _build_charts(data: FrequencyResponsePageData) -> list[dict[str, Any]]:
    charts = []
    for n in range(min(data.recording.responses, SHOWN_RESPONSES)):
        rows = np.flatnonzero(data.recording.group == n)
        rows = rows[np.argsort(data.recording.frequency[rows])]
        x = round_for_json(data.recording.frequency[rows])
        measured = round_for_json(1e6 * np.abs(data.recording.receptance[rows]))
        fitted = round_for_json(1e6 * np.abs(data.predicted[rows]))
        charts.append(
            {
                "id": f"c-response-{n}",
                "title": f"Response {n + 1}",
                "xlabel": "Frequency (Hz)",
                "ylabel": "Receptance (µm/N)",
                "height": 320,
                "layers": [
                    {"type": "points", "name": "measured", "color": MEASURED, "x": x, "y": measured},
                    {"type": "line", "name": "fit", "color": FITTED, "x": x, "y": fitted},
                ],
            }
        )
    return charts
