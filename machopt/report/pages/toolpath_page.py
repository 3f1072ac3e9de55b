"""Page of ``inspect --html``: the content of a CAM file with pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from machopt.data_types.documents.inspect_documents import InspectedOperationEntry, InspectedToolpathDocument
from machopt.data_types.documents.optimize_document import IgnoredWordEntry
from machopt.data_types.toolpath import MoveKind, Toolpath, format_incomplete_warning
from machopt.output.single_file import write_text_file
from machopt.report.charts.scene_json import build_empty_scene, build_posture_view
from machopt.report.page_shell import POSTURE_SCRIPTS, build_page_html, build_section
from machopt.report.page_types.display_units import LENGTH
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.scene.scene_types import ToolpathScene
from machopt.report.svg.toolpath_picture import COLOURS, VIEWS, build_view_svg
from machopt.report.template_rendering import render_macro, render_part
from machopt.version import __version__

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


MAX_POINTS = 10_000  # of the picture in three dimensions


def write_toolpath_page(
    path: Path,
    toolpath: Toolpath,
    summary: InspectedToolpathDocument,
    *,
    force: bool = False,
    inputs: Sequence[Path] = (),
) -> None:
    """Write the page.

    Args:
        path: the HTML file.
        toolpath: what was read.
        summary: of :func:`machopt.toolpath.toolpath_summary.summarise_toolpath`.
        force: replace whatever file is there.
        inputs: files that were read.

    Raises:
        InputError: the file is an input, machopt did not write it, it was edited, or it cannot be written.
    """
    write_text_file(path, build_toolpath_html(toolpath, summary), force=force, inputs=inputs)


def build_toolpath_html(toolpath: Toolpath, summary: InspectedToolpathDocument) -> str:
    """Return the page; the same toolpath gives the same bytes.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        summary: Content of the toolpath inspection.
    """
    unknown = [w for w in summary.ignored if not w.understood]
    sections = [
        ("read", "As read", _build_verdict(summary, unknown)),
        ("scene", "Toolpath", _build_scene(toolpath)),
        ("views", "Pictures", _build_views(toolpath)),
        ("operations", "Operations", _build_operations(summary.operations)),
        ("extent", "Extent", _build_extent(summary)),
        ("words", "Words", _build_words(summary.ignored, unknown)),
        ("events", "Events", _build_events(toolpath)),
    ]
    head = (("File", summary.source), ("Format", summary.format), ("Unit", summary.unit))
    return build_page_html(
        f"Toolpath {summary.source}",
        head,
        sections,
        {"view": build_posture_view("Toolpath", build_empty_scene(), path=_build_toolpath_scene(toolpath))}
        if len(toolpath) > 1
        else {},
        scripts=POSTURE_SCRIPTS if len(toolpath) > 1 else (),
        footer=f"machopt {__version__}. Lengths mm, feeds mm/min, angles deg. SHA-256 {summary.sha256}.",
    )


def _build_scene(toolpath: Toolpath) -> Body:
    if len(toolpath) < 2:
        return ""
    lead = (
        "Drag to turn; cuts are coloured in the order of the file from dark to bright, other moves are thin and grey."
    )
    return build_section("scene", "The toolpath", lead, render_macro("report.html", "view"))


def _build_toolpath_scene(toolpath: Toolpath) -> ToolpathScene:
    """The toolpath coloured by the length cut so far; of a long one every so many points."""
    n = len(toolpath)
    step = np.r_[0.0, np.linalg.norm(np.diff(toolpath.position, axis=0), axis=1)] * toolpath.cutting
    k = np.unique(np.r_[0 : n : -(-n // MAX_POINTS), n - 1])
    along = np.cumsum(step) * LENGTH.factor
    return ToolpathScene(
        position=toolpath.position[k],
        point=k.astype(float),
        cutting=toolpath.cutting[k],
        value=along[k],
        label="length cut (mm)",
        large_is_good=True,
    )


def _build_verdict(summary: InspectedToolpathDocument, unknown: Sequence[IgnoredWordEntry]) -> Body:
    incomplete = summary.incomplete
    warnings = [w for w in summary.warnings if not incomplete or w != format_incomplete_warning(incomplete)]
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
    items = [*([render_part("strong", incomplete)] if incomplete else []), *warnings]
    cards = [
        ("Cut", _format_number(summary.length_mm["cut"], 1), "mm", ""),
        ("Rapid", _format_number(summary.length_mm["rapid"], 1), "mm", ""),
        ("Feed", _format_range(summary.feed_mm_min, 0), "mm/min", ""),
        ("Tilt of the tool", _format_range(summary.tilt_deg), "deg", ""),
        ("Words not understood", str(sum(w.count for w in unknown)), "", ""),
    ]
    return render_part("verdict", "read", tone, badge, sentence, items, cards)


def _build_views(toolpath: Toolpath) -> Body:
    present = [m for m in MoveKind if bool((toolpath.move == m).any())]
    key = [(m.word, COLOURS[m], m is MoveKind.RAPID) for m in present]
    views = [(view.title, build_view_svg(toolpath, view)) for view in VIEWS]
    lead = "Lines by move; red strokes point along the tool axis where it is tilted; the green dot is the first point."
    return build_section("views", "Pictures", lead, render_macro("inspect.html", "views", key, views))


def _build_operations(operations: Sequence[InspectedOperationEntry]) -> Body:
    columns = [
        TableColumn("No.", "n"),
        TableColumn("Operation"),
        TableColumn("Kind"),
        TableColumn("Tool"),
        TableColumn("Points", "n"),
        TableColumn("Cutting", "n"),
        TableColumn("Feed (mm/min)", "n"),
        TableColumn("First line", "n"),
    ]
    rows = [
        (
            k + 1,
            o.label,
            o.kind,
            o.tool or "–",
            o.points,
            o.cutting_points,
            _format_range(o.feed_mm_min),
            o.first_line if o.first_line is not None else "–",
        )
        for k, o in enumerate(operations)
    ]
    lead = "A point operation drills: every cut runs along the tool axis or comes from a cycle."
    return build_section("operations", "Operations", lead, build_table(columns, rows))


def _build_extent(summary: InspectedToolpathDocument) -> Body:
    columns = [TableColumn("Moves"), *(TableColumn(f"{c} {side} (mm)", "n") for c in "xyz" for side in ("from", "to"))]
    rows = []
    for name, box in (("all moves", summary.extent_mm), ("cuts", summary.cutting_extent_mm)):
        rows.append((name, *(_format_number(side[k], 3) for k in range(3) for side in (box.min, box.max))))
    meta = build_table([TableColumn("Content of the file"), TableColumn("Value", "mono")], sorted(summary.meta.items()))
    return build_section(
        "extent",
        "Extent",
        "In the file's own coordinate system, which is the workpiece.",
        build_table(columns, rows) + meta,
    )


def _build_words(ignored: Sequence[IgnoredWordEntry], unknown: Sequence[IgnoredWordEntry]) -> Body:
    columns = [TableColumn("Word", "mono"), TableColumn("Times", "n"), TableColumn("First in line", "n")]
    body: Body = ""
    if unknown:
        rows = [(w.word, w.count, w.first_line) for w in unknown]
        body += render_part("heading", "Not understood") + build_table(columns, rows)
    known = [(w.word, w.count, w.first_line) for w in ignored if w.understood]
    if known:
        body += build_folded_block("Understood, without effect on the path", len(known), build_table(columns, known))
    lead = "Words of the file that move nothing here. Strict reading refuses those not understood."
    return build_section("words", "Words", lead, body)


def _build_events(toolpath: Toolpath) -> Body:
    columns = [TableColumn("Before point", "n"), TableColumn("What"), TableColumn("Words of the file", "mono")]
    rows = [(e.index, e.kind, e.text) for e in toolpath.events]
    body: Body = build_folded_block("Events on the way", len(rows), build_table(columns, rows)) if rows else ""
    return build_section(
        "events", "Events", "Spindle, coolant, tools, dwells, stops and comments, at their points.", body
    )


def _format_range(values: Sequence[float] | None, decimals: int = 1) -> str:
    if values is None:
        return "–"
    low, high = (_format_number(v, decimals) for v in values)
    return low if low == high else f"{low} … {high}"


def _format_number(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return (text.rstrip("0").rstrip(".") if "." in text else text).replace("-", "−")
