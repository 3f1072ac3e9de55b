"""The trade-off front on the report page: a table, and a picture of stiffness against time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from machopt.report.data import ReportData
from machopt.report.shell import section
from machopt.report.svg import Style, drawn, shape
from machopt.report.tables import Column, table

if TYPE_CHECKING:
    from markupsafe import Markup

WIDTH, HEIGHT, EDGE = 560, 260, 46


def front_section(data: ReportData) -> Markup | str:
    """The section; empty where no front was asked for."""
    if not data.front:
        return ""
    unit = "deflection mm" if data.summary.quantity == "deflection" else "compliance mm/N"
    columns = [
        Column("plan"),
        Column("changed"),
        Column(f"mean {unit}", "n"),
        Column(f"worst {unit}", "n"),
        Column("cycle s", "n"),
        Column("joint travel deg", "n"),
        Column("clearance mm", "n"),
        Column("note"),
    ]
    rows = [
        (
            p.name,
            p.changed,
            f"{p.mean:.4g}",
            f"{p.worst:.4g}",
            f"{p.cycle:.2f}",
            f"{p.travel:.0f}",
            "–" if p.clearance is None else f"{p.clearance:.2f}",
            "dominated" if p.dominated else "",
        )
        for p in data.front
    ]
    lead = (
        "Whole plans with other weights or another clearance, each driven and checked. A plan is dominated where "
        "another is nowhere worse in mean, time, travel and clearance."
    )
    return section("front", "Trade-off front", lead, _picture(data, unit) + table(columns, rows))


def _picture(data: ReportData, unit: str) -> Markup:
    time, mean = [p.cycle for p in data.front], [p.mean for p in data.front]

    def at(value: float, values: list[float], size: int) -> float:
        low, high = min(values), max(values)
        return EDGE + (size - 2 * EDGE) * ((value - low) / (high - low) if high > low else 0.5)

    ink = "currentColor"
    small: Style = {"font_size": 11, "fill": ink}
    marks = []
    for p in data.front:
        x, y = at(p.cycle, time, WIDTH), HEIGHT - at(p.mean, mean, HEIGHT)
        marks.append(shape("circle", cx=x, cy=y, r=5, fill="none" if p.dominated else ink, stroke=ink))
        marks.append(shape("text", p.name, x=x + 8, y=y - 6, **small))
    words = [
        shape(
            "text",
            f"cycle {min(time):.2f} to {max(time):.2f} s",
            x=WIDTH / 2,
            y=HEIGHT - 8,
            text_anchor="middle",
            **small,
        ),
        shape("text", f"mean {unit}, {min(mean):.4g} to {max(mean):.4g}", x=6, y=14, **small),
    ]
    return drawn(
        shape(
            "svg",
            viewBox=f"0 0 {WIDTH + 90} {HEIGHT}",
            width="100%",
            style=f"max-width:{WIDTH + 90}px",
            role="img",
            aria_label="mean over cycle time",
            inside=[*words, *marks],
        )
    )
