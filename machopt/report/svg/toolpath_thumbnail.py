"""Thumbnail of a toolpath: cuts coloured by the predicted value."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from machopt.numerics.array_types import Array, Bools
from machopt.report.svg.chart_elements import map_to_colours
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup

WIDTH, HEIGHT = 132.0, 84.0
_EDGE = 5.0
_SEGMENTS = 240
_SHADES = 10
_VIEW_MATRIX = np.array([[0.78, 0.62, 0.0], [-0.34, 0.43, 0.84]])  # right and up of a viewer at a corner


@dataclass(frozen=True)
class PathPicture:
    """P points of a toolpath, in the frame of the workpiece."""

    position: Array  # (P, 3) m
    cutting: Bools  # (P,) the segment that ends here cuts
    value: Array  # (P,) NaN: no answer there
    large_is_good: bool
    words: str  # what colours it


def build_thumbnail(path: PathPicture) -> Markup:
    """Return the thumbnail; bright is good, dark is poor, red has no solution.

    Args:
        path: Points and values of the picture.
    """
    keep = np.unique(np.linspace(0, len(path.position) - 1, _SEGMENTS + 1).round().astype(int))
    at = path.position[keep] @ _VIEW_MATRIX.T
    cut = np.array([path.cutting[a + 1 : b + 1].any() for a, b in pairwise(keep.tolist())], bool)
    low, high = at.min(axis=0), at.max(axis=0)
    scale = float(np.min((np.array([WIDTH, HEIGHT]) - 2 * _EDGE) / np.maximum(high - low, 1e-6)))
    x = WIDTH / 2 + (at[:, 0] - (low + high)[0] / 2) * scale
    y = HEIGHT / 2 - (at[:, 1] - (low + high)[1] / 2) * scale
    value = path.value[keep[1:]]
    known = np.isfinite(value)
    span = np.percentile(value[known & cut], [2, 98]) if (known & cut).any() else np.array([0.0, 1.0])
    share = np.clip((value - span[0]) / (float(span[1] - span[0]) or 1.0), 0.0, 1.0)
    good = share if path.large_is_good else 1.0 - share
    shade = np.where(known, np.round(np.nan_to_num(good) * (_SHADES - 1)), -1).astype(int)
    parts: list[SvgShape] = []
    for kind in (-2, *range(-1, _SHADES)):
        here = ~cut if kind == -2 else cut & (shade == kind)
        d = "".join(f"M{x[k]:.1f} {y[k]:.1f}L{x[k + 1]:.1f} {y[k + 1]:.1f}" for k in np.flatnonzero(here))
        if d:
            parts.append(build_shape("path", d=d, fill="none", stroke_linecap="round", **_get_pen_style(kind)))
    size: Style = {"viewBox": f"0 0 {WIDTH:.0f} {HEIGHT:.0f}", "width": WIDTH, "height": HEIGHT}
    return render_svg(build_shape("svg", title=path.words, role="img", aria_label=path.words, inside=parts, **size))


def _get_pen_style(kind: int) -> Style:
    if kind == -2:
        return {"stroke": "currentColor", "stroke_width": 0.7, "opacity": 0.4}
    if kind == -1:
        return {"stroke": "#d93636", "stroke_width": 2.4}
    r, g, b = (int(v) for v in map_to_colours(np.array([kind / (_SHADES - 1)]))[0])
    return {"stroke": f"rgb({r},{g},{b})", "stroke_width": 2.4}
