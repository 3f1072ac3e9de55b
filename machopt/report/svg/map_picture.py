"""``map.svg``: the map as a static picture for documents."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.report.charts.isolines import choose_round_levels, compute_isolines
from machopt.report.charts.map_charts import Spec, build_curve_charts
from machopt.report.page_types.workspace_map_page_data import MapAxis, MapField, MapPageData
from machopt.report.svg.chart_elements import (
    Box,
    Pixels,
    build_bottom_ticks,
    build_colour_bar,
    build_frame,
    build_image,
    build_left_ticks,
    build_path,
    build_text,
    compute_hatching,
    map_to_colours,
    render_document,
)
from machopt.report.svg.shapes import SvgShape, build_shape

if TYPE_CHECKING:
    from markupsafe import Markup

CodeArray = NDArray[np.uint8]

_WIDTH, _MOST_HEIGHT, _PIXEL = 460.0, 460.0, 2
_LEFT, _TOP, _BOTTOM, _BAR = 62.0, 44.0, 74.0, 96.0


def write_map_svg(path: Path, data: MapPageData) -> None:
    """Write the picture; the same data give the same bytes.

    Args:
        path: The file to write.
        data: The data of the page.
    """
    path.write_text(build_map_svg(data) + "\n", encoding="utf-8", newline="\n")


def build_map_svg(data: MapPageData) -> Markup:
    """Return colours and isolines of the quantity that chooses the postures, one panel for each layer; curves over
    one axis.

    A volume shows the slice normal to its last axis through its best sample.

    Args:
        data: The data of the page.
    """
    return _build_curves(data) if len(data.axes) == 1 else _build_panels(data)


def _build_panels(data: MapPageData) -> Markup:
    field = data.shown_field
    axes, panels, title = data.axes[:2], [], f"{field.name}: {data.place}"
    level = _count_levels(data) if len(data.axes) == 3 else None
    for layer in data.layers:
        value = (layer.value[field.key] * field.display_unit.factor).reshape(data.shape)
        reason = layer.reason.reshape(data.shape)
        cut = (...,) if level is None else (..., level)
        panels.append((layer, value[cut], reason[cut]))
    if level is not None:
        axis = data.axes[2]
        title += f"; shown at {axis.name} = {axis.values[level] * axis.display_unit.factor:g} {axis.display_unit.name}"
    known = np.concatenate([value[np.isfinite(value)] for _, value, _ in panels])
    low, high = (float(v) for v in np.percentile(known, [2, 98])) if known.size else (0.0, 1.0)
    high = high if high > low else low + 1.0
    (u0, u1), (v0, v1) = (_compute_axis_ends(a) for a in axes)
    scale = min(_WIDTH / (u1 - u0), _MOST_HEIGHT / (v1 - v0))
    w, h = (u1 - u0) * scale, (v1 - v0) * scale
    if data.kind == "joints" or min(w, h) < 120:
        w, h = _WIDTH, _MOST_HEIGHT * 0.8
    panel = w + _LEFT + 24
    parts: list[SvgShape] = []
    for n, (layer, value, reason) in enumerate(panels):
        heading = field.name if data.kind == "joints" else layer.title
        shown = _FieldSlice(axes=axes, field=field, value=value, reason=reason, title=heading)
        parts += _build_panel(shown, (low, high), (_LEFT + n * panel, _TOP, w, h))
    width, height = panel * len(panels) + _BAR, h + _TOP + _BOTTOM
    unit = f" ({field.display_unit.name})" if field.display_unit.name else ""
    bar = (width - _BAR + 4, _TOP, 14.0, h)
    parts.extend(build_colour_bar(bar, low, high, field.name + unit, inverted=field.better == "less"))
    codes = np.unique(np.concatenate([reason.ravel() for _, _, reason in panels]))
    parts += _build_legend([int(c) for c in codes if c > 0], data, height - 26)
    return render_document(max(width, 640.0), height, title, parts)


def build_comparison_svg(data: MapPageData, axis: str) -> Markup:
    """Return the model's stiffness along an axis and the measured one over the same slice, in the same colours.

    Circles are the measured positions; dots mark what lies outside their convex hull.

    Args:
        data: The data of the page.
        axis: X, y or z.
    """
    layer = data.layers[0]
    keys = {f"k_{axis}": "Model", f"measured_{axis}": "Measured, interpolated"}
    fields = [next(f for f in data.fields if f.key == key) for key in keys]
    factor, reason = fields[0].display_unit.factor, layer.reason.reshape(data.shape)
    values = [(layer.value[f.key] * factor).reshape(data.shape) for f in fields]
    known = np.concatenate([v[np.isfinite(v)] for v in values])
    low, high = (float(v) for v in np.percentile(known, [2, 98])) if known.size else (0.0, 1.0)
    high = high if high > low else low + 1.0
    (u0, u1), (v0, v1) = (_compute_axis_ends(a) for a in data.axes)
    scale = min(400.0 / (u1 - u0), 320.0 / (v1 - v0))
    w, h = ((u1 - u0) * scale, (v1 - v0) * scale) if data.kind == "slice" else (400.0, 300.0)
    parts: list[SvgShape] = []
    for n, (f, value, title) in enumerate(zip(fields, values, keys.values(), strict=True)):
        box = (_LEFT + n * (w + _LEFT + 24), _TOP, w, h)
        guess = layer.guess[f.key].reshape(data.shape) if f.key in layer.guess else None
        heading = f.name if data.kind == "joints" and guess is None else title
        shown = _FieldSlice(axes=data.axes, field=f, value=value, reason=reason, title=heading, guess=guess)
        parts.extend(_build_panel(shown, (low, high), box))
        if data.kind == "slice" and data.measured is not None:
            at = data.measured.position[:, ["xyz".index(a.name) for a in data.axes]] * data.axes[0].display_unit.factor
            x, y = box[0] + (at[:, 0] - u0) / (u1 - u0) * w, box[1] + h - (at[:, 1] - v0) / (v1 - v0) * h
            parts += [
                build_shape("circle", cx=a, cy=b, r=3.5, fill="#fff", stroke="#b3261e")
                for a, b in zip(x.tolist(), y.tolist(), strict=True)
                if box[0] <= a <= box[0] + w and box[1] <= b <= box[1] + h
            ]
    width = 2 * (w + _LEFT + 24) + _BAR
    label = f"Stiffness along {axis} ({fields[0].display_unit.name})"
    parts.extend(build_colour_bar((width - _BAR + 4, _TOP, 14.0, h), low, high, label, inverted=False))
    return render_document(width, h + _TOP + 44, f"Stiffness along {axis}", parts)


def _count_levels(data: MapPageData) -> int:
    best = next((layer.best for layer in data.layers if layer.best >= 0), -1)
    return int(np.unravel_index(best, data.shape)[2]) if best >= 0 else data.shape[2] // 2


def _compute_axis_ends(axis: MapAxis) -> tuple[float, float]:
    """Where the outermost samples' own places end."""
    values = axis.values * axis.display_unit.factor
    step = (values[1] - values[0]) / 2
    return float(values[0] - step), float(values[-1] + step)


@dataclass(frozen=True, kw_only=True)
class _FieldSlice:
    """One quantity over two axes, for one panel."""

    axes: tuple[MapAxis, ...]
    field: MapField
    value: Array  # (U, V) in the display unit
    reason: CodeArray  # (U, V) 0 where there is a posture
    title: str
    guess: NDArray[np.bool_] | None = None  # (U, V) beyond the measured positions; None: nothing is interpolated


def _build_panel(field_slice: _FieldSlice, limits: tuple[float, float], box: Box) -> list[SvgShape]:
    x, y, w, h = box
    low, high = limits
    value, reason, axes = field_slice.value, field_slice.reason, field_slice.axes
    size = round(w * _PIXEL), round(h * _PIXEL)
    out = [build_image(box, _build_pixels(value, reason, field_slice.field, low, high, size, field_slice.guess))]
    nu, nv = value.shape
    for level in choose_round_levels(low, high).tolist():
        found = compute_isolines(np.where(reason == 0, value, np.nan), level)
        at = [
            zip((x + (p[:, 0] + 0.5) / nu * w).tolist(), (y + h - (p[:, 1] + 0.5) / nv * h).tolist(), strict=True)
            for p in found
        ]
        lines = ("M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points) for points in at)
        out += [build_path("".join(lines), "i")] if found else []
    label = [f"{a.label} ({a.display_unit.name})" for a in axes]
    out += [
        build_frame(box),
        *build_bottom_ticks(box, *_compute_axis_ends(axes[0]), label[0]),
        *build_left_ticks(box, *_compute_axis_ends(axes[1]), label[1]),
    ]
    return [*out, build_text(x, y - 8, field_slice.title[0].upper() + field_slice.title[1:])]


def _build_pixels(
    value: Array,
    reason: CodeArray,
    field: MapField,
    low: float,
    high: float,
    size: tuple[int, int],
    guess: NDArray[np.bool_] | None = None,
) -> Pixels:
    """(height, width, 3) nearest sample a pixel; grey and hatched where there is no posture."""
    w, h = size
    i = np.minimum((np.arange(w) + 0.5) / w * value.shape[0], value.shape[0] - 1).astype(int)
    j = np.minimum((h - np.arange(h) - 0.5) / h * value.shape[1], value.shape[1] - 1).astype(int)
    v, code = value[i][:, j].T, reason[i][:, j].T
    t = (v - low) / (high - low)
    t = 1.0 - t if field.better == "less" else t
    out = map_to_colours(np.where(np.isfinite(t), t, 0.0))
    out[~np.isfinite(v)] = 255
    y, x = np.indices((h, w))
    if guess is not None:
        out[guess[i][:, j].T & (x % 14 < 3) & ((y + 7 * (x // 14 % 2)) % 14 < 3)] = 255
    for c in np.unique(code[code > 0]).tolist():
        here = code == c
        out[here] = compute_hatching(c, x[here], y[here])
    return out


def _build_legend(codes: list[int], data: MapPageData, y: float) -> list[SvgShape]:
    out: list[SvgShape] = []
    at = 14.0
    rows, columns = np.indices((28, 44))
    for code in codes:
        words = data.reasons[code]
        out += [
            build_image((at, y, 22.0, 14.0), compute_hatching(code, columns, rows)),
            build_text(at + 28, y + 11, words, kind="t"),
        ]
        at += 44 + 5.6 * len(words)
    return out


def _build_curves(data: MapPageData) -> Markup:
    charts = build_curve_charts(data)[: len(data.layers) + 2]
    w, h, gap = 620.0, 190.0, 66.0
    parts = [s for n, chart in enumerate(charts) for s in _build_curve(chart, (_LEFT, _TOP + n * (h + gap) + 14, w, h))]
    return render_document(_LEFT + w + 270, _TOP + len(charts) * (h + gap) + 14, data.place, parts)


def _build_curve(chart: Spec, box: Box) -> list[SvgShape]:
    x, y, w, h = box
    at = np.array(chart["x"], float)
    lines = [np.array([np.nan if v is None else v for v in s["y"]], float) for s in chart["series"]]
    known = np.concatenate([v[np.isfinite(v)] for v in lines])
    low, high = min(0.0, float(known.min())), (float(known.max()) * 1.05 or 1.0)
    first, last = float(at[0]), float(at[-1])
    out = [
        *build_left_ticks(box, low, high, chart["ylabel"], grid=True),
        *build_bottom_ticks(box, first, last, chart["xlabel"]),
        build_frame(box),
        build_text(x, y - 7, chart["title"]),
    ]
    for n, (series, values) in enumerate(zip(chart["series"], lines, strict=True)):
        px, py = x + w * (at - first) / (last - first), y + h * (1 - (values - low) / (high - low))
        d, pen = "", "M"
        for a, b in zip(px.tolist(), py.tolist(), strict=True):
            d += f"{pen}{a:.1f} {b:.1f}" if np.isfinite(b) else ""
            pen = "L" if np.isfinite(b) else "M"
        paint = {"stroke": series["color"], "stroke_dasharray": series["dash"], "fill": "none"}
        key = y + 10 + 17 * n
        out.append(build_path(d, stroke_width="1.6", **paint))
        out.append(build_path(f"M{x + w + 10} {key:.1f}h22", stroke_width="2.4", **paint))
        out.append(build_text(x + w + 38, key + 4, series["name"], kind="t"))
    return out
