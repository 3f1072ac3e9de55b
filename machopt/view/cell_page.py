"""Page of a cell, for ``machopt view CELL``."""

from __future__ import annotations

from machopt.data_types.cell import Cell
from machopt.report.charts.scene_json import build_posture_view
from machopt.report.page_data.cell_scene import build_cell_scene
from machopt.report.page_shell import POSTURE_SCRIPTS, build_page_html, build_section
from machopt.report.template_rendering import render_macro, render_part
from machopt.version import __version__


def build_cell_html(cell: Cell) -> str:
    """Return the page; the same cell gives the same bytes.

    Args:
        cell: The robot cell.

    Raises:
        InputError: the arm's bodies cannot be read.
    """
    lead = "Drag to turn, use the buttons to zoom; the boxes below select the bodies that are drawn."
    notes = (*cell.warnings, *cell.notes)
    scene, home = build_cell_scene(cell)
    return build_page_html(
        cell.name,
        (("Robot", cell.urdf.name),),
        [
            (
                "scene",
                "Cell",
                build_section("scene", "The cell, the arm at home", lead, render_macro("report.html", "view")),
            ),
            (
                "notes",
                "Notes",
                build_section("notes", "Notes", "What was read.", render_part("bullets", notes)) if notes else "",
            ),
        ],
        {"view": build_posture_view(cell.name, scene, home)},
        scripts=POSTURE_SCRIPTS,
        footer=f"machopt {__version__}. Lengths mm, angles deg.",
    )
