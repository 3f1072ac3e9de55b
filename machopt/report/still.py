"""Pieces of still SVG pictures: texts, strokes, ticks, an embedded PNG, colours."""

from __future__ import annotations

import base64
import struct
import zlib
from html import escape

import numpy as np
from numpy.typing import NDArray

from machopt.report.contours import round_levels

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]
Box = tuple[float, float, float, float]  # x, y, width, height

VIRIDIS = np.array([
    [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121],
    [110, 206, 88], [181, 222, 43], [253, 231, 37],
], float)  # fmt: skip
INK, PALE = np.array([92, 98, 108], np.uint8), np.array([226, 228, 231], np.uint8)
_STYLE = (
    ".still text{font-family:Arial,'Liberation Sans',sans-serif;font-size:12px;fill:#333d49}"
    ".still .t{font-size:11px}.still .h{font-size:14px;font-weight:bold;fill:#1b2430}"
    ".still .a{stroke:#7c8794;fill:none}.still .g{stroke:#e8ebee}.still .i{stroke:#fff;stroke-width:.9;fill:none}"
)


def text(x: float, y: float, words: str, *, anchor: str = "start", kind: str = "", upright: bool = True) -> str:
    """A line of text; not upright: turned to read from below, about its anchor."""
    place = f'x="{x:.1f}" y="{y:.1f}"' if upright else f'transform="translate({x:.1f} {y:.1f}) rotate(-90)"'
    return f'<text {f"""class="{kind}" """ if kind else ""}{place} text-anchor="{anchor}">{escape(words)}</text>'


def stroke(d: str, kind: str = "", **more: str) -> str:
    """A path; further attributes with _ for -."""
    extra = "".join(f' {name.replace("_", "-")}="{value}"' for name, value in more.items() if value)
    return f'<path {f"""class="{kind}" """ if kind else ""}d="{d}"{extra}/>'


def frame(box: Box) -> str:
    x, y, w, h = box
    return f'<rect class="a" x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}"/>'


def number(value: float) -> str:
    return f"{value + 0.0:.6g}".replace("-", "−")


def ticks_below(box: Box, low: float, high: float, label: str) -> str:
    """Ticks and label of a horizontal axis under a box."""
    x, y, w, h = box
    out = []
    for v in round_levels(low, high, 8).tolist():
        at = x + w * (v - low) / (high - low)
        out.append(stroke(f"M{at:.1f} {y + h:.1f}v4", "a") + text(at, y + h + 16, number(v), anchor="middle", kind="t"))
    return "".join([*out, text(x + w / 2, y + h + 34, label, anchor="middle")])


def ticks_left(box: Box, low: float, high: float, label: str, *, grid: bool = False) -> str:
    """Ticks and label of a vertical axis left of a box, with lines across it if ``grid``."""
    x, y, w, h = box
    out = []
    for v in round_levels(low, high, 6).tolist():
        at = y + h * (1 - (v - low) / (high - low))
        out.append(stroke(f"M{x:.1f} {at:.1f}h{w:.1f}", "g") if grid else stroke(f"M{x:.1f} {at:.1f}h-4", "a"))
        out.append(text(x - 7, at + 4, number(v), anchor="end", kind="t"))
    return "".join([*out, text(x - 46, y + h / 2, label, anchor="middle", upright=False)])


def colour_bar(box: Box, low: float, high: float, label: str, *, inverted: bool) -> str:
    """A vertical scale with round values on its right."""
    x, y, w, h = box
    n, out = 64, []
    shades = colours(np.arange(n) / (n - 1))[:: -1 if inverted else 1]
    for k, (r, g, b) in enumerate(shades.tolist()):
        out.append(
            f'<rect x="{x:.1f}" y="{y + h * (1 - (k + 1) / n):.1f}" width="{w:.1f}" height="{h / n + 0.6:.1f}" '
            f'fill="rgb({r},{g},{b})"/>'
        )
    for v in round_levels(low, high).tolist():
        at = y + h * (1 - (v - low) / (high - low))
        out.append(stroke(f"M{x + w:.1f} {at:.1f}h4", "a") + text(x + w + 7, at + 4, number(v), kind="t"))
    return "".join([*out, text(x + 76, y + h / 2, label, anchor="middle", upright=False)])


def colours(t: Array) -> Pixels:
    """(..., 3) colour of shares 0 (dark, poor) to 1 (bright, good)."""
    place = np.clip(t, 0.0, 1.0) * (len(VIRIDIS) - 1)
    i = np.minimum(place.astype(int), len(VIRIDIS) - 2)
    f = (place - i)[..., None]
    return np.asarray(np.round(VIRIDIS[i] + f * (VIRIDIS[i + 1] - VIRIDIS[i])), np.uint8)


def hatching(code: int, x: NDArray[np.intp], y: NDArray[np.intp]) -> Pixels:
    """(..., 3) pixels that stand for a reason code; patterns differ so that they survive a grey print."""
    patterns = {1: x < 0, 2: (x + y) % 12 < 3, 3: y % 9 < 2, 4: x % 9 < 2, 5: (x % 10 < 2) | (y % 10 < 2),
                6: (x - y) % 10 < 4}  # fmt: skip
    ink, pale = (np.array([126, 34, 40], np.uint8), np.array([222, 178, 178], np.uint8)) if code == 6 else (INK, PALE)
    mark = patterns.get(code, (x % 12 < 2) & (y % 12 < 2))
    return np.where(mark[..., None], ink, pale)


def image(box: Box, pixels: Pixels) -> str:
    """Pixels (height, width, 3) as an embedded PNG."""
    x, y, w, h = box
    data = base64.b64encode(_png(pixels)).decode("ascii")
    return (
        f'<image x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{data}"/>'
    )


def document(width: float, height: float, title: str, parts: list[str]) -> str:
    return (
        '<svg class="still" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" height="{height:.0f}">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style>"
        f'<rect width="100%" height="100%" fill="#fff"/>{text(14, 18, title, kind="h")}{"".join(parts)}</svg>\n'
    )


def _png(pixels: Pixels) -> bytes:
    h, w, _ = pixels.shape
    rows = np.concatenate([np.zeros((h, 1), np.uint8), pixels.reshape(h, 3 * w)], axis=1).tobytes()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", w, h, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
