"""Section of the optimize report with the trade-off front: a table, and a chart of stiffness against time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from machopt.report.charts.isolines import choose_round_levels
from machopt.report.page_shell import build_section
from machopt.report.page_types.optimize_page_data import ReportData, TradeOffPoint
from machopt.report.pages.optimize.outcomes_over_time import draw_outcomes
from machopt.report.pages.report_tables import TableColumn, build_table
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

WIDE_WIDTH, NARROW_WIDTH, HEIGHT, MARGIN = (
    640.0,
    372.0,
    320.0,
    62.0,
)  # px; the narrow one for pages that would shrink the broad
MISSING, ALWAYS, WORDS = "–", ("clearance (mm)", "in tolerance"), ("plan", "changed", "note")
CHARACTER_WIDTH, LINE_HEIGHT = 6.5, 13.0  # px, of a tick's words: the most that a letter takes on average, and a line


def build_trade_off_section(data: ReportData) -> Markup | str:
    """Return the section; empty where no front was requested.

    Args:
        data: The data of the page.
    """
    if not data.front:
        return ""
    unit = "deflection (mm)" if data.summary.quantity == "deflection" else "compliance (mm/N)"
    columns, rows = _build_rows(data, unit)
    lead = (
        "Whole plans with other options, each driven and checked. A plan is dominated where another is nowhere worse "
        "in mean, time, travel, clearance, tolerances, mean error and stability (hollow in the picture); 0.1 % of the "
        "mean, 0.1 s, 1 deg, 0.01 mm of clearance, 0.001 mm of error and 0.01 of the ratio are no difference. Names "
        "say what counted more, not what came of it."
    )
    pictures = _build_picture(data, unit, WIDE_WIDTH, "broad") + _build_picture(data, unit, NARROW_WIDTH, "narrow")
    if any(p.in_tolerance is not None for p in data.front):
        pictures += render_part("heading", "In tolerance against cycle time") + draw_outcomes(data.front)
    return build_section("front", "Trade-off front", lead, pictures + build_table(columns, rows))


def _build_rows(data: ReportData, unit: str) -> tuple[list[TableColumn], list[tuple[str, ...]]]:
    """Return the columns that have values, and their texts."""
    texts: dict[str, Callable[[TradeOffPoint], str]] = {
        "plan": lambda p: p.name,
        "changed": lambda p: p.changed,
        f"mean {unit}": lambda p: f"{p.mean:.3g}",
        f"worst {unit}": lambda p: f"{p.worst:.3g}",
        "cycle (s)": lambda p: f"{p.cycle:.1f}",
        "joint travel (deg)": lambda p: f"{p.travel:.0f}",
        "clearance (mm)": lambda p: _format_known(p.clearance, ".1f"),
        "in tolerance": lambda p: _format_known(p.in_tolerance, "d"),
        "marginal": lambda p: _format_known(p.others and p.others[0], "d"),
        "fail": lambda p: _format_known(p.others and p.others[1], "d"),
        "unknown": lambda p: _format_known((p.others and p.others[2]) or None, "d"),
        "mean error (mm)": lambda p: _format_known(p.mean_error, ".3f"),
        "worst error (mm)": lambda p: _format_known(p.worst_error, ".3f"),
        "least stability ratio": lambda p: _format_known(p.least_stability, ".2f"),
        "changes of posture": lambda p: _format_known(p.changes or None, "d"),
        "note": lambda p: "dominated" if p.dominated else "",
    }
    shown = [name for name, text in texts.items() if name in ALWAYS or any(text(p) != MISSING for p in data.front)]
    columns = [TableColumn(name) if name in WORDS else TableColumn(name, "n") for name in shown]
    return columns, [tuple(texts[name](p) for name in shown) for p in data.front]


def _format_known(value: float | None, form: str) -> str:
    return MISSING if value is None else format(value, form)


def _build_picture(data: ReportData, unit: str, width: float, kind: str) -> Markup:
    x0, y0, wide, high = (MARGIN, 14.0, width - MARGIN - 14.0, HEIGHT - 62.0)
    (left, right), (least, most) = (
        _compute_span([p.cycle for p in data.front]),
        _compute_span([p.mean for p in data.front]),
    )
    inside: list[SvgShape] = []
    for v in choose_round_levels(least, most, 6).tolist():
        y = y0 + high * (most - v) / (most - least)
        inside.append(build_shape("path", class_="grid", d=f"M{x0:.1f} {y:.1f}h{wide:.1f}"))
        inside.append(build_shape("text", f"{v:.6g}", class_="tick", x=x0 - 7, y=y + 4, text_anchor="end"))
    for v in choose_round_levels(left, right, 8 if width == WIDE_WIDTH else 4).tolist():
        x = x0 + wide * (v - left) / (right - left)
        inside.append(build_shape("path", class_="grid", d=f"M{x:.1f} {y0:.1f}v{high:.1f}"))
        inside.append(build_shape("text", f"{v:.6g}", class_="tick", x=x, y=y0 + high + 16, text_anchor="middle"))
    middle: Style = {"class_": "label", "text_anchor": "middle"}
    inside.append(build_shape("text", "cycle time (s)", x=x0 + wide / 2, y=y0 + high + 36, **middle))
    turned = f"translate(14 {y0 + high / 2:.1f}) rotate(-90)"
    inside.append(build_shape("text", f"mean {unit}", transform=turned, **middle))
    words: dict[tuple[int, int], tuple[float, float]] = {}
    named: dict[tuple[int, int], list[str]] = {}  # plans that are one dot have one line of names
    for p in data.front:
        x = x0 + wide * (p.cycle - left) / (right - left)
        y = y0 + high * (most - p.mean) / (most - least)
        colour: Style = {"fill": "none" if p.dominated else "currentColor", "stroke": "currentColor"}
        inside.append(build_shape("circle", cx=x, cy=y, r=5, title=p.name, **colour))
        names = named.setdefault((round(x / 6), round(y / 6)), [])
        names.append(p.name)
        if len(names) > 1:
            continue
        words[(round(x / 6), round(y / 6))] = (x, y - 6)
    lines = [_place_label(x, y, _join_names(named[at], width), width) for at, (x, y) in words.items()]
    for x, y, anchor, text in _separate_labels(lines):
        inside.append(build_shape("text", text, class_="tick", x=x, y=y, text_anchor=anchor))
    return render_svg(
        build_shape(
            "svg",
            class_=f"{kind} front",
            viewBox=f"0 0 {width:.0f} {HEIGHT:.0f}",
            width="100%",
            style=f"max-width:{width:.0f}px",
            role="img",
            aria_label=f"mean {unit} over cycle time of each plan",
            inside=inside,
        )
    )


def _join_names(names: list[str], width: float) -> str:
    """Return the names of plans that are one dot, as many as half of the picture holds; at least the first."""
    count = 1
    while count < len(names) and CHARACTER_WIDTH * len(", ".join(names[: count + 1])) < 0.5 * width:
        count += 1
    more = f" and {len(names) - count} more" if count < len(names) else ""
    return ", ".join(names[:count]) + more


def _place_label(x: float, y: float, text: str, width: float) -> tuple[float, float, str, str]:
    """A line of words (x, y, anchor, text) right of its dot, or left of it where it would leave the picture."""
    long = CHARACTER_WIDTH * len(text)
    if x + 8 + long <= width:
        return x + 8, y, "", text
    return (x - 8 if x - 8 - long >= 0 else width - 2), y, "end", text


def _separate_labels(lines: list[tuple[float, float, str, str]]) -> list[tuple[float, float, str, str]]:
    """Lines of words (x, y, anchor, text), those that would lie on an earlier one moved up, or down from the top."""
    put: list[tuple[float, float, str, str]] = []

    def ends(x: float, anchor: str, text: str) -> tuple[float, float]:
        return (x - CHARACTER_WIDTH * len(text), x) if anchor == "end" else (x, x + CHARACTER_WIDTH * len(text))

    def free(x: float, y: float, anchor: str, text: str) -> bool:
        left, right = ends(x, anchor, text)
        return all(
            abs(y - other) >= LINE_HEIGHT or right < least or most < left
            for (least, most), other in ((ends(a, b, c), v) for a, v, b, c in put)
        )

    for x, y, anchor, text in lines:
        steps = (n * way for n in range(len(lines) + 1) for way in (-LINE_HEIGHT, LINE_HEIGHT))
        spots = (y + step for step in steps if y + step > LINE_HEIGHT)
        put.append((x, next((v for v in spots if free(x, v, anchor, text)), y), anchor, text))
    return put


def _compute_span(values: list[float]) -> tuple[float, float]:
    """Ends of an axis that holds all values and has a length where they are one."""
    room = 0.12 * (max(values) - min(values)) or 0.05 * abs(max(values)) or 1.0
    return min(values) - room, max(values) + room
