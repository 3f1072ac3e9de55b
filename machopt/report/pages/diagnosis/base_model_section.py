"""Section of the diagnosis page with the base model: each coefficient in the final model and alone."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from machopt.data_types.effect_locations import parse_location
from machopt.effects.effect_wording import format_place
from machopt.measurement.diagnosis.data_types.diagnosis_result import BaseCoefficient, DiagnosisResult
from machopt.report.page_shell import build_section
from machopt.report.page_types.display_units import format_fixed
from machopt.report.pages.report_tables import TableColumn, build_folded_block, build_table
from machopt.report.wording.diagnosis_terms import format_significant

if TYPE_CHECKING:
    from markupsafe import Markup

    Body = Markup | str

ARCMIN = math.pi / 180 / 60
Z_90_PERCENT = 1.645
COMPLIANCE_UNITS = ("rad/(N·m)", "rad/Nm", "rad/(Nm)", "rad/N·m")
DISPLAY_UNITS = {
    "m": ("mm", 1e3),
    "rad": ("mrad", 1e3),
    "s": ("ms", 1e3),
    "1": ("", 1.0),
    "m/K": ("µm/K", 1e6),
    "rad/K": ("µrad/K", 1e6),
}
MAX_OPEN_ROWS = 12  # coefficients and rows: more are folded


def build_model_html(d: DiagnosisResult) -> Body:
    """Return the section as markup.

    Args:
        d: The diagnosis.
    """
    joints = [c for c in d.coefficients if c.unknown.unit in COMPLIANCE_UNITS]
    others = [c for c in d.coefficients if c.unknown.unit not in COMPLIANCE_UNITS]
    body: Body = ""
    if joints:
        columns = [
            TableColumn("Joint"),
            TableColumn("k (N·m/rad)", "n"),
            TableColumn("N·m/arcmin", "n"),
            TableColumn("90 % interval (N·m/rad)", "n"),
            TableColumn("Before (N·m/rad)", "n"),
            TableColumn("Change", "n"),
        ]
        body += build_table(columns, [_build_stiffness_row(c) for c in joints])
    if others:
        columns = [
            TableColumn("Coefficient"),
            TableColumn("Value", "n"),
            TableColumn("± 90 %", "n"),
            TableColumn("Before", "n"),
            TableColumn("Unit"),
        ]
        rows = [_build_plain_row(c) for c in others]
        body += build_folded_block(
            "Other coefficients", len(rows), build_table(columns, rows), opened=len(rows) <= MAX_OPEN_ROWS
        )
    lead = (
        "The base model with everything that was found in it, and as it came out alone. A base coefficient that "
        "changes much had taken up a share of what was missing."
    )
    return build_section("model", "The base model, before and after", lead, body)


def _build_stiffness_row(c: BaseCoefficient) -> list[str]:
    k, before = _invert_compliance(c.value), _invert_compliance(c.before)
    low, high = (
        _invert_compliance(c.value + Z_90_PERCENT * c.sigma),
        _invert_compliance(c.value - Z_90_PERCENT * c.sigma),
    )
    change = 100 * (k / before - 1.0) if math.isfinite(k) and math.isfinite(before) else math.nan
    return [
        _format_joint(c),
        format_significant(k),
        format_significant(k * ARCMIN),
        f"{format_significant(low)} … {format_significant(high)}" if math.isfinite(c.sigma) else "–",
        format_significant(before),
        f"{format_fixed(change, 1, signed=True)} %" if math.isfinite(change) else "–",
    ]


def _format_joint(c: BaseCoefficient) -> str:
    where = c.unknown.location
    return (format_place(where) if parse_location(where).is_joint_location else c.unknown.name).replace(
        " ", "\u00a0", 1
    )


def _invert_compliance(compliance: float) -> float:
    return math.nan if math.isnan(compliance) else 1.0 / compliance if compliance > 0.0 else math.inf


def _build_plain_row(c: BaseCoefficient) -> list[str]:
    unit, factor = DISPLAY_UNITS.get(c.unknown.unit, (c.unknown.unit, 1.0))
    half = Z_90_PERCENT * c.sigma * factor
    return [
        c.unknown.name,
        format_significant(c.value * factor),
        format_significant(half, 2),
        format_significant(c.before * factor),
        unit,
    ]
