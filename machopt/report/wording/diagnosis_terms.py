"""Names of effects and places, and formats of numbers, on the diagnosis page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.effects.effect_wording import format_effect_at_place, join_with_commas
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, MismatchShare
from machopt.measurement.diagnosis.verdict.verdict_text import has_record_findings_only

SMALL_LENGTH_MM = 0.5  # below it a length reads better in µm

DEG = 180.0 / math.pi
AXIS_UNITS = {
    "q": ("deg", DEG),
    "qd": ("deg/s", DEG),
    "speed": ("deg/s", DEG),
    "load": ("N", 1.0),
    "time": ("s", 1.0),
    "temperature": ("°C", 1.0),
    "x": ("mm", 1e3),
    "y": ("mm", 1e3),
    "z": ("mm", 1e3),
    "tau": ("N·m", 1.0),
}

VERDICTS = {  # badge, tone of the page
    "consistent": ("CONSISTENT", "good"),
    "explained": ("EXPLAINED", "good"),
    "partly_explained": ("EXPLAINED IN PART", "warn"),
    "unexplained": ("NOT EXPLAINED", "bad"),
    "insufficient": ("NOT ENOUGH DATA", "warn"),
}


def describe_verdict(d: DiagnosisResult) -> tuple[str, str]:
    """Return badge and CSS tone of the page.

    Args:
        d: The diagnosis.
    """
    badge, tone = VERDICTS[d.verdict]
    if tone == "good" and any(f.record for f in d.findings):
        return f"{badge}: CHECK THE RECORD", "warn"
    return badge, tone


def has_machine_finding(d: DiagnosisResult) -> bool:
    """Return whether an effect of the machine was found, so that there is a result after correction.

    Args:
        d: The diagnosis.
    """
    return any(not f.record for f in d.findings)


def describe_error_before(d: DiagnosisResult) -> str:
    """Return what the errors before are errors of.

    Args:
        d: The diagnosis.
    """
    return "record corrected, model refitted" if has_record_findings_only(d) else "model as it was, refitted"


def describe_alternatives(one_of: Sequence[tuple[str, str]]) -> str:
    """Return what the set of possible explanations means.

    Args:
        one_of: (effect, place) of each explanation, the reported one first.
    """
    others = [format_effect_at_place(*name) for name in one_of[1:]]
    if not others:
        return "These data single it out: nothing else in the catalogue predicts unseen readings as well."
    return f"These data cannot tell it from {join_with_commas(others)}."


def format_error(value: float, unit: str) -> str:
    """Return an error with its unit, three digits, small lengths in µm.

    Args:
        value: The error, in ``unit``.
        unit: Unit of the value.
    """
    number, unit = format_error_parts(value, unit)
    return f"{number} {unit}".rstrip()


def format_error_parts(value: float, unit: str) -> tuple[str, str]:
    """Return the number and the unit of :func:`format_error`.

    Args:
        value: The error, in ``unit``.
        unit: Unit of the value.
    """
    if not math.isfinite(value):
        return "–", ""
    if unit == "mm" and abs(value) < SMALL_LENGTH_MM:
        value, unit = 1e3 * value, "µm"
    return format_significant(value), unit


def format_significant(value: float, count: int = 3) -> str:
    """Return a number with so many significant digits: 0.0612, 61.2, 1 410, 1.41e6.

    Args:
        value: The value.
        count: Significant digits.
    """
    if not math.isfinite(value):
        return "∞" if value > 0 else "−∞" if value < 0 else "–"
    if value == round(value) and abs(value) < 1e5:
        return f"{value:.0f}".replace("-", "−")
    size = math.floor(math.log10(abs(value)))
    if size >= 5 or size < -4:
        return f"{value:.{count - 1}e}".replace("e+0", "e").replace("e-0", "e−").replace("e+", "e").replace("-", "−")
    return f"{round(value, count - 1 - size):.{max(count - 1 - size, 0)}f}".replace("-", "−")


def format_interval_parts(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return value and interval ends with one or two digits of the half width.

    Args:
        value: The value.
        low: The lower end.
        high: The upper end.
    """
    half = 0.5 * (high - low)
    tiny = 0.0 < abs(value) < 1e-4 or 0.0 < half < 1e-6
    if not (math.isfinite(half) and half > 0.0 and math.isfinite(value)) or abs(value) >= 1e5 or tiny:
        return format_significant(value), format_significant(low), format_significant(high)
    lead = math.floor(math.log10(half))
    decimals = max((0 if half >= 3 * 10**lead else 1) - lead, 0)  # 0.080 → 0.08, 0.12 stays
    first, second, third = (f"{v:.{decimals}f}".replace("-", "−") for v in (value, low, high))
    return first, second, third


def format_estimate(e: EstimatedValue) -> str:
    """Return an estimate as "0.90 arcmin (0.81 … 0.99)"; the interval is the 90 % one.

    Args:
        e: The estimate.
    """
    factor, unit = choose_compliance_unit(e.unit)
    value, low, high = format_interval_parts(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
    out = f"{value} {unit}".strip()
    return f"{out} ({low} … {high})" if math.isfinite(sum(e.ci90)) and e.ci90[0] < e.ci90[1] else out


def describe_axis(axis: str) -> str:
    """Return the name of an axis of the data: ``q3`` is "angle of joint 3".

    Args:
        axis: Name of the axis, such as ``q3``.
    """
    stem, number = axis.rstrip("0123456789"), axis[len(axis.rstrip("0123456789")) :]
    joint = {"q": "angle", "qd": "velocity", "speed": "speed", "tau": "torque"}.get(stem.strip())
    if joint and number:
        return f"{joint} of joint {number}"
    if axis in ("x", "y", "z"):
        return f"{axis} of the tip"
    return {"load": "force", "branch": "loading and unloading"}.get(axis, axis.replace("_", " "))


def get_axis_unit(axis: str) -> tuple[float, str]:
    """Return the factor from SI and the unit of an axis of the data.

    Args:
        axis: Name of the axis, such as ``q3``.
    """
    unit, factor = AXIS_UNITS.get(axis.rstrip("0123456789").strip(), ("", 1.0))
    return factor, unit


def format_axis_value(axis: str, value: float, unit: str) -> str:
    """Return a value on an axis of the data.

    Args:
        axis: Name of the axis, such as ``q3``.
        value: Value in ``unit``.
        unit: Unit of the value.
    """
    if axis == "branch":
        return {1.0: "loading", -1.0: "unloading", 0.0: "not stated"}.get(value, f"{value:g}")
    return f"{format_significant(value)} {unit}".strip().replace("-", "−")


def describe_share(s: MismatchShare) -> str:
    """Return the note of a share: a range of an axis in displayed units, other notes unchanged.

    Args:
        s: Share of the model error.
    """
    if s.stretch is None:
        return s.note
    factor, unit = get_axis_unit(s.axis)
    ends = [factor * v for v in dict.fromkeys((s.stretch.low, s.stretch.high))]
    texts = [format_axis_value(s.axis, v, unit if n == len(ends) - 1 else "") for n, v in enumerate(ends)]
    return f"{' … '.join(texts)}, {100 * s.stretch.readings:.0f} % of the readings"


def choose_compliance_unit(unit: str) -> tuple[float, str]:
    """Return factor and unit that make a compliance readable.

    Args:
        unit: SI unit of the compliance.
    """
    return {
        "rad/(N·m)": (1e6, "µrad/(N·m)"),
        "m/N": (1e6, "µm/N"),
        "rad/N": (1e6, "µrad/N"),
        "m": (1e3, "mm"),
        "rad": (1e3, "mrad"),
        "1": (1.0, ""),
    }.get(unit, (1.0, unit))


def format_percent(share: float) -> str:
    """Return a share as whole percent.

    Args:
        share: The share, 1 is 100 %.
    """
    return " ".join(format_percent_parts(share)).rstrip()


def format_percent_parts(share: float) -> tuple[str, str]:
    """Return the number and the sign of :func:`format_percent`.

    Args:
        share: The share, 1 is 100 %.
    """
    return (f"{100 * share:.0f}".replace("-", "−"), "%") if math.isfinite(share) else ("–", "")


def format_plural(word: str) -> str:
    """Return the plural of a word: poses, stretches.

    Args:
        word: The singular.
    """
    return f"{word}es" if word.endswith("ch") else f"{word}s"


def format_p_value(p: float) -> str:
    """Return a p value for reading.

    Args:
        p: The p value.
    """
    if not math.isfinite(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"
