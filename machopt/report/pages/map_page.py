"""``report.html`` of a map: one self-contained page with an interactive picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.charts.map_charts import build_map_specs
from machopt.report.page_shell import STILL_SCENE_SCRIPTS, build_page_html, build_section
from machopt.report.page_types.display_units import LENGTH
from machopt.report.page_types.workspace_map_page_data import MapField, MapLayer, MapPageData
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_pair_table, build_table
from machopt.report.svg.map_picture import build_comparison_svg
from machopt.report.template_rendering import join_markup, render_macro, render_part
from machopt.report.wording.diagnosis_terms import format_significant

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_map_page(path: Path, data: MapPageData) -> None:
    """Write the page; the same data give the same bytes.

    Args:
        path: The file to write.
        data: The data of the page.
    """
    path.write_text(build_map_html(data), encoding="utf-8", newline="\n")


def build_map_html(data: MapPageData) -> str:
    """Return the page.

    Args:
        data: The data of the page.
    """
    specs = build_map_specs(data)
    charts = join_markup(render_part("chart", c["id"]) for c in specs["charts"])
    if specs["view"] is not None and specs["field"] is None:
        charts += render_macro("report.html", "view")
    if specs["arms"] is not None:
        charts += render_macro("map.html", "arms")
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("map", "Map", _build_map(data, specs["view"] is not None) if specs["field"] is not None else ""),
        ("curves", "Curves", build_section("curves", "Curves", _CURVE_NOTES[data.kind == "line"], charts)),
        ("measured", "Measured", _build_measured(data)),
        ("numbers", "Numbers", _build_numbers(data)),
        ("meaning", "What it means", _build_meaning(data)),
        ("run", "This run", _build_run(data)),
    ]
    return build_page_html(
        data.title,
        (("Cell", data.cell), ("Map", data.place)),
        sections,
        specs,
        scripts=("chart.js", *_PICTURE_SCRIPTS[specs["view"] is not None], "arm.js", "field.js", "start_map.js"),
        footer=f"machopt {data.version}. Lengths mm, angles deg, stiffness N/mm as in map.csv. "
        f"x, y, z are those of {data.frame}.",
    )


MIN_FIXED_VALUE = 0.01  # of the shown unit; below that three decimals say nothing
MAX_FIXED_VALUE = 1e7  # above it every digit of a stiffness near a singularity would be written out
_PICTURE_SCRIPTS = {
    False: ("heatmap.js",),
    True: (*STILL_SCENE_SCRIPTS, "mapstand.js"),
}  # without and with three dimensions
_CURVE_NOTES = {
    True: "The tool keeps its orientation and the arm its branch; a gap is a place that cannot be reached that way.",
    False: "One joint moves, the others are fixed.",
}


def _build_verdict(data: MapPageData) -> Body:
    reached = [int((layer.reason == 0).sum()) for layer in data.layers]
    tone = "good" if any(reached) else "bad"
    badge, sentence = "MAPPED" if any(reached) else "OUT OF REACH", f"{data.verdict[0].upper()}{data.verdict[1:]}."
    return render_part(
        "verdict", "verdict", tone, badge, sentence, data.warnings, _list_key_figures(data) if any(reached) else []
    )


def _list_key_figures(data: MapPageData) -> list[tuple[str, str, str, str]]:
    f = data.shown_field
    out: list[tuple[str, str, str, str]] = []
    for layer in data.layers:
        share = (layer.reason == 0).mean()
        if data.kind != "joints":
            out.append((f"Reached, {layer.title}", f"{100 * share:.0f}", "%", f"of {len(layer.reason):,} samples"))
        if layer.best >= 0:
            value = layer.value[f.key]
            out.append(
                (
                    f"Best place, {layer.title}" if data.kind != "joints" else "Best posture",
                    f.display_unit.format_value(float(value[layer.best])),
                    f.display_unit.name,
                    format_sample_location(data, layer.best),
                )
            )
            known = value[np.isfinite(value)]
            out.append(
                (
                    f"Median, {layer.title}" if data.kind != "joints" else "Median",
                    f.display_unit.format_value(float(np.median(known))),
                    f.display_unit.name,
                    f.name[0].lower() + f.name[1:],
                )
            )
    gain = next((layer.value["gain"] for layer in data.layers if "gain" in layer.value), None)
    if gain is not None and np.isfinite(gain).any():
        share = f"{100 * float(np.nanmedian(gain)):.0f}"
        out.append(("Gain by turning", share, "%", "median, against the given rotation"))
    return out


def format_sample_location(data: MapPageData, row: int) -> str:
    """Return the coordinates of a sample as text.

    Args:
        data: The data of the page.
        row: Number of the sample, from 0.
    """
    index = np.unravel_index(row, data.shape)
    return (
        ", ".join(
            f"{a.name} {a.display_unit.format_value(float(a.values[i]))}" for a, i in zip(data.axes, index, strict=True)
        )
        + f" {data.axes[0].display_unit.name}"
    )


def _build_map(data: MapPageData, in_space: bool) -> Body:
    lead = (
        "Move over the map to read every quantity and to see the arm; click to select a position. Bright is good, "
        "dark is "
        "poor; grey and hatched places have no posture, and the hatching gives the reason."
    )
    if data.kind != "joints":
        lead += (
            " Where several branches reach a place the map shows one posture for all quantities, so they belong "
            "together."
        )
    body = render_macro("map.html", "field")
    if in_space:
        lead += " The view below the map shows the robot at that position."
        body += render_macro("report.html", "view")
    return build_section("map", data.place, lead, body)


def _build_measured(data: MapPageData) -> Body:
    m = data.measured
    if m is None:
        return ""
    rows = []
    for axis in m.axes:
        e = m.errors[axis]
        rows.append(
            [
                f"k_{axis}",
                *(
                    _format_percent(e[name])
                    for name in ("left_out_rms", "left_out_median", "model_rms", "model_median", "held_rms")
                ),
            ]
        )
    names = ("From the others, rms error", "median", "Model 1/(eᵀCe), rms error", "median", "K_m, rms error")
    heads = [TableColumn("Direction"), *(TableColumn(name, "n") for name in names)]
    summary = build_table(heads, rows)
    unit = 1e-3
    columns = [TableColumn("x (mm)", "n"), TableColumn("y", "n"), TableColumn("z", "n")]
    for axis in m.axes:
        columns += [
            TableColumn(f"k_{axis} measured (N/mm)", "n"),
            TableColumn("from the others", "n"),
            TableColumn("model", "n"),
            TableColumn("K_m", "n"),
        ]
    listed = []
    for i in range(len(m.position)):
        row = [LENGTH.format_value(float(v)) for v in m.position[i]]
        for f in range(len(m.axes)):
            row += [
                _format_integer(float(source[i, f]) * unit)
                for source in (m.measured, m.left_out, m.model, m.held_stiffness)
            ]
        listed.append(row)
    readings = build_folded_block("Readings", len(listed), build_table(columns, listed))
    postures = "at the readings' own joints" if m.from_joints else "at the postures this map chooses"
    lead = render_macro("map.html", "measured_lead", len(m.position), m.file, f"{m.power:g}", postures)
    pictures = [build_comparison_svg(data, axis) for axis in m.axes] if len(data.axes) == 2 else []
    body = summary + readings + render_macro("map.html", "pictures", pictures)
    return build_section("measured", "Measured stiffness", lead, body)


def _format_percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _format_integer(value: float) -> str:
    return f"{value:,.0f}" if np.isfinite(value) else "–"


def _build_numbers(data: MapPageData) -> Body:
    columns = [
        TableColumn("Quantity"),
        TableColumn("Unit"),
        TableColumn("Least", "n"),
        TableColumn("Where"),
        TableColumn("Median", "n"),
        TableColumn("Largest", "n"),
        TableColumn("Where"),
    ]
    body: Body = ""
    for layer in data.layers:
        rows = [row for f in data.fields if f.key in layer.value for row in _build_row(data, f, layer)]
        body += render_part("heading", layer.title[0].upper() + layer.title[1:]) + _build_reasons(data, layer)
        body += build_table(columns, rows) if rows else ""
    return build_section("numbers", "Numbers", "Over all samples that have a posture.", body)


def _build_row(data: MapPageData, f: MapField, layer: MapLayer) -> list[list[str]]:
    value = layer.value[f.key]
    if not np.isfinite(value).any():
        return []
    low, high = int(np.nanargmin(value)), int(np.nanargmax(value))
    small = (
        abs(float(value[high]) * f.display_unit.factor) < MIN_FIXED_VALUE
    )  # of what is small by nature, digits that mean something

    def text(v: float) -> str:
        shown = v * f.display_unit.factor
        if abs(shown) > MAX_FIXED_VALUE:
            return format_significant(shown)
        return f"{shown:.3g}".replace("-", "−") if small else f.display_unit.format_value(v)

    return [
        [
            f.name,
            f.display_unit.name,
            text(float(value[low])),
            format_sample_location(data, low),
            text(float(np.nanmedian(value))),
            text(float(value[high])),
            format_sample_location(data, high),
        ]
    ]


def _build_reasons(data: MapPageData, layer: MapLayer) -> Markup:
    codes, counts = np.unique(layer.reason, return_counts=True)
    parts = [f"{data.reasons[c]} {100 * n / len(layer.reason):.1f} %" for c, n in zip(codes, counts, strict=True)]
    return render_part("lead", f"{', '.join(parts)}.")


def _build_meaning(data: MapPageData) -> Body:
    rows = [[f.name, f.note] for f in data.fields]
    body = build_table([TableColumn("Quantity"), TableColumn("What it is, and when it does not hold", "why")], rows)
    return build_section("meaning", "What it means", "Every quantity of the map.", body)


def _build_run(data: MapPageData) -> Body:
    body = build_folded_block("Options", len(data.options), build_pair_table("Option", "Value", data.options))
    body += build_folded_block("Inputs", len(data.hashes), build_pair_table("File", "SHA-256", data.hashes))
    return build_section("run", "This run", "What it was made from.", body)
