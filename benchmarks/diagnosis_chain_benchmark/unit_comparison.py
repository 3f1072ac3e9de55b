"""Compares numbers that carry a unit: a true size with a detection limit, a true parameter with an interval."""

from __future__ import annotations

import math

# unit: factor to SI, dimension
UNITS: dict[str, tuple[float, str]] = {
    "rad": (1.0, "angle"),
    "mrad": (1e-3, "angle"),
    "µrad": (1e-6, "angle"),
    "urad": (1e-6, "angle"),
    "deg": (math.pi / 180, "angle"),
    "°": (math.pi / 180, "angle"),
    "arcmin": (math.pi / 10800, "angle"),
    "arcsec": (math.pi / 648000, "angle"),
    "m": (1.0, "length"),
    "mm": (1e-3, "length"),
    "µm": (1e-6, "length"),
    "um": (1e-6, "length"),
    "N": (1.0, "force"),
    "kN": (1e3, "force"),
    "N·m": (1.0, "moment"),
    "Nm": (1.0, "moment"),
    "kg": (1.0, "mass"),
    "kg·m": (1.0, "mass moment"),
    "s": (1.0, "time"),
    "ms": (1e-3, "time"),
    "K": (1.0, "kelvin"),
    "%": (1e-2, "share"),
    "1": (1.0, "share"),
    "": (1.0, "share"),
    "-": (1.0, "share"),
    "rad/rad": (1.0, "share"),
    "rad/(N·m)": (1.0, "compliance"),
    "mrad/(kN·m)": (1e-6, "compliance"),
    "µrad/(N·m)": (1e-6, "compliance"),
    "rad/Nm": (1.0, "compliance"),
    "µrad/Nm": (1e-6, "compliance"),
    "N·m/rad": (1.0, "1/compliance"),
    "Nm/rad": (1.0, "1/compliance"),
    "MN·m/rad": (1e6, "1/compliance"),
    "N·m/arcmin": (10800 / math.pi, "1/compliance"),
    "m/N": (1.0, "softness"),
    "µm/N": (1e-6, "softness"),
    "mm/N": (1e-3, "softness"),
    "mm/kN": (1e-6, "softness"),
    "N/m": (1.0, "1/softness"),
    "N/mm": (1e3, "1/softness"),
    "N/µm": (1e6, "1/softness"),
    "N·m²": (1.0, "1/bending"),
    "1/(N·m²)": (1.0, "bending"),
    "1/rev": (1.0, "order"),
}
# what a diagnosis may call a parameter of the truth
ALIASES = {
    "width": ("width", "gap", "lost_motion", "backlash", "loop", "clearance"),
    "offset": ("offset", "delta", "zero", "bias"),
    "mass": ("mass", "delta_mass", "payload"),
    "delay": ("delay", "lag", "time_constant", "dead_time"),
    "late": ("late", "skew", "delay", "shift"),
    "amplitude": ("amplitude",),
    "angle": ("angle", "rotation", "tilt"),
    "gain": ("gain", "scale"),
    "compliance": ("compliance", "coupling"),
    "ratio": ("ratio", "kappa", "coupling"),
    "EI": ("EI", "1/EI"),
    "tilt_stiffness": ("tilt", "rotation", "k_rot", "tilt_stiffness"),
    "share": ("share", "creep"),
    "lateral_stiffness": ("lateral", "stiffness"),
    "stiffness_ratio": ("ratio",),
    "order": ("order", "harmonic"),
    "variation": ("variation",),
    "peak_torque": ("peak", "torque"),
}


def same_dimension(value: float, unit: str, like: str) -> float | None:
    """``value`` in SI of the dimension of ``like``; a stiffness is turned into a compliance where needed; else None."""
    if unit not in UNITS or like not in UNITS:
        return None
    (factor, have), (_, want) = UNITS[unit], UNITS[like]
    if have == want:
        return value * factor
    if value != 0 and (have == f"1/{want}" or want == f"1/{have}"):
        return 1.0 / (value * factor)
    return None


def in_si(value: float, unit: str) -> float:
    """A truth's own number in SI."""
    return value * UNITS[unit][0] if unit in UNITS else value


def named_alike(truth: str, other: str) -> bool:
    """Whether a parameter of a diagnosis is the one the truth means."""
    return any(alias.lower() in other.lower() for alias in ALIASES.get(truth, (truth,)))
