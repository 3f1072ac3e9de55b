"""J around a sequence of poses, in the coefficients of curves of rotation and external joints: its least place.

With z (n, d) the offsets at the stations, z = M c, the model is

    Σ (gᵀz + ½ zᵀHz) + w·max (c + sᵀz + ½ zᵀBz) + Σ price·|v| + Σ lost·max(0, |v|·slowness − seconds)

with v the steps of joints, external joints and rotation from station to station, linear in z. Its kinks are rounded by
a width ε that goes to zero, and what leaves the bounds pays the square of the distance, ever more, as in
:mod:`machopt.plan.programme`. Absolute values are majorised by parabolas, |v| ≤ (v²/s + s)/2 with s ≥ |v| (Hunter & Li
2005, Ann. Statist. 33:1617, section 3), so that a step of Newton's method on them never leads up. Each term ties one
station or two neighbouring ones: the Hessian is block tridiagonal in z, banded in the coefficients of splines, and
sparse where a value is shared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from machopt.arrays import Array, Bools

WIDTHS = np.geomspace(2e-2, 2e-5, 7)  # ε in rad, and in c₀ for the worst index
STIFF = np.geomspace(1e3, 1e6, 7)  # price per rad² beyond the bounds, at each width
STEPS = 12  # at one width
DAMPED = 1e-2  # of J for a step across all of the bounds, at first; ten times as much where the model does not fall
TRIES = 8
ENOUGH = 1e-7  # of the model: a step that gains less is the last at its width
RIDGE = 1e-9  # added to the Hessian, of its largest entry
SMOOTH = 1e-4  # price of the sum of squares of neighbouring coefficients' difference: what nothing else decides stays


@dataclass(frozen=True)
class Local:
    """What is known around the pose of each of n stations, by differences."""

    q: Array  # (n, 6, d) ∂q/∂z
    margins: Array  # (n, 3, d) of the margins to singularities
    known: Bools  # (n,) the differences exist; elsewhere z must be 0
    gradient: Array  # (n, d) of the smooth terms, by their share
    hessian: Array  # (n, d, d) likewise, positive semidefinite
    cost: Array  # (n,) the index in units of c₀
    slope: Array  # (n, d) of it
    bend: Array  # (n, d, d) likewise, positive semidefinite
    counted: Bools  # (n,) the worst index counts there
    worst: float  # its price


@dataclass(frozen=True)
class Steps:
    """The steps between stations: k absolute values each."""

    jump: Array  # (n − 1, k) at z = 0
    lean: Array  # (n, k, d) of the values whose differences they are
    price: Array  # (n − 1, k)
    lost: Array  # (n − 1,) price of a second lost
    seconds: Array  # (n − 1,)
    slowness: Array  # (k,) s/rad


@dataclass(frozen=True)
class Bounds:
    """What z must keep; 0 is inside."""

    low: Array  # (n, d)
    high: Array  # (n, d)
    lean: Array  # (n, m, d) of what is linear in z
    under: Array  # (n, m) and what that must not fall below
    over: Array  # (n, m) or exceed


def _blocks(blocks: Array, columns: int, offset: int = 0) -> sparse.csr_matrix:
    """(n·k, columns) with blocks (n, k, d) one below the other, each d columns on from the last."""
    n, k, d = blocks.shape
    rows = np.arange(n * k).reshape(n, k, 1)
    across = (np.arange(n)[:, None, None] + offset) * d + np.arange(d)
    i, j = np.broadcast_arrays(rows, across)
    return sparse.csr_matrix((blocks.ravel(), (i.ravel(), j.ravel())), shape=(n * k, columns))


class _Model:
    def __init__(self, local: Local, steps: Steps, bounds: Bounds, curves: sparse.csr_matrix) -> None:
        n, d = local.gradient.shape
        self.local, self.curves, self.shape = local, curves, (n, d)
        lean = _blocks(steps.lean[1:], n * d, 1) - _blocks(steps.lean[:-1], n * d)
        k = steps.jump.shape[1]
        self.jump, self.price = steps.jump.ravel(), steps.price.ravel()
        self.walk = (lean @ curves).tocsr()
        self.late = np.repeat(steps.lost, k), np.tile(steps.slowness, n - 1), np.repeat(steps.seconds, k)
        self.kept = sparse.vstack([curves, _blocks(bounds.lean, n * d) @ curves]).tocsr()
        self.low = np.r_[bounds.low.ravel(), bounds.under.ravel()]
        self.high = np.r_[bounds.high.ravel(), bounds.over.ravel()]
        wide = np.maximum(bounds.high - bounds.low, 1e-6).ravel()
        self.damping = curves.T @ sparse.diags(4.0 / (n * wide * wide)) @ curves
        m = curves.shape[1]
        self.ridge = SMOOTH * sparse.identity(m) / m

    def terms(self, c: Array, width: float, stiff: float) -> tuple[float, Array, Array, Array, Array, Array]:
        """Value; for the derivatives z, the steps' slope and curvature, the worst's shares, what is beyond bounds."""
        x = self.local
        z = (self.curves @ c).reshape(self.shape)
        Bz = np.einsum("nij,nj->ni", x.bend, z)
        cost = np.where(x.counted, x.cost + (x.slope * z).sum(axis=1) + 0.5 * (Bz * z).sum(axis=1), -np.inf)
        top = float(cost.max()) if x.counted.any() else 0.0
        p = np.exp((cost - top) / width)
        total = max(float(p.sum()), 1e-300)
        value = x.worst * (top + width * np.log(total)) if x.counted.any() else 0.0
        value += float((x.gradient * z).sum() + 0.5 * np.einsum("ni,nij,nj->", z, x.hessian, z))
        v = self.jump + self.walk @ c
        s = np.sqrt(v * v + width * width)
        lost, slowness, seconds = self.late
        over = s * slowness - seconds
        narrow = width * max(float(slowness.max()), 1e-12)
        root = np.sqrt(over * over + narrow * narrow)
        value += float(self.price @ s + 0.5 * lost @ (over + root))
        rise = self.price + 0.5 * lost * slowness * (1.0 + over / root)
        y = self.kept @ c
        out = np.minimum(y - self.low, 0.0) + np.maximum(y - self.high, 0.0)
        value += stiff * float(out @ out) + 0.5 * float(c @ (self.ridge @ c))
        return value, z, rise * v / s, rise / s, p / total, out

    def newton(
        self, c: Array, width: float, stiff: float, at: tuple[float, Array, Array, Array, Array, Array]
    ) -> tuple[Array, sparse.csc_matrix, Array]:
        """Gradient, and Hessian but for a dyad, both in the coefficients; that of the parabolas."""
        x, (n, d) = self.local, self.shape
        _, z, pull, curved, p, out = at
        slope = x.slope + np.einsum("nij,nj->ni", x.bend, z)
        gradient = x.gradient + np.einsum("nij,nj->ni", x.hessian, z) + x.worst * p[:, None] * slope
        blocks = x.hessian + x.worst * p[:, None, None] * (x.bend + slope[:, :, None] * slope[:, None] / width)
        dyad = self.curves.T @ (p[:, None] * slope).ravel() * np.sqrt(x.worst / width)
        g = self.curves.T @ gradient.ravel() + self.walk.T @ pull + 2.0 * stiff * (self.kept.T @ out) + self.ridge @ c
        H = self.curves.T @ (_blocks(blocks, n * d) @ self.curves)
        curved_walk = self.walk.copy()
        curved_walk.data *= np.repeat(curved, np.diff(curved_walk.indptr))
        H += self.walk.T @ curved_walk
        beyond = self.kept[np.flatnonzero(out)]
        H += 2.0 * stiff * (beyond.T @ beyond)
        H = (H + self.ridge + RIDGE * (1.0 + abs(H).max()) * sparse.identity(len(c))).tocsc()
        return np.asarray(g), H, np.asarray(dyad)

    def step(self, newton: tuple[Array, sparse.csc_matrix, Array], damped: float) -> Array:
        """Levenberg and Marquardt's."""
        gradient, H, dyad = newton
        solver = splu((H + damped * self.damping).tocsc())
        step, along = -solver.solve(gradient), solver.solve(dyad)
        left = 1.0 - float(dyad @ along)  # Sherman & Morrison
        if left > 1e-6:
            step += along * (float(dyad @ step) / left)
        return np.asarray(step)


def lessened(local: Local, steps: Steps, bounds: Bounds, curves: sparse.csr_matrix) -> Array:
    """(m,) coefficients at which the model is least, from 0 on.

    Args:
        curves: (n·d, m) the offsets, station by station, of coefficients.
    """
    model, c = _Model(local, steps, bounds, curves), np.zeros(curves.shape[1])
    for width, stiff in zip(WIDTHS, STIFF, strict=True):
        here, damped = model.terms(c, width, stiff), DAMPED
        for _ in range(STEPS):
            newton = model.newton(c, width, stiff, here)
            for _ in range(TRIES):
                step = model.step(newton, damped)
                there = model.terms(c + step, width, stiff)
                if there[0] < here[0]:
                    break
                damped *= 10.0
            else:
                break
            gained, c, here, damped = here[0] - there[0], c + step, there, 0.2 * damped
            if gained < ENOUGH * (1.0 + abs(here[0])):
                break
    return c
