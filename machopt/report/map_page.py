"""``report.html`` of a map: one self-contained page with a picture that answers under the pointer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.report.diagnosis_words import digits
from machopt.report.display import LENGTH
from machopt.report.map_data import MapData, MapField, MapLayer
from machopt.report.map_figures import map_specs
from machopt.report.map_svg import pair_svg
from machopt.report.shell import STILL_SCENE, page_html, section
from machopt.report.tables import Column, folded, pairs, table
from machopt.report.template import fragment, joined, part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def write_map_page(path: Path, data: MapData) -> None:
    """Write the page; the same data give the same bytes."""
    path.write_text(map_page_html(data), encoding="utf-8", newline="\n")


def map_page_html(data: MapData) -> str:
    """The page as text."""
    specs = map_specs(data)
    charts = joined(part("chart", c["id"]) for c in specs["charts"])
    if specs["view"] is not None and specs["field"] is None:
        charts += fragment("report.html", "view")
    if specs["arms"] is not None:
        charts += fragment("map.html", "arms")
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("map", "Map", _map(data, specs["view"] is not None) if specs["field"] is not None else ""),
        ("curves", "Curves", section("curves", "Curves", _CURVES[data.kind == "line"], charts)),
        ("measured", "Measured", _measured(data)),
        ("numbers", "Numbers", _numbers(data)),
        ("meaning", "What it means", _meaning(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
        data.title,
        (("Cell", data.cell), ("Map", data.place)),
        sections,
        specs,
        scripts=("chart.js", *_DRAWN[specs["view"] is not None], "arm.js", "field.js", "start_map.js"),
        footer=f"machopt {data.version}. Lengths mm, angles deg, stiffness N/mm as in map.csv. "
        f"x, y, z are those of {data.frame}.",
    )


SMALL = 0.01  # of the shown unit; below that three decimals say nothing
LARGE = 1e7  # above it every digit of a stiffness near a singularity would be written out
_DRAWN = {False: ("heatmap.js",), True: (*STILL_SCENE, "mapstand.js")}  # without and with three dimensions
_CURVES = {
    True: "The tool keeps its orientation and the arm its branch; a gap is a place that cannot be reached that way.",
    False: "One joint moves, the others stand still.",
}


def _verdict(data: MapData) -> Body:
    reached = [int((layer.reason == 0).sum()) for layer in data.layers]
    tone = "good" if any(reached) else "bad"
    badge, said = "MAPPED" if any(reached) else "OUT OF REACH", f"{data.verdict[0].upper()}{data.verdict[1:]}."
    return part("verdict", "verdict", tone, badge, said, data.warnings, _cards(data) if any(reached) else [])


def _cards(data: MapData) -> list[tuple[str, str, str, str]]:
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
                    f.shown.text(float(value[layer.best])),
                    f.shown.name,
                    where(data, layer.best),
                )
            )
            known = value[np.isfinite(value)]
            out.append(
                (
                    f"Median, {layer.title}" if data.kind != "joints" else "Median",
                    f.shown.text(float(np.median(known))),
                    f.shown.name,
                    f.name[0].lower() + f.name[1:],
                )
            )
    gain = next((layer.value["gain"] for layer in data.layers if "gain" in layer.value), None)
    if gain is not None and np.isfinite(gain).any():
        share = f"{100 * float(np.nanmedian(gain)):.0f}"
        out.append(("Gain by turning", share, "%", "median, against the given rotation"))
    return out


def where(data: MapData, row: int) -> str:
    """Coordinates of a sample in words."""
    index = np.unravel_index(row, data.shape)
    return (
        ", ".join(f"{a.name} {a.shown.text(float(a.values[i]))}" for a, i in zip(data.axes, index, strict=True))
        + f" {data.axes[0].shown.name}"
    )


def _map(data: MapData, in_space: bool) -> Body:
    lead = (
        "Move over the map to read every quantity and to see the arm; click to keep a place. Bright is good, dark is "
        "poor; grey and hatched places have no posture, and the hatching says why."
    )
    if data.kind != "joints":
        lead += (
            " Where several branches reach a place the map shows one posture for all quantities, so they belong "
            "together."
        )
    body = fragment("map.html", "field")
    if in_space:
        lead += " Below the map the robot stands at that place."
        body += fragment("report.html", "view")
    return section("map", data.place, lead, body)


def _measured(data: MapData) -> Body:
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
                    _percent(e[name])
                    for name in ("left_out_rms", "left_out_median", "model_rms", "model_median", "held_rms")
                ),
            ]
        )
    names = ("From the others, rms error", "median", "Model 1/(eᵀCe), rms error", "median", "K_m, rms error")
    heads = [Column("Direction"), *(Column(name, "n") for name in names)]
    summary = table(heads, rows)
    unit = 1e-3
    columns = [Column("x (mm)", "n"), Column("y", "n"), Column("z", "n")]
    for axis in m.axes:
        columns += [
            Column(f"k_{axis} measured (N/mm)", "n"),
            Column("from the others", "n"),
            Column("model", "n"),
            Column("K_m", "n"),
        ]
    listed = []
    for i in range(len(m.position)):
        row = [LENGTH.text(float(v)) for v in m.position[i]]
        for f in range(len(m.axes)):
            row += [_whole(float(source[i, f]) * unit) for source in (m.measured, m.left_out, m.model, m.held)]
        listed.append(row)
    readings = folded("Readings", len(listed), table(columns, listed))
    postures = "at the readings' own joints" if m.from_joints else "at the postures this map chooses"
    lead = fragment("map.html", "measured_lead", len(m.position), m.file, f"{m.power:g}", postures)
    pictures = [pair_svg(data, axis) for axis in m.axes] if len(data.axes) == 2 else []
    body = summary + readings + fragment("map.html", "pictures", pictures)
    return section("measured", "Measured stiffness", lead, body)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _whole(value: float) -> str:
    return f"{value:,.0f}" if np.isfinite(value) else "–"


def _numbers(data: MapData) -> Body:
    columns = [
        Column("Quantity"),
        Column("Unit"),
        Column("Least", "n"),
        Column("Where"),
        Column("Median", "n"),
        Column("Largest", "n"),
        Column("Where"),
    ]
    body: Body = ""
    for layer in data.layers:
        rows = [row for f in data.fields if f.key in layer.value for row in _row(data, f, layer)]
        body += part("heading", layer.title[0].upper() + layer.title[1:]) + _reasons(data, layer)
        body += table(columns, rows) if rows else ""
    return section("numbers", "Numbers", "Over all samples that have a posture.", body)


def _row(data: MapData, f: MapField, layer: MapLayer) -> list[list[str]]:
    value = layer.value[f.key]
    if not np.isfinite(value).any():
        return []
    low, high = int(np.nanargmin(value)), int(np.nanargmax(value))
    small = abs(float(value[high]) * f.shown.factor) < SMALL  # of what is small by nature, digits that mean something

    def text(v: float) -> str:
        shown = v * f.shown.factor
        if abs(shown) > LARGE:
            return digits(shown)
        return f"{shown:.3g}".replace("-", "−") if small else f.shown.text(v)

    return [
        [
            f.name,
            f.shown.name,
            text(float(value[low])),
            where(data, low),
            text(float(np.nanmedian(value))),
            text(float(value[high])),
            where(data, high),
        ]
    ]


def _reasons(data: MapData, layer: MapLayer) -> Markup:
    codes, counts = np.unique(layer.reason, return_counts=True)
    parts = [f"{data.reasons[c]} {100 * n / len(layer.reason):.1f} %" for c, n in zip(codes, counts, strict=True)]
    return part("lead", f"{', '.join(parts)}.")


def _meaning(data: MapData) -> Body:
    rows = [[f.name, f.note] for f in data.fields]
    body = table([Column("Quantity"), Column("What it is, and when it does not hold", "why")], rows)
    return section("meaning", "What it means", "Every quantity of the map.", body)


def _run(data: MapData) -> Body:
    body = folded("Options", len(data.options), pairs("Option", "Value", data.options))
    body += folded("Inputs", len(data.hashes), pairs("File", "SHA-256", data.hashes))
    return section("run", "This run", "What it was made from.", body)
