"""Thrust and torque of full engagement: Kienzle for the lips, a linear term for the chisel edge; vendor's form.

Lips with the half point angle κ cut the ring from d to D with the chip thickness h = (f / z) sin κ:

    thrust = ½ kc (D − d)/2 f sin κ,   torque = kc f (D² − d²) / 8,   kc = kc1 (h / 1 mm)^(−mc) (1 − γ / 100°)

and the chisel edge of a solid drill adds the thrust k_ch · web · f. Source: Kienzle & Victor; the published forms agree
in torque within 15 to 40 %, in thrust only within a factor of 2 to 3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cutting_coefficients import KIENZLE_CHIP_THICKNESS, DrillingCoefficients
from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, make_arrays_read_only
from machopt.process.drilling.drilling_tools import DrillingTool, check_drilling_coefficients, check_drilling_tool

RAKE_PER_DEGREE = 0.01  # change of kc by 1° of rake, as the tables of the tool makers state it
VENDOR_FEED_EXPONENT = 0.85


@dataclass(frozen=True)
class DrillingLoad:
    """Load of a drill at P feeds: thrust along the axis, and torque."""

    thrust: Array  # (P,) N, presses the drill out of the hole
    torque: Array  # (P,) N·m, opposes the rotation

    def __post_init__(self) -> None:
        make_arrays_read_only(self)


@dataclass(frozen=True)
class FeedPowerLaw:
    """Full load as functions of the feed: thrust = lips f^(1−mc) + chisel f, torque = torque_factor f^(1−mc).

    The feed f is in m per revolution. mc is that of the coefficients.
    """

    lips: float  # N / m^(1−mc)
    chisel: float  # N/m
    torque_factor: float  # N·m / m^(1−mc)
    exponent: float  # 1 − mc


def build_feed_power_law(coefficients: DrillingCoefficients, tool: DrillingTool) -> FeedPowerLaw:
    """Return thrust and torque of full engagement as functions of the feed.

    Args:
        coefficients: drilling coefficients; an unknown chisel edge (None) adds nothing.
        tool: drill, countersink or reamer.

    Raises:
        CuttingInputError: impossible coefficients or tool, or a chisel edge without web thickness.
    """
    check_drilling_coefficients(coefficients)
    check_drilling_tool(tool, coefficients)
    sine = math.sin(tool.half_point_angle)
    correction = 1.0 - RAKE_PER_DEGREE * math.degrees(tool.rake)
    kc = coefficients.kc1_Pa * correction * (sine / tool.lips / KIENZLE_CHIP_THICKNESS) ** -coefficients.mc
    solid = tool.inner_diameter == 0.0
    chisel = coefficients.chisel_Pa * tool.web if solid and coefficients.chisel_Pa and tool.web else 0.0
    return FeedPowerLaw(
        lips=0.25 * kc * (tool.diameter - tool.inner_diameter) * sine,
        chisel=chisel,
        torque_factor=kc * (tool.diameter**2 - tool.inner_diameter**2) / 8.0,
        exponent=1.0 - coefficients.mc,
    )


def check_feed_per_revolution(feed: Array) -> None:
    """Refuse a feed that is not positive.

    Args:
        feed: (P,) m per revolution.

    Raises:
        CuttingInputError: the first feed that is wrong.
    """
    wrong = ~((feed > 0.0) & np.isfinite(feed))
    if wrong.any():
        n = int(np.argmax(wrong))
        raise CuttingInputError(
            f"feed is {feed.flat[n] * 1e3:g} mm per revolution; more than 0 is expected (feed / spindle speed)",
            key="feed",
        )


def compute_feed_per_revolution(feed: Array, spindle_rpm: float) -> Array:
    """Return the feed per revolution, (P,) m.

    Args:
        feed: (P,) m/s.
        spindle_rpm: revolutions per minute, > 0.

    Raises:
        CuttingInputError: a spindle speed that is not positive.
    """
    if not (math.isfinite(spindle_rpm) and spindle_rpm > 0.0):
        raise CuttingInputError(f"spindle speed {spindle_rpm:g} rpm; more than 0 is expected", key="spindle_rpm")
    return np.asarray(feed, float) * (60.0 / spindle_rpm)


def compute_full_load(coefficients: DrillingCoefficients, tool: DrillingTool, feed: Array | float) -> DrillingLoad:
    """Return thrust and torque where the whole lips cut.

    Args:
        coefficients: drilling coefficients.
        tool: drill, countersink or reamer.
        feed: (P,) or one value, m per revolution.

    Raises:
        CuttingInputError: impossible coefficients, tool or feed.
    """
    f = np.atleast_1d(np.asarray(feed, float))
    check_feed_per_revolution(f)
    law = build_feed_power_law(coefficients, tool)
    power = f**law.exponent
    return DrillingLoad(law.lips * power + law.chisel * f, law.torque_factor * power)


def compute_vendor_load(material_factor: float, diameter: float, feed: Array | float) -> DrillingLoad:
    """Return thrust and torque of a solid drill by the form of a tool maker, with its material factor K.

    thrust = 570 K D f^0.85 N, torque = K D² (0.630 + 16.84 f) / 100 N·m, with D and f in mm.

    Args:
        material_factor: K, 1.00 for grey cast iron of 210 MPa.
        diameter: m.
        feed: (P,) or one value, m per revolution.

    Raises:
        CuttingInputError: a factor, diameter or feed that is not positive.

    Source: Tungaloy general catalogue 2020–2021, p. L068.
    """
    f = np.atleast_1d(np.asarray(feed, float))
    check_feed_per_revolution(f)
    if not (math.isfinite(material_factor) and material_factor > 0.0):
        raise CuttingInputError(f"material factor {material_factor:g}; more than 0 is expected", key="K")
    if not (math.isfinite(diameter) and diameter > 0.0):
        raise CuttingInputError("the diameter must be larger than 0", key="diameter_mm")
    f_mm, d_mm = f * 1e3, diameter * 1e3
    return DrillingLoad(
        570.0 * material_factor * d_mm * f_mm**VENDOR_FEED_EXPONENT,
        material_factor * d_mm**2 * (0.630 + 16.84 * f_mm) / 100.0,
    )
