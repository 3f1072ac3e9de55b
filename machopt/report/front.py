"""The trade-off front on the report page: a table, and a picture of stiffness against time."""

from __future__ import annotations

from html import escape

from machopt.report.data import ReportData
from machopt.report.shell import section
from machopt.report.tables import Column, table

WIDTH, HEIGHT, EDGE = 560, 260, 46


def front_section(data: ReportData) -> str:
    """The section; empty where no front was asked for."""
    if not data.front:
        return ""
    unit = "deflection mm" if data.summary.quantity == "deflection" else "compliance mm/N"
    columns = [Column("plan"), Column("changed"), Column(f"mean {unit}", "n"), Column(f"worst {unit}", "n"),
               Column("cycle s", "n"), Column("joint travel deg", "n"), Column("clearance mm", "n"),
               Column("")]  # fmt: skip
    rows = [
        (p.name, p.changed, f"{p.mean:.4g}", f"{p.worst:.4g}", f"{p.cycle:.2f}", f"{p.travel:.0f}",
         "–" if p.clearance is None else f"{p.clearance:.2f}", "dominated" if p.dominated else "")
        for p in data.front
    ]  # fmt: skip
    lead = (
        "Whole plans with other weights or another clearance, each driven and checked. A plan is dominated where "
        "another is nowhere worse in mean, time, travel and clearance."
    )
    return section("front", "Trade-off front", lead, _picture(data, unit) + table(columns, rows))


def _picture(data: ReportData, unit: str) -> str:
    time, mean = [p.cycle for p in data.front], [p.mean for p in data.front]

    def at(value: float, values: list[float], size: int) -> float:
        low, high = min(values), max(values)
        return EDGE + (size - 2 * EDGE) * ((value - low) / (high - low) if high > low else 0.5)

    marks = "".join(
        f'<circle cx="{at(p.cycle, time, WIDTH):.1f}" cy="{HEIGHT - at(p.mean, mean, HEIGHT):.1f}" r="5" '
        f'fill="{"none" if p.dominated else "currentColor"}" stroke="currentColor"/>'
        f'<text x="{at(p.cycle, time, WIDTH) + 8:.1f}" y="{HEIGHT - at(p.mean, mean, HEIGHT) - 6:.1f}" font-size="11" '
        f'fill="currentColor">{escape(p.name)}</text>'
        for p in data.front
    )  # fmt: skip
    words = (
        f'<text x="{WIDTH / 2:.0f}" y="{HEIGHT - 8}" font-size="11" text-anchor="middle" fill="currentColor">cycle '
        f"{min(time):.2f} to {max(time):.2f} s</text>"
        f'<text x="6" y="14" font-size="11" fill="currentColor">mean {escape(unit)}, {min(mean):.4g} to '
        f"{max(mean):.4g}</text>"
    )
    return (
        f'<svg viewBox="0 0 {WIDTH + 90} {HEIGHT}" width="100%" style="max-width:{WIDTH + 90}px" role="img" '
        f'aria-label="mean over cycle time">{words}{marks}</svg>'
    )
