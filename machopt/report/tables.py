"""Tables of the pages: what stands in which column."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machopt.report.data import ReportData
from machopt.report.display import ANGLE, FEED, FINE_LENGTH, LENGTH, MOMENT, QUANTITY, SHARE, STIFFNESS, TIME, WORDS
from machopt.report.template import fragment
from machopt.report.template import part as piece
from machopt.report.verdict import change

if TYPE_CHECKING:
    from markupsafe import Markup

MOST_ROWS = 300
"""A longer list says how much more points.csv and result.json hold."""


@dataclass(frozen=True)
class Column:
    """A heading; ``kind`` is n for numbers, mono for source words, empty for text, html for cells of markup."""

    title: str
    kind: str = ""


def table(columns: Sequence[Column], rows: Iterable[Sequence[object]]) -> Markup:
    """A scrolling table; at most MOST_ROWS rows."""
    rows = list(rows)
    nothing = {"n": "–", "": ""}  # no column of dashes, none of empty words
    used = [n for n, c in enumerate(columns) if not rows or any(row[n] != nothing.get(c.kind) for row in rows)]
    columns, rows = [columns[n] for n in used], [[row[n] for n in used] for row in rows]
    return piece("table", columns, rows[:MOST_ROWS], max(len(rows) - MOST_ROWS, 0))


def folded(title: str, count: int, body: Markup | str, *, opened: bool = False) -> Markup:
    """A part that opens on a click."""
    return piece("folded", title, count, body, opened)


def worst_points(data: ReportData) -> Markup:
    unit = QUANTITY[data.summary.quantity]
    what = WORDS[data.summary.quantity].axis
    own = data.summary.quantity == "deflection"  # then the deflection stands in the first column already
    columns = [
        Column("Point", "n"),
        Column("Operation"),
        Column(f"{what} ({unit.name})", "n"),
        Column(f"CAM default ({unit.name})", "n"),
        Column("Change", "n"),
        *([] if own else [Column("Deflection (mm)", "n")]),
        Column("± 1 σ (mm)", "n"),
        Column("Tolerance (mm)", "n"),
        Column("φ (deg)", "n"),
        Column("γ (deg)", "n"),
        Column("k axial (N/µm)", "n"),
        Column("Clearance (mm)", "n"),
        Column("Why", "why"),
    ]
    rows = [
        (
            _place(data, w.point),
            w.operation,
            unit.text(w.value),
            unit.text(w.value_default),
            change(w.value_default, w.value),
            *(() if own else (FINE_LENGTH.text(w.deflection),)),
            FINE_LENGTH.text(w.deflection_std),
            FINE_LENGTH.text(w.tolerance),
            ANGLE.text(w.phi),
            ANGLE.text(w.gamma),
            STIFFNESS.text(w.k_axial),
            LENGTH.text(w.clearance),
            w.reason,
        )
        for w in data.worst
    ]
    return table(columns, rows)


def _place(data: ReportData, point: float) -> Markup | float:
    """A point's number, as a link into the 3-D picture where there is one."""
    return point if data.view is None else fragment("report.html", "place", point)


def infeasible_points(data: ReportData) -> Markup:
    columns = [
        Column("Point", "n"),
        Column("State"),
        Column("How far off"),
        Column("Why"),
        Column("What would help"),
        Column("Operation"),
        Column("x (mm)", "n"),
        Column("y (mm)", "n"),
        Column("z (mm)", "n"),
    ]
    return table(
        columns,
        [
            (
                _place(data, p.point),
                p.status,
                p.shortfall,
                p.reason,
                p.help,
                p.operation,
                *(LENGTH.text(float(v)) for v in p.position),
            )
            for p in data.infeasible
        ],
    )


def breaks(data: ReportData) -> Markup:
    columns = [Column("From"), Column("To"), Column("Why"), Column("What would help")]
    return table(columns, [(b.before, b.after, b.reason, b.help) for b in data.breaks])


def operations(data: ReportData) -> Markup:
    unit = QUANTITY[data.summary.quantity]
    worst = "Least" if WORDS[data.summary.quantity].large_is_good else "Worst"
    columns = [
        Column("Operation"),
        Column("Kind"),
        Column("Points", "n"),
        Column("Path (mm)", "n"),
        Column("Time (s)", "n"),
        Column(f"{worst}, CAM default ({unit.name})", "n"),
        Column(f"{worst}, chosen ({unit.name})", "n"),
        Column("Change", "n"),
        Column("Nearest miss (mm)", "n"),
        Column("Feed held (%)", "n"),
        Column("State"),
    ]
    rows = [
        (
            o.label or "(no name)",
            o.kind,
            o.points,
            LENGTH.text(o.length),
            TIME.text(o.time),
            unit.text(o.worst_default),
            unit.text(o.worst_chosen),
            change(o.worst_default, o.worst_chosen),
            LENGTH.text(o.nearest_miss),
            SHARE.text(o.feed_held),
            o.status,
        )
        for o in data.operations
    ]
    if any(o.tool for o in data.operations):
        columns.insert(1, Column("Tool"))
        rows = [(row[0], o.tool, *row[1:]) for o, row in zip(data.operations, rows, strict=True)]  # type: ignore[misc]
    return table(columns, rows)


def feed_dips(data: ReportData) -> Markup:
    columns = [
        Column("Point", "n"),
        Column("Path (mm)", "n"),
        Column("From (s)", "n"),
        Column("For (s)", "n"),
        Column("Programmed (mm/min)", "n"),
        Column("Lowest (mm/min)", "n"),
        Column("Held (%)", "n"),
        Column("What did it"),
    ]
    return table(
        columns,
        [
            (
                _place(data, round(d.point, 1)),
                LENGTH.text(d.s),
                MOMENT.text(d.time),
                MOMENT.text(d.duration),
                FEED.text(d.feed_programmed),
                FEED.text(d.feed_lowest),
                SHARE.text(d.feed_lowest / d.feed_programmed if d.feed_programmed else 0.0),
                d.cause,
            )
            for d in sorted(data.dips, key=lambda d: d.feed_lowest - d.feed_programmed)
        ],
    )


def checks(data: ReportData) -> Markup:
    words = {
        True: piece("toned", "pass", "passed"),
        False: piece("toned", "fail", "failed"),
        None: piece("toned", "none", "not run"),
    }
    columns = [Column("Check"), Column("Result", "html"), Column("Found"), Column("Allowed"), Column("Where")]
    return table(columns, [(c.name, words[c.passed], c.found, c.allowed, c.where) for c in data.checks])


def information(data: ReportData) -> Markup:
    """Measured values without a condition: no checks, so without a result."""
    columns = [Column("Information"), Column("Found"), Column("Where")]
    return table(columns, [(i.name, i.found, i.where) for i in data.information])


def cam_words(data: ReportData) -> Markup:
    words = {True: "known, no effect on the motion", False: "not understood"}
    columns = [Column("Word", "mono"), Column("Times", "n"), Column("First line", "n"), Column("Understood")]
    ordered = sorted(data.ignored, key=lambda w: (w.understood, w.first_line))
    return table(columns, [(w.word, w.count, w.first_line, words[w.understood]) for w in ordered])


def events(data: ReportData) -> Markup:
    columns = [Column("Before point", "n"), Column("Kind"), Column("Source words", "mono")]
    return table(columns, [(e.index, e.kind, e.text) for e in data.events])


def excluded_pairs(data: ReportData) -> Markup:
    columns = [Column("Body"), Column("Body"), Column("Why it is not checked")]
    return table(columns, [(p.first, p.second, p.reason) for p in (*data.excluded_pairs, *data.adjacent_pairs)])


def timings(data: ReportData) -> Markup:
    total = sum(t for _, t in data.timings)
    rows = [(stage, f"{t:.3f}") for stage, t in data.timings]
    return table([Column("Stage"), Column("Time (s)", "n")], [*rows, ("all", f"{total:.3f}")])


def pairs(first: str, second: str, rows: Sequence[tuple[str, str]], kind: str = "mono") -> Markup:
    """Two plain columns: options, hashes."""
    return table([Column(first), Column(second, kind)], rows)


def part(
    count: int, title: str, build: Callable[[ReportData], Markup], data: ReportData, *, opened: bool = False
) -> Markup | str:
    """A folded table, or nothing where there is nothing to list."""
    return folded(title, count, build(data), opened=opened) if count else ""
