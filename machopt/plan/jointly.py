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

from machopt.arrays import Array, Bools
from machopt.plan.bordered import Bordered

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


@dataclass(frozen=True)
class _Terms:
    """The model at some coefficients, and what its derivatives are made of."""

    value: float
    c: Array  # (m,)
    slope: Array  # (n, d) of the index
    gradient: Array  # (n, d) of the smooth terms
    pull: Array  # (n − 1, k) slope of the steps' prices
    curved: Array  # (n − 1, k) their curvature, that of the parabolas
    p: Array  # (n,) shares of the worst index
    out: Array  # (n, d) beyond ``low`` and ``high``
    beyond: Array  # (n, m) beyond ``under`` and ``over``


@dataclass(frozen=True)
class _Newton:
    """Gradient in the coefficients, and the Hessian in the offsets, block tridiagonal but for a dyad to take away."""

    gradient: Array  # (m,)
    own: Array  # (n, d, d) blocks on the diagonal
    on: Array  # (n − 1, d, d) blocks below it
    dyad: Array  # (m,)


class _Model:
    def __init__(self, local: Local, steps: Steps, bounds: Bounds, curves: Bordered) -> None:
        self.local, self.steps, self.bounds, self.curves = local, steps, bounds, curves
        n = len(local.gradient)
        wide = np.maximum(bounds.high - bounds.low, 1e-6)
        self.damping = (4.0 / (n * wide * wide))[:, :, None] * np.eye(wide.shape[1])
        self.ridge = SMOOTH / max(curves.curves.shape[1], 1)
        self.narrow = max(float(steps.slowness.max()), 1e-12)

    def terms(self, c: Array, width: float, stiff: float) -> _Terms:
        """The model at some coefficients (m,)."""
        x, walk, kept = self.local, self.steps, self.bounds
        z = self.curves.along(c).reshape(x.gradient.shape)
        Bz, Hz = _times(x.bend, z), _times(x.hessian, z)
        cost = np.where(x.counted, x.cost + (x.slope * z).sum(axis=1) + 0.5 * (Bz * z).sum(axis=1), -np.inf)
        top = float(cost.max()) if x.counted.any() else 0.0
        p = np.exp((cost - top) / width)
        total = max(float(p.sum()), 1e-300)
        value = x.worst * (top + width * np.log(total)) if x.counted.any() else 0.0
        value += float(((x.gradient + 0.5 * Hz) * z).sum())
        v = walk.jump + np.diff(_times(walk.lean, z), axis=0)
        s = np.sqrt(v * v + width * width)
        over = s * walk.slowness - walk.seconds[:, None]
        root = np.sqrt(over * over + (width * self.narrow) ** 2)
        value += float((walk.price * s + 0.5 * walk.lost[:, None] * (over + root)).sum())
        rise = walk.price + 0.5 * walk.lost[:, None] * walk.slowness * (1.0 + over / root)
        y = _times(kept.lean, z)
        out = np.minimum(z - kept.low, 0.0) + np.maximum(z - kept.high, 0.0)
        beyond = np.minimum(y - kept.under, 0.0) + np.maximum(y - kept.over, 0.0)
        value += stiff * float((out * out).sum() + (beyond * beyond).sum()) + 0.5 * self.ridge * float(c @ c)
        return _Terms(value, c, x.slope + Bz, x.gradient + Hz, rise * v / s, rise / s, p / total, out, beyond)

    def newton(self, at: _Terms, width: float, stiff: float) -> _Newton:
        """Gradient and Hessian, that of the parabolas."""
        x, lean, room = self.local, self.steps.lean, self.bounds.lean
        p, slope = x.worst * at.p, at.slope
        gradient = at.gradient + p[:, None] * slope + 2.0 * stiff * (at.out + _times(_turned(room), at.beyond))
        gradient[1:] += _times(_turned(lean[1:]), at.pull)
        gradient[:-1] -= _times(_turned(lean[:-1]), at.pull)
        own = x.hessian + p[:, None, None] * (x.bend + slope[:, :, None] * slope[:, None] / width)
        after, before = _turned(lean[1:]) * at.curved[:, None], _turned(lean[:-1]) * at.curved[:, None]
        own[1:] += after @ lean[1:]
        own[:-1] += before @ lean[:-1]
        own += 2.0 * stiff * (at.out != 0.0)[:, :, None] * np.eye(own.shape[1])
        own += 2.0 * stiff * ((_turned(room) * (at.beyond != 0.0)[:, None]) @ room)
        dyad = self.curves.summed((at.p[:, None] * slope).ravel()) * np.sqrt(x.worst / width)
        return _Newton(self.curves.summed(gradient.ravel()) + self.ridge * at.c, own, -after @ lean[:-1], dyad)

    def step(self, newton: _Newton, damped: float) -> Array | None:
        """Levenberg and Marquardt's (m,); None where rounding leaves none."""
        right = np.column_stack([-newton.gradient, newton.dyad])
        found = self.curves.solved(newton.own + damped * self.damping, newton.on, self.ridge, RIDGE, right)
        if found is None:
            return None
        step, along = found.T
        left = 1.0 - float(newton.dyad @ along)  # Sherman & Morrison
        return np.asarray(step + along * (float(newton.dyad @ step) / left) if left > 1e-6 else step)


def _times(blocks: Array, z: Array) -> Array:
    """(n, k) of (n, k, d) and (n, d)."""
    return np.asarray((blocks @ z[:, :, None])[:, :, 0])


def _turned(blocks: Array) -> Array:
    return np.swapaxes(blocks, 1, 2)


def lessened(local: Local, steps: Steps, bounds: Bounds, curves: Bordered) -> Array:
    """(m,) coefficients at which the model is least, from 0 on.

    Args:
        curves: the offsets, station by station, of coefficients.
    """
    model, c = _Model(local, steps, bounds, curves), np.zeros(curves.curves.shape[1])
    for width, stiff in zip(WIDTHS, STIFF, strict=True):
        here, damped = model.terms(c, width, stiff), DAMPED
        for _ in range(STEPS):
            newton = model.newton(here, width, stiff)
            for _ in range(TRIES):
                step = model.step(newton, damped)
                there = None if step is None else model.terms(c + step, width, stiff)
                if there is not None and there.value < here.value:
                    break
                damped *= 10.0
            else:
                break
            if there is None:
                raise AssertionError("a step that leads down was found")
            gained, c, here, damped = here.value - there.value, there.c, there, 0.2 * damped
            if gained < ENOUGH * (1.0 + abs(here.value)):
                break
    return c
