"""Harmonics of a joint angle, used by angle-dependent stiffness and by transmission errors."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

ARCSEC = np.pi / 648000.0  # rad


def compute_harmonics(angle: Array, orders: Sequence[float] | Array, derivative: int = 0) -> Array:
    """Return cosine and sine of each order at joint angles, or a derivative of them.

    Args:
        angle: (...,) joint angles, rad.
        orders: n orders per turn of the joint.
        derivative: Order of the derivative with respect to the angle; 0 is the function itself.

    Returns:
        (..., 2n) cosine and sine of each order in turn; derivatives in 1/rad^k.
    """
    phase_shift = derivative * 0.5 * np.pi  # d/dx of cos is cos a quarter turn later
    out = np.empty((*np.shape(angle), 2 * len(orders)))
    for k, n in enumerate(orders):
        phase = n * angle + phase_shift
        out[..., 2 * k], out[..., 2 * k + 1] = n**derivative * np.cos(phase), n**derivative * np.sin(phase)
    return out


class HarmonicSeries:
    """Harmonics of a fixed set of angles. Integer orders are products of cached powers z = exp(iq), z², z⁴ …."""

    def __init__(self, angle: Array) -> None:
        self.angle = angle
        self._squares: list[NDArray[np.complex128]] = []

    def compute(self, orders: Sequence[float]) -> Array:
        """Return cosine and sine of each order, as :func:`compute_harmonics`.

        Args:
            orders: n orders per turn of the joint.

        Returns:
            (M, 2n) cosine and sine of each order in turn.
        """
        if any(n < 1 or n != int(n) for n in orders):
            return compute_harmonics(self.angle, orders)
        out = np.empty((len(self.angle), 2 * len(orders)))
        for k, n in enumerate(orders):
            power = self._compute_power(int(n))
            out[:, 2 * k], out[:, 2 * k + 1] = power.real, power.imag
        return out

    def _compute_power(self, n: int) -> NDArray[np.complex128]:
        factors = [self._compute_squared_power(k) for k in range(n.bit_length()) if n >> k & 1]
        return functools.reduce(np.multiply, factors)

    def _compute_squared_power(self, k: int) -> NDArray[np.complex128]:
        """Return z to the power 2ᵏ."""
        if not self._squares:
            self._squares.append(np.exp(1j * self.angle))
        while len(self._squares) <= k:
            self._squares.append(self._squares[-1] ** 2)
        return self._squares[k]
