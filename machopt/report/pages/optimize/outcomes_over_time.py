"""Picture of the trade-off front: holes and points in tolerance over cycle time, and the outcomes of each plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from machopt.report.charts.isolines import choose_round_levels
from machopt.report.page_types.optimize_page_data import TradeOffPoint
from machopt.report.svg.shapes import SvgShape, build_shape, render_svg

if TYPE_CHECKING:
    from markupsafe import Markup

WIDTH, CURVE_HEIGHT, ROW_HEIGHT = 640.0, 250.0, 20.0
LEFT, RIGHT, TOP = 62.0, 20.0, 16.0
NAME_WIDTH, TIME_WIDTH = 200.0, 62.0
CHARACTER_WIDTH = 6.5  # px of a tick's text
OUTCOMES = (
    ("pass", (32, 110, 70)),
    ("marginal", (217, 163, 13)),
    ("fail", (179, 38, 30)),
    ("unknown", (150, 156, 166)),
)


def draw_outcomes(front: Sequence[TradeOffPoint]) -> Markup:
    """Return the picture; plans without tolerances are left out.

    Args:
        front: Plans of the front, at least one with tolerances.
    """
    plans = sorted((p for p in front if p.in_tolerance is not None), key=lambda p: (p.cycle, p.in_tolerance))
    bars = TOP + CURVE_HEIGHT + 64.0
    high = bars + ROW_HEIGHT * len(plans) + 30.0
    return render_svg(
        build_shape(
            "svg",
            class_="front",
            viewBox=f"0 0 {WIDTH:.0f} {high:.0f}",
            width="100%",
            style=f"max-width:{WIDTH:.0f}px",
            role="img",
            aria_label="holes and points in tolerance over cycle time of each plan",
            inside=[*_draw_curve(plans), *_draw_bars(plans, bars)],
        )
    )


def list_best_steps(plans: Sequence[TradeOffPoint]) -> list[TradeOffPoint]:
    """Return the plans that have more in tolerance than every faster one, the fastest first.

    Args:
        plans: Plans with tolerances.
    """
    out: list[TradeOffPoint] = []
    for p in sorted(plans, key=lambda p: (p.cycle, -(p.in_tolerance or 0))):
        if not out or (p.in_tolerance or 0) > (out[-1].in_tolerance or 0):
            out.append(p)
    return out


def _draw_curve(plans: Sequence[TradeOffPoint]) -> list[SvgShape]:
    """Return axes, one dot a plan, and a line through the best ones."""
    wide, high = WIDTH - LEFT - RIGHT, CURVE_HEIGHT
    total = float(max(_count(p) for p in plans))
    first, last = plans[0].cycle, plans[-1].cycle
    room = 0.06 * (last - first) or 0.05 * first or 1.0
    first, last = first - room, last + room

    def place(p: TradeOffPoint) -> tuple[float, float]:
        x = LEFT + wide * (p.cycle - first) / (last - first)
        return x, TOP + high * (1.0 - (p.in_tolerance or 0) / max(total, 1.0))

    out: list[SvgShape] = []
    for v in choose_round_levels(0.0, total, 6).tolist():
        y = TOP + high * (1.0 - v / max(total, 1.0))
        out.append(build_shape("path", class_="grid", d=f"M{LEFT:.1f} {y:.1f}h{wide:.1f}"))
        out.append(build_shape("text", f"{v:.6g}", class_="tick", x=LEFT - 7, y=y + 4, text_anchor="end"))
    for v in choose_round_levels(first, last, 7).tolist():
        x = LEFT + wide * (v - first) / (last - first)
        out.append(build_shape("path", class_="grid", d=f"M{x:.1f} {TOP:.1f}v{high:.1f}"))
        out.append(build_shape("text", f"{v:.6g}", class_="tick", x=x, y=TOP + high + 16, text_anchor="middle"))
    path = "L".join(f"{x:.1f} {y:.1f}" for x, y in map(place, list_best_steps(plans)))
    out.append(build_shape("path", d=f"M{path}", fill="none", stroke="currentColor", stroke_width=1.5))
    for p in plans:
        x, y = place(p)
        fill = "none" if p.dominated else "currentColor"
        out.append(build_shape("circle", cx=x, cy=y, r=5, title=p.name, fill=fill, stroke="currentColor"))
    below = TOP + high + 36
    out.append(build_shape("text", "cycle time (s)", class_="label", x=LEFT + wide / 2, y=below, text_anchor="middle"))
    turned = f"translate(14 {TOP + high / 2:.1f}) rotate(-90)"
    label = f"in tolerance, of {total:.0f}"
    return [*out, build_shape("text", label, class_="label", transform=turned, text_anchor="middle")]


def _draw_bars(plans: Sequence[TradeOffPoint], y0: float) -> list[SvgShape]:
    """Return one bar a plan, the fastest first: how many pass, are marginal, fail and are unknown."""
    out: list[SvgShape] = []
    x0, wide = NAME_WIDTH + TIME_WIDTH, WIDTH - NAME_WIDTH - TIME_WIDTH - RIGHT
    most = int((NAME_WIDTH - 6.0) / CHARACTER_WIDTH)
    for n, p in enumerate(plans):
        y, x = y0 + ROW_HEIGHT * n, x0
        name = p.name if len(p.name) <= most else p.name[: most - 1] + "…"
        out.append(build_shape("text", name, class_="tick", x=2.0, y=y + 11))
        out.append(build_shape("text", f"{p.cycle:.1f} s", class_="tick", x=x0 - 8, y=y + 11, text_anchor="end"))
        for count, (word, colour) in zip((p.in_tolerance or 0, *(p.others or (0, 0, 0))), OUTCOMES, strict=True):
            part = wide * count / max(_count(p), 1)
            if count:
                title = f"{p.name}: {count} {word}"
                out.append(
                    build_shape("rect", x=x, y=y, width=part, height=14.0, fill=_format_hex(colour), title=title)
                )
            x += part
    return [*out, *_draw_legend(y0 + ROW_HEIGHT * len(plans) + 8.0)]


def _draw_legend(y: float) -> list[SvgShape]:
    out: list[SvgShape] = []
    x = NAME_WIDTH + TIME_WIDTH
    for word, colour in OUTCOMES:
        out.append(build_shape("rect", x=x, y=y, width=12.0, height=12.0, fill=_format_hex(colour)))
        out.append(build_shape("text", word, class_="tick", x=x + 17, y=y + 10))
        x += 40.0 + CHARACTER_WIDTH * len(word)
    return out


def _format_hex(colour: tuple[int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _count(p: TradeOffPoint) -> int:
    return (p.in_tolerance or 0) + sum(p.others or ())
