"""``report.html`` of a map: one self-contained page with a picture that answers under the pointer."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from machopt.report.display import LENGTH
from machopt.report.map_data import MapData, MapField, MapLayer
from machopt.report.map_figures import map_specs
from machopt.report.map_svg import pair_svg
from machopt.report.shell import page_html, section
from machopt.report.tables import Column, folded, pairs, table


def write_map_page(path: Path, data: MapData) -> None:
    """Write the page; the same data give the same bytes."""
    path.write_text(map_page_html(data), encoding="utf-8", newline="\n")


def map_page_html(data: MapData) -> str:
    """The page as text."""
    specs = map_specs(data)
    charts = "".join(f'<div class=chart id="{c["id"]}"></div>' for c in specs["charts"])
    if specs["arms"] is not None:
        charts += "<h3>The arm on the way, from pale to dark</h3><div id=arms></div>"
    sections = [
        ("verdict", "Verdict", _verdict(data)),
        ("map", "Map", _map(data) if specs["field"] is not None else ""),
        ("curves", "Curves", section("curves", "Curves", _CURVES[data.kind == "line"], charts)),
        ("measured", "Measured", _measured(data)),
        ("numbers", "Numbers", _numbers(data)),
        ("meaning", "What it means", _meaning(data)),
        ("run", "This run", _run(data)),
    ]
    return page_html(
        data.title, (("Cell", data.cell), ("Map", data.place)), sections, specs,
        scripts=("chart.js", "heatmap.js", "arm.js", "field.js", "start_map.js"),
        footer=f"machopt {escape(data.version)}. Lengths mm, angles deg, stiffness N/mm as in map.csv. "
        f"x, y, z are those of {escape(data.frame)}.",
    )  # fmt: skip


_CURVES = {
    True: "The tool keeps its orientation and the arm its branch; a gap is a place that cannot be reached that way.",
    False: "One joint moves, the others stand still.",
}


def _verdict(data: MapData) -> str:
    reached = [int((layer.reason == 0).sum()) for layer in data.layers]
    tone = "good" if any(reached) else "bad"
    items = "".join(f"<li>{escape(w)}</li>" for w in data.warnings)
    boxes = "".join(_cards(data)) if any(reached) else ""
    return (
        f'<section id=verdict class="verdict {tone}"><span class=badge>{"MAPPED" if any(reached) else "OUT OF REACH"}'
        f"</span><p class=sentence>{escape(data.verdict[0].upper() + data.verdict[1:])}.</p>"
        f"{f'<ul>{items}</ul>' if items else ''}<div class=cards>{boxes}</div></section>\n"
    )


def _cards(data: MapData) -> list[str]:
    f = data.shown_field
    out = []
    for layer in data.layers:
        share = (layer.reason == 0).mean()
        if data.kind != "joints":
            out.append(_card(f"Reached, {layer.title}", f"{100 * share:.0f}", "%", f"of {len(layer.reason):,} samples"))
        if layer.best >= 0:
            value = layer.value[f.key]
            out.append(_card(f"Best place, {layer.title}" if data.kind != "joints" else "Best posture",
                             f.shown.text(float(value[layer.best])), f.shown.name,
                             where(data, layer.best)))  # fmt: skip
            known = value[np.isfinite(value)]
            out.append(_card(f"Median, {layer.title}" if data.kind != "joints" else "Median",
                             f.shown.text(float(np.median(known))), f.shown.name,
                             escape(f.name[0].lower() + f.name[1:])))  # fmt: skip
    gain = next((layer.value["gain"] for layer in data.layers if "gain" in layer.value), None)
    if gain is not None and np.isfinite(gain).any():
        share = f"{100 * float(np.nanmedian(gain)):.0f}"
        out.append(_card("Gain by turning", share, "%", "median, against the given rotation"))
    return out


def _card(name: str, value: str, unit: str, more: str) -> str:
    return (
        f'<div class=card><div class=name>{escape(name)}</div><div class=value>{escape(value)} '
        f"<small>{escape(unit)}</small></div><div class=more>{more}</div></div>"
    )  # fmt: skip


def where(data: MapData, row: int) -> str:
    """Coordinates of a sample in words."""
    index = np.unravel_index(row, data.shape)
    return ", ".join(
        f"{a.name} {a.shown.text(float(a.values[i]))}" for a, i in zip(data.axes, index, strict=True)
    ) + f" {data.axes[0].shown.name}"  # fmt: skip


def _map(data: MapData) -> str:
    lead = (
        "Move over the map to read every quantity and to see the arm; click to keep a place. Bright is good, dark is "
        "poor; grey and hatched places have no posture, and the hatching says why."
    )
    if data.kind != "joints":
        lead += (
            " Where several branches reach a place the map shows one posture for all quantities, so they belong "
            "together."
        )
    return section("map", escape(data.place), lead, "<div class=field id=field></div>")


def _measured(data: MapData) -> str:
    m = data.measured
    if m is None:
        return ""
    rows = []
    for axis in m.axes:
        e = m.errors[axis]
        rows.append([f"k_{axis}", *(_percent(e[name]) for name in ("left_out_rms", "left_out_median", "model_rms",
                                                                  "model_median", "held_rms"))])  # fmt: skip
    names = ("From the others, rms error", "median", "Model 1/(eᵀCe), rms error", "median", "K_m, rms error")
    heads = [Column("Direction"), *(Column(name, "n") for name in names)]
    summary = table(heads, rows)
    unit = 1e-3
    columns = [Column("x (mm)", "n"), Column("y", "n"), Column("z", "n")]
    for axis in m.axes:
        columns += [Column(f"k_{axis} measured (N/mm)", "n"), Column("from the others", "n"), Column("model", "n"),
                    Column("K_m", "n")]  # fmt: skip
    body = []
    for i in range(len(m.position)):
        row = [LENGTH.text(float(v)) for v in m.position[i]]
        for f in range(len(m.axes)):
            row += [_whole(float(source[i, f]) * unit) for source in (m.measured, m.left_out, m.model, m.held)]
        body.append(row)
    readings = folded("Readings", len(body), table(columns, body))
    postures = "at the readings' own joints" if m.from_joints else "at the postures this map chooses"
    lead = (
        f"{len(m.position)} readings of {escape(m.file)}, interpolated by inverse distance (power {m.power:g}). "
        "<b>From the other readings</b> leaves each reading out and predicts it from the rest: what the interpolated "
        f"map is worth between its points. The model is taken {postures}. Interpolation knows places, not postures."
    )
    pictures = "".join(f"<div>{pair_svg(data, axis)}</div>" for axis in m.axes) if len(data.axes) == 2 else ""
    return section("measured", "Measured stiffness", lead, summary + readings + pictures)


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _whole(value: float) -> str:
    return f"{value:,.0f}" if np.isfinite(value) else "–"


def _numbers(data: MapData) -> str:
    columns = [Column("Quantity"), Column("Unit"), Column("Least", "n"), Column("Where"), Column("Median", "n"),
               Column("Largest", "n"), Column("Where")]  # fmt: skip
    body = ""
    for layer in data.layers:
        rows = [row for f in data.fields if f.key in layer.value for row in _row(data, f, layer)]
        body += f"<h3>{escape(layer.title[0].upper() + layer.title[1:])}</h3>{_reasons(data, layer)}"
        body += table(columns, rows) if rows else ""
    return section("numbers", "Numbers", "Over all samples that have a posture.", body)


def _row(data: MapData, f: MapField, layer: MapLayer) -> list[list[str]]:
    value = layer.value[f.key]
    if not np.isfinite(value).any():
        return []
    low, high = int(np.nanargmin(value)), int(np.nanargmax(value))
    text = f.shown.text
    return [[f.name, f.shown.name, text(float(value[low])), where(data, low), text(float(np.nanmedian(value))),
             text(float(value[high])), where(data, high)]]  # fmt: skip


def _reasons(data: MapData, layer: MapLayer) -> str:
    codes, counts = np.unique(layer.reason, return_counts=True)
    parts = [f"{data.reasons[c]} {100 * n / len(layer.reason):.1f} %" for c, n in zip(codes, counts, strict=True)]
    return f"<p class=lead>{escape(', '.join(parts))}.</p>"


def _meaning(data: MapData) -> str:
    rows = [[f.name, f.note] for f in data.fields]
    body = table([Column("Quantity"), Column("What it is, and when it does not hold", "why")], rows)
    return section("meaning", "What it means", "Every quantity of the map.", body)


def _run(data: MapData) -> str:
    body = folded("Options", len(data.options), pairs("Option", "Value", data.options))
    body += folded("Inputs", len(data.hashes), pairs("File", "SHA-256", data.hashes))
    return section("run", "This run", "What it was made from.", body)
