"""Section of the optimize report with the outcome of ``--method joint``: cycle times, and each window."""

from __future__ import annotations

from typing import TYPE_CHECKING

from machopt.data_types.documents.optimize_document import JointMethodEntry
from machopt.report.page_shell import build_section
from machopt.report.page_types.optimize_page_data import ReportData
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table

if TYPE_CHECKING:
    from markupsafe import Markup

MISSING = "–"
LEAD = (
    "Rotation, external axes and feed were optimised together, window by window, within the tolerances. The path of "
    "the plan at its own advised feeds is the comparison. A window is driven where its run becomes shorter, nothing "
    "collides, and no more points fail."
)


def build_joint_method_section(data: ReportData) -> Markup | str:
    """Return the section; empty with another method.

    Args:
        data: The data of the page.
    """
    if not data.joint_method:
        return ""
    columns = [
        TableColumn("tool"),
        TableColumn("path of the plan (s)", "n"),
        TableColumn("joint result (s)", "n"),
        TableColumn("change (%)", "n"),
        TableColumn("driven"),
        TableColumn("why"),
    ]
    rows = [
        (
            _format_tool(data, n),
            _format_seconds(row.fixed_path_s),
            _format_seconds(row.joint_s),
            _format_change(row),
            "joint result" if row.accepted else "path of the plan",
            row.reason,
        )
        for n, row in enumerate(data.joint_method)
    ]
    body = build_table(columns, rows) + _build_windows(data)
    return build_section("joint", "Rotation and feed together", LEAD, body)


def _build_windows(data: ReportData) -> Markup | str:
    rows = [
        (
            _format_tool(data, n),
            window.window,
            str(window.nodes),
            _format_seconds(window.run_before_s),
            _format_seconds(window.run_after_s),
            "yes" if window.accepted else "no",
            window.reason,
        )
        for n, outcome in enumerate(data.joint_method)
        for window in outcome.windows
    ]
    if not rows:
        return ""
    columns = [
        TableColumn("tool"),
        TableColumn("window"),
        TableColumn("nodes", "n"),
        TableColumn("run before (s)", "n"),
        TableColumn("run after (s)", "n"),
        TableColumn("accepted"),
        TableColumn("why not"),
    ]
    return build_folded_block("Windows", len(rows), build_table(columns, rows), opened=len(rows) <= 12)


def _format_seconds(value: float | None) -> str:
    return MISSING if value is None else f"{value:.1f}"


def _format_change(row: JointMethodEntry) -> str:
    if row.fixed_path_s is None or row.joint_s is None:
        return MISSING
    return f"{100 * (row.joint_s / row.fixed_path_s - 1):+.1f}"


def _format_tool(data: ReportData, n: int) -> str:
    """Return the place of a tool in the job, from 1 on; empty with one tool."""
    return str(n + 1) if len(data.joint_method) > 1 else ""
