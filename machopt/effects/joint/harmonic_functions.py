"""Waves over a joint's angle, as springs that change with it and gears that run ahead and behind both have them."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array

ARCSEC = np.pi / 648000.0  # rad


def compute_harmonics(angle: Array, orders: Sequence[float] | Array, derivative: int = 0) -> Array:
    """(..., 2n) cos and sin of each order per turn, at angles (...,) rad; or a derivative by the angle."""
    later = derivative * 0.5 * np.pi  # d/dx of cos is cos a quarter turn later
    out = np.empty((*np.shape(angle), 2 * len(orders)))
    for k, n in enumerate(orders):
        at = n * angle + later
        out[..., 2 * k], out[..., 2 * k + 1] = n**derivative * np.cos(at), n**derivative * np.sin(at)
    return out


class HarmonicSeries:
    """Waves of the same angles over and over: whole orders as products of z = exp(iq), z², z⁴ …, whatever else anew."""

    def __init__(self, angle: Array) -> None:
        self.angle = angle
        self._squares: list[NDArray[np.complex128]] = []

    def compute(self, orders: Sequence[float]) -> Array:
        """(M, 2n) as :func:`compute_harmonics`."""
        if any(n < 1 or n != int(n) for n in orders):
            return compute_harmonics(self.angle, orders)
        out = np.empty((len(self.angle), 2 * len(orders)))
        for k, n in enumerate(orders):
            power = self._power(int(n))
            out[:, 2 * k], out[:, 2 * k + 1] = power.real, power.imag
        return out

    def _power(self, n: int) -> NDArray[np.complex128]:
        factors = [self._square(k) for k in range(n.bit_length()) if n >> k & 1]
        return functools.reduce(np.multiply, factors)

    def _square(self, k: int) -> NDArray[np.complex128]:
        """z to the power 2ᵏ."""
        if not self._squares:
            self._squares.append(np.exp(1j * self.angle))
        while len(self._squares) <= k:
            self._squares.append(self._squares[-1] ** 2)
        return self._squares[k]
