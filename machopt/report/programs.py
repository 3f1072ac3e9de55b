"""The block about robot programs: what was written, what came back, what happens between the points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from machopt.report.data import Program, ReportData
from machopt.report.display import Unit
from machopt.report.shell import section
from machopt.report.svg import drawn, shape
from machopt.report.tables import Column, table
from machopt.report.template import fragment, part

if TYPE_CHECKING:
    from markupsafe import Markup

NARROW = "\u00a0"  # between a number and its unit: no line begins with a unit
_FILES = 4  # named of a program that has many
_BAR = 90  # pixels that stand for the tolerance
_SMALL_LENGTH, _SMALL_ANGLE = Unit(1e3, "mm", 4), Unit(180 / math.pi, "deg", 4)
_SHORT, _TURN = Unit(1e3, "mm", 3), Unit(180 / math.pi, "deg", 3)
_FEED = Unit(6e4, "mm/min", 3)


def programs(data: ReportData) -> Markup | str:
    """The section, empty where no program was written."""
    if not data.programs:
        return ""
    columns = [
        Column("Post"),
        Column("Files", "html"),
        Column("Moves", "html"),
        Column("Targets off by", "html"),
        Column("Feeds off by", "n"),
        Column("Configuration"),
        Column("Events"),
        Column("Between the points", "html"),
        Column("Feed by the controller's model", "html"),
        Column("Check", "html"),
    ]
    body = table(columns, [_row(p) for p in data.programs])
    wrong = [(p.files[0] if p.files else p.post, text) for p in data.programs for text in p.differences]
    if wrong:
        body = fragment("report.html", "differing", wrong) + body
    body = _said(data.programs, "unstarted", "Words of the CAM file that no line of the program carries out") + body
    body += _said(data.programs, "assumed", "Assumed of the controller, because the cell does not say it")
    return section("programs", "Robot programs", fragment("report.html", "programs_lead"), body)


def _row(p: Program) -> tuple[object, ...]:
    lines = [f"{p.lines}{NARROW}lines"]
    if p.withheld:
        return (p.post, "none", "–", *"–" * 6, part("toned", "fail", f"withheld: {p.withheld}"))
    if not p.checked:
        state = part("toned", "none", "not checked: no reader here knows its language")
        return (p.post, _files(p), part("unbroken", lines), *"–" * 5, _feed(p), state)
    moves = part("unbroken", [f"{p.moves}{NARROW}moves", *([f"{p.added} of them added"] if p.added else []), *lines])
    configuration = {None: "–", True: "equal", False: "differs"}[p.configuration_equal]
    events = "equal" if p.events_equal else "differ"
    state = part("toned", "fail", "differs") if p.differences else part("toned", "pass", "reads back")
    return (
        p.post,
        _files(p),
        moves,
        _targets(p),
        _least(p.feed_error, _FEED),
        configuration,
        events,
        _between(p),
        _feed(p),
        state,
    )


def _said(rows: Sequence[Program], what: str, title: str) -> Markup | str:
    """What the programs have to say, each sentence once with the posts it is of."""
    of: dict[str, list[str]] = {}
    for p in rows:
        for text in getattr(p, what):
            of.setdefault(text, []).append(p.post)
    listed = [(text, ", ".join(posts)) for text, posts in of.items()]
    return fragment("report.html", "said", title, listed) if of else ""


def _feed(p: Program) -> Markup | str:
    """What the controller will hold of the programmed feed, at which deviation."""
    if not math.isfinite(p.feed_mean):
        return "the motion's own: it is streamed, or no model is known"
    return part(
        "unbroken",
        [
            f"{100 * p.feed_mean:.0f} % on average",
            f"{100 * p.feed_lowest:.0f} % in the slowest move",
            f"points passed by {_SHORT.text(p.feed_deviation, unit=True)} at most",
        ],
    )


def _targets(p: Program) -> Markup:
    words = [_least(p.position_error, _SMALL_LENGTH), _least(p.angle_error, _SMALL_ANGLE)]
    words += [f"joints {_least(p.joint_error, _SMALL_ANGLE)}"] if math.isfinite(p.joint_error) else []
    return part("unbroken", words)


def _files(p: Program) -> Markup:
    return fragment("report.html", "program_files", p.files[:_FILES], max(len(p.files) - _FILES, 0))


def _least(value: float, unit: Unit) -> str:
    """The value; where the decimals cannot show it, that it is less than the last of them."""
    step = 10.0**-unit.decimals
    small = 0.0 < value * unit.factor < 0.5 * step
    words = f"< {step:.{unit.decimals}f} {unit.name}" if small else unit.text(value, unit=True)
    return words.replace(" ", NARROW)


def _between(p: Program) -> Markup | str:
    """A bar of the tolerance with what of it is used, and the numbers."""
    if not math.isfinite(p.path_error):
        return "no lines: joints are interpolated"
    share = min(p.path_error / p.tolerance, 1.25) if p.tolerance else 0.0
    colour = "var(--bad)" if share > 1.0 else "var(--blue)"
    bar = drawn(
        shape(
            "svg",
            viewBox=f"0 0 {1.25 * _BAR + 1:g} 11",  # a narrow column shrinks it and cuts nothing off
            width=1.25 * _BAR + 1,
            height=11,
            role="img",
            aria_label="share of the tolerance",
            inside=[
                shape("rect", y=1, width=_BAR, height=9, style="fill:var(--rule)"),
                shape("rect", y=1, width=share * _BAR, height=9, style=f"fill:{colour}"),
                shape("path", d=f"M{_BAR} 0V11", stroke="#b3261e"),
            ],
        )
    )
    words = [
        f"{_SHORT.text(p.path_error)} of {_least(p.tolerance, _SHORT)}",
        f"tool axis {_least(p.axis_error, _TURN)}",
        f"orientation {_least(p.turn_error, _TURN)}",
    ]
    return fragment("report.html", "below", bar, part("unbroken", words))
