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

from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from machopt.arrays import Array, Bools
from machopt.plan.bordered import Bordered
from machopt.plan.rounded import derived, valued

WIDTHS = np.geomspace(2e-2, 2e-5, 10)  # ε in rad, and in c₀ for the worst index
STIFF = np.geomspace(1e3, 1e6, 10)  # price per rad² beyond the bounds, at each width
STEPS = 60  # at one width; 12 at each of seven widths ended far from the least place: J 6 % higher on the rail job
DAMPED = 1e-2  # of J for a step across all of the bounds, at first
MORE, LESS, LEAST = 4.0, 0.3, 1e-6  # of it where the model does not fall, where it does at once; and at least
TRIES = 12
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


T = TypeVar("T", Local, Steps, Bounds)


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
        self.local, self.steps, self.bounds = _in_rows(local), _in_rows(steps), _in_rows(bounds)
        self.curves = curves
        n = len(local.gradient)
        wide = np.maximum(bounds.high - bounds.low, 1e-6)
        self.damping = (4.0 / (n * wide * wide))[:, :, None] * np.eye(wide.shape[1])
        self.ridge = SMOOTH / max(curves.curves.shape[1], 1)
        self.narrow = max(float(steps.slowness.max()), 1e-12)

    def terms(self, c: Array, width: float, stiff: float) -> _Terms:
        """The model at some coefficients (m,)."""
        x, walk, kept = self.local, self.steps, self.bounds
        z = self.curves.along(c).reshape(x.gradient.shape)
        value, *parts = valued(
            z, x.gradient, x.hessian, x.cost, x.slope, x.bend, x.counted, x.worst,
            walk.jump, walk.lean, walk.price, walk.lost, walk.seconds, walk.slowness,
            kept.low, kept.high, kept.lean, kept.under, kept.over, width, stiff, self.narrow,
        )  # fmt: skip
        return _Terms(value + 0.5 * self.ridge * float(c @ c), c, *parts)

    def newton(self, at: _Terms, width: float, stiff: float) -> _Newton:
        """Gradient and Hessian, that of the parabolas."""
        gradient, own, on, dyad = derived(
            at.slope, at.gradient, at.pull, at.curved, at.p, at.out, at.beyond,
            self.local.hessian, self.local.bend, self.local.worst, self.steps.lean, self.bounds.lean, width, stiff,
        )  # fmt: skip
        slope = self.curves.summed(gradient.ravel()) + self.ridge * at.c
        return _Newton(slope, own, on, self.curves.summed(dyad.ravel()))

    def step(self, newton: _Newton, damped: float) -> Array | None:
        """Levenberg and Marquardt's (m,); None where rounding leaves none."""
        right = np.column_stack([-newton.gradient, newton.dyad])
        found = self.curves.solved(newton.own + damped * self.damping, newton.on, self.ridge, RIDGE, right)
        if found is None:
            return None
        step, along = found.T
        left = 1.0 - float(newton.dyad @ along)  # Sherman & Morrison
        return np.asarray(step + along * (float(newton.dyad @ step) / left) if left > 1e-6 else step)


def _in_rows(given: T) -> T:
    """With its arrays as compiled code wants them, each row after row."""
    held = {f.name: getattr(given, f.name) for f in fields(given)}
    arrays: dict[str, Any] = {k: np.ascontiguousarray(v) for k, v in held.items() if isinstance(v, np.ndarray)}
    return replace(given, **arrays)


def lessened(local: Local, steps: Steps, bounds: Bounds, curves: Bordered) -> Array:
    """(m,) coefficients at which the model is least, from 0 on.

    Args:
        curves: the offsets, station by station, of coefficients.
    """
    model, c, damped = _Model(local, steps, bounds, curves), np.zeros(curves.curves.shape[1]), DAMPED
    for width, stiff in zip(WIDTHS, STIFF, strict=True):
        here = model.terms(c, width, stiff)
        for _ in range(STEPS):
            newton = model.newton(here, width, stiff)
            easy = True
            for _ in range(TRIES):
                step = model.step(newton, damped)
                there = None if step is None else model.terms(c + step, width, stiff)
                if there is not None and there.value < here.value:
                    break
                damped, easy = MORE * damped, False
            else:
                break
            if there is None:
                raise AssertionError("a step that leads down was found")
            gained, c, here = here.value - there.value, there.c, there
            damped = max(LESS * damped, LEAST) if easy else damped
            if gained < ENOUGH * (1.0 + abs(here.value)):
                break
    return c
