"""The cost over (station, rotation) as a CasADi function, made in a time that grows with the number of stations.

The splines of all stations stand one behind the other on one axis: station r owns the stretch around r·width, and a
cost is looked up at r·width + offset. ``casadi.interpolant`` over both would solve one sparse system of all values
(quadratic in the stations: half of the smoothing where they are 4,000), and its derivative writes outside its memory
wherever a row is asked at exactly its own knot: degree 1 there gives degree 0, and ``boor[degree - 1]`` of
casadi_nd_boor_eval (CasADi 3.8.2) lies before the array. One axis of degree 3 with simple knots never comes there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

Array = NDArray[np.float64]
BESIDE = 5  # steps of the offset that a station owns beyond either end of its table: three knots, and half a gap


@dataclass(frozen=True)
class CostTable:
    """Costs of n stations; a cubic spline through the values of each, without knots next to its ends."""

    function: Any  # CasADi's, of (1, k) places on the common axis
    width: float  # rad, of one station on it

    @classmethod
    def of(cls, cost: Array, step: float) -> CostTable:
        """From costs (n, m) at offsets (−(m−1)/2 … (m−1)/2)·step rad, m odd and at least 5."""
        import casadi as ca

        n, m = cost.shape
        offset = (np.arange(m) - (m - 1) // 2) * step
        beyond = np.arange(1, 4) * step
        knots = np.r_[offset[0] - beyond[::-1], offset[0], offset[2:-2], offset[-1], offset[-1] + beyond]
        inside = make_interp_spline(offset, cost.T, k=3, t=knots).c.T  # (n, m)
        width = (m - 1 + 2 * BESIDE) * step
        # four more splines stand between two stations; they hold what the table ends with
        between = np.c_[inside[:-1, [-1, -1]], inside[1:, [0, 0]]]
        coefficients = np.r_[np.c_[inside[:-1], between].ravel(), inside[-1]]
        axis = (np.arange(n)[:, None] * width + knots).ravel()
        return cls(ca.Function.bspline("cost", [axis.tolist()], coefficients.tolist(), [3], 1, {}), width)

    def __call__(self, rows: NDArray[np.intp], offset: Any) -> Any:
        """(k, 1) costs of stations (k,) at offsets (k,) rad: a CasADi expression of one, DM of numbers."""
        import casadi as ca

        at = ca.DM(rows * self.width) + (offset if isinstance(offset, ca.MX) else ca.DM(offset))
        return self.function(at.T).T
