"""Effects, places and numbers of a diagnosis in words of the trade."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from machopt.diagnose.result import Estimate

HALF_MM = 0.5  # below it a length reads better in µm

DEG = 180.0 / math.pi
AXIS_UNITS = {
    "q": ("deg", DEG), "qd": ("deg/s", DEG), "speed": ("deg/s", DEG), "load": ("N", 1.0), "time": ("s", 1.0),
    "temperature": ("°C", 1.0), "x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "tau": ("N·m", 1.0),
}  # fmt: skip
_RANGE = re.compile(r"(-?\d[\d.e+-]*)(?: … (-?\d[\d.e+-]*))?: (.*)")  # "0.7252 … 0.9975: 33 % of the readings", SI


@dataclass(frozen=True)
class Effect:
    """A word of the vocabulary as people say it."""

    name: str  # "hysteresis"; the place follows
    what: str  # one sentence for the reader of a report


EFFECTS = {
    "joint_nonlinear_stiffness": Effect(
        "nonlinear stiffness", "The reducer is softer or stiffer at small torque than near its rated torque."
    ),
    "joint_backlash": Effect(
        "backlash", "The joint is loose by a small angle wherever its total torque, weight included, changes sign."
    ),
    "joint_hysteresis": Effect(
        "hysteresis", "The joint comes back by another path than it went: friction in the drive train holds twist back."
    ),
    "joint_creep": Effect("creep", "The joint goes on yielding for seconds after the load has come to rest."),
    "joint_pose_dependent_stiffness": Effect(
        "angle-dependent stiffness", "One spring constant does not hold over the joint's range."
    ),
    "joint_zero_offset": Effect("zero offset", "The mastering of the joint is off by a constant angle."),
    "transmission_error": Effect(
        "transmission error", "The gear runs ahead and behind periodically, with no load at all."
    ),
    "joint_friction": Effect("friction", "The motor works against friction that the model does not hold."),
    "joint_coupling": Effect("coupling", "What one joint does turns or twists the other one too."),
    "gravity_compensator": Effect(
        "gravity compensator", "The spring or gas cylinder at joint 2 carries a torque that depends on its angle."
    ),
    "link_compliance": Effect("compliance", "The link body bends or twists; the joint beside it does not."),
    "base_compliance": Effect("compliance", "Pedestal, anchors or floor give way under the overturning moment."),
    "tool_compliance": Effect("compliance", "Flange, force sensor, spindle or holder bend behind the tool tip."),
    "payload": Effect("mass or centre of mass", "Mass or centre of mass on the flange are not what the cell says."),
    "geometric_stiffness": Effect(
        "geometric stiffness (K_C)", "The load turns lever arms by its own deflection (Chen and Kao's K_C)."
    ),
    "force_sensor_offset": Effect("zero offset", "The force sensor shows a load where none acts."),
    "force_sensor_gain": Effect("gain", "The force sensor reads a share too much or too little."),
    "force_sensor_frame": Effect("misalignment", "The force sensor's axes are turned against the recorded frame."),
    "displacement_frame": Effect("misalignment", "The measured displacements are turned against the recorded frame."),
    "load_geometry": Effect("load geometry", "The load acted elsewhere, or in another direction, than recorded."),
    "units": Effect("wrong unit", "The column carries another unit than its name says."),
    "time_skew": Effect("time skew", "The channel is early or late against the others."),
    "outliers": Effect("outliers", "Single readings that no physics explains: slips, slipped decimals, lost beams."),
    "thermal_drift": Effect("thermal drift", "The arm or the set-up grows with temperature or time, load or not."),
    "servo_lag": Effect("servo lag", "The arm follows its command late, in proportion to speed."),
    "joint_elasticity": Effect("vibration", "The joint swings on its own spring."),
}  # fmt: skip

VERDICTS = {  # badge, tone of the page
    "consistent": ("CONSISTENT", "good"),
    "explained": ("EXPLAINED", "good"),
    "partly_explained": ("EXPLAINED IN PART", "warn"),
    "unexplained": ("NOT EXPLAINED", "bad"),
}

_SENSORS = {
    "force": "force sensor", "displacement": "tracker", "tau": "torque channel", "qse": "link-side encoder",
    "q": "encoder", "qcmd": "command channel", "position": "tracker", "wrench": "force sensor", "current": "current",
    "qd": "velocity channel", "xyz": "tracker",
}  # fmt: skip


def place(location: str) -> str:
    """A location of the contracts in words: ``joint:4-5`` is "joints 4 and 5"."""
    kind, _, which = location.partition(":")
    if kind == "joint" and "-" in which:
        return "joints " + " and ".join(which.split("-"))
    if kind in ("joint", "link"):
        return f"{kind} {which}"
    if kind == "sensor":
        return _SENSORS.get(which, f"channel {which}")
    if kind == "column":
        return f"column {which}"
    if kind == "rows":
        return _rows(which)
    return {"base": "base", "tool": "tool", "arm": "whole arm", "": "no particular place"}.get(location, location)


def named(effect: str, location: str) -> str:
    """An effect at its place: "hysteresis of joint 3", "compliance of the base"."""
    known = EFFECTS.get(effect)
    name = known.name if known else effect.replace("_", " ")
    kind, _, which = location.partition(":")
    if effect == "gravity_compensator":
        return "gravity compensator of joint 2"
    if effect in ("thermal_drift", "servo_lag", "geometric_stiffness", "load_geometry"):
        return name
    if effect in ("payload",):
        return f"{name} of the tool side"
    if effect in ("units", "outliers"):
        return f"{name} in {place(location)}"
    if kind == "sensor" and known is not None and effect == "time_skew":
        return f"{name} of the {place(location)}"
    article = "the " if kind in ("base", "tool", "sensor", "arm") else ""
    return f"{name} of {article}{place(location)}" if which or location else name


def what(effect: str) -> str:
    """One sentence on what the effect is; empty for a user's own."""
    return EFFECTS[effect].what if effect in EFFECTS else ""


def listed(words: Sequence[str], last: str = "or") -> str:
    """ "a, b or c"."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def alternatives(one_of: Sequence[tuple[str, str]]) -> str:
    """What the set of explanations means, the named one first in it."""
    others = [named(*name) for name in one_of[1:]]
    if not others:
        return "These data single it out: nothing else in the catalogue predicts unseen readings as well."
    return f"These data cannot tell it from {listed(others)}."


def sized(value: float, unit: str) -> str:
    """An error with its unit, three digits, small lengths in µm."""
    if not math.isfinite(value):
        return "–"
    if unit == "mm" and abs(value) < HALF_MM:
        value, unit = 1e3 * value, "µm"
    return f"{digits(value)} {unit}"


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


def axis_note(axis: str, note: str) -> str:
    """A note on a stretch of an axis, its SI numbers in the unit shown; other notes as they are."""
    found = _RANGE.fullmatch(note)
    if found is None:
        return note
    first, last, rest = found.groups()
    factor, unit = axis_unit(axis)
    try:
        ends = [factor * float(v) for v in (first, last) if v is not None]
    except ValueError:
        return note
    texts = [axis_value(axis, v, unit if n == len(ends) - 1 else "") for n, v in enumerate(ends)]
    return f"{' … '.join(texts)}, {rest}"


def readable(unit: str) -> tuple[float, str]:
    """Factor and unit that keep the numbers of a compliance readable."""
    return {
        "rad/(N·m)": (1e6, "µrad/(N·m)"), "m/N": (1e6, "µm/N"), "rad/N": (1e6, "µrad/N"), "m": (1e3, "mm"),
        "rad": (1e3, "mrad"), "1": (1.0, ""),
    }.get(unit, (1.0, unit))  # fmt: skip


def percent(share: float) -> str:
    """A share as whole percent."""
    return f"{100 * share:.0f} %".replace("-", "−") if math.isfinite(share) else "–"


def plural(word: str) -> str:
    """poses, stretches."""
    return f"{word}es" if word.endswith("ch") else f"{word}s"


def chance(p: float) -> str:
    """A p value for reading."""
    if not math.isfinite(p):
        return "–"
    return "< 0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def _rows(which: str) -> str:
    numbers = [n for n in which.split(",") if n]
    if not numbers:
        return "rows"
    if len(numbers) > 6:
        return f"{len(numbers)} rows ({', '.join(numbers[:4])} …)"
    return f"row {numbers[0]}" if len(numbers) == 1 else f"rows {listed(numbers, 'and')}"
