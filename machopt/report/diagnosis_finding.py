"""One finding on the diagnosis page: what it is, its law and size, the picture, the rivals, what cannot be excluded."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from html import escape
from typing import Any

from machopt.diagnose.problem import Correction, RecordCorrection
from machopt.diagnose.result import Estimate, Finding, Rival
from machopt.domain.kinematics import KinematicCorrection
from machopt.effects.words import named, what
from machopt.report.diagnosis_words import alternatives, chance, measured, numeral, percent, readable, sized
from machopt.report.tables import Column, table

_WITH_UNIT = re.compile(r"(\S+) ([^\d\s]\S*)")  # "61 µm", not "6 of 6" or "< 0.001"


def heading(f: Finding) -> str:
    """ "Hysteresis of joint 3: 0.90 arcmin (0.81 … 0.99), on load reversal"."""
    words = named(f.effect, f.location)
    size = next(iter(f.parameters.values()), None)
    out = words[:1].upper() + words[1:]
    if size is not None:
        out += f": {measured(size)}"
    return out + (f", {f.note}" if f.note else "")


def finding_html(n: int, f: Finding, unit: str, charts: set[str]) -> str:
    """The block of one finding."""
    parts = [f"<h3>{n}. {escape(heading(f))}</h3>"]
    said = what(f.effect)
    if said:
        parts.append(f"<p>{escape(said)}</p>")
    sets = "note" if len(f.one_of) > 1 else "lead"
    own = (f.effect, f.location)
    one_of = (own, *(name for name in f.one_of if name != own))
    parts.append(f'<p class="{sets}">{escape(alternatives(one_of))}</p>')
    parts.append(_cards(f, unit))
    parts.append(f"<p><b>Law:</b> {escape(f.law)}. <span class=lead>{escape(f.equation)}</span></p>")
    parts.append(_parameters(f.parameters))
    if f"d-law{n}" in charts:
        parts.append(f'<div class=chart id="d-law{n}"></div>')
        parts.append(
            "<p class=lead>Points: the law at each reading plus what the fit leaves there. Diamonds: medians of "
            "neighbouring readings with 90 % bars.</p>"
        )
    parts.append(_rivals(f.rivals))
    parts.append(f"<p class=lead>{escape(goes_into(f.correction))}</p>")
    return "".join(parts)


def goes_into(correction: Correction | None) -> str:
    """Where what was found is written."""
    if correction is None:
        return "No correction is written for it: the planner's model has no such law."
    values = ", ".join(f"{k} {_value(v)}" for k, v in correction.parameters.items())
    which = f"{correction.effect} {correction.location}{f' ({values})' if values else ''}"
    if isinstance(correction, RecordCorrection):
        return f"Stays in the diagnosis, the robot's model is not touched by it: {which}."
    if isinstance(correction, KinematicCorrection):
        return f"Goes into kinematics.yaml and is compensated in the exported joints: {which}."
    return f"Goes into stiffness.yaml as a term, which optimize takes: {which}."


def _cards(f: Finding, unit: str) -> str:
    gain = 1.0 - (f.after / f.before) ** 2 if f.before > 0.0 else math.nan
    cards = [
        ("Without it", sized(f.before, unit), "held-out error, other findings in"),
        ("With it", sized(f.after, unit), "held-out error"),
        ("Closes", percent(gain), "of the held-out power"),
        ("p", chance(f.p_value), "of the whole search"),
    ]
    return cards_html(cards)


def cards_html(cards: list[tuple[str, str, str]]) -> str:
    """Boxes of name, value with its unit, and what it is."""
    out = []
    for name, value, more in cards:
        split = _WITH_UNIT.fullmatch(value)
        number, unit = split.groups() if split else (value, "")
        out.append(
            f"<div class=card><div class=name>{escape(name)}</div><div class=value>{escape(number)} "
            f"<small>{escape(unit)}</small></div><div class=more>{escape(more)}</div></div>"
        )
    return f'<div class=cards style="margin-bottom:12px">{"".join(out)}</div>'


def _parameters(parameters: Mapping[str, Estimate]) -> str:
    rows = []
    for name, e in parameters.items():
        factor, unit = readable(e.unit)
        value, low, high = numeral(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
        _, low95, high95 = numeral(factor * e.value, factor * e.ci95[0], factor * e.ci95[1])
        rows.append([name.replace("_", " "), value, unit, _between(low, high), _between(low95, high95)])
    columns = [Column("Parameter"), Column("Value", "n"), Column("Unit"), Column("90 % interval", "n"),
               Column("95 % interval", "n")]  # fmt: skip
    return table(columns, rows) if rows else ""


def _between(low: str, high: str) -> str:
    if "–" in (low, high):
        return "–"
    return "a step of a grid" if low == high else f"{low} … {high}"


def _rivals(rivals: tuple[Rival, ...]) -> str:
    if not rivals:
        return ""
    words = {"rejected": '<span class="pass">rejected</span>', "not excluded": "<b>not excluded</b>"}
    order = sorted(rivals, key=lambda r: (r.placebo, r.standing == "rejected", -r.closed))
    rows = [
        [("placebo: " if r.placebo else "") + named(r.effect, r.location), r.law, percent(r.closed), chance(r.p_value),
         words[r.standing]]
        for r in order
    ]  # fmt: skip
    columns = [
        Column("Rival"), Column("Law"), Column("Reaches of the gain", "n"), Column("p that it does as well", "n"),
        Column("", "html"),
    ]  # fmt: skip
    placebos = [r for r in rivals if r.placebo]
    lost = sum(r.standing == "rejected" for r in placebos)
    said = f" Placebos must lose: {lost} of {len(placebos)} did." if placebos else ""
    return f"<p><b>Rivals</b>, each fitted alone in its place and judged by unseen readings.{said}</p>" + table(
        columns, rows
    )


def _value(v: Any) -> str:
    if isinstance(v, bool | str):
        return str(v)
    if isinstance(v, int | float):
        return f"{v:.4g}".replace("-", "−")
    if hasattr(v, "tolist"):
        v = v.tolist()
    if isinstance(v, list | tuple):
        return f"[{', '.join(_value(x) for x in v[:6])}{', …' if len(v) > 6 else ''}]"
    return str(v)
