"""The page of a cell by itself, for ``machopt view CELL``."""

from __future__ import annotations

from machopt.domain.cell import Cell
from machopt.report.gather.cell import cell_scene
from machopt.report.scene_spec import posture_view
from machopt.report.shell import POSTURE, page_html, section
from machopt.report.template import fragment, part
from machopt.version import __version__


def cell_html(cell: Cell) -> str:
    """The page as text; the same cell gives the same bytes.

    Raises:
        InputError: the arm's bodies cannot be read.
    """
    lead = "Turn it by dragging, go nearer with the buttons; the boxes below say which bodies are drawn."
    notes = (*cell.warnings, *cell.notes)
    scene, home = cell_scene(cell)
    return page_html(
        cell.name,
        (("Robot", cell.urdf.name),),
        [
            ("scene", "Cell", section("scene", "The cell, the arm at home", lead, fragment("report.html", "view"))),
            ("notes", "Notes", section("notes", "Notes", "What was read.", part("bullets", notes)) if notes else ""),
        ],
        {"view": posture_view(cell.name, scene, home)},
        scripts=POSTURE,
        footer=f"machopt {__version__}. Lengths mm, angles deg.",
    )
