"""One finding on the diagnosis page: what it is, its law and size, the picture, the rivals, what cannot be excluded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from machopt.diagnose.nouns.problem import Correction, RecordCorrection
from machopt.diagnose.nouns.result import Estimate, Finding, Rival
from machopt.domain.kinematics import KinematicCorrection
from machopt.effects.words import named, what
from machopt.report.diagnosis_words import alternatives, chance, measured, numeral, parted, percent, percents, readable
from machopt.report.tables import Column, table
from machopt.report.template import fragment, part

if TYPE_CHECKING:
    from markupsafe import Markup


def heading(f: Finding) -> str:
    """ "Hysteresis of joint 3: 0.90 arcmin (0.81 … 0.99), on load reversal"."""
    words = named(f.effect, f.location)
    size = next(iter(f.parameters.values()), None)
    out = words[:1].upper() + words[1:]
    if size is not None:
        out += f": {measured(size)}"
    return out + (f", {f.note}" if f.note else "")


def finding_html(n: int, f: Finding, unit: str, charts: set[str]) -> Markup:
    """The block of one finding."""
    own = (f.effect, f.location)
    one_of = (own, *(name for name in f.one_of if name != own))
    placebos = [r for r in f.rivals if r.placebo]
    return fragment(
        "diagnosis.html",
        "finding",
        number=n,
        heading=heading(f),
        said=what(f.effect),
        several=len(f.one_of) > 1,
        alternatives=alternatives(one_of),
        cards=part("boxes", _cards(f, unit), True),
        law=f.law,
        equation=f.equation,
        parameters=_parameters(f.parameters),
        drawn=f"d-law{n}" in charts,
        placebos=len(placebos),
        lost=sum(r.standing == "rejected" for r in placebos),
        rivals=_rivals(f.rivals),
        goes_into=goes_into(f.correction),
    )


def goes_into(correction: Correction | None) -> str:
    """Where what was found is written."""
    if correction is None:
        return "No correction is written for it: the planner's model has no such law."
    values = ", ".join(f"{k} {_value(v)}" for k, v in correction.parameters.items() if k != "message")
    if isinstance(correction, RecordCorrection):  # no file has a key of that name: the finding's title says what it is
        return f"Stays in the diagnosis, the robot's model is not touched by it{f': {values}' if values else ''}."
    which = f"{correction.effect} {correction.location}{f' ({values})' if values else ''}"
    if isinstance(correction, KinematicCorrection):
        return f"Goes into kinematics.yaml and is compensated in the exported joints: {which}."
    return f"Goes into stiffness.yaml as a term, which optimize takes: {which}."


def _cards(f: Finding, unit: str) -> list[tuple[str, str, str, str]]:
    """Name, number, unit and what it is."""
    if f.record:
        return [
            ("As stated", *parted(f.before, unit), "what a fit to the record leaves"),
            ("Put right", *parted(f.after, unit), "what the same fit leaves, all of the record put right"),
            ("p", chance(f.p_value), "", "that as stated it fits as well, pose by pose"),
        ]
    gain = 1.0 - (f.after / f.before) ** 2 if f.before > 0.0 else math.nan
    return [
        ("Without it", *parted(f.before, unit), "held-out error, other findings in"),
        ("With it", *parted(f.after, unit), "held-out error"),
        ("Closes", *percents(gain), "of its square"),
        ("p", chance(f.p_value), "", "of the whole search"),
    ]


def _parameters(parameters: Mapping[str, Estimate]) -> Markup | str:
    rows = []
    for name, e in parameters.items():
        factor, unit = readable(e.unit)
        value, low, high = numeral(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
        _, low95, high95 = numeral(factor * e.value, factor * e.ci95[0], factor * e.ci95[1])
        rows.append([name.replace("_", " "), value, unit, _between(low, high), _between(low95, high95)])
    columns = [
        Column("Parameter"),
        Column("Value", "n"),
        Column("Unit"),
        Column("90 % interval", "n"),
        Column("95 % interval", "n"),
    ]
    return table(columns, rows) if rows else ""


def _between(low: str, high: str) -> str:
    if "–" in (low, high):
        return "–"
    return "a step of a grid" if low == high else f"{low} … {high}"


def _rivals(rivals: tuple[Rival, ...]) -> Markup | str:
    if not rivals:
        return ""
    words = {"rejected": part("toned", "pass", "rejected"), "not excluded": part("strong", "not excluded")}
    order = sorted(rivals, key=lambda r: (r.placebo, r.standing == "rejected", -r.closed))
    rows = [
        [
            ("placebo: " if r.placebo else "") + named(r.effect, r.location),
            r.law,
            percent(r.closed),
            chance(r.p_value),
            words[r.standing],
        ]
        for r in order
    ]
    columns = [
        Column("Rival"),
        Column("Law"),
        Column("Reaches of the gain", "n"),
        Column("p that it does as well", "n"),
        Column("Standing", "html"),
    ]
    return table(columns, rows)


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
