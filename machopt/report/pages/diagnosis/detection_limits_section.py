"""Section of the diagnosis page with detection limits: the smallest detectable size of each effect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from machopt.data_types.effect_locations import JOINT, LINK, format_joint_location, format_link_location, parse_location
from machopt.effects.effect_wording import format_effect_at_place, format_effect_noun, format_place, join_with_commas
from machopt.measurement.diagnosis.data_types.diagnosis_result import DetectionLimit, DiagnosisResult
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.template_rendering import render_part
from machopt.report.wording.diagnosis_terms import choose_compliance_unit, format_significant

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str


def build_limits_html(d: DiagnosisResult) -> Body:
    """Return matrices of effects over joints and links, a table of the rest, and the reasons; empty without limits.

    Args:
        d: The diagnosis.
    """
    least = _find_smallest_limits(d.limits)
    reasons = {(u.effect, u.location): u.reason for u in d.untestable}
    if not least and not reasons:
        return ""
    numbers = range(1, d.joint_count + 1)
    joints, links = ([at(j) for j in numbers] for at in (format_joint_location, format_link_location))
    body: Body = ""
    for title, places in (("Joints", joints), ("Links", links)):
        effects = list(dict.fromkeys(e for e, where in [*least, *reasons] if where in places))
        rows = [_build_row(e, places, least, reasons) for e in effects]
        if rows:
            columns = [TableColumn(title), TableColumn("Unit"), *(TableColumn(str(n), "html") for n in numbers)]
            body += build_table(columns, rows)
    rest = [name for name in dict.fromkeys([*least, *reasons]) if name[1] not in (*joints, *links)]
    if rest:
        columns = [TableColumn("Elsewhere"), TableColumn("Least size", "html"), TableColumn("Unit")]
        body += build_table(
            columns,
            [
                [
                    _capitalise(format_effect_at_place(*n)),
                    _build_cell(n, least, reasons, ""),
                    _format_unit(least.get(n)),
                ]
                for n in rest
            ],
        )
    sets = [
        [
            _capitalise(format_effect_at_place(x.effect, x.location)),
            " ".join(_format_size(x)) if math.isfinite(x.value) else "–",
            join_with_commas([format_effect_at_place(*n) for n in x.one_of if n != (x.effect, x.location)], "and")
            or "–",
        ]
        for x in least.values()
        if x.standing == "only as a set"
    ]
    if sets:
        columns = [TableColumn("Effect"), TableColumn("Least size", "n"), TableColumn("Indistinguishable from")]
        body += build_folded_block("Only as one of a set", len(sets), build_table(columns, sets))
    body += _build_untestable(least, reasons)
    return body


def _build_untestable(least: dict[tuple[str, str], DetectionLimit], reasons: dict[tuple[str, str], str]) -> Body:
    """What is not testable, by reason."""
    by_reason: dict[str, list[tuple[str, str]]] = {}
    for name, reason in reasons.items():
        by_reason.setdefault(reason, []).append(name)
    for name, x in least.items():
        if x.standing == "not testable" and name not in reasons:
            by_reason.setdefault("this design hardly moves it: the base or other laws take it up", []).append(name)
    rows = [[_group_names(names), reason] for reason, names in by_reason.items()]
    count = sum(len(names) for names in by_reason.values())
    columns = [TableColumn("Not testable here"), TableColumn("Why", "why")]
    return build_folded_block("Not testable with these data", count, build_table(columns, rows)) if rows else ""


def _group_names(names: list[tuple[str, str]]) -> str:
    """Effects with their places together: "hysteresis (joint 1, joint 2)"."""
    places: dict[str, list[str]] = {}
    for effect, location in names:
        places.setdefault(effect, []).append(location)
    out = []
    for effect, where in places.items():
        if len(where) == 1:
            out.append(format_effect_at_place(effect, where[0]))
            continue
        kinds = {parse_location(w).kind for w in where}
        if kinds in ({JOINT}, {LINK}):
            text = f"{kinds.pop()}s {join_with_commas([parse_location(w).which for w in where], 'and')}"
        else:
            text = join_with_commas([format_place(w) for w in where], "and")
        out.append(f"{format_effect_noun(effect)} ({text})")
    return _capitalise("; ".join(out))


def _build_row(
    effect: str,
    places: Sequence[str],
    least: dict[tuple[str, str], DetectionLimit],
    reasons: dict[tuple[str, str], str],
) -> list[Body]:
    here = [least[effect, p] for p in places if (effect, p) in least]
    units = [_format_size(x)[1] for x in here if math.isfinite(x.value)]
    common = max(set(units), key=lambda u: (units.count(u), u)) if units else ""
    return [
        _capitalise(format_effect_noun(effect)),
        common,
        *(_build_cell((effect, p), least, reasons, common) for p in places),
    ]


def _build_cell(
    name: tuple[str, str],
    least: dict[tuple[str, str], DetectionLimit],
    reasons: dict[tuple[str, str], str],
    common: str,
) -> Body:
    x = least.get(name)
    if x is None:
        return render_part("toned", "none", "✕", reasons[name]) if name in reasons else ""
    if x.standing == "not testable" or not math.isfinite(x.value):
        return render_part("toned", "none", "✕", "not testable")
    value, unit = _format_size(x)
    text = value + (f" {unit}" if common and unit != common else "")
    if x.standing == "only as a set":
        others = join_with_commas([format_effect_at_place(*n) for n in x.one_of if n != name], "and")
        return render_part("toned", "none", f"({text})", f"cannot be distinguished from {others}")
    return text


def _find_smallest_limits(limits: tuple[DetectionLimit, ...]) -> dict[tuple[str, str], DetectionLimit]:
    """The limit of each effect at each place; of rival laws the one that is seen best."""
    rank = {"testable": 0, "only as a set": 1, "not testable": 2}
    best: dict[tuple[str, str], DetectionLimit] = {}
    for x in limits:
        name = (x.effect, x.location)
        if name not in best or rank[x.standing] < rank[best[name].standing]:
            best[name] = x
    return best


def _format_unit(x: DetectionLimit | None) -> str:
    return _format_size(x)[1] if x is not None and math.isfinite(x.value) else ""


def _format_size(x: DetectionLimit) -> tuple[str, str]:
    """Value in a readable unit."""
    factor, unit = choose_compliance_unit(x.unit)
    return format_significant(factor * x.value, 2), unit


def _capitalise(words: str) -> str:
    return words[:1].upper() + words[1:]
