"""Stability of a milling cut with the whole delay, by a sweep of the frequency: fast modes count too.

With the averaged H, Λ_i = ω_i² − ω² + 2 i ζ_i ω_i ω and p = 1 − exp(−iωT) the modes obey det(I − a p Λ⁻¹ G) = 0,
G = Uᵀ H U of rank 2:

    D(ω) = 1 − a p Σ_i G_ii / Λ_i + (a p)² Σ_{i<j} (G_ii G_jj − G_ij G_ji) / (Λ_i Λ_j)

The modes alone are stable, so that the number of growing solutions is the number of clockwise turns of D about 0 from
ω = −∞ to ∞ (Nyquist). D tends to 1 at both ends. A highly interrupted cut may double its period: with one impulse
a T G (q − q_T) a period, the map of one period has the eigenvalue −1 at these depths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.verification.motion.process.stability import DelayLaw

CIRCLE, TURN = 120, 0.05  # points on each mode's circle; rad of ωT between frequencies
LADDER, LEAST, HALVINGS = 1.1, 1e-3, 12  # ratio of depths; lowest depth as a share of the largest; bisections
OVERRUN = 4.0  # |a p Λ⁻¹ G| is below 1 / OVERRUN above the sweep
MOST = 200_000  # frequencies
DOUBLE = 1e-6  # imaginary part of two equal eigenvalues, as a share


@dataclass
class DelaySweep:
    """The whole delay at one point, for depths up to a largest one."""

    law: DelayLaw
    largest: float  # m
    doubling: float = field(init=False)  # m, at which the period doubles; inf: nowhere
    _loop: tuple[NDArray[np.complex128], NDArray[np.complex128]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        law, w = self.law, self._list_frequencies()
        d = 1.0 / (law.omega[:, None] ** 2 - w**2 + 2j * (law.zeta * law.omega)[:, None] * w)
        G, p = law.G, 1.0 - np.exp(-1j * w * law.T)
        gains = np.diag(G)
        minors = np.triu(np.outer(gains, gains) - G * G.T, 1)
        self._loop = p * (gains @ d), p**2 * np.sum(d * (minors @ d), axis=0)
        self.doubling = self._find_doubling()

    def find_limit(self) -> float:
        """Return the least depth at which a solution grows or the period doubles, m; inf up to the largest depth."""
        count = math.ceil(math.log(1.0 / LEAST) / math.log(LADDER)) + 1
        depths = self.largest * np.geomspace(LEAST, 1.0, count)
        grows = np.flatnonzero(self.find_unstable(depths))
        if not len(grows):
            return math.inf
        low, high = (float(depths[grows[0] - 1]) if grows[0] else 0.0), float(depths[grows[0]])
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.find_unstable(np.array([middle]))[0] else (middle, high)
        return low

    def find_unstable(self, depths: Array) -> NDArray[np.bool_]:
        """Return (n,) whether a solution grows at some depths, or the period has doubled below them.

        Args:
            depths: (n,) m, none above the largest one.
        """
        one, two = self._loop
        out = depths >= self.doubling
        for n, a in enumerate(depths.tolist()):
            D = 1.0 - a * one + a * a * two
            turn = float(np.sum(np.angle(D[1:] * np.conj(D[:-1]))))
            out[n] |= round(-turn / math.pi) > 0  # half a turn for ω > 0 is one growing solution
        return out

    def _find_doubling(self) -> float:
        """Return the least depth at which the map of the impulse model has the eigenvalue −1, m; inf without one."""
        law, n = self.law, len(self.law.omega)
        damped, decay = law.omega * np.sqrt(1.0 - law.zeta**2), law.zeta * law.omega
        e, s, c = np.exp(-decay * law.T), np.sin(damped * law.T), np.cos(damped * law.T)
        flow = np.zeros((2 * n, 2 * n))
        flow[:n, :n], flow[:n, n:] = np.diag(e * (c + decay / damped * s)), np.diag(e * s / damped)
        flow[n:, :n], flow[n:, n:] = np.diag(-e * law.omega**2 / damped * s), np.diag(e * (c - decay / damped * s))
        kick, push = np.eye(2 * n, 3 * n), np.zeros((2 * n, 3 * n))
        push[n:, :n], push[n:, 2 * n :] = law.T * law.G, -law.T * law.G
        still, change = np.zeros((3 * n, 3 * n)), np.zeros((3 * n, 3 * n))
        still[: 2 * n], change[: 2 * n] = flow @ kick, flow @ push
        still[2 * n :, :n] = np.eye(n)
        inverse = np.linalg.eigvals(np.linalg.solve(still + np.eye(3 * n), -change))  # of the depths, 1/m
        real = inverse.real[np.abs(inverse.imag) <= DOUBLE * np.abs(inverse)]
        return 1.0 / float(real.max()) if (real > 0.0).any() else math.inf

    def _list_frequencies(self) -> Array:
        """Return (n,) rad/s from 0: each mode's circle, and the turns of the delay."""
        law, last = self.law, float(self.law.omega[-1])
        gain = 2.0 * self.largest * float(np.abs(law.G).sum())  # |p| ≤ 2
        top = max(2.0 * last, math.sqrt(last**2 + OVERRUN * gain))
        tangents = np.tan(np.pi * ((np.arange(CIRCLE) + 0.5) / CIRCLE - 0.5))
        circles = (law.omega[:, None] * (1.0 + law.zeta[:, None] * tangents)).ravel()
        count = min(int(top * law.T / TURN) + 200, MOST)
        return np.unique([*np.linspace(0.0, top, count), *circles[(circles > 0.0) & (circles < top)]])
