"""Mean change of the cutting force with a displacement of the cutter, per depth of cut."""

from __future__ import annotations

import math

import numpy as np

from machopt.data_types.cutting_coefficients import MillingCoefficients
from machopt.numerics.array_types import Array
from machopt.process.milling.engagement_angles import ContactArc
from machopt.process.milling.mean_force import get_axial_hand
from machopt.process.milling.milling_cut import MillingCut, MillingCutter, check_cutter


def compute_directional_matrix(
    coefficients: MillingCoefficients, cutter: MillingCutter, cut: MillingCut, arc: ContactArc
) -> Array:
    """Return H of F = a H (r − r_T), averaged over a revolution: force on the tool per depth a and displacement.

    A displacement (x, y) of the cutter in travel and normal changes the chip by x sin φ + y cos φ; an axial one does
    not, on the cylindrical part, which is the only one that is modelled here.

    Args:
        coefficients: milling coefficients; the edge coefficients have no influence.
        cutter: end mill; flat.
        cut: direction of the cut; its spindle direction counts.
        arc: (P,) or scalar angles of contact.

    Returns:
        (P, 3, 2) or (3, 2) Pa: rows travel, normal, axial; columns displacement in travel and normal.

    Raises:
        CuttingInputError: an impossible cutter.

    Source: Altıntaş, Manufacturing Automation, 2nd ed. (2012), eqs. 3.71 to 3.74, without his factor ½ N Kt / 2π.
    """
    check_cutter(cutter, coefficients)
    a, b = np.asarray(arc.start, float), np.asarray(arc.end, float)
    s, c = np.cos(a) - np.cos(b), np.sin(b) - np.sin(a)
    sc = 0.5 * (np.sin(b) ** 2 - np.sin(a) ** 2)
    swing = 0.25 * (np.sin(2.0 * b) - np.sin(2.0 * a))
    ss, cc = 0.5 * (b - a) - swing, 0.5 * (b - a) + swing
    Kt, Kr = coefficients.Ktc_Pa, coefficients.Krc_Pa
    Ka = get_axial_hand(cutter, cut) * coefficients.Kac_Pa
    m = cut.mirror
    rows = [[-Kt * sc - Kr * ss, -m * (Kt * cc + Kr * sc)], [m * (Kt * ss - Kr * sc), Kt * sc - Kr * cc]]
    rows.append([-Ka * s, -m * Ka * c])
    H = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.asarray(cutter.teeth / (2.0 * math.pi) * H)
