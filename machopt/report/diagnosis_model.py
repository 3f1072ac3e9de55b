"""The base model of a diagnosis as tables: each coefficient with what was found, and as it came out alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.diagnose.nouns.result import Coefficient, Diagnosis
from machopt.domain.location import located
from machopt.effects.words import place
from machopt.report.diagnosis_words import digits
from machopt.report.display import fixed
from machopt.report.shell import section
from machopt.report.tables import Column, folded, table

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

ARCMIN = math.pi / 180 / 60
Z90 = 1.645
COMPLIANCE = ("rad/(N·m)", "rad/Nm", "rad/(Nm)", "rad/N·m")
SHOWN = {
    "m": ("mm", 1e3),
    "rad": ("mrad", 1e3),
    "s": ("ms", 1e3),
    "1": ("", 1.0),
    "m/K": ("µm/K", 1e6),
    "rad/K": ("µrad/K", 1e6),
}
OPEN = 12  # coefficients and rows: more are folded


def model_html(d: Diagnosis) -> Body:
    joints = [c for c in d.coefficients if c.unknown.unit in COMPLIANCE]
    others = [c for c in d.coefficients if c.unknown.unit not in COMPLIANCE]
    body: Body = ""
    if joints:
        columns = [
            Column("Joint"),
            Column("k (N·m/rad)", "n"),
            Column("N·m/arcmin", "n"),
            Column("90 % interval (N·m/rad)", "n"),
            Column("Before (N·m/rad)", "n"),
            Column("Change", "n"),
        ]
        body += table(columns, [_stiffness_row(c) for c in joints])
    if others:
        columns = [
            Column("Coefficient"),
            Column("Value", "n"),
            Column("± 90 %", "n"),
            Column("Before", "n"),
            Column("Unit"),
        ]
        rows = [_plain_row(c) for c in others]
        body += folded("Other coefficients", len(rows), table(columns, rows), opened=len(rows) <= OPEN)
    lead = (
        "The base model with everything that was found in it, and as it came out alone. A base coefficient that "
        "changes much had taken up a share of what was missing."
    )
    return section("model", "The base model, before and after", lead, body)


def _stiffness_row(c: Coefficient) -> list[str]:
    k, before = _inverse(c.value), _inverse(c.before)
    low, high = _inverse(c.value + Z90 * c.sigma), _inverse(c.value - Z90 * c.sigma)
    change = 100 * (k / before - 1.0) if math.isfinite(k) and math.isfinite(before) else math.nan
    return [
        _joint(c),
        digits(k),
        digits(k * ARCMIN),
        f"{digits(low)} … {digits(high)}" if math.isfinite(c.sigma) else "–",
        digits(before),
        f"{fixed(change, 1, signed=True)} %" if math.isfinite(change) else "–",
    ]


def _joint(c: Coefficient) -> str:
    where = c.unknown.location
    return (place(where) if located(where).of_joints else c.unknown.name).replace(" ", "\u00a0", 1)


def _inverse(compliance: float) -> float:
    return math.nan if math.isnan(compliance) else 1.0 / compliance if compliance > 0.0 else math.inf


def _plain_row(c: Coefficient) -> list[str]:
    unit, factor = SHOWN.get(c.unknown.unit, (c.unknown.unit, 1.0))
    half = Z90 * c.sigma * factor
    return [c.unknown.name, digits(c.value * factor), digits(half, 2), digits(c.before * factor), unit]
