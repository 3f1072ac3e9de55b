"""The end mill, the direction of a cut, and the checks of both.

Signs: travel is the direction of motion of the tool, axis points from tip to shank, normal = axis × travel (left of
travel). The rotation angle φ of a tooth is zero at +normal and grows with the rotation of a spindle that turns
clockwise seen from the shank (M3). Up milling then has φ from 0 to θ and the material left of travel; down milling has
φ from π − θ to π and the material right of travel. M4 is the mirror image: normal force and torque change their signs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.errors import CuttingInputError
from machopt.numerics.array_types import Array, Bools

CutSide = Literal["up", "down", "slot"]
SpindleDirection = Literal["cw", "ccw"]
StockBoundary = Literal["previous_pass", "plane"]
MILLIMETRE = 1e-3
LENGTH_TOLERANCE = 1e-9  # m, rounding of lengths that are converted from mm


@dataclass(frozen=True, kw_only=True)
class MillingCutter:
    """An end mill: flat (corner radius 0), bull-nose, or ball (corner radius = diameter / 2)."""

    diameter: float  # m
    teeth: int
    helix: float  # rad, right-hand helix positive
    length: float  # m, usable length of the cutting edges from the tip
    corner_radius: float = 0.0  # m
    runout: float = 0.0  # m, offset of the cutter's axis from the spindle's axis
    runout_angle: float = 0.0  # rad, from tooth 0 to the offset, in the sense of φ

    @property
    def radius(self) -> float:
        """Radius of the cylindrical part, m."""
        return 0.5 * self.diameter


@dataclass(frozen=True)
class MillingCut:
    """Direction of a cut."""

    side: CutSide
    spindle: SpindleDirection = "cw"  # cw: M3, clockwise seen from the shank
    boundary: StockBoundary = "previous_pass"  # what bounds the material beside the tool: the pass before, or a plane

    @property
    def mirror(self) -> float:
        """Sign of the normal force and of the torque: +1 for M3, −1 for M4."""
        return 1.0 if self.spindle == "cw" else -1.0


def check_milling_coefficients(coefficients: MillingCoefficients, accept_unusual: bool = False) -> None:
    """Refuse coefficients that are impossible, or that published sets suggest are of another convention.

    Args:
        coefficients: set to check.
        accept_unusual: accept a negative coefficient and Krc > Ktc, which some published sets have.

    Raises:
        CuttingInputError: what is wrong, with its key.
    """
    values = {
        "Ktc": coefficients.Ktc_Pa * 1e-6,
        "Krc": coefficients.Krc_Pa * 1e-6,
        "Kac": coefficients.Kac_Pa * 1e-6,
        "Kte": coefficients.Kte_N_m * 1e-3,
        "Kre": coefficients.Kre_N_m * 1e-3,
        "Kae": coefficients.Kae_N_m * 1e-3,
    }
    for key, value in values.items():
        if not math.isfinite(value):
            raise CuttingInputError(f"{key} is {value}; a finite number is expected", key=key)
    if values["Ktc"] <= 0.0:
        raise CuttingInputError(f"Ktc is {values['Ktc']:g} N/mm²; a positive value is expected", key="Ktc")
    low, high = coefficients.h_range_m
    if not 0.0 <= low < high:
        raise CuttingInputError(
            f"h_mm is [{low * 1e3:g}, {high * 1e3:g}]; 0 ≤ smallest < largest chip thickness is expected", key="h_mm"
        )
    if not (math.isfinite(coefficients.sigma_log) and coefficients.sigma_log >= 0.0):
        raise CuttingInputError("the spread is negative or not finite; 0 or more is expected", key="spread_percent")
    if accept_unusual:
        return
    for key, value in values.items():
        if value < 0.0:
            unit = "N/mm²" if key.endswith("c") else "N/mm"
            raise CuttingInputError(
                f"{key} is {value:g} {unit}: negative; a source with another sign convention is likely. "
                "Change the sign, or accept the set with `accept: true`",
                key=key,
            )
    if values["Krc"] > values["Ktc"]:
        raise CuttingInputError(
            f"Krc {values['Krc']:g} is larger than Ktc {values['Ktc']:g} N/mm²: the two may be exchanged. "
            "Correct the set, or accept it with `accept: true`",
            key="Krc",
        )


def check_cutter(cutter: MillingCutter, coefficients: MillingCoefficients | None = None) -> None:
    """Refuse an impossible cutter, and a cutter without helix where axial coefficients need the helix's hand.

    Args:
        cutter: end mill.
        coefficients: set that is used with it.

    Raises:
        CuttingInputError: what is wrong, with its key.
    """
    if not (math.isfinite(cutter.diameter) and cutter.diameter > 0.0):
        raise CuttingInputError("the diameter must be larger than 0", key="diameter_mm")
    if cutter.teeth < 1:
        raise CuttingInputError(f"{cutter.teeth} teeth; 1 or more are expected", key="teeth")
    if not abs(cutter.helix) < math.pi / 2:
        raise CuttingInputError("the helix angle must lie between −90° and 90°", key="helix_deg")
    if not 0.0 <= cutter.corner_radius <= cutter.radius + LENGTH_TOLERANCE:
        raise CuttingInputError(
            f"corner radius {cutter.corner_radius * 1e3:g} mm; 0 … {cutter.radius * 1e3:g} mm (half the diameter) is "
            "expected",
            key="corner_radius_mm",
        )
    if cutter.runout < 0.0:
        raise CuttingInputError("the run-out must be 0 or more", key="runout_mm")
    if coefficients is not None and cutter.helix == 0.0 and (coefficients.Kac_Pa or coefficients.Kae_N_m):
        raise CuttingInputError(
            "Kac and Kae need the hand of the helix, which decides the sign of the axial force: give helix_deg "
            "(right-hand positive), or Kac and Kae of 0",
            key="helix_deg",
        )


def check_cut_dimensions(cutter: MillingCutter, cut: MillingCut, ae: Array, ap: Array) -> None:
    """Refuse an impossible radial or axial depth of cut.

    Args:
        cutter: end mill.
        cut: direction of the cut.
        ae: (P,) m, radial depth of cut; 0: nothing is cut.
        ap: (P,) m, axial depth of cut; 0: nothing is cut.

    Raises:
        CuttingInputError: the first point that is wrong.
    """
    _refuse_first(~((ae >= 0.0) & np.isfinite(ae)), ae, "ae_mm", "0 or more is expected")
    _refuse_first(~((ap >= 0.0) & np.isfinite(ap)), ap, "ap_mm", "0 or more is expected")
    most = f"at most the diameter {cutter.diameter * 1e3:g} mm is expected"
    _refuse_first(ae > cutter.diameter + LENGTH_TOLERANCE, ae, "ae_mm", most)
    most = f"at most the length of the cutting edges {cutter.length * 1e3:g} mm is expected"
    _refuse_first(ap > cutter.length + LENGTH_TOLERANCE, ap, "ap_mm", most)
    if cut.side == "slot":
        full = f"a slot has the full diameter {cutter.diameter * 1e3:g} mm; name the side `up` or `down` otherwise"
        _refuse_first((ae > 0.0) & (ae < cutter.diameter - LENGTH_TOLERANCE), ae, "ae_mm", full)


def check_feed_per_tooth(fz: Array) -> None:
    """Refuse a feed per tooth that is not positive.

    Args:
        fz: (P,) m.

    Raises:
        CuttingInputError: the first point that is wrong.
    """
    more = "more than 0 is expected (feed / (spindle speed × teeth))"
    _refuse_first(~((fz > 0.0) & np.isfinite(fz)), fz, "feed per tooth", more)


def _refuse_first(wrong: Bools, values: Array, key: str, expected: str) -> None:
    if wrong.any():
        n = int(np.argmax(wrong))
        place = f" at point {n}" if values.size > 1 else ""
        raise CuttingInputError(
            f"{key.removesuffix('_mm')} is {values.flat[n] / MILLIMETRE:g} mm{place}; {expected}", key=key
        )


def compute_feed_per_tooth(feed: Array, spindle_rpm: float, teeth: int) -> Array:
    """Return the feed per tooth, (P,) m.

    Args:
        feed: (P,) m/s.
        spindle_rpm: revolutions per minute, > 0.
        teeth: number of teeth.

    Raises:
        CuttingInputError: a spindle speed or number of teeth that is not positive.
    """
    if not (math.isfinite(spindle_rpm) and spindle_rpm > 0.0):
        raise CuttingInputError(f"spindle speed {spindle_rpm:g} rpm; more than 0 is expected", key="spindle_rpm")
    if teeth < 1:
        raise CuttingInputError(f"{teeth} teeth; 1 or more are expected", key="teeth")
    return np.asarray(feed, float) * (60.0 / (spindle_rpm * teeth))
