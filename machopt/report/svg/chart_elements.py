"""Elements of static SVG charts: texts, paths, ticks, an embedded PNG, colours."""

from __future__ import annotations

import base64
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.report.charts.isolines import choose_round_levels
from machopt.report.page_types.map_sample_states import PlaceCode
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup

Pixels = NDArray[np.uint8]
Box = tuple[float, float, float, float]  # x, y, width, height

VIRIDIS = np.array(
    [
        [68, 1, 84],
        [72, 40, 120],
        [62, 74, 137],
        [49, 104, 142],
        [38, 130, 142],
        [31, 158, 137],
        [53, 183, 121],
        [110, 206, 88],
        [181, 222, 43],
        [253, 231, 37],
    ],
    float,
)
DARK_COLOR, LIGHT_COLOR = np.array([92, 98, 108], np.uint8), np.array([226, 228, 231], np.uint8)
_STYLE = (
    ".still text{font-family:Arial,Liberation Sans,sans-serif;font-size:12px;fill:#333d49}"
    ".still .t{font-size:11px}.still .h{font-size:14px;font-weight:bold;fill:#1b2430}"
    ".still .a{stroke:#7c8794;fill:none}.still .g{stroke:#e8ebee}.still .i{stroke:#fff;stroke-width:.9;fill:none}"
)


def build_text(
    x: float, y: float, words: str, *, anchor: str = "start", kind: str = "", upright: bool = True
) -> SvgShape:
    """Return a line of text.

    Args:
        x: Horizontal position, pixels.
        y: Vertical position, pixels.
        words: The text.
        anchor: SVG text anchor.
        kind: CSS class.
        upright: False turns the text by 90° about its anchor.
    """
    place: Style = {"x": x, "y": y} if upright else {"transform": f"translate({x:.1f} {y:.1f}) rotate(-90)"}
    return build_shape("text", words, class_=kind, **place, text_anchor=anchor)


def build_path(d: str, kind: str = "", **more: str | float) -> SvgShape:
    """Return a path.

    Args:
        d: SVG path data.
        kind: CSS class.
        more: Further attributes, with _ for -.
    """
    attributes: dict[str, Any] = {"class_": kind, "d": d, **more}
    return build_shape("path", **attributes)


def build_frame(box: Box) -> SvgShape:
    """Return the frame of a chart.

    Args:
        box: Left, top, width and height in pixels.
    """
    x, y, w, h = box
    return build_shape("rect", class_="a", x=x, y=y, width=w, height=h)


def format_number(value: float) -> str:
    """Return a number with up to six digits and a true minus sign.

    Args:
        value: The value.
    """
    return f"{value + 0.0:.6g}".replace("-", "−")


def build_bottom_ticks(box: Box, low: float, high: float, label: str) -> list[SvgShape]:
    """Return ticks and label of the horizontal axis below a box.

    Args:
        box: Left, top, width and height in pixels.
        low: Value at the left edge.
        high: Value at the right edge.
        label: Label of the axis.
    """
    x, y, w, h = box
    out = []
    for v in choose_round_levels(low, high, 8).tolist():
        at = x + w * (v - low) / (high - low)
        out += [
            build_path(f"M{at:.1f} {y + h:.1f}v4", "a"),
            build_text(at, y + h + 16, format_number(v), anchor="middle", kind="t"),
        ]
    return [*out, build_text(x + w / 2, y + h + 34, label, anchor="middle")]


def build_left_ticks(box: Box, low: float, high: float, label: str, *, grid: bool = False) -> list[SvgShape]:
    """Return ticks and label of the vertical axis left of a box.

    Args:
        box: Left, top, width and height in pixels.
        low: Value at the lower edge.
        high: Value at the upper edge.
        label: Label of the axis.
        grid: Draw grid lines.
    """
    x, y, w, h = box
    out = []
    for v in choose_round_levels(low, high, 6).tolist():
        at = y + h * (1 - (v - low) / (high - low))
        out.append(build_path(f"M{x:.1f} {at:.1f}h{w:.1f}", "g") if grid else build_path(f"M{x:.1f} {at:.1f}h-4", "a"))
        out.append(build_text(x - 7, at + 4, format_number(v), anchor="end", kind="t"))
    return [*out, build_text(x - 46, y + h / 2, label, anchor="middle", upright=False)]


def build_colour_bar(box: Box, low: float, high: float, label: str, *, inverted: bool) -> list[SvgShape]:
    """Return a vertical colour scale with round values on its right.

    Args:
        box: Left, top, width and height in pixels.
        low: Value at the lower edge.
        high: Value at the upper edge.
        label: Label of the scale.
        inverted: Low values are bright.
    """
    x, y, w, h = box
    n, out = 64, []
    shades = map_to_colours(np.arange(n) / (n - 1))[:: -1 if inverted else 1]
    for k, (r, g, b) in enumerate(shades.tolist()):
        at = y + h * (1 - (k + 1) / n)
        out.append(build_shape("rect", x=x, y=at, width=w, height=h / n + 0.6, fill=f"rgb({r},{g},{b})"))
    for v in choose_round_levels(low, high).tolist():
        at = y + h * (1 - (v - low) / (high - low))
        out += [build_path(f"M{x + w:.1f} {at:.1f}h4", "a"), build_text(x + w + 7, at + 4, format_number(v), kind="t")]
    return [*out, build_text(x + 76, y + h / 2, label, anchor="middle", upright=False)]


def map_to_colours(t: Array) -> Pixels:
    """Return (..., 3) colours.

    Args:
        t: (...) shares from 0 (dark, poor) to 1 (bright, good).
    """
    place = np.clip(t, 0.0, 1.0) * (len(VIRIDIS) - 1)
    i = np.minimum(place.astype(int), len(VIRIDIS) - 2)
    f = (place - i)[..., None]
    return np.asarray(np.round(VIRIDIS[i] + f * (VIRIDIS[i + 1] - VIRIDIS[i])), np.uint8)


def compute_hatching(code: int, x: NDArray[np.intp], y: NDArray[np.intp]) -> Pixels:
    """Return (..., 3) pixels of a :class:`PlaceCode`; the patterns differ in a grey print.

    Args:
        code: The code.
        x: (...) horizontal pixel positions.
        y: (...) vertical pixel positions.
    """
    patterns = {
        PlaceCode.UNREACHABLE: x < 0,
        PlaceCode.LIMIT: (x + y) % 12 < 3,
        PlaceCode.SINGULAR_WRIST: y % 9 < 2,
        PlaceCode.SINGULAR_ELBOW: x % 9 < 2,
        PlaceCode.SINGULAR_SHOULDER: (x % 10 < 2) | (y % 10 < 2),
        PlaceCode.COLLIDING: (x - y) % 10 < 4,
        PlaceCode.UNSTABLE: (x - y) % 12 < 3,
        PlaceCode.BOUNDS: ((x + y) % 12 < 2) | ((x - y) % 12 < 2),
    }
    red = (np.array([126, 34, 40], np.uint8), np.array([222, 178, 178], np.uint8))
    ink, pale = red if code == PlaceCode.COLLIDING else (DARK_COLOR, LIGHT_COLOR)
    mark = patterns.get(PlaceCode(code), (x % 12 < 2) & (y % 12 < 2))
    return np.where(mark[..., None], ink, pale)


def build_image(box: Box, pixels: Pixels) -> SvgShape:
    """Return pixels as an embedded PNG.

    Args:
        box: Left, top, width and height in pixels.
        pixels: (height, width, 3) colours.
    """
    x, y, w, h = box
    data = base64.b64encode(_encode_png(pixels)).decode("ascii")
    href = f"data:image/png;base64,{data}"
    return build_shape("image", x=x, y=y, width=w, height=h, preserveAspectRatio="none", href=href)


def render_document(width: float, height: float, title: str, parts: list[SvgShape]) -> Markup:
    """Return a complete SVG document.

    Args:
        width: Width, pixels.
        height: Height, pixels.
        title: Title for screen readers.
        parts: The shapes.
    """
    style, ground = build_shape("style", _STYLE), build_shape("rect", width="100%", height="100%", fill="#fff")
    size: Style = {"viewBox": f"0 0 {width:.0f} {height:.0f}", "width": f"{width:.0f}", "height": f"{height:.0f}"}
    inside = [style, ground, build_text(14, 18, title, kind="h"), *parts]
    space = "http://www.w3.org/2000/svg"
    return render_svg(build_shape("svg", title=title, class_="still", xmlns=space, **size, inside=inside))


def _encode_png(pixels: Pixels) -> bytes:
    from PIL import Image  # late: only pages with still pictures need it

    written = BytesIO()
    Image.fromarray(pixels).save(written, "png", compress_level=9)
    return written.getvalue()
