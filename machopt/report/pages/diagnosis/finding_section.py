"""Section of one finding on the diagnosis page: effect, law, size, chart, alternatives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from machopt.data_types.kinematic_corrections import KinematicCorrection
from machopt.effects.effect_wording import format_effect_at_place, format_effect_sentence
from machopt.measurement.diagnosis.data_types.diagnosis_problem import Correction, RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding, RivalExplanation
from machopt.report.pages.report_tables import TableColumn, build_table
from machopt.report.template_rendering import render_macro, render_part
from machopt.report.wording.diagnosis_terms import (
    choose_compliance_unit,
    describe_alternatives,
    format_error_parts,
    format_estimate,
    format_interval_parts,
    format_p_value,
    format_percent,
    format_percent_parts,
)

if TYPE_CHECKING:
    from markupsafe import Markup


def format_finding_heading(f: Finding) -> str:
    """Return the heading: "Hysteresis of joint 3: 0.90 arcmin (0.81 … 0.99), on load reversal".

    Args:
        f: The finding.
    """
    words = format_effect_at_place(f.effect, f.location)
    size = next(iter(f.parameters.values()), None)
    out = words[:1].upper() + words[1:]
    if size is not None:
        out += f": {format_estimate(size)}"
    return out + (f", {f.note}" if f.note else "")


def build_finding_html(n: int, f: Finding, unit: str, charts: set[str]) -> Markup:
    """Return the section of one finding.

    Args:
        n: Number of the finding.
        f: The finding.
        unit: Unit of the errors.
        charts: Ids of the charts that the page has.
    """
    own = (f.effect, f.location)
    one_of = (own, *(name for name in f.one_of if name != own))
    placebos = [r for r in f.rivals if r.placebo]
    return render_macro(
        "diagnosis.html",
        "finding",
        number=n,
        heading=format_finding_heading(f),
        sentence=format_effect_sentence(f.effect),
        several=len(f.one_of) > 1,
        alternatives=describe_alternatives(one_of),
        cards=render_part("boxes", _list_key_figures(f, unit), True),
        law=f.law,
        equation=f.equation,
        parameters=_build_parameters(f.parameters),
        drawn=f"d-law{n}" in charts,
        placebos=len(placebos),
        lost=sum(r.standing == "rejected" for r in placebos),
        rivals=_build_rivals(f.rivals),
        goes_into=describe_correction_target(f.correction),
    )


def describe_correction_target(correction: Correction | None) -> str:
    """Return the file that a correction is written to.

    Args:
        correction: The correction; None where there is none.
    """
    if correction is None:
        return "No correction is written for it: the planner's model has no such law."
    values = ", ".join(f"{k} {_format_value(v)}" for k, v in correction.parameters.items() if k != "message")
    if isinstance(correction, RecordCorrection):  # no file has a key of that name: the finding's title says what it is
        return f"Stays in the diagnosis, the robot's model is not touched by it{f': {values}' if values else ''}."
    which = f"{correction.effect} {correction.location}{f' ({values})' if values else ''}"
    if isinstance(correction, KinematicCorrection):
        return f"Goes into kinematics.yaml and is compensated in the exported joints: {which}."
    return f"Goes into stiffness.yaml as a term, which optimize takes: {which}."


def _list_key_figures(f: Finding, unit: str) -> list[tuple[str, str, str, str]]:
    """Name, number, unit and what it is."""
    if f.record:
        return [
            ("As stated", *format_error_parts(f.before, unit), "what a fit to the record leaves"),
            (
                "Corrected",
                *format_error_parts(f.after, unit),
                "what the same fit leaves, with all corrections of the record",
            ),
            ("p", format_p_value(f.p_value), "", "that as stated it fits as well, pose by pose"),
        ]
    gain = 1.0 - (f.after / f.before) ** 2 if f.before > 0.0 else math.nan
    return [
        ("Without it", *format_error_parts(f.before, unit), "held-out error, other findings in"),
        ("With it", *format_error_parts(f.after, unit), "held-out error"),
        ("Closes", *format_percent_parts(gain), "of its square"),
        ("p", format_p_value(f.p_value), "", "of the whole search"),
    ]


def _build_parameters(parameters: Mapping[str, EstimatedValue]) -> Markup | str:
    rows = []
    for name, e in parameters.items():
        factor, unit = choose_compliance_unit(e.unit)
        value, low, high = format_interval_parts(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
        _, low95, high95 = format_interval_parts(factor * e.value, factor * e.ci95[0], factor * e.ci95[1])
        rows.append([name.replace("_", " "), value, unit, _format_interval(low, high), _format_interval(low95, high95)])
    columns = [
        TableColumn("Parameter"),
        TableColumn("Value", "n"),
        TableColumn("Unit"),
        TableColumn("90 % interval", "n"),
        TableColumn("95 % interval", "n"),
    ]
    return build_table(columns, rows) if rows else ""


def _format_interval(low: str, high: str) -> str:
    if "–" in (low, high):
        return "–"
    return "a step of a grid" if low == high else f"{low} … {high}"


def _build_rivals(rivals: tuple[RivalExplanation, ...]) -> Markup | str:
    if not rivals:
        return ""
    words = {
        "rejected": render_part("toned", "pass", "rejected"),
        "not excluded": render_part("strong", "not excluded"),
    }
    order = sorted(rivals, key=lambda r: (r.placebo, r.standing == "rejected", -r.closed))
    rows = [
        [
            ("placebo: " if r.placebo else "") + format_effect_at_place(r.effect, r.location),
            r.law,
            format_percent(r.closed),
            format_p_value(r.p_value),
            words[r.standing],
        ]
        for r in order
    ]
    columns = [
        TableColumn("Rival"),
        TableColumn("Law"),
        TableColumn("Reaches of the gain", "n"),
        TableColumn("p that it does as well", "n"),
        TableColumn("Standing", "html"),
    ]
    return build_table(columns, rows)


def _format_value(v: Any) -> str:
    if isinstance(v, bool | str):
        return str(v)
    if isinstance(v, int | float):
        return f"{v:.4g}".replace("-", "−")
    if hasattr(v, "tolist"):
        v = v.tolist()
    if isinstance(v, list | tuple):
        return f"[{', '.join(_format_value(x) for x in v[:6])}{', …' if len(v) > 6 else ''}]"
    return str(v)
