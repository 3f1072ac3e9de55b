"""``inspect --html``: what a CAM file holds, on one self-contained page with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.domain.results.inspected import OperationInspected, ToolpathInspected
from machopt.domain.results.optimize import IgnoredWord
from machopt.domain.toolpath import Move, Toolpath, cut_off_words
from machopt.output.single_file import write_text_file
from machopt.report.display import LENGTH
from machopt.report.scene import Path3D
from machopt.report.scene_spec import bare_scene, posture_view
from machopt.report.shell import POSTURE, page_html, section
from machopt.report.tables import Column, folded, table
from machopt.report.template import fragment, part
from machopt.report.toolpath_svg import COLOURS, VIEWS, view_svg
from machopt.version import __version__

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


MOST_POINTS = 10_000  # of the picture in three dimensions


def write_toolpath_page(
    path: Path, toolpath: Toolpath, summary: ToolpathInspected, *, force: bool = False, inputs: Sequence[Path] = ()
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        toolpath: what was read.
        summary: of :func:`machopt.formats.inspect.summarise`.
        force: replace whatever file is there.
        inputs: files that were read.

    Raises:
        InputError: the file is an input, machopt did not write it, it was edited, or it cannot be written.
    """
    write_text_file(path, toolpath_page(toolpath, summary), force=force, inputs=inputs)


def toolpath_page(toolpath: Toolpath, summary: ToolpathInspected) -> str:
    """The page as text; the same toolpath gives the same bytes."""
    unknown = [w for w in summary.ignored if not w.understood]
    sections = [
        ("read", "As read", _verdict(summary, unknown)),
        ("scene", "Toolpath", _scene(toolpath)),
        ("views", "Pictures", _views(toolpath)),
        ("operations", "Operations", _operations(summary.operations)),
        ("extent", "Extent", _extent(summary)),
        ("words", "Words", _words(summary.ignored, unknown)),
        ("events", "Events", _events(toolpath)),
    ]
    head = (("File", summary.source), ("Format", summary.format), ("Unit", summary.unit))
    return page_html(
        f"Toolpath {summary.source}",
        head,
        sections,
        {"view": posture_view("Toolpath", bare_scene(), path=_line(toolpath))} if len(toolpath) > 1 else {},
        scripts=POSTURE if len(toolpath) > 1 else (),
        footer=f"machopt {__version__}. Lengths mm, feeds mm/min, angles deg. SHA-256 {summary.sha256}.",
    )


def _scene(toolpath: Toolpath) -> Body:
    if len(toolpath) < 2:
        return ""
    lead = "Turn it by dragging; cuts in the order of the file from dark to bright, other moves thin and grey."
    return section("scene", "The toolpath", lead, fragment("report.html", "view"))


def _line(toolpath: Toolpath) -> Path3D:
    """The toolpath coloured by the length cut so far; of a long one every so many points."""
    n = len(toolpath)
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)] * toolpath.cutting
    k = np.unique(np.r_[0 : n : -(-n // MOST_POINTS), n - 1])
    along = np.cumsum(step) * LENGTH.factor
    return Path3D(
        position=toolpath.position[k],
        point=k.astype(float),
        cutting=toolpath.cutting[k],
        value=along[k],
        label="length cut (mm)",
        large_is_good=True,
    )


def _verdict(summary: ToolpathInspected, unknown: Sequence[IgnoredWord]) -> Body:
    incomplete = summary.incomplete
    warnings = [w for w in summary.warnings if not incomplete or w != cut_off_words(incomplete)]
    tone, badge = (
        ("bad", "INCOMPLETE FILE?") if incomplete else ("warn", "READ, WITH NOTES") if warnings else ("", "READ")
    )
    moves = summary.moves
    sentence = (
        f"{summary.points} points in {len(summary.operations)} "
        f"operation{'s' if len(summary.operations) != 1 else ''}: "
        + ", ".join(f"{n} {name}" for name, n in moves.items() if n)
        + "."
    )
    items = [*([part("strong", incomplete)] if incomplete else []), *warnings]
    cards = [
        ("Cut", _number(summary.length_mm["cut"], 1), "mm", ""),
        ("Rapid", _number(summary.length_mm["rapid"], 1), "mm", ""),
        ("Feed", _range(summary.feed_mm_min, 0), "mm/min", ""),
        ("Tilt of the tool", _range(summary.tilt_deg), "deg", ""),
        ("Words not understood", str(sum(w.count for w in unknown)), "", ""),
    ]
    return part("verdict", "read", tone, badge, sentence, items, cards)


def _views(toolpath: Toolpath) -> Body:
    present = [m for m in Move if bool((toolpath.move == m).any())]
    key = [(m.word, COLOURS[m], m is Move.RAPID) for m in present]
    views = [(view.title, view_svg(toolpath, view)) for view in VIEWS]
    lead = "Lines by move; red strokes point along the tool axis where it is tilted; the green dot is the first point."
    return section("views", "Pictures", lead, fragment("inspect.html", "views", key, views))


def _operations(operations: Sequence[OperationInspected]) -> Body:
    columns = [
        Column("No.", "n"),
        Column("Operation"),
        Column("Kind"),
        Column("Tool"),
        Column("Points", "n"),
        Column("Cutting", "n"),
        Column("Feed (mm/min)", "n"),
        Column("First line", "n"),
    ]
    rows = [
        (
            k + 1,
            o.label,
            o.kind,
            o.tool or "–",
            o.points,
            o.cutting_points,
            _range(o.feed_mm_min),
            o.first_line if o.first_line is not None else "–",
        )
        for k, o in enumerate(operations)
    ]
    lead = "A point operation drills: every cut runs along the tool axis or comes from a cycle."
    return section("operations", "Operations", lead, table(columns, rows))


def _extent(summary: ToolpathInspected) -> Body:
    columns = [Column("Moves"), *(Column(f"{c} {side} (mm)", "n") for c in "xyz" for side in ("from", "to"))]
    rows = []
    for name, box in (("all moves", summary.extent_mm), ("cuts", summary.cutting_extent_mm)):
        rows.append((name, *(_number(side[k], 3) for k in range(3) for side in (box.min, box.max))))
    meta = table([Column("What the file says"), Column("Value", "mono")], sorted(summary.meta.items()))
    return section(
        "extent", "Extent", "In the file's own coordinate system, which is the workpiece.", table(columns, rows) + meta
    )


def _words(ignored: Sequence[IgnoredWord], unknown: Sequence[IgnoredWord]) -> Body:
    columns = [Column("Word", "mono"), Column("Times", "n"), Column("First in line", "n")]
    body: Body = ""
    if unknown:
        rows = [(w.word, w.count, w.first_line) for w in unknown]
        body += part("heading", "Not understood") + table(columns, rows)
    known = [(w.word, w.count, w.first_line) for w in ignored if w.understood]
    if known:
        body += folded("Understood, without effect on the path", len(known), table(columns, known))
    lead = "Words of the file that move nothing here. Strict reading refuses those not understood."
    return section("words", "Words", lead, body)


def _events(toolpath: Toolpath) -> Body:
    columns = [Column("Before point", "n"), Column("What"), Column("Words of the file", "mono")]
    rows = [(e.index, e.kind, e.text) for e in toolpath.events]
    body: Body = folded("Events on the way", len(rows), table(columns, rows)) if rows else ""
    return section("events", "Events", "Spindle, coolant, tools, dwells, stops and comments, where they stand.", body)


def _range(values: Sequence[float] | None, decimals: int = 1) -> str:
    if values is None:
        return "–"
    low, high = (_number(v, decimals) for v in values)
    return low if low == high else f"{low} … {high}"


def _number(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", "−")
