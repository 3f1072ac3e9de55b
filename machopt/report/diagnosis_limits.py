"""What a recording could have shown: the least size of each effect at each place, as a table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.diagnose.nouns.result import Diagnosis, Limit
from machopt.domain.location import JOINT, LINK, joint_at, link_at, located
from machopt.effects.words import listed, named, noun, place
from machopt.report.diagnosis_words import digits, readable
from machopt.report.tables import Column, folded, table
from machopt.report.template import part

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

JOINTS = tuple(joint_at(j) for j in range(1, 7))
LINKS = tuple(link_at(j) for j in range(1, 7))


def limits_html(d: Diagnosis) -> Body:
    """Matrices of effects over joints and links, a table of the rest, and the reasons; nothing without limits."""
    least = _least(d.limits)
    reasons = {(u.effect, u.location): u.reason for u in d.untestable}
    if not least and not reasons:
        return ""
    body: Body = ""
    for title, places in (("Joints", JOINTS), ("Links", LINKS)):
        effects = list(dict.fromkeys(e for e, where in [*least, *reasons] if where in places))
        rows = [_row(e, places, least, reasons) for e in effects]
        if rows:
            columns = [Column(title), Column("Unit"), *(Column(str(n), "html") for n in range(1, 7))]
            body += table(columns, rows)
    rest = [name for name in dict.fromkeys([*least, *reasons]) if name[1] not in (*JOINTS, *LINKS)]
    if rest:
        columns = [Column("Elsewhere"), Column("Least size", "html"), Column("Unit")]
        body += table(columns, [[_capital(named(*n)), _cell(n, least, reasons, ""), _unit(least.get(n))] for n in rest])
    sets = [
        [
            _capital(named(x.effect, x.location)),
            " ".join(_size(x)) if math.isfinite(x.value) else "–",
            listed([named(*n) for n in x.one_of if n != (x.effect, x.location)], "and") or "–",
        ]
        for x in least.values()
        if x.standing == "only as a set"
    ]
    if sets:
        columns = [Column("Effect"), Column("Least size", "n"), Column("Cannot be told from")]
        body += folded("Only as one of a set", len(sets), table(columns, sets))
    body += _blind(least, reasons)
    return body


def _blind(least: dict[tuple[str, str], Limit], reasons: dict[tuple[str, str], str]) -> Body:
    """What is not testable, by reason."""
    by_reason: dict[str, list[tuple[str, str]]] = {}
    for name, reason in reasons.items():
        by_reason.setdefault(reason, []).append(name)
    for name, x in least.items():
        if x.standing == "not testable" and name not in reasons:
            by_reason.setdefault("this design hardly moves it: the base or other laws take it up", []).append(name)
    rows = [[_gathered(names), reason] for reason, names in by_reason.items()]
    count = sum(len(names) for names in by_reason.values())
    columns = [Column("Not testable here"), Column("Why", "why")]
    return folded("Not testable with these data", count, table(columns, rows)) if rows else ""


def _gathered(names: list[tuple[str, str]]) -> str:
    """Effects with their places together: "hysteresis (joint 1, joint 2)"."""
    places: dict[str, list[str]] = {}
    for effect, location in names:
        places.setdefault(effect, []).append(location)
    out = []
    for effect, where in places.items():
        if len(where) == 1:
            out.append(named(effect, where[0]))
            continue
        kinds = {located(w).kind for w in where}
        if kinds in ({JOINT}, {LINK}):
            text = f"{kinds.pop()}s {listed([located(w).which for w in where], 'and')}"
        else:
            text = listed([place(w) for w in where], "and")
        out.append(f"{noun(effect)} ({text})")
    return _capital("; ".join(out))


def _row(
    effect: str, places: tuple[str, ...], least: dict[tuple[str, str], Limit], reasons: dict[tuple[str, str], str]
) -> list[Body]:
    here = [least[effect, p] for p in places if (effect, p) in least]
    units = [_size(x)[1] for x in here if math.isfinite(x.value)]
    common = max(set(units), key=lambda u: (units.count(u), u)) if units else ""
    return [_capital(noun(effect)), common, *(_cell((effect, p), least, reasons, common) for p in places)]


def _cell(
    name: tuple[str, str], least: dict[tuple[str, str], Limit], reasons: dict[tuple[str, str], str], common: str
) -> Body:
    x = least.get(name)
    if x is None:
        return part("toned", "none", "✕", reasons[name]) if name in reasons else ""
    if x.standing == "not testable" or not math.isfinite(x.value):
        return part("toned", "none", "✕", "not testable")
    value, unit = _size(x)
    text = value + (f" {unit}" if common and unit != common else "")
    if x.standing == "only as a set":
        others = listed([named(*n) for n in x.one_of if n != name], "and")
        return part("toned", "none", f"({text})", f"cannot be told from {others}")
    return text


def _least(limits: tuple[Limit, ...]) -> dict[tuple[str, str], Limit]:
    """The limit of each effect at each place; of rival laws the one that is seen best."""
    rank = {"testable": 0, "only as a set": 1, "not testable": 2}
    best: dict[tuple[str, str], Limit] = {}
    for x in limits:
        name = (x.effect, x.location)
        if name not in best or rank[x.standing] < rank[best[name].standing]:
            best[name] = x
    return best


def _unit(x: Limit | None) -> str:
    return _size(x)[1] if x is not None and math.isfinite(x.value) else ""


def _size(x: Limit) -> tuple[str, str]:
    """Value in a readable unit."""
    factor, unit = readable(x.unit)
    return digits(factor * x.value, 2), unit


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
