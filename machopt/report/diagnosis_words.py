"""Effects, places and numbers of a diagnosis in words of the trade."""

from __future__ import annotations

import math
from collections.abc import Sequence

from machopt.diagnose.nouns.result import Diagnosis, Estimate, Share
from machopt.diagnose.verdict.words import closes, record_only
from machopt.effects.words import listed, named

HALF_MM = 0.5  # below it a length reads better in µm

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


def standing(d: Diagnosis) -> tuple[str, str]:
    """Badge and tone of the page."""
    badge, tone = VERDICTS[d.verdict]
    if d.verdict == "partly_explained" and record_only(d) and not closes(d):
        return "RECORD PUT RIGHT, MISMATCH NOT EXPLAINED", "bad"
    if tone == "good" and any(f.record for f in d.findings):
        return f"{badge}: CHECK THE RECORD", "warn"
    return badge, tone


def of_machine(d: Diagnosis) -> bool:
    """Whether something was found beside faults of the record, so that there is an after to be drawn."""
    return any(not f.record for f in d.findings)


def refitted(d: Diagnosis) -> str:
    """What the errors before are errors of."""
    return "record put right, model refitted" if record_only(d) else "model as it was, refitted"


def alternatives(one_of: Sequence[tuple[str, str]]) -> str:
    """What the set of explanations means, the named one first in it."""
    others = [named(*name) for name in one_of[1:]]
    if not others:
        return "These data single it out: nothing else in the catalogue predicts unseen readings as well."
    return f"These data cannot tell it from {listed(others)}."


def sized(value: float, unit: str) -> str:
    """An error with its unit, three digits, small lengths in µm."""
    number, unit = parted(value, unit)
    return f"{number} {unit}".rstrip()


def parted(value: float, unit: str) -> tuple[str, str]:
    """The number and the unit of :func:`sized`."""
    if not math.isfinite(value):
        return "–", ""
    if unit == "mm" and abs(value) < HALF_MM:
        value, unit = 1e3 * value, "µm"
    return digits(value), unit


def digits(value: float, count: int = 3) -> str:
    """A number with so many significant digits: 0.0612, 61.2, 1 410, 1.41e6."""
    if not math.isfinite(value):
        return "∞" if value > 0 else "−∞" if value < 0 else "–"
    if value == round(value) and abs(value) < 1e5:
        return f"{value:.0f}".replace("-", "−")
    size = math.floor(math.log10(abs(value)))
    if size >= 5 or size < -4:
        return f"{value:.{count - 1}e}".replace("e+0", "e").replace("e-0", "e−").replace("e+", "e").replace("-", "−")
    return f"{round(value, count - 1 - size):.{max(count - 1 - size, 0)}f}".replace("-", "−")


def numeral(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Value and interval with the decimals that the interval deserves: one or two digits of its half width."""
    half = 0.5 * (high - low)
    tiny = 0.0 < abs(value) < 1e-4 or 0.0 < half < 1e-6
    if not (math.isfinite(half) and half > 0.0 and math.isfinite(value)) or abs(value) >= 1e5 or tiny:
        return digits(value), digits(low), digits(high)
    lead = math.floor(math.log10(half))
    decimals = max((0 if half >= 3 * 10**lead else 1) - lead, 0)  # 0.080 → 0.08, 0.12 stays
    first, second, third = (f"{v:.{decimals}f}".replace("-", "−") for v in (value, low, high))
    return first, second, third


def measured(e: Estimate) -> str:
    """ "0.90 arcmin (0.81 … 0.99)"; the interval is the 90 % one."""
    factor, unit = readable(e.unit)
    value, low, high = numeral(factor * e.value, factor * e.ci90[0], factor * e.ci90[1])
    out = f"{value} {unit}".strip()
    return f"{out} ({low} … {high})" if math.isfinite(sum(e.ci90)) and e.ci90[0] < e.ci90[1] else out


def axis_words(axis: str) -> str:
    """An axis of the data: ``q3`` is "angle of joint 3"."""
    stem, number = axis.rstrip("0123456789"), axis[len(axis.rstrip("0123456789")) :]
    joint = {"q": "angle", "qd": "velocity", "speed": "speed", "tau": "torque"}.get(stem.strip())
    if joint and number:
        return f"{joint} of joint {number}"
    if axis in ("x", "y", "z"):
        return f"{axis} of the tip"
    return {"load": "force", "branch": "loading and unloading"}.get(axis, axis.replace("_", " "))


def axis_unit(axis: str) -> tuple[float, str]:
    """Factor from SI and unit of an axis of the data."""
    unit, factor = AXIS_UNITS.get(axis.rstrip("0123456789").strip(), ("", 1.0))
    return factor, unit


def axis_value(axis: str, value: float, unit: str) -> str:
    """A value on an axis of the data, already in its unit."""
    if axis == "branch":
        return {1.0: "loading", -1.0: "unloading", 0.0: "not stated"}.get(value, f"{value:g}")
    return f"{digits(value)} {unit}".strip().replace("-", "−")


def share_note(s: Share) -> str:
    """What a share of the mismatch shows: a stretch of an axis in the unit shown, other notes as they are."""
    if s.stretch is None:
        return s.note
    factor, unit = axis_unit(s.axis)
    ends = [factor * v for v in dict.fromkeys((s.stretch.low, s.stretch.high))]
    texts = [axis_value(s.axis, v, unit if n == len(ends) - 1 else "") for n, v in enumerate(ends)]
    return f"{' … '.join(texts)}, {100 * s.stretch.readings:.0f} % of the readings"


def readable(unit: str) -> tuple[float, str]:
    """Factor and unit that keep the numbers of a compliance readable."""
    return {
        "rad/(N·m)": (1e6, "µrad/(N·m)"),
        "m/N": (1e6, "µm/N"),
        "rad/N": (1e6, "µrad/N"),
        "m": (1e3, "mm"),
        "rad": (1e3, "mrad"),
        "1": (1.0, ""),
    }.get(unit, (1.0, unit))


def percent(share: float) -> str:
    """A share as whole percent."""
    return " ".join(percents(share)).rstrip()


def percents(share: float) -> tuple[str, str]:
    """The number and the sign of :func:`percent`."""
    return (f"{100 * share:.0f}".replace("-", "−"), "%") if math.isfinite(share) else ("–", "")


def plural(word: str) -> str:
    """poses, stretches."""
    return f"{word}es" if word.endswith("ch") else f"{word}s"


def chance(p: float) -> str:
    """A p value for reading."""
    if not math.isfinite(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"
