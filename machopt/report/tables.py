"""HTML tables of the report; every text is escaped here and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape

from machopt.report.data import ReportData
from machopt.report.display import ANGLE, FEED, FINE_LENGTH, LENGTH, MOMENT, QUANTITY, SHARE, STIFFNESS, TIME, WORDS
from machopt.report.verdict import change

MOST_ROWS = 300
"""A longer list says how much more points.csv and result.json hold."""


@dataclass(frozen=True)
class Column:
    """A heading; ``kind`` is n for numbers, mono for source words, empty for text, html for ready markup."""

    title: str
    kind: str = ""


def table(columns: Sequence[Column], rows: Iterable[Sequence[object]]) -> str:
    """A scrolling table; at most MOST_ROWS rows."""
    rows = list(rows)
    used = [n for n, c in enumerate(columns) if c.kind != "n" or not rows or any(row[n] != "–" for row in rows)]
    columns, rows = [columns[n] for n in used], [[row[n] for n in used] for row in rows]  # no column of dashes
    head = "".join(f'<th class="{c.kind}">{escape(c.title)}</th>' for c in columns)
    body = []
    for row in rows[:MOST_ROWS]:
        cells = (
            f"<td>{v}</td>" if c.kind == "html" else f'<td class="{c.kind}">{escape(str(v))}</td>'
            for c, v in zip(columns, row, strict=True)
        )  # fmt: skip
        body.append(f"<tr>{''.join(cells)}</tr>")
    more = f"<p class=lead>… and {len(rows) - MOST_ROWS} more.</p>" if len(rows) > MOST_ROWS else ""
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>{more}'
    )


def folded(title: str, count: int, body: str, *, opened: bool = False) -> str:
    """A part that opens on a click."""
    return (
        f"<details{' open' if opened else ''}><summary>{escape(title)} <span>({count})</span></summary>{body}</details>"
    )


def worst_points(data: ReportData) -> str:
    unit = QUANTITY[data.summary.quantity]
    what = WORDS[data.summary.quantity].axis
    own = data.summary.quantity == "deflection"  # then the deflection stands in the first column already
    columns = [
        Column("Point", "n"), Column("Operation"), Column(f"{what} ({unit.name})", "n"),
        Column("CAM default", "n"), Column("Change", "n"), *([] if own else [Column("Deflection (mm)", "n")]),
        Column("± 1 σ (mm)", "n"),
        Column("Tolerance (mm)", "n"), Column("γ (deg)", "n"), Column("k axial (N/µm)", "n"),
        Column("Clearance (mm)", "n"), Column("Why", "why"),
    ]  # fmt: skip
    rows = [
        (
            w.point, w.operation, unit.text(w.value), unit.text(w.value_default), change(w.value_default, w.value),
            *(() if own else (FINE_LENGTH.text(w.deflection),)), FINE_LENGTH.text(w.deflection_std),
            FINE_LENGTH.text(w.tolerance),
            ANGLE.text(w.gamma), STIFFNESS.text(w.k_axial), LENGTH.text(w.clearance), w.reason,
        )
        for w in data.worst
    ]  # fmt: skip
    return table(columns, rows)


def infeasible_points(data: ReportData) -> str:
    columns = [Column("Point", "n"), Column("Operation"), Column("x (mm)", "n"), Column("y (mm)", "n"),
               Column("z (mm)", "n"), Column("State"), Column("Why"), Column("How far off"),
               Column("What would help")]  # fmt: skip
    return table(columns, [
        (p.point, p.operation, *(LENGTH.text(float(v)) for v in p.position), p.status, p.reason, p.shortfall, p.help)
        for p in data.infeasible
    ])  # fmt: skip


def breaks(data: ReportData) -> str:
    columns = [Column("From"), Column("To"), Column("Why"), Column("What would help")]
    return table(columns, [(b.before, b.after, b.reason, b.help) for b in data.breaks])


def operations(data: ReportData) -> str:
    unit = QUANTITY[data.summary.quantity]
    worst = "Least" if WORDS[data.summary.quantity].large_is_good else "Worst"
    columns = [
        Column("Operation"), Column("Kind"), Column("Points", "n"), Column("Path (mm)", "n"), Column("Time (s)", "n"),
        Column(f"{worst}, CAM default ({unit.name})", "n"), Column(f"{worst}, chosen ({unit.name})", "n"),
        Column("Change", "n"), Column("Nearest miss (mm)", "n"), Column("Feed held (%)", "n"), Column("State"),
    ]  # fmt: skip
    rows = [
        (
            o.label or "(no name)", o.kind, o.points, LENGTH.text(o.length), TIME.text(o.time),
            unit.text(o.worst_default), unit.text(o.worst_chosen), change(o.worst_default, o.worst_chosen),
            LENGTH.text(o.nearest_miss), SHARE.text(o.feed_held), o.status,
        )
        for o in data.operations
    ]  # fmt: skip
    return table(columns, rows)


def feed_dips(data: ReportData) -> str:
    columns = [Column("Point", "n"), Column("Path (mm)", "n"), Column("From (s)", "n"), Column("For (s)", "n"),
               Column("Programmed (mm/min)", "n"), Column("Lowest (mm/min)", "n"), Column("Held (%)", "n"),
               Column("What did it")]  # fmt: skip
    return table(columns, [
        (f"{d.point:.1f}", LENGTH.text(d.s), MOMENT.text(d.time), MOMENT.text(d.duration), FEED.text(d.feed_programmed),
         FEED.text(d.feed_lowest), SHARE.text(d.feed_lowest / d.feed_programmed if d.feed_programmed else 0.0), d.cause)
        for d in sorted(data.dips, key=lambda d: d.feed_lowest - d.feed_programmed)
    ])  # fmt: skip


def checks(data: ReportData) -> str:
    words = {True: '<span class="pass">passed</span>', False: '<span class="fail">failed</span>',
             None: '<span class="none">not run</span>'}  # fmt: skip
    columns = [Column("Check"), Column("Result", "html"), Column("Found"), Column("Allowed"), Column("Where")]
    return table(columns, [(c.name, words[c.passed], c.found, c.allowed, c.where) for c in data.checks])


def cam_words(data: ReportData) -> str:
    words = {True: "known, no effect on the motion", False: "not understood"}
    columns = [Column("Word", "mono"), Column("Times", "n"), Column("First line", "n"), Column("Understood")]
    ordered = sorted(data.ignored, key=lambda w: (w.understood, w.first_line))
    return table(columns, [(w.word, w.count, w.first_line, words[w.understood]) for w in ordered])


def events(data: ReportData) -> str:
    columns = [Column("Before point", "n"), Column("Kind"), Column("Source words", "mono")]
    return table(columns, [(e.index, e.kind, e.text) for e in data.events])


def excluded_pairs(data: ReportData) -> str:
    columns = [Column("Body"), Column("Body"), Column("Why it is not checked")]
    return table(columns, [(p.first, p.second, p.reason) for p in data.excluded_pairs])


def timings(data: ReportData) -> str:
    total = sum(t for _, t in data.timings)
    rows = [(stage, f"{t:.3f}") for stage, t in data.timings]
    return table([Column("Stage"), Column("Time (s)", "n")], [*rows, ("all", f"{total:.3f}")])


def pairs(first: str, second: str, rows: Sequence[tuple[str, str]], kind: str = "mono") -> str:
    """Two plain columns: options, hashes."""
    return table([Column(first), Column(second, kind)], rows)


def part(count: int, title: str, build: Callable[[ReportData], str], data: ReportData, *, opened: bool = False) -> str:
    """A folded table, or nothing where there is nothing to list."""
    return folded(title, count, build(data), opened=opened) if count else ""
