"""Coefficients of cutting forces, in SI units, with their spread and source.

A spread is one standard deviation of the logarithm of the force: s = ln(1 + percent / 100), median factor 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

KIENZLE_CHIP_THICKNESS = 1e-3  # m, the chip thickness for which kc1 holds


def convert_spread_to_sigma(percent: float) -> float:
    """Return the standard deviation of the logarithm, ln(1 + percent / 100).

    Args:
        percent: spread of a force in percent, ≥ 0.
    """
    return math.log1p(percent / 100.0)


@dataclass(frozen=True, kw_only=True)
class MillingCoefficients:
    """Mechanistic coefficients of milling: dF = (K_c h + K_e) db for the tangential, radial and axial force.

    A positive value presses against the motion of the tooth (t), from the work to the tool's axis (r), and along the
    axis (a) to the side that the hand of the helix and the spindle's direction decide.

    Source: Altıntaş, Manufacturing Automation, 2nd ed. (2012), eqs. 2.89 to 2.96.
    """

    Ktc_Pa: float  # tangential cutting coefficient
    Krc_Pa: float  # radial cutting coefficient
    Kac_Pa: float  # axial cutting coefficient
    Kte_N_m: float  # tangential edge coefficient, N per m of edge
    Kre_N_m: float
    Kae_N_m: float
    h_range_m: tuple[float, float]  # smallest and largest chip thickness for which the set holds
    sigma_log: float  # of all six together
    source: str  # text that names where the numbers come from


@dataclass(frozen=True, kw_only=True)
class DrillingCoefficients:
    """Kienzle coefficients of the lips and the coefficient of the chisel edge.

    Specific cutting force kc = kc1 (h / 1 mm)^(−mc) at the chip thickness h. Tables give kc1 in N/mm², which is MPa:
    kc1_Pa = 1e6 times the number of the table, whatever mc is, because h is divided by 1 mm.
    """

    kc1_Pa: float  # noqa: N815 - specific cutting force at a chip thickness of 1 mm and a rake angle of 0
    mc: float  # Kienzle exponent, 0 … 1
    chisel_Pa: float | None  # noqa: N815 - thrust of the chisel edge per web thickness and feed; None: unknown, lips only
    thrust_sigma_log: float
    torque_sigma_log: float
    source: str
