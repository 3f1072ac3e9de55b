"""Page of ``machopt place``: a map of the index over x and y, the best placements, and their neighbourhood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.data_types.documents.place_document import NeighbourPlaceEntry, PlaceDocument, PlaceEntry
from machopt.report.page_shell import build_page_html, build_section
from machopt.report.page_types.display_units import format_fixed
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.svg.placement_map import PlaceMark, build_placement_map, format_number
from machopt.report.template_rendering import render_part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


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
        cards.append(("Worst index", f"{format_number(top.worst)}", r.unit, f"mean {format_number(top.mean)} {r.unit}"))
        if r.as_it_stands is not None and r.as_it_stands.worst is not None:
            cards.append(
                (
                    "Current place",
                    f"{format_number(r.as_it_stands.worst)}",
                    r.unit,
                    "the same planner, the cell unmoved",
                )
            )
        if r.gain_percent is not None:
            cards.append(("Gain", f"{r.gain_percent:.1f}", "%", "of the worst index over all toolpaths"))
        if (t := top.tolerances) is not None:
            total = t.in_tolerance + t.marginal + t.fail + t.unknown
            rest = f"{t.marginal} marginal, {t.fail} fail, {t.unknown} unknown"
            cards.insert(0, ("In tolerance", f"{t.in_tolerance}", "", f"of {total} holes and points; {rest}"))
        cards.append(("Places", f"{r.within_reach}", "", f"within reach of {r.looked_at}, {r.planned} planned wholly"))
    sentence = f"{r.verdict[0].upper()}{r.verdict[1:]}.".replace(" -", " −")
    leaving = [w for w in r.warnings if w.startswith("place ")]
    others = [w for w in r.warnings if w not in leaving]
    return render_part("verdict", "verdict", tone, badge, sentence, others, cards, leaving)


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
        "collisions. Crosses are out of reach or without support. The diamond is the present place, the star the best."
    )
    if any(m.outcomes for m in marks):
        lead += (
            " The number on a square is that of holes and points that are not in tolerance; places are compared by it "
            "first."
        )
    return build_section(
        "map",
        f"Worst index over x and y ({data.result.unit}, less is better)",
        lead,
        build_placement_map(data.result, marks),
    )


def _rank_mark(mark: PlaceMark) -> tuple[bool, int, float]:
    return (bool(mark.refused) or not math.isfinite(mark.value), mark.missed, mark.value)


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
    ]
    entries = [(str(k), p) for k, p in enumerate(r.best, 1)]
    entries += [] if r.as_it_stands is None else [("present position", r.as_it_stands)]
    has_outcomes = any(p.tolerances is not None for _, p in entries)
    titles = (*_OUTCOME_TITLES, "Worst error (mm)", "at point") if has_outcomes else ()
    columns += [*(TableColumn(title, "n") for title in titles), TableColumn("Plan", "html")]
    rows = [_build_row(name, p, len(titles)) for name, p in entries]
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


_OUTCOME_TITLES = ("In tolerance", "Marginal", "Fail", "Unknown")


def _list_outcomes(p: PlaceEntry, count: int) -> tuple[str, ...]:
    t = p.tolerances
    if t is None:
        return ("–",) * count
    counts = (t.in_tolerance, t.marginal, t.fail, t.unknown)
    return (*map(str, counts), format_number(t.worst_error_mm, ".3f"), str(t.worst_error_point))


def _build_row(name: str, p: PlaceEntry, outcomes: int) -> tuple[Body, ...]:
    x, y, z = p.shift_mm
    plan: Body = render_part("linked", p.plans, p.verdict)
    gain = format_number(p.gain_percent, ".1f")
    return (
        name,
        *(format_fixed(v, 0, signed=True) for v in (x, y, z)),
        format_fixed(p.turn_deg, 1, signed=True),
        format_number(p.worst),
        format_number(p.mean),
        gain,
        format_number(p.cycle_time_s, ".1f"),
        *_list_outcomes(p, outcomes),
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


def _format_neighbour(neighbour_place_entry: NeighbourPlaceEntry) -> str:
    if neighbour_place_entry.refused or neighbour_place_entry.change_percent is None:
        return neighbour_place_entry.refused or "no way"
    return f"{format_fixed(neighbour_place_entry.change_percent, 1, signed=True)} %"


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
            format_number(p.worst_point, "g"),
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
            f"{format_number(r.open_bound)} {r.unit}" if r.open_bound is not None else "none left",
        ),
        ("stopped", r.stopped or "when no place left could be better"),
    ]
    return build_section("run", "This run", "", build_table([TableColumn("What"), TableColumn("Value")], rows))


def _format_range(values: Sequence[float]) -> str:
    low, high = values
    return format_number(low, ".0f") if low == high else f"{format_number(low, '.0f')} to {format_number(high, '.0f')}"
