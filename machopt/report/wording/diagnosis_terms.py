"""Effects, places and numbers of a diagnosis in words of the trade."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.effects.effect_wording import format_effect_at_place, join_with_commas
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EstimatedValue, MismatchShare
from machopt.measurement.diagnosis.verdict.verdict_text import has_record_findings_only, is_mismatch_closed

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
    """Badge and tone of the page."""
    badge, tone = VERDICTS[d.verdict]
    if d.verdict == "partly_explained" and has_record_findings_only(d) and not is_mismatch_closed(d):
        return "RECORD PUT RIGHT, MISMATCH NOT EXPLAINED", "bad"
    if tone == "good" and any(f.record for f in d.findings):
        return f"{badge}: CHECK THE RECORD", "warn"
    return badge, tone


def has_machine_finding(d: DiagnosisResult) -> bool:
    """Whether something was found beside faults of the record, so that there is an after to be drawn."""
    return any(not f.record for f in d.findings)


def describe_error_before(d: DiagnosisResult) -> str:
    """What the errors before are errors of."""
    return "record put right, model refitted" if has_record_findings_only(d) else "model as it was, refitted"


def describe_alternatives(one_of: Sequence[tuple[str, str]]) -> str:
    """What the set of explanations means, the named one first in it."""
    others = [format_effect_at_place(*name) for name in one_of[1:]]
    if not others:
        return "These data single it out: nothing else in the catalogue predicts unseen readings as well."
    return f"These data cannot tell it from {join_with_commas(others)}."


def format_error(value: float, unit: str) -> str:
    """An error with its unit, three digits, small lengths in µm."""
    number, unit = format_error_parts(value, unit)
    return f"{number} {unit}".rstrip()


def format_error_parts(value: float, unit: str) -> tuple[str, str]:
    """The number and the unit of :func:`format_error`."""
    if not math.isfinite(value):
        return "–", ""
    if unit == "mm" and abs(value) < SMALL_LENGTH_MM:
        value, unit = 1e3 * value, "µm"
    return format_significant(value), unit


def format_significant(value: float, count: int = 3) -> str:
    """A number with so many significant digits: 0.0612, 61.2, 1 410, 1.41e6."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "−∞" if value < 0 else "–"
    if value == round(value) and abs(value) < 1e5:
        return f"{value:.0f}".replace("-", "−")
    size = math.floor(math.log10(abs(value)))
    if size >= 5 or size < -4:
        return f"{value:.{count - 1}e}".replace("e+0", "e").replace("e-0", "e−").replace("e+", "e").replace("-", "−")
    return f"{round(value, count - 1 - size):.{max(count - 1 - size, 0)}f}".replace("-", "−")


def format_interval_parts(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Value and interval with the decimals that the interval deserves: one or two digits of its half width."""
    half = 0.5 * (high - low)
    tiny = 0.0 < abs(value) < 1e-4 or 0.0 < half < 1e-6
    if not (math.isfinite(half) and half > 0.0 and math.isfinite(value)) or abs(value) >= 1e5 or tiny:
        return format_significant(value), format_significant(low), format_significant(high)
    lead = math.floor(math.log10(half))
    decimals = max((0 if half >= 3 * 10**lead else 1) - lead, 0)  # 0.080 → 0.08, 0.12 stays
    first, second, third = (f"{v:.{decimals}f}".replace("-", "−") for v in (value, low, high))
    return first, second, third


def format_estimate(e: EstimatedValue) -> str:
    """ "0.90 arcmin (0.81 … 0.99)"; the interval is the 90 % one."""
    factor, unit = choose_compliance_unit(e.unit)
    value, low, high = format_interval_parts(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
    out = f"{value} {unit}".strip()
    return f"{out} ({low} … {high})" if math.isfinite(sum(e.ci90)) and e.ci90[0] < e.ci90[1] else out


def describe_axis(axis: str) -> str:
    """An axis of the data: ``q3`` is "angle of joint 3"."""
    stem, number = axis.rstrip("0123456789"), axis[len(axis.rstrip("0123456789")) :]
    joint = {"q": "angle", "qd": "velocity", "speed": "speed", "tau": "torque"}.get(stem.strip())
    if joint and number:
        return f"{joint} of joint {number}"
    if axis in ("x", "y", "z"):
        return f"{axis} of the tip"
    return {"load": "force", "branch": "loading and unloading"}.get(axis, axis.replace("_", " "))


def get_axis_unit(axis: str) -> tuple[float, str]:
    """Factor from SI and unit of an axis of the data."""
    unit, factor = AXIS_UNITS.get(axis.rstrip("0123456789").strip(), ("", 1.0))
    return factor, unit


def format_axis_value(axis: str, value: float, unit: str) -> str:
    """A value on an axis of the data, already in its unit."""
    if axis == "branch":
        return {1.0: "loading", -1.0: "unloading", 0.0: "not stated"}.get(value, f"{value:g}")
    return f"{format_significant(value)} {unit}".strip().replace("-", "−")


def describe_share(s: MismatchShare) -> str:
    """What a share of the mismatch shows: a stretch of an axis in the unit shown, other notes as they are."""
    if s.stretch is None:
        return s.note
    factor, unit = get_axis_unit(s.axis)
    ends = [factor * v for v in dict.fromkeys((s.stretch.low, s.stretch.high))]
    texts = [format_axis_value(s.axis, v, unit if n == len(ends) - 1 else "") for n, v in enumerate(ends)]
    return f"{' … '.join(texts)}, {100 * s.stretch.readings:.0f} % of the readings"


def choose_compliance_unit(unit: str) -> tuple[float, str]:
    """Factor and unit that keep the numbers of a compliance readable."""
    return {
        "rad/(N·m)": (1e6, "µrad/(N·m)"),
        "m/N": (1e6, "µm/N"),
        "rad/N": (1e6, "µrad/N"),
        "m": (1e3, "mm"),
        "rad": (1e3, "mrad"),
        "1": (1.0, ""),
    }.get(unit, (1.0, unit))


def format_percent(share: float) -> str:
    """A share as whole percent."""
    return " ".join(format_percent_parts(share)).rstrip()


def format_percent_parts(share: float) -> tuple[str, str]:
    """The number and the sign of :func:`format_percent`."""
    return (f"{100 * share:.0f}".replace("-", "−"), "%") if math.isfinite(share) else ("–", "")


def format_plural(word: str) -> str:
    """poses, stretches."""
    return f"{word}es" if word.endswith("ch") else f"{word}s"


def format_p_value(p: float) -> str:
    """A p value for reading."""
    if not math.isfinite(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"
