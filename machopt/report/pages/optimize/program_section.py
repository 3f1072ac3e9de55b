"""Section of the optimize report about robot programs: files, read-back result, and moves between the points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from machopt.report.page_shell import build_section
from machopt.report.page_types.display_units import DisplayUnit
from machopt.report.page_types.optimize_page_data import ProgramRow, ReportData
from machopt.report.pages.report_tables import TableColumn, build_table
from machopt.report.svg.shapes import build_shape, render_svg
from machopt.report.template_rendering import render_macro, render_part

if TYPE_CHECKING:
    from markupsafe import Markup

NARROW_SPACE = "\u00a0"  # between a number and its unit: no line begins with a unit
_FILES = 4  # named of a program that has many
_BAR = 90  # pixels that stand for the tolerance
_SMALL_LENGTH, _SMALL_ANGLE = DisplayUnit(1e3, "mm", 4), DisplayUnit(180 / math.pi, "deg", 4)
_SHORT, _TURN = DisplayUnit(1e3, "mm", 3), DisplayUnit(180 / math.pi, "deg", 3)
_FEED = DisplayUnit(6e4, "mm/min", 3)


def build_program_section(data: ReportData) -> Markup | str:
    """Return the section; empty where no program was written.

    Args:
        data: The data of the page.
    """
    if not data.programs:
        return ""
    columns = [
        TableColumn("Post"),
        TableColumn("Files", "html"),
        TableColumn("Moves", "html"),
        TableColumn("Targets off by", "html"),
        TableColumn("Feeds off by", "n"),
        TableColumn("Configuration"),
        TableColumn("Events"),
        TableColumn("Between the points", "html"),
        TableColumn("Feed by the controller's model", "html"),
        TableColumn("Check", "html"),
    ]
    body = build_table(columns, [_build_row(p) for p in data.programs])
    wrong = [(p.files[0] if p.files else p.post, text) for p in data.programs for text in p.differences]
    if wrong:
        body = render_macro("report.html", "differing", wrong) + body
    body = (
        _build_statements(data.programs, "unstarted", "Words of the CAM file that no line of the program carries out")
        + body
    )
    body += _build_statements(
        data.programs, "assumed", "Assumptions about the controller that the cell does not define"
    )
    return build_section("programs", "Robot programs", render_macro("report.html", "programs_lead"), body)


def _build_row(p: ProgramRow) -> tuple[object, ...]:
    lines = [f"{p.lines}{NARROW_SPACE}lines"]
    if p.withheld:
        return (p.post, "none", "–", *"–" * 6, render_part("toned", "fail", f"withheld: {p.withheld}"))
    if not p.checked:
        state = render_part("toned", "none", "not checked: no reader here knows its language")
        return (p.post, _build_files(p), render_part("unbroken", lines), *"–" * 5, _build_feed_note(p), state)
    moves = render_part(
        "unbroken", [f"{p.moves}{NARROW_SPACE}moves", *([f"{p.added} of them added"] if p.added else []), *lines]
    )
    configuration = {None: "–", True: "equal", False: "differs"}[p.configuration_equal]
    events = "equal" if p.events_equal else "differ"
    state = render_part("toned", "fail", "differs") if p.differences else render_part("toned", "pass", "reads back")
    return (
        p.post,
        _build_files(p),
        moves,
        _build_targets(p),
        _format_small_value(p.feed_error, _FEED),
        configuration,
        events,
        _build_tolerance_bar(p),
        _build_feed_note(p),
        state,
    )


def _build_statements(rows: Sequence[ProgramRow], what: str, title: str) -> Markup | str:
    """What the programs have to say, each sentence once with the posts it is of."""
    of: dict[str, list[str]] = {}
    for p in rows:
        for text in getattr(p, what):
            of.setdefault(text, []).append(p.post)
    listed = [(text, ", ".join(posts)) for text, posts in of.items()]
    return render_macro("report.html", "messages", title, listed) if of else ""


def _build_feed_note(p: ProgramRow) -> Markup | str:
    """What the controller will hold of the programmed feed, at which deviation."""
    if not math.isfinite(p.feed_mean):
        return "the motion's own: it is streamed, or no model is known"
    return render_part(
        "unbroken",
        [
            f"{100 * p.feed_mean:.0f} % on average",
            f"{100 * p.feed_lowest:.0f} % in the slowest move",
            f"points passed by {_SHORT.format_value(p.feed_deviation, unit=True)} at most",
        ],
    )


def _build_targets(p: ProgramRow) -> Markup:
    words = [_format_small_value(p.position_error, _SMALL_LENGTH), _format_small_value(p.angle_error, _SMALL_ANGLE)]
    words += [f"joints {_format_small_value(p.joint_error, _SMALL_ANGLE)}"] if math.isfinite(p.joint_error) else []
    return render_part("unbroken", words)


def _build_files(p: ProgramRow) -> Markup:
    return render_macro("report.html", "program_files", p.files[:_FILES], max(len(p.files) - _FILES, 0))


def _format_small_value(value: float, unit: DisplayUnit) -> str:
    """The value; where the decimals cannot show it, that it is less than the last of them."""
    step = 10.0**-unit.decimals
    small = 0.0 < value * unit.factor < 0.5 * step
    words = f"< {step:.{unit.decimals}f} {unit.name}" if small else unit.format_value(value, unit=True)
    return words.replace(" ", NARROW_SPACE)


def _build_tolerance_bar(p: ProgramRow) -> Markup | str:
    """A bar of the tolerance with what of it is used, and the numbers."""
    if not math.isfinite(p.path_error):
        return "no lines: joints are interpolated"
    share = min(p.path_error / p.tolerance, 1.25) if p.tolerance else 0.0
    colour = "var(--bad)" if share > 1.0 else "var(--blue)"
    bar = render_svg(
        build_shape(
            "svg",
            viewBox=f"0 0 {1.25 * _BAR + 1:g} 11",  # a narrow column shrinks it and cuts nothing off
            width=1.25 * _BAR + 1,
            height=11,
            role="img",
            aria_label="share of the tolerance",
            inside=[
                build_shape("rect", y=1, width=_BAR, height=9, style="fill:var(--rule)"),
                build_shape("rect", y=1, width=share * _BAR, height=9, style=f"fill:{colour}"),
                build_shape("path", d=f"M{_BAR} 0V11", stroke="#b3261e"),
            ],
        )
    )
    words = [
        f"{_SHORT.format_value(p.path_error)} of {_format_small_value(p.tolerance, _SHORT)}",
        f"tool axis {_format_small_value(p.axis_error, _TURN)}",
        f"orientation {_format_small_value(p.turn_error, _TURN)}",
    ]
    return render_macro("report.html", "below", bar, render_part("unbroken", words))
