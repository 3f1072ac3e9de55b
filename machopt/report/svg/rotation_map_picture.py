"""Static picture of the rotation map: index over path length and rotation, infeasible regions, chosen rotation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.report.page_types.display_units import ANGLE, LENGTH, QUANTITY_LABELS, QUANTITY_UNITS
from machopt.report.page_types.map_sample_states import PlaceCode
from machopt.report.page_types.optimize_page_data import STATUS_NAMES, Quantity, RotationMap
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
from machopt.report.svg.shapes import SvgShape

if TYPE_CHECKING:
    from markupsafe import Markup

_BOX: Box = (66.0, 44.0, 760.0, 300.0)
_PIXEL = 2  # of the picture's raster a unit of length
_WITH_INDEX = (PlaceCode.OK, PlaceCode.NOT_CHECKED)  # possible by themselves, so they have an index
_LINES = (("CAM default", "cam_default", "#c81e1e", "5 4"), ("Jiao 2022", "jiao2022", "#d9730d", "9 3"))


def build_rotation_svg(data: RotationMap, quantity: Quantity, *, title: str) -> Markup:
    """Colours of the quantity, hatching where a place is forbidden, and the rotations of three methods.

    Stations stand side by side with their number below where a few long steps would squeeze the others into slivers.

    Args:
        data: N stations, R rotations.
        quantity: what ``data.index`` is.
        title: of the picture.
    """
    x, y, w, h = _BOX
    shown, words = QUANTITY_UNITS[quantity], QUANTITY_LABELS[quantity]
    value = np.where(np.isin(data.status, _WITH_INDEX), data.index * shown.factor, np.nan)
    known = value[np.isfinite(value)]
    low, high = (float(v) for v in np.percentile(known, [2, 98])) if known.size else (0.0, 1.0)
    high = high if high > low else low + 1.0
    step = np.diff(data.s)
    even = not (len(step) > 2 and float(np.median(step)) < 0.2 * float(step.mean()))
    along = data.s * LENGTH.factor if even and data.s[-1] > data.s[0] else np.arange(len(data.s)).astype(float)
    label = "Path length (mm)" if along[-1] == data.s[-1] * LENGTH.factor else "Cutting station"
    rotation = data.rotation * ANGLE.factor
    left, right = float(along[0]), float(along[-1]) if along[-1] > along[0] else float(along[0]) + 1.0
    half = float(rotation[1] - rotation[0]) / 2 if len(rotation) > 1 else 1.0
    bottom, top = float(rotation[0]) - half, float(rotation[-1]) + half
    parts: list[SvgShape] = [
        build_image(_BOX, _build_pixels(value, data.status, along, (low, high), large_is_good=words.large_is_good)),
        *build_bottom_ticks(_BOX, left, right, label),
        *build_left_ticks(_BOX, bottom, top, "Rotation φ (deg)"),
        build_frame(_BOX),
    ]
    lines = [*_LINES, ("chosen", "chosen", "#000000", "")]
    at = x
    for name, field, colour, dash in lines:
        phi = np.asarray(getattr(data, field), float) * ANGLE.factor
        if not np.isfinite(phi).any():
            continue
        px = x + w * (along - left) / (right - left)
        py = y + h * (1 - (phi - bottom) % 360.0 / (top - bottom))
        if name == "chosen":
            parts.append(build_path(_build_line_path(px, py, h), stroke="#ffffff", stroke_width="4.4", fill="none"))
        paint = {"stroke": colour, "stroke_width": "2", "fill": "none", "stroke_dasharray": dash or "none"}
        parts += [
            build_path(_build_line_path(px, py, h), **paint),
            build_path(f"M{at:.1f} {y + h + 58:.1f}h24", **paint),
        ]
        parts.append(build_text(at + 30, y + h + 62, name, kind="t"))
        at += 130
    codes = [int(c) for c in np.unique(data.status) if c not in _WITH_INDEX]
    rows, columns = np.indices((28, 44))
    for n, code in enumerate(codes):
        place = (x + 190 * (n % 4), y + h + 74 + 22 * (n // 4), 22.0, 14.0)
        parts += [build_image(place, compute_hatching(code, columns, rows))]
        parts += [build_text(place[0] + 28, place[1] + 11, STATUS_NAMES[code], kind="t")]
    unit = f" ({shown.name})" if shown.name else ""
    parts += build_colour_bar((x + w + 14, y, 14.0, h), low, high, words.axis + unit, inverted=not words.large_is_good)
    return render_document(x + w + 120, y + h + 96 + 22 * (max(len(codes) - 1, 0) // 4), title, parts)


def _build_pixels(
    value: Array, status: NDArray[np.uint8], along: Array, limits: tuple[float, float], *, large_is_good: bool
) -> Pixels:
    """(height, width, 3) the nearest station and rotation a pixel."""
    w, h = round(_BOX[2] * _PIXEL), round(_BOX[3] * _PIXEL)
    place = along[0] + (np.arange(w) + 0.5) / w * (along[-1] - along[0])
    middle = (along[1:] + along[:-1]) / 2
    i = np.searchsorted(middle, place)
    j = np.minimum((h - np.arange(h) - 0.5) / h * value.shape[1], value.shape[1] - 1).astype(int)
    v, code = value[i][:, j].T, status[i][:, j].T
    low, high = limits
    t = (v - low) / (high - low)
    out = map_to_colours(np.where(np.isfinite(t), t if large_is_good else 1.0 - t, 0.0))
    out[~np.isfinite(v)] = 255
    y, x = np.indices((h, w))
    for c in np.unique(code[~np.isin(code, _WITH_INDEX)]).tolist():
        here = code == c
        out[here] = compute_hatching(c, x[here], y[here])
    return out


def _build_line_path(x: Array, y: Array, height: float) -> str:
    """The line as SVG; it breaks where there is none, and where it leaves the map above or below."""
    d, pen, last = "", "M", np.nan
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if abs(b - last) > height / 2:
            pen = "M"
        d += f"{pen}{a:.1f} {b:.1f}" if np.isfinite(b) else ""
        pen, last = ("L" if np.isfinite(b) else "M"), b
    return d
