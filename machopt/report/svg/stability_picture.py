"""Picture of the stability map: path length across, rotation upwards, colour by stable depth over planned depth."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

from machopt.numerics.array_types import Array
from machopt.report.page_types.optimize_page_data import StabilityMap
from machopt.report.svg.shapes import SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup

WIDTH, HEIGHT, MARGIN = 980.0, 330.0, 56.0
UNSTABLE, FORBIDDEN, SMALL_RESERVE, STABLE, FREE, MISSING = (
    (179, 38, 30),
    (226, 120, 60),
    (217, 163, 13),
    (140, 196, 120),
    (32, 110, 70),
    (225, 228, 232),
)
LEVELS = (1.0, 1.2, 4.0)  # ratios at which the colour changes; between the last two it fades
LEGEND = (
    (UNSTABLE, "unstable at the planned depth"),
    (SMALL_RESERVE, "reserve below 20 %"),
    (STABLE, "stable"),
    (FREE, "stable at 4 times the depth"),
    (MISSING, "no posture"),
)


def draw_stability_map(stability_map: StabilityMap) -> Markup:
    """Return the picture.

    Args:
        stability_map: Data of the map.
    """
    wide, high = WIDTH - MARGIN - 26.0, HEIGHT - 84.0
    pixels = _compute_colours(stability_map.ratio, stability_map.least)[:, ::-1].transpose(1, 0, 2)  # rotation upwards
    url = f"data:image/png;base64,{base64.b64encode(encode_png(pixels)).decode()}"
    inside: list[SvgShape] = [
        build_shape(
            "image",
            href=url,
            x=MARGIN,
            y=10.0,
            width=wide,
            height=high,
            preserveAspectRatio="none",
            style="image-rendering:pixelated",
        )
    ]
    low, top = float(stability_map.rotation.min()), float(stability_map.rotation.max())
    for degrees in range(-180, 181, 60):
        y = 10.0 + high * (top - math.radians(degrees)) / (top - low)
        if 9.0 <= y <= 11.0 + high:
            inside.append(build_shape("text", f"{degrees}°", class_="tick", x=MARGIN - 6, y=y + 4, text_anchor="end"))
    length = 1e3 * (stability_map.s[-1] - stability_map.s[0]) or 1.0
    for n in range(6):
        x = MARGIN + wide * n / 5
        text = f"{1e3 * stability_map.s[0] + length * n / 5:.0f}"
        inside.append(build_shape("text", text, class_="tick", x=x, y=high + 26, text_anchor="middle"))
    inside.append(
        build_shape("text", "path length (mm)", class_="label", x=MARGIN + wide / 2, y=high + 44, text_anchor="middle")
    )
    inside += _draw_chosen(stability_map.chosen, (low, top), (wide, high))
    inside += _draw_legend(high + 62, stability_map.least)
    return render_svg(
        build_shape(
            "svg",
            viewBox=f"0 0 {WIDTH:.0f} {HEIGHT:.0f}",
            width="100%",
            role="img",
            aria_label="stable depth of cut over the planned depth, along the path and over the rotation",
            inside=inside,
        )
    )


def _draw_chosen(chosen: Array, span: tuple[float, float], size: tuple[float, float]) -> list[SvgShape]:
    """Return the chosen rotation as a line that breaks where it wraps around."""
    (low, top), (wide, high) = span, size
    d, last = [], math.nan
    for n, phi in enumerate(chosen.tolist()):
        if not math.isfinite(phi):
            last = math.nan
            continue
        x = MARGIN + wide * (n + 0.5) / len(chosen)
        y = 10.0 + high * (top - phi) / (top - low)
        joined = math.isfinite(last) and abs(phi - last) < math.pi
        d.append(f"{'L' if joined else 'M'}{x:.1f} {y:.1f}")
        last = phi
    path = "".join(d)
    return [
        build_shape("path", d=path, fill="none", stroke="#000", stroke_width=3.4),
        build_shape("path", d=path, fill="none", stroke="#fff", stroke_width=1.8),
    ]


def _draw_legend(y: float, least: float | None) -> list[SvgShape]:
    out, x = [], MARGIN
    entries = list(LEGEND)
    if least is not None and least > LEVELS[0]:
        entries.insert(1, (FORBIDDEN, f"below the least ratio {least:g}"))
    if least is not None and least >= LEVELS[1]:
        entries.remove((SMALL_RESERVE, "reserve below 20 %"))
    for colour, text in entries:
        out.append(build_shape("rect", x=x, y=y, width=12.0, height=12.0, fill="#{:02x}{:02x}{:02x}".format(*colour)))
        out.append(build_shape("text", text, class_="tick", x=x + 17, y=y + 10))
        x += 34.0 + 6.6 * len(text)
    return out


def _compute_colours(ratio: Array, least: float | None) -> np.ndarray:
    """Return (S, R, 3) bytes."""
    out = np.empty((*ratio.shape, 3), np.uint8)
    fade = np.clip((np.nan_to_num(ratio, posinf=LEVELS[2]) - LEVELS[1]) / (LEVELS[2] - LEVELS[1]), 0.0, 1.0)[..., None]
    out[:] = np.round((1.0 - fade) * np.array(STABLE) + fade * np.array(FREE))
    out[ratio < LEVELS[1]] = SMALL_RESERVE
    if least is not None:
        out[ratio < least] = FORBIDDEN
    out[ratio <= LEVELS[0]] = UNSTABLE
    out[np.isnan(ratio)] = MISSING
    return out


def encode_png(pixels: np.ndarray) -> bytes:
    """Return a PNG file.

    Args:
        pixels: (height, width, 3) bytes.

    Source: Portable Network Graphics Specification, 2nd ed. (2003).
    """
    height, width = pixels.shape[:2]
    rows = b"".join(b"\x00" + row.tobytes() for row in np.ascontiguousarray(pixels))

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")
