"""Page of ``machopt place``: a map of the index over x and y, the best placements, and their neighbourhood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.data_types.documents.place_document import NeighbourPlaceEntry, PlaceDocument, PlaceEntry
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.display_units import format_fixed
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.svg.chart_elements import map_to_colours
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup
    from numpy.typing import NDArray

    Body = Markup | str

DARK_COLOR = "#1a2330"  # round white marks, so that they stand out on every colour
WIDTH, HEIGHT = 640.0, 460.0
LEFT, TOP, RIGHT, BOTTOM = 84.0, 16.0, 120.0, 44.0
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


@dataclass(frozen=True)
class PlacementPageData:
    """Data of the page."""

    result: PlaceDocument
    marks: tuple[PlaceMark, ...]


def write_placement_page(path: Path, data: PlacementPageData) -> None:
    """Write the page; the same data give the same bytes.

    Args:
        path: The file to write.
        data: The data of the page.
    """
    path.write_text(build_placement_html(data), encoding="utf-8", newline="\n")


def build_placement_html(data: PlacementPageData) -> str:
    """Return the page.

    Args:
        data: The data of the page.
    """
    r = data.result
    sections = [
        ("verdict", "Verdict", _build_verdict(data)),
        ("map", "Map", _build_map(data)),
        ("best", "Best places", _build_best(r)),
        ("around", "Around", _build_neighbours(r)),
        ("rules", "What rules", _build_rules(r)),
        ("refused", "Refused", _build_refused(data)),
        ("run", "This run", _build_run(r)),
    ]
    return build_page_html(
        f"Placement: {r.cell}",
        (("Cell", r.cell), ("Toolpaths", ", ".join(r.toolpaths))),
        sections,
        {},
        scripts=(),
        footer=f"machopt {r.version}. Lengths mm, angles deg, index {r.index} in {r.unit}; x, y and z are those of "
        "world, shifts count from where the cell has it.",
    )


def _build_verdict(data: PlacementPageData) -> Body:
    r = data.result
    tone = {0: "good", 3: "bad"}.get(r.exit_code, "bad")
    badge = {0: "PLACED", 3: "NOWHERE"}.get(r.exit_code, "NOT CONFIRMED")
    cards = []
    if r.best:
        top = r.best[0]
        cards.append(
            ("Worst index", f"{_format_number(top.worst)}", r.unit, f"mean {_format_number(top.mean)} {r.unit}")
        )
        if r.as_it_stands is not None and r.as_it_stands.worst is not None:
            cards.append(
                (
                    "As it stands",
                    f"{_format_number(r.as_it_stands.worst)}",
                    r.unit,
                    "the same planner, the cell unmoved",
                )
            )
        if r.gain_percent is not None:
            cards.append(("Gain", f"{r.gain_percent:.1f}", "%", "of the worst index over all toolpaths"))
        cards.append(("Places", f"{r.within_reach}", "", f"within reach of {r.looked_at}, {r.planned} planned wholly"))
    said = f"{r.verdict[0].upper()}{r.verdict[1:]}.".replace(" -", " −")
    leaving = [w for w in r.warnings if w.startswith("place ")]
    others = [w for w in r.warnings if w not in leaving]
    return render_part("verdict", "verdict", tone, badge, said, others, cards, leaving)


def _build_map(data: PlacementPageData) -> Body:
    best: dict[tuple[float, float], PlaceMark] = {}
    for mark in data.marks:
        at = (round(mark.x, 6), round(mark.y, 6))
        if at not in best or _rank_mark(mark) < _rank_mark(best[at]):
            best[at] = mark
    marks = list(best.values())
    if len({m.x for m in marks}) < 2 and len({m.y for m in marks}) < 2:
        return ""
    lead = (
        "Each square is a place; where height or turn vary too, the best of them. A ring marks places that were "
        "planned wholly, with collisions and motion; the others show the best the grid of rotations comes to without "
        "collisions. Crosses cannot be reached or stood on. The diamond is where the cell has it, the star the best."
    )
    return build_section(
        "map", f"Worst index over x and y ({data.result.unit}, less is better)", lead, _build_picture(data, marks)
    )


def _rank_mark(mark: PlaceMark) -> tuple[bool, float]:
    return (bool(mark.refused) or not math.isfinite(mark.value), mark.value)


def _build_picture(data: PlacementPageData, marks: Sequence[PlaceMark]) -> Markup:
    xs, ys = np.array([m.x for m in marks]), np.array([m.y for m in marks])
    step = min((float(np.diff(np.unique(v)).max()) for v in (xs, ys) if len(np.unique(v)) > 1), default=1.0)
    low = np.array([xs.min(), ys.min()]) - 0.5 * step
    high = np.array([xs.max(), ys.max()]) + 0.5 * step
    scale = min((WIDTH - LEFT - RIGHT) / (high[0] - low[0]), (HEIGHT - TOP - BOTTOM) / (high[1] - low[1]))
    wide, tall = scale * (high - low)

    def at(x: float, y: float) -> tuple[float, float]:
        return LEFT + scale * (x - float(low[0])), TOP + tall - scale * (y - float(low[1]))

    known = np.array([m.value for m in marks if not m.refused and math.isfinite(m.value)])
    least, most = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    span = most - least or 1.0
    small: Style = {"font_size": 11, "fill": "currentColor"}
    size = 0.94 * scale * step
    shapes: list[SvgShape] = []
    for m in sorted(marks, key=lambda m: (m.planned, m.x, m.y)):
        share = (most - m.value) / span
        shapes += _draw_place(m, at(m.x, m.y), size, share, data.result.unit)
    mark: Style = {
        "fill": "#fff",
        "stroke": DARK_COLOR,
        "stroke_width": 3,
        "paint_order": "stroke",
        "text_anchor": "middle",
    }
    shapes.append(build_shape("text", "◆", x=at(0, 0)[0], y=at(0, 0)[1] + 5, font_size=15, **mark))
    if data.result.best:
        bx, by = at(data.result.best[0].shift_mm[0], data.result.best[0].shift_mm[1])
        shapes.append(build_shape("text", "★", x=bx, y=by + 6, font_size=18, **mark))
    for v in _select_labelled_values(xs):
        shapes.append(
            build_shape(
                "text", _format_number(v, ".0f"), x=at(v, 0)[0], y=TOP + tall + 16, text_anchor="middle", **small
            )
        )
    for v in _select_labelled_values(ys):
        shapes.append(
            build_shape("text", _format_number(v, ".0f"), x=LEFT - 8, y=at(0, v)[1] + 4, text_anchor="end", **small)
        )
    shapes.append(build_shape("text", "x (mm)", x=LEFT + wide / 2, y=TOP + tall + 34, text_anchor="middle", **small))
    shapes.append(build_shape("text", "y (mm)", x=2.0, y=TOP + tall / 2, **small))
    shapes += _draw_colour_scale(LEFT + wide + 18, tall, least, most)
    return render_svg(
        build_shape(
            "svg",
            viewBox=f"0 0 {LEFT + wide + RIGHT:.0f} {TOP + tall + BOTTOM:.0f}",
            width="100%",
            style=f"max-width:{LEFT + wide + RIGHT:.0f}px",
            role="img",
            aria_label="worst index over x and y",
            inside=shapes,
        )
    )


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
    title = f"{m.words}: {_format_number(m.value)} {unit}{' (planned)' if m.planned else ''}"
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


def _draw_colour_scale(x: float, tall: float, least: float, most: float) -> list[SvgShape]:
    """Return the bar with the colours of the values."""
    out: list[SvgShape] = []
    small: Style = {"font_size": 11, "fill": "currentColor"}
    for k in range(24):
        red, green, blue = (int(v) for v in np.asarray(map_to_colours(np.array([1 - k / 23])))[0][:3])
        y = TOP + tall * (1 - (k + 1) / 24)
        out.append(build_shape("rect", x=x, y=y, width=14, height=tall / 24 + 0.6, fill=f"rgb({red},{green},{blue})"))
    for value, y in ((most, TOP + 8), (least, TOP + tall)):
        out.append(build_shape("text", _format_number(value), x=x + 20, y=y, **small))
    return out


def _select_labelled_values(values: NDArray[np.float64]) -> list[float]:
    """The coordinates of places that the axis names: all, or every so many from the middle out, as many as fit."""
    at = np.unique(values.round(6))
    every = -(-len(at) // MAX_LABELS)
    return [float(v) for v in at[(len(at) // 2) % every :: every]]


def _build_best(r: PlaceDocument) -> Body:
    if not r.best:
        return ""
    columns = [
        TableColumn("Place"),
        TableColumn("x (mm)", "n"),
        TableColumn("y (mm)", "n"),
        TableColumn("z (mm)", "n"),
        TableColumn("turn (deg)", "n"),
        TableColumn(f"Worst ({r.unit})", "n"),
        TableColumn(f"Mean ({r.unit})", "n"),
        TableColumn("Gain (%)", "n"),
        TableColumn("Cycle (s)", "n"),
        TableColumn("Plan", "html"),
    ]
    rows = [_build_row(f"{k}", p) for k, p in enumerate(r.best, 1)]
    if r.as_it_stands is not None:
        rows.append(_build_row("present position", r.as_it_stands))
    lead = (
        "Whole plans with collisions and motion. Each folder holds the moved cell and, for every toolpath, what "
        "optimize writes: motion, programs, report, verified."
    )
    body = build_table(columns, rows) + render_part("heading", "Pose for cell.yaml") + _build_poses(r)
    return build_section("best", "Best places", lead, body)


def _build_poses(r: PlaceDocument) -> Body:
    """The absolute pose of each best place, to be pasted into cell.yaml."""
    key = "robot.pose, base_link in world" if r.moved == "base_link" else "workpiece.pose, in its link"
    along = f"; {', '.join(r.carried)} moved along" if r.carried else ""
    rows = [(str(k), p.pose_text, f"{p.folder}/cell{along}" if p.folder else "–") for k, p in enumerate(r.best, 1)]
    return build_table([TableColumn("Place"), TableColumn(key, "mono"), TableColumn("The whole cell")], rows)


def _build_row(name: str, p: PlaceEntry) -> tuple[Body, ...]:
    x, y, z = p.shift_mm
    plan: Body = render_part("linked", p.plans, p.verdict)
    gain = _format_number(p.gain_percent, ".1f")
    return (
        name,
        *(format_fixed(v, 0, signed=True) for v in (x, y, z)),
        format_fixed(p.turn_deg, 1, signed=True),
        _format_number(p.worst),
        _format_number(p.mean),
        gain,
        _format_number(p.cycle_time_s, ".1f"),
        plan,
    )


def _build_neighbours(r: PlaceDocument) -> Body:
    moved = [n.moved for n in r.best[0].around] if r.best else []
    if not moved:
        return ""
    columns = [TableColumn("Place"), *(TableColumn(m.replace(" -", " −"), "n") for m in moved)]
    rows = [(str(k), *(_format_neighbour(n) for n in p.around)) for k, p in enumerate(r.best, 1)]
    lead = "Change of the worst index when the place is missed by so much; collisions are not checked."
    return build_section("around", "If the place is missed", lead, build_table(columns, rows))


def _format_neighbour(near: NeighbourPlaceEntry) -> str:
    if near.refused or near.change_percent is None:
        return near.refused or "no way"
    return f"{format_fixed(near.change_percent, 1, signed=True)} %"


def _build_rules(r: PlaceDocument) -> Body:
    if not r.best:
        return ""
    columns = [
        TableColumn("Place"),
        TableColumn("Toolpath"),
        TableColumn("Point", "n"),
        *(TableColumn(f"Joint {j} (%)", "n") for j in range(1, 7)),
    ]
    rows = [
        (
            str(k),
            p.worst_toolpath or "",
            _format_number(p.worst_point, "g"),
            *(format_fixed(s, 0) for s in p.joint_share_percent),
        )
        for k, p in enumerate(r.best, 1)
    ]
    lead = "The point with the worst index, and how much of it would go if one joint were rigid."
    return build_section("rules", "What rules there", lead, build_table(columns, rows))


def _build_refused(data: PlacementPageData) -> Body:
    rows = [(m.words, m.refused) for m in data.marks if m.refused]
    if not rows:
        return ""
    body = build_folded_block(
        "Positions that cannot be used or reached",
        len(rows),
        build_table([TableColumn("Place"), TableColumn("Why")], rows),
    )
    return build_section("refused", "Refused", "", body)


def _build_run(r: PlaceDocument) -> Body:
    s = r.search
    rows = [
        ("moved", r.moved + (f" with {', '.join(r.carried)}" if r.carried else "")),
        (
            "ranges",
            f"x {_format_range(s.x_mm)} mm, y {_format_range(s.y_mm)} mm, z {_format_range(s.z_mm)} mm, turn "
            f"{_format_range(s.turn_deg)}°",
        ),
        ("grid", f"{s.places} places at most, {' × '.join(f'{v:.0f}' for v in s.step_mm)} mm, {s.step_deg:.1f}°"),
        ("turned about", f"the vertical through {', '.join(f'{v:.0f}' for v in r.turn_about_mm)} mm"),
        (
            "best possible among the places left",
            f"{_format_number(r.open_bound)} {r.unit}" if r.open_bound is not None else "none left",
        ),
        ("stopped", r.stopped or "when no place left could be better"),
    ]
    return build_section("run", "This run", "", build_table([TableColumn("What"), TableColumn("Value")], rows))


def _format_range(values: Sequence[float]) -> str:
    low, high = values
    return (
        _format_number(low, ".0f") if low == high else f"{_format_number(low, '.0f')} to {_format_number(high, '.0f')}"
    )


def _format_number(value: float | None, form: str = "#.4g") -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:{form}}".replace("-", "−")
