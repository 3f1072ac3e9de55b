"""Section of a page that states the notes of a run and its input files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from machopt.report.page_shell import build_section
from machopt.report.pages.report_tables import TableColumn, build_table

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def build_run_section(warnings: Sequence[str], inputs: Mapping[str, str]) -> Body:
    """Build the section of notes and input files.

    Args:
        warnings: Notes of the run.
        inputs: SHA-256 of each input file by name.

    Returns:
        The section.
    """
    facts = [("note", text) for text in warnings] + sorted(inputs.items())
    body = build_table([TableColumn("What"), TableColumn("Value")], facts)
    return build_section("run", "This run", "Notes, and the input files with their hashes.", body)
