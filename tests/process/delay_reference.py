"""References for stability of milling: Chebyshev collocation and semi-discretization of the periodic delay equation.

q̈ + 2 ζ ω q̇ + ω² q = a Uᵀ H(t) (r(t) − r(t − T)) with r = (travel, normal) displacement, straight teeth. Neither
method shares code with the package.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DelaySystem:
    omega: Array  # (n,) rad/s
    zeta: Array  # (n,)
    shape: Array  # (n, 3) 1/√kg, travel, normal, axial
    teeth: int
    start: float  # rad, contact arc
    end: float
    K: tuple[float, float, float]  # Pa: tangential, radial, axial with its sign (the axial force is −K_a h)
    period: float  # s, tooth period

    def directional(self, t: float) -> Array:
        """Return the directional matrix (3, 2) in Pa: force per depth and displacement."""
        total = np.zeros((3, 2))
        for j in range(self.teeth):
            phi = 2 * math.pi * (t / self.period + j) / self.teeth
            phi %= 2 * math.pi
            if self.start <= phi <= self.end:
                s, c = math.sin(phi), math.cos(phi)
                force = np.array([-self.K[0] * c - self.K[1] * s, self.K[0] * s - self.K[1] * c, -self.K[2]])
                total += np.outer(force, [s, c])
        return total

    def breaks(self) -> list[float]:
        pitch = 2 * math.pi / self.teeth
        at = {0.0, self.period}
        for angle in (self.start, self.end):
            at.add(min(max((angle % pitch) / pitch * self.period, 0.0), self.period))
        return sorted(at)

    def free(self) -> Array:
        n = len(self.omega)
        return np.block(
            [[np.zeros((n, n)), np.eye(n)], [-np.diag(self.omega**2), -np.diag(2 * self.zeta * self.omega)]]
        )


def chebyshev(m: int) -> tuple[Array, Array]:
    """Return the nodes on −1 … 1 in ascending order, and the differentiation matrix."""
    x = -np.cos(np.pi * np.arange(m + 1) / m)
    c = np.where((np.arange(m + 1) == 0) | (np.arange(m + 1) == m), 2.0, 1.0) * (-1.0) ** np.arange(m + 1)
    dx = x[:, None] - x + np.eye(m + 1)
    D = np.outer(c, 1 / c) / dx
    return x, D - np.diag(D.sum(axis=1))


class ChebyshevMap:
    """The map over one tooth period of the state and of the history of r at the nodes of the contact."""

    def __init__(self, system: DelaySystem, nodes: int, elements: int = 1) -> None:
        self.system, self.parts = system, []
        bounds = system.breaks()
        for a, b in itertools.pairwise(bounds):
            if b - a < 1e-12 * system.period:
                continue
            cuts = np.any(system.directional(0.5 * (a + b)))
            edges = np.linspace(a, b, (elements if cuts else 1) + 1)
            self.parts += [(x, y, bool(cuts)) for x, y in itertools.pairwise(edges)]
        self.m = nodes
        self.x, self.D = chebyshev(nodes)
        self.free = system.free()
        self.flights = {k: expm(self.free * (b - a)) for k, (a, b, cuts) in enumerate(self.parts) if not cuts}
        self.H = [
            np.array(
                [
                    system.directional(min(max(t, a + 1e-12 * (b - a)), b - 1e-12 * (b - a)))
                    for t in a + (b - a) * (self.x + 1) / 2
                ]
            )
            if cuts
            else None
            for a, b, cuts in self.parts
        ]

    def radius(self, depth: float) -> float:
        s, n, m = self.system, len(self.system.omega), self.m
        contacts = sum(cuts for *_, cuts in self.parts)
        size = 2 * n + 2 * m * contacts
        state = np.eye(2 * n, size)
        history, observed = [], 0
        read = np.hstack([s.shape[:, :2].T, np.zeros((2, n))])  # r = read x
        for k, (a, b, cuts) in enumerate(self.parts):
            if not cuts:
                state = self.flights[k] @ state
                continue
            push = np.array([np.vstack([np.zeros((n, 2)), depth * s.shape @ h]) for h in self.H[k][1:]])  # (m, 2n, 2)
            system = np.kron(self.D[1:, 1:] * (2 / (b - a)), np.eye(2 * n))
            right = np.zeros((2 * n * m, size))
            for j in range(m):
                rows = slice(2 * n * j, 2 * n * (j + 1))
                system[rows, rows] -= self.free + push[j] @ read
                right[rows] = -self.D[1 + j, 0] * (2 / (b - a)) * state
                first = 2 * n + 2 * (observed + j)
                right[rows, first : first + 2] -= push[j]
            found = np.linalg.solve(system, right)
            history += [read @ found[2 * n * j : 2 * n * (j + 1)] for j in range(m)]
            observed += m
            state = found[-2 * n :]
        return float(np.abs(np.linalg.eigvals(np.vstack([state, *history]))).max())


def semi_discretization_radius(system: DelaySystem, depth: float, intervals: int) -> float:
    """Return the spectral radius by zeroth-order semi-discretization with a given number of intervals per tooth
    period."""
    n, k = len(system.omega), intervals
    h = system.period / k
    read = np.hstack([system.shape[:, :2].T, np.zeros((2, n))])
    size = 2 * n + 2 * k
    total = np.eye(size)
    for i in range(k):
        mean = np.mean([system.directional((i + (p + 0.5) / 16) * h) for p in range(16)], axis=0)
        push = np.vstack([np.zeros((n, 2)), depth * system.shape @ mean])
        A = system.free() + push @ read
        big = expm(np.block([[A, push], [np.zeros((2, 2 * n + 2))]]) * h)
        P, R = big[: 2 * n, : 2 * n], -big[: 2 * n, 2 * n :]
        step = np.zeros((size, size))
        step[: 2 * n, : 2 * n] = P
        step[: 2 * n, size - 4 : size - 2] = R / 2  # mean of both ends of the interval one period earlier
        step[: 2 * n, size - 2 :] = R / 2
        step[2 * n : 2 * n + 2, : 2 * n] = read
        step[2 * n + 2 :, 2 * n : size - 2] = np.eye(2 * k - 2)
        total = step @ total
    return float(np.abs(np.linalg.eigvals(total)).max())


def first_unstable(
    radius: Callable[[float], float], low: float, high: float, step: float = 1.05, tolerance: float = 1e-4
) -> float:
    """Return the smallest depth with a spectral radius of 1, by a scan with a fixed ratio and bisection."""
    stable = low
    assert radius(stable) < 1
    while stable < high:
        unstable = stable * step
        if radius(unstable) > 1:
            while unstable / stable > 1 + tolerance:
                middle = math.sqrt(stable * unstable)
                stable, unstable = (middle, unstable) if radius(middle) < 1 else (stable, middle)
            return stable
        stable = unstable
    return math.inf
