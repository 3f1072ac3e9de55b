"""Linear edge coefficients that follow Kienzle's power law over a stated range of chip thickness."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cutting_coefficients import KIENZLE_CHIP_THICKNESS
from machopt.errors import CuttingInputError


@dataclass(frozen=True)
class LinearizedKienzle:
    """F / b ≈ K_c h + K_e in place of kc1 h^(1−mc), with its range and largest relative deviation."""

    cutting_Pa: float  # noqa: N815 - K_c
    edge_N_m: float  # noqa: N815 - K_e, N per m of edge
    h_range_m: tuple[float, float]
    worst_deviation: float  # largest |linear / power law − 1| in the range


def linearize_kienzle(kc1_Pa: float, mc: float, h_range_m: tuple[float, float]) -> LinearizedKienzle:
    """Return the least-squares line through the power law over a range of chip thickness, uniform weight.

    Args:
        kc1_Pa: Pa, specific cutting force at a chip thickness of 1 mm.
        mc: Kienzle exponent.
        h_range_m: m, smallest and largest chip thickness in use; the result holds in it only.

    Raises:
        CuttingInputError: coefficients or range that are impossible.
    """
    low, high = h_range_m
    if not (math.isfinite(kc1_Pa) and kc1_Pa > 0.0):
        raise CuttingInputError(f"kc1 is {kc1_Pa * 1e-6:g} N/mm²; more than 0 is expected", key="kc1")
    if not 0.0 <= mc < 1.0:
        raise CuttingInputError(f"mc is {mc:g}; 0 ≤ mc < 1 is expected", key="mc")
    if not 0.0 < low < high < math.inf:
        raise CuttingInputError(
            f"h_mm is [{low * 1e3:g}, {high * 1e3:g}]; 0 < smallest < largest chip thickness is expected", key="h_mm"
        )

    def integrate(power: float) -> float:
        return float(high ** (power + 1.0) - low ** (power + 1.0)) / (power + 1.0)

    scale, p = kc1_Pa * KIENZLE_CHIP_THICKNESS**mc, 1.0 - mc
    normal = np.array([[integrate(2.0), integrate(1.0)], [integrate(1.0), integrate(0.0)]])
    cutting, edge = np.linalg.solve(normal, scale * np.array([integrate(1.0 + p), integrate(p)]))
    # the deviation is extreme at both ends and where p K_e = (1 − p) K_c h
    turning = p * edge / ((1.0 - p) * cutting) if mc > 0.0 else low
    places = np.array([low, high, min(max(turning, low), high)])
    worst = float(np.abs((cutting * places + edge) / (scale * places**p) - 1.0).max())
    return LinearizedKienzle(float(cutting), float(edge), (low, high), worst)
