"""Diagrams of the location of the model error: a strip of the machine, and bars of shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from machopt.data_types.effect_locations import BASE, TOOL, format_joint_location, format_link_location, parse_location
from machopt.effects.effect_wording import format_place
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, MismatchShare
from machopt.report.svg.shapes import Style, SvgShape, build_shape, render_svg
from machopt.report.template_rendering import render_macro
from machopt.report.wording.diagnosis_terms import describe_axis, describe_share, format_percent

if TYPE_CHECKING:
    from markupsafe import Markup

BLUE, FOUND, METAL, SOFT = "var(--blue)", "#d9730d", "#5b6673", "#c3c9d1"
MIN_SHARE = 0.005  # of the mismatch: smaller shares get no bar
MAX_BARS = 14

_WIDTH, _TOP, _HIGH, _ARM = 1090.0, 34.0, 130.0, 196.0  # bars hang between _TOP and _TOP + _HIGH; the arm at _ARM
_MARGIN, _GAP, _WIDE = 34.0, 26.0, 1.5  # a slot beside the arm is so much wider: its label is a word
_NARROW, _HEAD, _LINE, _APART = 372.0, 46.0, 20.0, 8.0  # of the picture for narrow pages: lines from _HEAD
_SPINE, _ZERO, _BESIDE = 14.0, 150.0, 84.0  # the arm's column, where bars begin, room for numbers and marks


_STANDALONE_STYLE = (
    "text{font-family:Helvetica,Arial,sans-serif;fill:#1b2430}.grid{stroke:#dfe3e8}"
    ".tick{font-size:11px;fill:#5b6673}.label{font-size:12px}"
)


@dataclass(frozen=True)
class _DiagramSlot:
    location: str
    label: tuple[str, ...]  # lines
    x: float


def build_machine_picture(d: DiagnosisResult) -> str:
    """Return the machine strip as an SVG document of its own, with the styles that the page has in its sheet.

    Args:
        d: the diagnosis.
    """
    drawn = str(build_machine_strip(d)).replace("var(--blue)", "#1552b8")
    opening, _, rest = drawn.partition(">")
    size = 'xmlns="http://www.w3.org/2000/svg" width="1098" height="268"'
    style = render_svg(build_shape("style", _STANDALONE_STYLE))
    return f"{opening.replace(' ', f' {size} ', 1)}>{style}{rest}"


def build_machine_strip(d: DiagnosisResult) -> Markup:
    """Return the chain from base to tool, with the data sources next to it; bars are shares, numbers are findings.

    Args:
        d: The diagnosis.
    """
    shares = _list_largest_shares(d)
    slots = _list_slots(d)
    wide = slots[1].x - slots[0].x
    floor = _TOP + _HIGH
    out: list[SvgShape] = []
    for level in (0.0, 0.5, 1.0):
        y = floor - _HIGH * level
        out.append(build_shape("line", class_="grid", x1=_MARGIN, x2=_WIDTH, y1=y, y2=y))
        out.append(_build_text(_MARGIN - 6, y + 4, f"{100 * level:.0f}", "end", "tick"))
    out.append(_build_text(0, _TOP - 18, "Share of the mismatch (%)", "start", "label"))
    out.extend(_build_arm([s for s in slots if _is_on_chain(s.location)]))
    for slot in slots:
        share = shares.get(slot.location, math.nan)
        mine = _has_finding_at(d, slot.location)
        if math.isfinite(share) and share >= MIN_SHARE:
            high = _HIGH * min(share, 1.0)
            bar = min(30.0, 0.62 * wide)
            out.append(
                build_shape(
                    "rect",
                    x=slot.x - bar / 2,
                    y=floor - high,
                    width=bar,
                    height=high,
                    fill=FOUND if mine else BLUE,
                    fill_opacity="0.95" if mine else "0.75",
                )
            )
            out.append(_build_text(slot.x, floor - high - 4, f"{100 * share:.0f}", "middle", "tick"))
        if not _is_on_chain(slot.location):
            out.append(
                build_shape(
                    "rect",
                    x=slot.x - 9,
                    y=_ARM - 9,
                    width=18,
                    height=18,
                    rx=4,
                    fill="#fff",
                    stroke=METAL,
                    stroke_width=1.6,
                )
            )
        for n, line in enumerate(slot.label):
            out.append(_build_text(slot.x, _ARM + 28 + 13 * n, line, "middle", "tick"))
        marks = _list_marks(d, slot.location)
        y = _ARM + 20 + 13 * len(slot.label) + 11
        for k, (n, full) in enumerate(marks):
            out.extend(_build_mark(slot.x + 20.0 * (k - (len(marks) - 1) / 2), y, n, full=full))
    words = "; ".join(f"{format_place(s.axis)} {format_percent(s.share)}" for s in d.mismatch if s.kind == "machine")
    return _render_svg(
        _WIDTH + 4, 268, "Share of the mismatch by part of the machine: " + (words or "none"), out, "broad"
    )


def build_machine_column(d: DiagnosisResult) -> Markup:
    """Return the same diagram for narrow pages: base at the top, tool at the bottom, then the data sources.

    Args:
        d: The diagnosis.
    """
    shares, slots = _list_largest_shares(d), _list_slots(d)
    chain = [s for s in slots if _is_on_chain(s.location)]
    y = {s.location: _HEAD + _LINE * n + (_APART if n >= len(chain) else 0.0) for n, s in enumerate(slots)}
    high = max(y.values()) + 0.5 * _LINE
    room = _NARROW - _ZERO - _BESIDE
    out: list[SvgShape] = []
    for level in (0.0, 0.5, 1.0):
        x = _ZERO + room * level
        out.append(build_shape("line", class_="grid", x1=x, x2=x, y1=_HEAD - 12, y2=high))
        out.append(_build_text(x, _HEAD - 17, f"{100 * level:.0f}", "middle", "tick"))
    out.append(_build_text(0, 12, "Share of the mismatch (%)", "start", "label"))
    out.append(
        build_shape(
            "path", d=f"M{_SPINE:.1f} {y['base']:.1f}V{y['tool']:.1f}", stroke=METAL, stroke_width=6, fill="none"
        )
    )
    for slot in slots:
        at = y[slot.location]
        words = (
            format_place(slot.location)
            if parse_location(slot.location).kind in ("joint", "link", "sensor")
            else " ".join(slot.label)
        )
        out.append(_build_text(_ZERO - 8, at + 4, words, "end", "label"))
        out.extend(_build_column_symbol(slot.location, at))
        marks = _list_marks(d, slot.location)
        share = shares.get(slot.location, math.nan)
        end = _ZERO
        if math.isfinite(share) and share >= MIN_SHARE:
            wide = room * min(share, 1.0)
            paint: Style = (
                {"fill": FOUND, "fill_opacity": 0.95} if _has_finding_at(d, slot.location) else {"fill": BLUE}
            )
            out.append(build_shape("rect", x=_ZERO, y=at - 6, width=wide, height=12, **{"fill_opacity": 0.75, **paint}))
            out.append(_build_text(_ZERO + wide + 4, at + 4, f"{100 * share:.0f}", "start", "tick"))
            end += wide + 24
        for k, (n, full) in enumerate(marks):
            out.extend(_build_mark(end + 12 + 20.0 * k, at, n, full=full))
    words = "; ".join(f"{format_place(s.axis)} {format_percent(s.share)}" for s in d.mismatch if s.kind == "machine")
    return _render_svg(
        _NARROW, high + 4, "Share of the mismatch by part of the machine: " + (words or "none"), out, "narrow"
    )


def build_share_bars(shares: Sequence[MismatchShare]) -> Markup | str:
    """Return one bar for each share, widest first, with place and note; empty without shares.

    Args:
        shares: Shares of the model error by place.
    """
    rows = sorted((s for s in shares if math.isfinite(s.share)), key=lambda s: -s.share)[:MAX_BARS]
    if not rows:
        return ""
    labels = [
        (describe_axis(s.axis), f"{100 * min(max(s.share, 0.0), 1.0):.1f}", format_percent(s.share), describe_share(s))
        for s in rows
    ]
    return render_macro("diagnosis.html", "bars", labels)


def _render_svg(width: float, height: float, label: str, parts: Sequence[SvgShape], kind: str = "") -> Markup:
    box = f"-4 0 {width + 4:.0f} {height:.0f}"
    words = f"plot {kind}".strip()
    return render_svg(build_shape("svg", class_=words, viewBox=box, role="img", aria_label=label, inside=parts))


def _build_mark(x: float, y: float, number: int, *, full: bool) -> list[SvgShape]:
    """The number of a finding: full where it sits, dashed where it might sit as well."""
    style: Style = {"r": 9, "fill": FOUND}
    if not full:
        style = {"r": 8.5, "fill": "#fff", "stroke": FOUND, "stroke_dasharray": "3 2"}
    return [
        build_shape("circle", cx=x, cy=y, **style),
        build_shape(
            "text",
            str(number),
            x=x,
            y=y + 4,
            text_anchor="middle",
            font_size=11,
            font_weight=700 if full else 400,
            fill="#fff" if full else "#333d49",
        ),
    ]


def _list_largest_shares(d: DiagnosisResult) -> dict[str, float]:
    """The largest share at each place of the machine."""
    shares: dict[str, float] = {}
    for s in d.mismatch:
        if s.kind == "machine":
            shares[_find_slot(s.axis)] = max(shares.get(_find_slot(s.axis), 0.0), s.share)
    return shares


def _has_finding_at(d: DiagnosisResult, location: str) -> bool:
    return any(_find_slot(f.location) == location for f in d.findings)


def _list_marks(d: DiagnosisResult, location: str) -> list[tuple[int, bool]]:
    """Numbers of the findings that sit at a place (True), and of those that might as well (False)."""
    found = [n for n, f in enumerate(d.findings, 1) if _find_slot(f.location) == location]
    also = [n for n, f in enumerate(d.findings, 1) for name in f.one_of if _find_slot(name[1]) == location]
    return [(n, True) for n in found] + [(n, False) for n in dict.fromkeys(also) if n not in found]


def _build_column_symbol(location: str, y: float) -> list[SvgShape]:
    """Return the shape of a part in the narrow diagram, in the column of the arm."""
    x = _SPINE
    if location == "base":
        return [build_shape("path", d=f"M{x - 11:.1f} {y - 8:.1f}h22l-5 16h-12z", fill=METAL)]
    if location == "tool":
        return [build_shape("path", d=f"M{x - 8:.1f} {y - 8:.1f}h16v7l-8 10l-8 -10z", fill=METAL)]
    ring: Style = {"fill": "#fff", "stroke": METAL}
    if not _is_on_chain(location):
        return [build_shape("rect", x=x - 6, y=y - 6, width=12, height=12, rx=3, stroke_width=1.6, **ring)]
    return (
        [build_shape("circle", cx=x, cy=y, r=6.5, stroke_width=3, **ring)]
        if parse_location(location).is_joint_location
        else []
    )


def _is_on_chain(location: str) -> bool:
    place = parse_location(location)
    return place.kind in (BASE, TOOL) or len(place.numbers) == 1


def _list_chain(joints: int) -> tuple[str, ...]:
    return (
        "base",
        *(at(j) for j in range(1, joints + 1) for at in (format_joint_location, format_link_location)),
        "tool",
    )


def _list_slots(d: DiagnosisResult) -> list[_DiagramSlot]:
    """Return the chain, then sensors, environment and controller, and further data sources with a share."""
    named = [s.axis for s in d.mismatch if s.kind == "machine"] + [
        name[1] for f in d.findings for name in (f.one_of or ((f.effect, f.location),))
    ]
    around = ["sensor:force", "sensor:displacement", "environment", "controller"]
    if d.channel == "torque":
        around = ["sensor:tau", "sensor:force", "environment", "controller"]
    chain = _list_chain(d.joint_count)
    around += sorted({_find_slot(n) for n in named} - {*around} - {*chain})
    step = (_WIDTH - _MARGIN - _GAP - 10) / (len(chain) + _WIDE * len(around))
    slots = []
    for n, location in enumerate(chain):
        at = parse_location(location)
        label = f"{at.kind[0].upper()}{at.which}" if at.which else location
        slots.append(_DiagramSlot(location, (label,), _MARGIN + step * (n + 0.5)))
    start = _MARGIN + _GAP + step * len(chain)
    for n, location in enumerate(around):
        words = "the record" if location == "record" else format_place(location)
        slots.append(_DiagramSlot(location, _split_lines(words), start + _WIDE * step * (n + 0.5)))
    return slots


def _find_slot(location: str) -> str:
    return "record" if parse_location(location).is_row_location else location


def _split_lines(words: str) -> tuple[str, ...]:
    """Two lines where the words allow it: a slot is narrow."""
    first, _, second = words.partition(" ")
    return (first, second) if second else (first,)


def _build_arm(chain: Sequence[_DiagramSlot]) -> list[SvgShape]:
    """Pedestal, joints as rings, links as bars between them, a tool at the end."""
    y, out = _ARM, []
    out.append(build_shape("path", d=f"M{chain[0].x:.1f} {y:.1f}H{chain[-1].x:.1f}", stroke=METAL, stroke_width=7))
    for slot in chain:
        x = slot.x
        if slot.location == "base":
            out.append(build_shape("path", d=f"M{x - 17:.1f} {y + 13:.1f}l7 -26h20l7 26z", fill=METAL))
        elif slot.location == "tool":
            out.append(build_shape("path", d=f"M{x - 14:.1f} {y - 11:.1f}h16l15 11l-15 11h-16z", fill=METAL))
        elif parse_location(slot.location).is_joint_location:
            out.append(build_shape("circle", cx=x, cy=y, r=10.5, fill="#fff", stroke=METAL, stroke_width=4))
    return out


def _build_text(x: float, y: float, words: str, anchor: str, kind: str) -> SvgShape:
    return build_shape("text", words, class_=kind, x=x, y=y, text_anchor=anchor)
