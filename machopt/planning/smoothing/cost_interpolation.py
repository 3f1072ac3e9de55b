"""Interpolation of a quantity of the stations over the rotation, between the steps of the grid."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.smoothing.cubic_curves import fit_cubic_splines


class CostInterpolation:
    """Cubic spline through the values of each of n stations (not-a-knot ends)."""

    def __init__(self, values: Array, step: float) -> None:
        """Fit the splines.

        Args:
            values: (n, m) values at offsets (−(m−1)/2 … (m−1)/2)·step rad, m odd and at least 5.
            step: rad.
        """
        self.step, self.rows, self.middle = step, np.arange(len(values)), (values.shape[1] - 1) // 2
        offset = np.arange(-self.middle, self.middle + 1) * step
        self.pieces = fit_cubic_splines(offset, values.T)  # (4, m − 1, n), highest power first

    def at(self, offset: Array) -> tuple[Array, Array, Array]:
        """Return value, first and second derivative (n,); beyond the table its last cubic is extrapolated.

        Args:
            offset: (n,) rad.
        """
        k = np.clip(np.floor(offset / self.step).astype(int) + self.middle, 0, 2 * self.middle - 1)
        a, b, c, d = self.pieces[:, k, self.rows]
        t = offset - (k - self.middle) * self.step
        return ((a * t + b) * t + c) * t + d, (3.0 * a * t + 2.0 * b) * t + c, 6.0 * a * t + 2.0 * b
