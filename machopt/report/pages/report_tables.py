"""Tables of the report pages: columns and rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machopt.report.page_types.display_units import (
    ANGLE,
    FEED,
    FINE_LENGTH,
    FINE_TIME,
    LENGTH,
    QUANTITY_LABELS,
    QUANTITY_UNITS,
    SHARE,
    STIFFNESS,
    TIME,
)
from machopt.report.template_rendering import render_macro
from machopt.report.template_rendering import render_part as piece
from machopt.report.wording.result_verdict import format_change

if TYPE_CHECKING:
    from markupsafe import Markup

    from machopt.report.page_types.optimize_page_data import ReportData

MAX_ROWS = 300
"""A longer list says how much more points.csv and result.json hold."""


@dataclass(frozen=True)
class TableColumn:
    """A heading; ``kind`` is n for numbers, mono for source words, empty for text, html for cells of markup."""

    title: str
    kind: str = ""


def build_table(columns: Sequence[TableColumn], rows: Iterable[Sequence[object]]) -> Markup:
    """Return a scrolling table of at most MOST_ROWS rows.

    Args:
        columns: Headings and formats of the columns.
        rows: Cells of each row.
    """
    rows = list(rows)
    nothing = {"n": "–", "": ""}  # no column of dashes, none of empty words
    used = [n for n, c in enumerate(columns) if not rows or any(row[n] != nothing.get(c.kind) for row in rows)]
    columns, rows = [columns[n] for n in used], [[row[n] for n in used] for row in rows]
    return piece("table", columns, rows[:MAX_ROWS], max(len(rows) - MAX_ROWS, 0))


def build_folded_block(title: str, count: int, body: Markup | str, *, opened: bool = False) -> Markup:
    """Return a block that unfolds on a click.

    Args:
        title: The heading.
        count: Number shown next to the title.
        body: Content of the section, markup or text.
        opened: Whether the block is unfolded at first.
    """
    return piece("folded", title, count, body, opened)


def build_worst_point_table(data: ReportData) -> Markup:
    """Return the table of the worst points.

    Args:
        data: Data of the report.
    """
    unit = QUANTITY_UNITS[data.summary.quantity]
    what = QUANTITY_LABELS[data.summary.quantity].axis
    own = data.summary.quantity == "deflection"  # the first column is the deflection already
    columns = [
        TableColumn("Point", "n"),
        TableColumn("Operation"),
        TableColumn(f"{what} ({unit.name})", "n"),
        TableColumn(f"CAM default ({unit.name})", "n"),
        TableColumn("Change", "n"),
        *([] if own else [TableColumn("Deflection (mm)", "n")]),
        TableColumn("± 1 σ (mm)", "n"),
        TableColumn("Tolerance (mm)", "n"),
        TableColumn("φ (deg)", "n"),
        TableColumn("γ (deg)", "n"),
        TableColumn("k axial (N/µm)", "n"),
        TableColumn("Clearance (mm)", "n"),
        TableColumn("Why", "why"),
    ]
    rows = [
        (
            _link_point(data, w.point),
            w.operation,
            unit.format_value(w.value),
            unit.format_value(w.value_default),
            format_change(w.value_default, w.value),
            *(() if own else (FINE_LENGTH.format_value(w.deflection),)),
            FINE_LENGTH.format_value(w.deflection_std),
            FINE_LENGTH.format_value(w.tolerance),
            ANGLE.format_value(w.phi),
            ANGLE.format_value(w.gamma),
            STIFFNESS.format_value(w.k_axial),
            LENGTH.format_value(w.clearance),
            w.reason,
        )
        for w in data.worst
    ]
    return build_table(columns, rows)


def _link_point(data: ReportData, point: float) -> Markup | float:
    """A point's number, as a link into the 3-D picture where there is one."""
    return point if data.view is None else render_macro("report.html", "place", point)


def build_infeasible_point_table(data: ReportData) -> Markup:
    """Return the table of the infeasible points.

    Args:
        data: Data of the report.
    """
    columns = [
        TableColumn("Point", "n"),
        TableColumn("State"),
        TableColumn("How far off"),
        TableColumn("Why"),
        TableColumn("What would help"),
        TableColumn("Operation"),
        TableColumn("x (mm)", "n"),
        TableColumn("y (mm)", "n"),
        TableColumn("z (mm)", "n"),
    ]
    return build_table(
        columns,
        [
            (
                _link_point(data, p.point),
                p.status,
                p.shortfall,
                p.reason,
                p.help,
                p.operation,
                *(LENGTH.format_value(float(v)) for v in p.position),
            )
            for p in data.infeasible
        ],
    )


def build_break_table(data: ReportData) -> Markup:
    """Return the table of the breaks of the motion.

    Args:
        data: Data of the report.
    """
    columns = [TableColumn("From"), TableColumn("To"), TableColumn("Why"), TableColumn("What would help")]
    return build_table(columns, [(b.before, b.after, b.reason, b.help) for b in data.breaks])


def build_operation_table(data: ReportData) -> Markup:
    """Return the table of the operations.

    Args:
        data: Data of the report.
    """
    unit = QUANTITY_UNITS[data.summary.quantity]
    worst = "Least" if QUANTITY_LABELS[data.summary.quantity].large_is_good else "Worst"
    columns = [
        TableColumn("Operation"),
        TableColumn("Kind"),
        TableColumn("Points", "n"),
        TableColumn("Path (mm)", "n"),
        TableColumn("Time (s)", "n"),
        TableColumn(f"{worst}, CAM default ({unit.name})", "n"),
        TableColumn(f"{worst}, chosen ({unit.name})", "n"),
        TableColumn("Change", "n"),
        TableColumn("Minimum clearance (mm)", "n"),
        TableColumn("Feed reached (%)", "n"),
        TableColumn("State"),
    ]
    rows = [
        (
            o.label or "(no name)",
            o.kind,
            o.points,
            LENGTH.format_value(o.length),
            TIME.format_value(o.time),
            unit.format_value(o.worst_default),
            unit.format_value(o.worst_chosen),
            format_change(o.worst_default, o.worst_chosen),
            LENGTH.format_value(o.nearest_miss),
            SHARE.format_value(o.feed_held),
            o.status,
        )
        for o in data.operations
    ]
    if any(o.tool for o in data.operations):
        columns.insert(1, TableColumn("Tool"))
        rows = [(row[0], o.tool, *row[1:]) for o, row in zip(data.operations, rows, strict=True)]  # type: ignore[misc]
    return build_table(columns, rows)


def build_feed_dip_table(data: ReportData) -> Markup:
    """Return the table of the feed dips.

    Args:
        data: Data of the report.
    """
    columns = [
        TableColumn("Point", "n"),
        TableColumn("Path (mm)", "n"),
        TableColumn("From (s)", "n"),
        TableColumn("Duration (s)", "n"),
        TableColumn("Programmed (mm/min)", "n"),
        TableColumn("Lowest (mm/min)", "n"),
        TableColumn("Reached (%)", "n"),
        TableColumn("Cause"),
    ]
    return build_table(
        columns,
        [
            (
                _link_point(data, round(d.point, 1)),
                LENGTH.format_value(d.s),
                FINE_TIME.format_value(d.time),
                FINE_TIME.format_value(d.duration),
                FEED.format_value(d.feed_programmed),
                FEED.format_value(d.feed_lowest),
                SHARE.format_value(d.feed_lowest / d.feed_programmed if d.feed_programmed else 0.0),
                d.cause,
            )
            for d in sorted(data.dips, key=lambda d: d.feed_lowest - d.feed_programmed)
        ],
    )


def build_check_table(data: ReportData) -> Markup:
    """Return the table of the checks.

    Args:
        data: Data of the report.
    """
    words = {
        True: piece("toned", "pass", "passed"),
        False: piece("toned", "fail", "failed"),
        None: piece("toned", "none", "not run"),
    }
    columns = [
        TableColumn("Check"),
        TableColumn("Result", "html"),
        TableColumn("Found"),
        TableColumn("Allowed"),
        TableColumn("Where"),
    ]
    return build_table(columns, [(c.name, words[c.passed], c.found, c.allowed, c.where) for c in data.checks])


def build_information_table(data: ReportData) -> Markup:
    """Return the table of measured values without a condition.

    Args:
        data: Data of the report.
    """
    columns = [TableColumn("Information"), TableColumn("Found"), TableColumn("Where")]
    return build_table(columns, [(i.name, i.found, i.where) for i in data.information])


def build_cam_word_table(data: ReportData) -> Markup:
    """Return the table of CAM words without effect.

    Args:
        data: Data of the report.
    """
    words = {True: "known, no effect on the motion", False: "not understood"}
    columns = [
        TableColumn("Word", "mono"),
        TableColumn("Times", "n"),
        TableColumn("First line", "n"),
        TableColumn("Understood"),
    ]
    ordered = sorted(data.ignored, key=lambda w: (w.understood, w.first_line))
    return build_table(columns, [(w.word, w.count, w.first_line, words[w.understood]) for w in ordered])


def build_event_table(data: ReportData) -> Markup:
    """Return the table of the events.

    Args:
        data: Data of the report.
    """
    columns = [TableColumn("Before point", "n"), TableColumn("Kind"), TableColumn("Source words", "mono")]
    return build_table(columns, [(e.index, e.kind, e.text) for e in data.events])


def build_excluded_pair_table(data: ReportData) -> Markup:
    """Return the table of the body pairs that are not checked.

    Args:
        data: Data of the report.
    """
    columns = [TableColumn("Body"), TableColumn("Body"), TableColumn("Why it is not checked")]
    return build_table(columns, [(p.first, p.second, p.reason) for p in (*data.excluded_pairs, *data.adjacent_pairs)])


def build_timing_table(data: ReportData) -> Markup:
    """Return the table of the computing time of each stage.

    Args:
        data: Data of the report.
    """
    total = sum(t for _, t in data.timings)
    rows = [(stage, f"{t:.3f}") for stage, t in data.timings]
    return build_table([TableColumn("Stage"), TableColumn("Time (s)", "n")], [*rows, ("all", f"{total:.3f}")])


def build_pair_table(first: str, second: str, rows: Sequence[tuple[str, str]], kind: str = "mono") -> Markup:
    """Return a table of two columns, as for options and hashes.

    Args:
        first: Heading of the first column.
        second: Heading of the second column.
        rows: Cells of each row.
        kind: CSS class of the second column.
    """
    return build_table([TableColumn(first), TableColumn(second, kind)], rows)


def build_folded_table(
    count: int, title: str, build: Callable[[ReportData], Markup], data: ReportData, *, opened: bool = False
) -> Markup | str:
    """Return a folded table, or nothing where it has no rows.

    Args:
        count: Number of rows.
        title: The heading.
        build: Builder of the table.
        data: Data of the report.
        opened: Whether the block is unfolded at first.
    """
    return build_folded_block(title, count, build(data), opened=opened) if count else ""
