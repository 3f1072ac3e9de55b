"""Map of ``machopt place``: the index of each place over x and y, with its holes and points out of tolerance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from machopt.data_types.documents.place_document import PlaceDocument
from machopt.report.svg.chart_elements import map_to_colours
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup
    from numpy.typing import NDArray

DARK_COLOR = "#1a2330"  # round white marks, so that they stand out on every colour
WIDTH, HEIGHT = 640.0, 460.0
LEFT, TOP, RIGHT, BOTTOM = 84.0, 16.0, 120.0, 44.0
MIN_LABELLED_SIZE = 26.0  # px of a square that has room for a number
MAX_LABELS = 9  # coordinates along an axis


@dataclass(frozen=True, kw_only=True)
class PlaceMark:
    """Placement on the map; mm, and the index in its unit (of the plan, else of the estimate)."""

    x: float
    y: float
    value: float
    planned: bool
    words: str
    refused: str
    outcomes: tuple[int, ...] = ()  # pass, marginal, fail, unknown; empty: nothing has a tolerance

    @property
    def missed(self) -> int:
        """Holes and points that are not in tolerance."""
        return sum(self.outcomes[1:])


@dataclass(frozen=True, kw_only=True)
class _MapFrame:
    """Scale of the map: px per mm, the lowest corner in mm, and the size of the plotted area in px."""

    low: NDArray[np.float64]  # (2,) mm
    scale: float  # px/mm
    wide: float  # px
    tall: float  # px
    square: float  # px, edge of the square of one place

    def locate(self, x: float, y: float) -> tuple[float, float]:
        """Return the pixel of a shift (mm)."""
        return LEFT + self.scale * (x - float(self.low[0])), TOP + self.tall - self.scale * (y - float(self.low[1]))


def _build_frame(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> _MapFrame:
    """Return the frame that holds all places, with half a step around them."""
    step = min((float(np.diff(np.unique(v)).max()) for v in (xs, ys) if len(np.unique(v)) > 1), default=1.0)
    low = np.array([xs.min(), ys.min()]) - 0.5 * step
    high = np.array([xs.max(), ys.max()]) + 0.5 * step
    scale = min((WIDTH - LEFT - RIGHT) / (high[0] - low[0]), (HEIGHT - TOP - BOTTOM) / (high[1] - low[1]))
    wide, tall = scale * (high - low)
    return _MapFrame(low=low, scale=scale, wide=wide, tall=tall, square=0.94 * scale * step)


def build_placement_map(result: PlaceDocument, marks: Sequence[PlaceMark]) -> Markup:
    """Return the picture.

    Args:
        result: Content of place.json.
        marks: One place for each x and y.
    """
    xs, ys = np.array([m.x for m in marks]), np.array([m.y for m in marks])
    frame = _build_frame(xs, ys)
    known = np.array([m.value for m in marks if not m.refused and math.isfinite(m.value)])
    least, most = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    shapes = _draw_places(marks, frame, (least, most), result.unit)
    shapes += _draw_reference_marks(result, frame)
    shapes += _draw_axis_labels(xs, ys, frame)
    shapes += _draw_colour_scale(LEFT + frame.wide + 18, frame.tall, least, most)
    return render_svg(
        build_shape(
            "svg",
            viewBox=f"0 0 {LEFT + frame.wide + RIGHT:.0f} {TOP + frame.tall + BOTTOM:.0f}",
            width="100%",
            style=f"max-width:{LEFT + frame.wide + RIGHT:.0f}px",
            role="img",
            aria_label="worst index over x and y",
            inside=shapes,
        )
    )


def _draw_places(
    marks: Sequence[PlaceMark], frame: _MapFrame, limits: tuple[float, float], unit: str
) -> list[SvgShape]:
    """Return the squares of all places; planned ones lie above the others."""
    least, most = limits
    shapes: list[SvgShape] = []
    for m in sorted(marks, key=lambda m: (m.planned, m.x, m.y)):
        share = (most - m.value) / (most - least or 1.0)
        shapes += _draw_place(m, frame.locate(m.x, m.y), frame.square, share, unit)
        if m.outcomes and not m.refused and frame.square >= MIN_LABELLED_SIZE:
            shapes.append(_write_missed(m, frame.locate(m.x, m.y)))
    return shapes


def _draw_reference_marks(result: PlaceDocument, frame: _MapFrame) -> list[SvgShape]:
    """Return the marks of the cell's own place and of the best one."""
    style: Style = {
        "fill": "#fff",
        "stroke": DARK_COLOR,
        "stroke_width": 3,
        "paint_order": "stroke",
        "text_anchor": "middle",
    }
    x, y = frame.locate(0, 0)
    shapes = [build_shape("text", "◆", x=x, y=y + 5, font_size=15, **style)]
    if result.best:
        x, y = frame.locate(result.best[0].shift_mm[0], result.best[0].shift_mm[1])
        shapes.append(build_shape("text", "★", x=x, y=y + 6, font_size=18, **style))
    return shapes


def _draw_axis_labels(xs: NDArray[np.float64], ys: NDArray[np.float64], frame: _MapFrame) -> list[SvgShape]:
    """Return numbers and names of both axes."""
    small: Style = {"font_size": 11, "fill": "currentColor"}
    below, left = TOP + frame.tall, LEFT - 8
    shapes: list[SvgShape] = []
    for v in _select_labelled_values(xs):
        x = frame.locate(v, 0)[0]
        shapes.append(build_shape("text", format_number(v, ".0f"), x=x, y=below + 16, text_anchor="middle", **small))
    for v in _select_labelled_values(ys):
        y = frame.locate(0, v)[1] + 4
        shapes.append(build_shape("text", format_number(v, ".0f"), x=left, y=y, text_anchor="end", **small))
    shapes.append(build_shape("text", "x (mm)", x=LEFT + frame.wide / 2, y=below + 34, text_anchor="middle", **small))
    shapes.append(build_shape("text", "y (mm)", x=2.0, y=TOP + frame.tall / 2, **small))
    return shapes


def _format_mark_outcomes(m: PlaceMark) -> str:
    return f", {m.outcomes[0]} of {sum(m.outcomes)} in tolerance" if m.outcomes else ""


def _draw_place(m: PlaceMark, place: tuple[float, float], size: float, share: float, unit: str) -> list[SvgShape]:
    """Return the square of a position, with a ring where it was planned; a cross where it cannot be used."""
    shapes: list[SvgShape] = []
    x, y = place
    if m.refused or not math.isfinite(m.value):
        arm = 0.16 * size
        left, right, up, down = x - arm, x + arm, y - arm, y + arm
        cross = f"M{left:.1f} {up:.1f}L{right:.1f} {down:.1f}M{left:.1f} {down:.1f}L{right:.1f} {up:.1f}"
        title = f"{m.words}: {m.refused or 'no continuous way'}"
        return [build_shape("path", d=cross, stroke="currentColor", opacity=0.45, fill="none", title=title)]
    red, green, blue = (int(v) for v in np.asarray(map_to_colours(np.array([share])))[0][:3])
    title = f"{m.words}: {format_number(m.value)} {unit}{_format_mark_outcomes(m)}{' (planned)' if m.planned else ''}"
    fill = f"rgb({red},{green},{blue})"
    shapes.append(build_shape("rect", x=x - size / 2, y=y - size / 2, width=size, height=size, fill=fill, title=title))
    if m.planned:
        shapes.append(
            build_shape("circle", cx=x, cy=y, r=0.3 * size, fill="none", stroke=DARK_COLOR, stroke_width=4, title=title)
        )
        shapes.append(
            build_shape("circle", cx=x, cy=y, r=0.3 * size, fill="none", stroke="#fff", stroke_width=2, title=title)
        )
    return shapes


def _write_missed(m: PlaceMark, place: tuple[float, float]) -> SvgShape:
    """Return the number of holes and points that are not in tolerance, on the square of a place."""
    outline: Style = {"fill": "#fff", "stroke": DARK_COLOR, "stroke_width": 2.5, "paint_order": "stroke"}
    x, y = place
    return build_shape("text", str(m.missed), x=x, y=y + 18, font_size=10, text_anchor="middle", **outline)


def _draw_colour_scale(x: float, tall: float, least: float, most: float) -> list[SvgShape]:
    """Return the bar with the colours of the values."""
    out: list[SvgShape] = []
    small: Style = {"font_size": 11, "fill": "currentColor"}
    for k in range(24):
        red, green, blue = (int(v) for v in np.asarray(map_to_colours(np.array([1 - k / 23])))[0][:3])
        y = TOP + tall * (1 - (k + 1) / 24)
        out.append(build_shape("rect", x=x, y=y, width=14, height=tall / 24 + 0.6, fill=f"rgb({red},{green},{blue})"))
    for value, y in ((most, TOP + 8), (least, TOP + tall)):
        out.append(build_shape("text", format_number(value), x=x + 20, y=y, **small))
    return out


def _select_labelled_values(values: NDArray[np.float64]) -> list[float]:
    """The coordinates of places that the axis names: all, or every so many from the middle out, as many as fit."""
    at = np.unique(values.round(6))
    every = -(-len(at) // MAX_LABELS)
    return [float(v) for v in at[(len(at) // 2) % every :: every]]


def format_number(value: float | None, form: str = "#.4g") -> str:
    """Return a number as text, "–" where there is none.

    Args:
        value: The number.
        form: Its format.
    """
    return "–" if value is None or not math.isfinite(value) else f"{value:{form}}".replace("-", "−")
