"""Views of a toolpath as SVG: from above, from the front, from the side and slanted, coloured by move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup

COLOURS = {
    MoveKind.CUT: "var(--blue)",  # as the page's theme has it
    MoveKind.RAPID: "#d9730d",
    MoveKind.APPROACH: "#2c8a57",
    MoveKind.RETRACT: "#7a8490",
    MoveKind.LINK: "#8a4fbf",
}
_DASHED = {MoveKind.RAPID: "4 3"}
_AXIS_COLOUR = "#b3261e"
_WIDTH, _MARGIN = 560.0, 46.0
_HEIGHT_SHARE = (0.45, 0.95)  # of the width: least and most height of a view
_CELL = 0.35  # of a pixel: steps smaller than that are invisible
_MOST_STEPS = 12_000  # drawn in one view; beyond it the cell grows
_COARSEST = 8.0  # pixels
_AXES_SHOWN = 120
_TICK_ROOM = 18.0  # pixels a number takes
_AXIS_LENGTH = 16.0  # pixels of a tool axis seen from the side
_GRID = 1 << 15  # cells of a picture's side, more than there are


@dataclass(frozen=True)
class ViewDirection:
    """Direction of a view: ``right`` and ``up`` of the picture in the workpiece frame."""

    name: str
    title: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    labels: tuple[str, str] | None  # of the axes; None: slanted, no scales


_A, _B = math.radians(30.0), math.radians(35.264)
VIEWS = (
    ViewDirection("top", "From above", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("x (mm)", "y (mm)")),
    ViewDirection("front", "From the front", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), ("x (mm)", "z (mm)")),
    ViewDirection("side", "From the side", (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), ("y (mm)", "z (mm)")),
    ViewDirection(
        "slanted",
        "Slanted",
        (math.cos(_A), math.sin(_A), 0.0),
        (-math.sin(_A) * math.sin(_B), math.cos(_A) * math.sin(_B), math.cos(_B)),
        None,
    ),
)


@dataclass(frozen=True)
class _ViewScale:
    low: Array  # (2,) mm
    per_mm: float
    left: float
    bottom: float

    def __call__(self, flat: Array) -> Array:
        """(N, 2) mm → pixels."""
        return np.column_stack(
            [
                self.left + (flat[:, 0] - self.low[0]) * self.per_mm,
                self.bottom - (flat[:, 1] - self.low[1]) * self.per_mm,
            ]
        )


def build_view_svg(toolpath: Toolpath, view: ViewDirection) -> Markup:
    """Return one view; the same toolpath gives the same bytes.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        view: The direction of the view.
    """
    flat = toolpath.position * 1e3 @ np.array([view.right, view.up]).T
    low, high = flat.min(axis=0), flat.max(axis=0)
    span = np.maximum(high - low, 1e-3)
    room = _WIDTH - 2.0 * _MARGIN
    tallest = _WIDTH * _HEIGHT_SHARE[1] - 2.0 * _MARGIN
    per_mm = float(min(room / span[0], tallest / span[1]))
    height = max(float(span[1]) * per_mm + 2.0 * _MARGIN, _WIDTH * _HEIGHT_SHARE[0])
    left = _MARGIN + (room - float(span[0]) * per_mm) / 2.0
    bottom = height - _MARGIN - (height - 2.0 * _MARGIN - float(span[1]) * per_mm) / 2.0
    scale = _ViewScale(low, per_mm, left, bottom)
    pixels = scale(flat)
    parts: list[SvgShape] = []
    if view.labels is not None:
        parts.extend(_build_scales(view.labels, low, high, scale, height))
    for move in (MoveKind.RAPID, MoveKind.RETRACT, MoveKind.LINK, MoveKind.APPROACH, MoveKind.CUT):  # cuts on top
        parts.extend(_build_move_path(pixels, np.asarray(toolpath.move), move))
    parts.extend(_build_tool_axes(toolpath, pixels, view))
    x, y = pixels[0].tolist()
    parts.append(build_shape("circle", title="first point", cx=x, cy=y, r=3.5, fill="#14703c"))
    box = f"0 0 {_WIDTH:g} {height:.0f}"
    return render_svg(build_shape("svg", title=view.title, class_="plot", viewBox=box, role="img", inside=parts))


def _build_move_path(pixels: Array, move: NDArray[np.int8], which: MoveKind) -> list[SvgShape]:
    """All lines of one kind of move as one SVG path."""
    ends = np.flatnonzero(move == which)
    ends = ends[ends > 0]
    if not len(ends):
        return []
    breaks = np.flatnonzero(np.diff(ends) > 1) + 1
    lines = [_thin_points(pixels[run[0] - 1 : run[-1] + 1], _CELL) for run in np.split(ends, breaks)]
    if sum(map(len, lines)) <= _MOST_STEPS + 2 * len(lines) and len(lines) <= _MOST_STEPS:
        d = "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points.tolist()) for points in lines)
    else:
        d = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {e:.1f}" for a, b, c, e in _remove_duplicate_lines(lines).tolist())
    width = 1.3 if which is MoveKind.CUT else 0.9
    return [
        build_shape(
            "path",
            title=which.word,
            class_="line",
            d=d,
            stroke=COLOURS[which],
            stroke_width=width,
            stroke_dasharray=_DASHED.get(which, ""),
        )
    ]


def _thin_points(points: Array, cell: float) -> Array:
    """Points that fall into another cell than the one before; both ends stay."""
    cells = np.round(points / cell)
    keep = np.ones(len(points), dtype=bool)
    keep[1:-1] = (np.diff(cells, axis=0) != 0.0).any(axis=1)[:-1]
    return np.asarray(points[keep])


def _remove_duplicate_lines(lines: list[Array]) -> Array:
    """(M, 4) strokes of long paths: those that fall on one another are drawn once, on a grid as fine as it may be."""
    strokes = np.vstack([np.column_stack([points[:-1], points[1:]]) for points in lines])
    cell = _CELL
    while True:
        grid = np.round(strokes / cell).astype(np.int64)
        moved = (grid[:, :2] != grid[:, 2:]).any(axis=1)
        keys = ((grid[:, 0] * _GRID + grid[:, 1]) * _GRID + grid[:, 2]) * _GRID + grid[:, 3]
        keep = np.unique(keys[moved], return_index=True)[1]
        strokes = strokes[np.flatnonzero(moved)[np.sort(keep)]] if len(keep) else strokes[:1]
        if len(strokes) <= _MOST_STEPS or cell > _COARSEST:
            return np.asarray(strokes[:: max(len(strokes) // _MOST_STEPS, 1)])
        cell *= 1.6


def _build_tool_axes(toolpath: Toolpath, pixels: Array, view: ViewDirection) -> list[SvgShape]:
    """Short strokes along the tool axis where it is not the same everywhere, or not upright."""
    cut = np.flatnonzero(toolpath.cutting)
    axis = toolpath.axis[cut]
    if not len(cut) or (axis[:, 2] > 1.0 - 1e-9).all():
        return []
    pick = np.unique(np.linspace(0, len(cut) - 1, min(len(cut), _AXES_SHOWN)).round().astype(int))
    flat = axis[pick] @ np.array([view.right, view.up]).T * _AXIS_LENGTH
    at = pixels[cut[pick]]
    d = "".join(f"M{x:.1f} {y:.1f}l{u:.1f} {-v:.1f}" for (x, y), (u, v) in zip(at.tolist(), flat.tolist(), strict=True))
    return [build_shape("path", title="tool axis", class_="line", d=d, stroke=_AXIS_COLOUR, stroke_width=0.8)]


def _build_scales(labels: tuple[str, str], low: Array, high: Array, scale: _ViewScale, height: float) -> list[SvgShape]:
    parts = []
    for value in _space_labels(_choose_ticks(float(low[0]), float(high[0])), scale.per_mm):
        x = scale.left + (value - float(low[0])) * scale.per_mm
        parts.append(build_shape("line", class_="grid", x1=x, x2=x, y1=_MARGIN / 2, y2=height - _MARGIN + 8))
        parts.append(_build_tick(value, x, height - _MARGIN + 20, "middle"))
    for value in _space_labels(_choose_ticks(float(low[1]), float(high[1])), scale.per_mm):
        y = scale.bottom - (value - float(low[1])) * scale.per_mm
        parts.append(build_shape("line", class_="grid", x1=_MARGIN - 8, x2=_WIDTH - _MARGIN / 2, y1=y, y2=y))
        parts.append(_build_tick(value, _MARGIN - 11, y + 4, "end"))
    label: Style = {"class_": "label", "text_anchor": "middle"}
    turned = f"rotate(-90 12 {height / 2:.1f})"
    parts.append(build_shape("text", labels[0], x=_WIDTH / 2, y=height - 6, **label))
    parts.append(build_shape("text", labels[1], x=12, y=height / 2, transform=turned, **label))
    return parts


def _build_tick(value: float, x: float, y: float, anchor: str) -> SvgShape:
    return build_shape("text", f"{value:g}".replace("-", "−"), class_="tick", x=x, y=y, text_anchor=anchor)


def _space_labels(values: list[float], per_mm: float) -> list[float]:
    """As many of evenly spaced values as have room for their numbers; both directions have one scale."""
    if len(values) < 2:
        return values
    return values[:: max(math.ceil(_TICK_ROOM / ((values[1] - values[0]) * per_mm)), 1)]


def _choose_ticks(low: float, high: float) -> list[float]:
    """Round values between low and high, about five."""
    span = high - low
    if not span > 1e-3:
        return [round(low, 3)]
    step = 10.0 ** math.floor(math.log10(span / 4.0))
    for factor in (1.0, 2.0, 5.0, 10.0):
        if span / (step * factor) <= 6.0:
            step *= factor
            break
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 6) + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]
