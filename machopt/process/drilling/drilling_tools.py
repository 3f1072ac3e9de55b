"""Drills, countersinks and reamers, and the layers that a hole goes through."""

from __future__ import annotations

import math
from dataclasses import dataclass

from machopt.data_types.cutting_coefficients import DrillingCoefficients
from machopt.errors import CuttingInputError

MILLIMETRE = 1e-3


@dataclass(frozen=True, kw_only=True)
class DrillingTool:
    """Lips that cut the ring between two diameters; a solid drill has an inner diameter of 0.

    A drill in a pilot hole, a countersink in its hole and a reamer have the diameter of that hole as inner diameter;
    their chisel edge cuts nothing.
    """

    diameter: float  # m, outer diameter of the ring that is cut
    inner_diameter: float = 0.0  # m
    half_point_angle: float  # rad, between axis and lip, 0 < κ ≤ π/2
    lips: int = 2
    web: float | None = None  # m, web thickness; None: unknown
    rake: float = 0.0  # rad, rake angle of the lips

    @property
    def point_length(self) -> float:
        """Axial length of the lips: from first contact to the full ring, m."""
        return 0.5 * (self.diameter - self.inner_diameter) / math.tan(self.half_point_angle)


@dataclass(frozen=True)
class MaterialLayer:
    """One layer of a stack."""

    coefficients: DrillingCoefficients
    thickness: float  # m; inf: the hole ends in it


def build_countersink(diameter: float, hole_diameter: float, included_angle: float, lips: int = 3) -> DrillingTool:
    """Return a countersink that widens a hole to a diameter at the surface.

    Args:
        diameter: m, of the countersink at the surface.
        hole_diameter: m.
        included_angle: rad, of the cone.
        lips: number of lips.
    """
    return DrillingTool(
        diameter=diameter, inner_diameter=hole_diameter, half_point_angle=0.5 * included_angle, lips=lips
    )


def build_reamer(diameter: float, stock: float, chamfer_angle: float, lips: int) -> DrillingTool:
    """Return a reamer.

    Args:
        diameter: m.
        stock: m, that it removes on the diameter.
        chamfer_angle: rad, between axis and chamfer.
        lips: number of lips.
    """
    return DrillingTool(diameter=diameter, inner_diameter=diameter - stock, half_point_angle=chamfer_angle, lips=lips)


def check_drilling_coefficients(coefficients: DrillingCoefficients) -> None:
    """Refuse impossible coefficients.

    Args:
        coefficients: set to check.

    Raises:
        CuttingInputError: what is wrong, with its key.
    """
    if not (math.isfinite(coefficients.kc1_Pa) and coefficients.kc1_Pa > 0.0):
        raise CuttingInputError(f"kc1 is {coefficients.kc1_Pa * 1e-6:g} N/mm²; more than 0 is expected", key="kc1")
    if not 0.0 <= coefficients.mc < 1.0:
        raise CuttingInputError(f"mc is {coefficients.mc:g}; 0 ≤ mc < 1 is expected", key="mc")
    chisel = coefficients.chisel_Pa
    if chisel is not None and not (math.isfinite(chisel) and chisel >= 0.0):
        raise CuttingInputError(
            f"chisel is {chisel * 1e-6:g} N/mm²; 0 or more, or null, is expected", key="chisel_N_mm2"
        )
    for key, sigma in (
        ("thrust_spread_percent", coefficients.thrust_sigma_log),
        ("torque_spread_percent", coefficients.torque_sigma_log),
    ):
        if not (math.isfinite(sigma) and sigma >= 0.0):
            raise CuttingInputError("the spread is negative or not finite; 0 or more is expected", key=key)


def check_drilling_tool(tool: DrillingTool, coefficients: DrillingCoefficients | None = None) -> None:
    """Refuse an impossible tool.

    Args:
        tool: drill, countersink or reamer.
        coefficients: set that is used with it.

    Raises:
        CuttingInputError: what is wrong, with its key.
    """
    if not (math.isfinite(tool.diameter) and tool.diameter > 0.0):
        raise CuttingInputError("the diameter must be larger than 0", key="diameter_mm")
    if not 0.0 <= tool.inner_diameter < tool.diameter:
        raise CuttingInputError(
            f"the hole before has {tool.inner_diameter / MILLIMETRE:g} mm; 0 or more and less than the diameter "
            f"{tool.diameter / MILLIMETRE:g} mm is expected",
            key="pilot_mm",
        )
    if not 0.0 < tool.half_point_angle <= math.pi / 2:
        raise CuttingInputError("the point angle must lie above 0° and at most 180°", key="point_deg")
    if tool.lips < 1:
        raise CuttingInputError(f"{tool.lips} lips; 1 or more are expected", key="teeth")
    if not abs(tool.rake) < math.radians(60.0):  # the linear correction, 1 % per degree, holds for small angles
        raise CuttingInputError("the rake angle must lie between −60° and 60°", key="rake_deg")
    if tool.web is not None and not 0.0 < tool.web < tool.diameter:
        raise CuttingInputError("the web must be larger than 0 and smaller than the diameter", key="web_mm")
    known = coefficients is not None and coefficients.chisel_Pa
    if known and tool.inner_diameter == 0.0 and tool.web is None:
        raise CuttingInputError(
            "a coefficient of the chisel edge needs the web thickness of the drill: give web_mm", key="web_mm"
        )
