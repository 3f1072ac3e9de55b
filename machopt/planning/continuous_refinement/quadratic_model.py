"""Quadratic model of J around a sequence of poses, in the coefficients of curves of rotation and external joints.

With z (n, d) the offsets at the stations, z = M c, the model is

    Σ (gᵀz + ½ zᵀHz) + w·max (c + sᵀz + ½ zᵀBz) + Σ price·|v| + Σ lost·max(0, |v|·slowness − seconds)

with v the steps of joints, external joints and rotation from station to station, linear in z. The lost time is a sum of
absolute values too, of v ± seconds/slowness, and so is an exact penalty for violated bounds. The model is therefore
convex. A primal-dual interior point method finds its minimum (Wright 1997, Primal-Dual Interior-Point Methods,
chapters 1 and 6), in about 20 Newton steps
(:mod:`machopt.planning.continuous_refinement.interior_point_kernels`). Each term couples one
station or two neighbouring ones: the Hessian is block tridiagonal in z, banded in the coefficients of splines, and
sparse where a value is shared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.planning.continuous_refinement.bordered_system import BorderedSystem
from machopt.planning.continuous_refinement.interior_point_kernels import (
    compute_absolute_arguments,
    compute_indices,
    compute_newton_terms,
    take_newton_step,
)

BEYOND = 20.0  # penalty per rad outside the bounds: greater than the gain in J, so that the result is inside
REACH = 2.0  # times the bounds: range that the iterates may reach
FIRST, LAST = 0.1, 1e-5  # initial and final gap, as a share of the non-smooth terms
STEPS = 60  # at most
FULL = 0.9  # share of a step from which it counts as full
FAST, SLOW = 0.1, 0.5  # factors of the gap after a full and after a shortened step
BISECTED = 60  # bisection steps for the initial worst index
SINGULAR = 1e-12
RIDGE = 1e-14  # added to the Hessian, of its largest entry
SMOOTH = 1e-4  # weight of the squared coefficients: undetermined coefficients stay at 0


@dataclass(frozen=True, kw_only=True)
class LocalModel:
    """Derivatives around the pose of each of n stations, by finite differences."""

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


@dataclass(frozen=True, kw_only=True)
class TransitionTerms:
    """The steps between stations: k absolute values each."""

    jump: Array  # (n − 1, k) at z = 0
    lean: Array  # (n, k, d) of the values whose differences they are
    price: Array  # (n − 1, k)
    lost: Array  # (n − 1,) price of a second lost
    seconds: Array  # (n − 1,)
    slowness: Array  # (k,) s/rad


@dataclass(frozen=True)
class OffsetBounds:
    """Bounds of z; 0 is inside."""

    low: Array  # (n, d)
    high: Array  # (n, d)
    lean: Array  # (n, m, d) derivative of the constrained linear values
    under: Array  # (n, m) their lower bounds
    over: Array  # (n, m) their upper bounds


@dataclass(frozen=True)
class AbsoluteValueTerms:
    """Weighted absolute values of ``at`` + ``lean`` times the offsets of a station and of the next."""

    row: NDArray[np.int64]  # (J,) the station
    lean: Array  # (J, 2d)
    at: Array  # (J,) rad
    price: Array  # (J,) per rad
    beside: Array  # (n, d) linear part: a one-sided bound is half an absolute value plus half a line

    @classmethod
    def build(cls, steps: TransitionTerms, bounds: OffsetBounds) -> AbsoluteValueTerms:
        """Return the terms of all steps and bounds; those that cannot become active within the bounds are left out.

        Args:
            steps: steps between stations.
            bounds: bounds of the offsets.
        """
        n, d = bounds.low.shape
        reach = np.maximum(-bounds.low, bounds.high)
        pair = np.concatenate([-steps.lean[:-1], steps.lean[1:]], axis=2)
        walk = np.einsum("skd,sd->sk", np.abs(pair), np.hstack([reach[:-1], reach[1:]]))
        late = 0.5 * steps.lost[:, None] * steps.slowness
        limit = steps.seconds[:, None] / np.maximum(steps.slowness, 1e-12)
        reached = (late > 0.0) & (np.abs(steps.jump) + REACH * walk > limit)
        between = np.broadcast_to(np.arange(n - 1)[:, None], steps.jump.shape)
        out = [(steps.price > 0.0, between, pair, steps.jump, steps.price)]
        out += [(reached, between, pair, steps.jump + side * limit, late) for side in (-1.0, 1.0)]
        slopes = np.concatenate([np.broadcast_to(np.eye(d), (n, d, d)), bounds.lean], axis=1)
        room = REACH * np.einsum("nmd,nd->nm", np.abs(slopes), reach)
        alone = np.concatenate([slopes, np.zeros_like(slopes)], axis=2)
        stations = np.broadcast_to(np.arange(n)[:, None], room.shape)
        low, high = np.hstack([bounds.low, bounds.under]), np.hstack([bounds.high, bounds.over])
        below, above = -low <= room, high <= room
        for near, end in ((below, low), (above, high)):
            out.append((near, stations, alone, np.where(near, -end, 0.0), np.full(end.shape, 0.5 * BEYOND)))
        linear_part = 0.5 * BEYOND * np.einsum("nm,nmd->nd", above.astype(float) - below, slopes)
        row, lean, at, price = (np.concatenate([one[i][one[0]] for one in out]) for i in range(1, 5))
        return cls(row.astype(np.int64), lean, at, price, linear_part)


class QuadraticModel:
    """Quadratic model of J as a function of the coefficients."""

    def __init__(self, local: LocalModel, steps: TransitionTerms, bounds: OffsetBounds, curves: BorderedSystem) -> None:
        self.curves, self.kinks, self.shape = curves, AbsoluteValueTerms.build(steps, bounds), local.gradient.shape
        self.counted: Bools = np.asarray(local.counted & (local.worst > 0.0))
        self.worst = local.worst if self.counted.any() else 0.0
        self.gradient, self.hessian = local.gradient + self.kinks.beside, np.ascontiguousarray(local.hessian)
        self.index = (
            np.ascontiguousarray(local.cost), np.ascontiguousarray(local.slope), np.ascontiguousarray(local.bend)
        )  # fmt: skip
        self.ridge = SMOOTH / max(curves.curves.shape[1], 1)

    def offsets(self, c: Array) -> Array:
        """Return the (n, d) offsets at the stations.

        Args:
            c: (m,) coefficients.
        """
        return self.curves.along(c).reshape(self.shape)

    def value(self, c: Array) -> float:
        """Return the model at some coefficients, up to a constant.

        Args:
            c: (m,) coefficients.
        """
        z, k = self.offsets(c), self.kinks
        smooth = float((z * (self.gradient + 0.5 * np.einsum("nij,nj->ni", self.hessian, z))).sum())
        kinks = float(k.price @ np.abs(compute_absolute_arguments(z, k.row, k.lean, k.at)))
        top = float(compute_indices(z, *self.index)[self.counted].max()) if self.worst else 0.0
        return float(smooth + kinks + self.worst * top + 0.5 * self.ridge * float(c @ c))

    def step(self, c: Array, on: CentralPathState, mu: float) -> Array | None:
        """Return the (m,) Newton step, shortened to stay feasible; None where rounding prevents one.

        Args:
            c: (m,) coefficients.
            on: state of the other unknowns; updated.
            mu: target of the products.
        """
        k = self.kinks
        gradient, own, below_diagonal, dyad, curvature, multiplier_offset, index_slope, residual = compute_newton_terms(
            self.offsets(c), on.top, self.gradient, self.hessian, *self.index, self.counted, self.worst,
            k.row, k.lean, k.at, on.plus, on.minus, on.above, on.below, on.slack, on.share, mu,
        )  # fmt: skip
        slope, across = self.curves.summed(gradient.ravel()) + self.ridge * c, self.curves.summed(dyad.ravel())
        found = self.curves.solved(own, below_diagonal, self.ridge, RIDGE, np.column_stack([-slope, across]))
        if found is None:
            return None
        step, along = found.T
        left = 1.0 - float(across @ along)  # Sherman & Morrison
        whole = np.asarray(step + along * (float(across @ step) / left) if left > SINGULAR else step)
        if not np.isfinite(whole).all():
            return None
        on.taken, on.top = take_newton_step(
            self.offsets(whole), on.top, mu, self.worst, self.counted, k.row, k.lean, curvature, multiplier_offset,
            index_slope, residual,
            on.slack, on.share, on.plus, on.minus, on.above, on.below,
        )  # fmt: skip
        return np.asarray(on.taken * whole)


@dataclass(kw_only=True)
class CentralPathState:
    """Unknowns of the interior point method besides the coefficients; products with multipliers are near μ."""

    plus: Array  # (J,) positive part of v of each kink
    minus: Array  # (J,) negative part of v
    above: Array  # (J,) price less the multiplier y of v = plus − minus
    below: Array  # (J,) price and y
    slack: Array  # (n,) of the worst index
    share: Array  # (n,) of its price
    top: float  # the worst index
    taken: float = 0.0  # of the last step

    @classmethod
    def at_first(cls, model: QuadraticModel, mu: float) -> CentralPathState:
        """Return the state on the central path, except for the gradient, at z = 0.

        Args:
            model: model of J.
            mu: value of the products.
        """
        v, w = model.kinks.at, model.kinks.price
        a = np.abs(w * v)
        root = np.sqrt(mu * mu + a * a)
        greater = (mu + a + root) / (2.0 * w)
        lesser = mu * greater / (a + root)
        plus, minus = np.where(v > 0.0, greater, lesser), np.where(v > 0.0, lesser, greater)
        index, counted = model.index[0], model.counted
        slack, share, top = np.ones(len(index)), np.zeros(len(index)), 0.0
        if model.worst:
            high = float(index[counted].max())
            least, most = high + mu / model.worst, high + mu * int(counted.sum()) / model.worst
            for _ in range(BISECTED):
                top = 0.5 * (least + most)
                over = float((mu / (top - index[counted])).sum()) > model.worst
                least, most = (top, most) if over else (least, top)
            slack[counted] = top - index[counted]
            share[counted] = mu / slack[counted]
        return cls(plus=plus, minus=minus, above=mu / plus, below=mu / minus, slack=slack, share=share, top=top)

    def gap(self) -> float:
        """Return the sum of all products (duality gap)."""
        return float(self.plus @ self.above + self.minus @ self.below + self.slack @ self.share)


def minimize_quadratic_model(
    local: LocalModel, steps: TransitionTerms, bounds: OffsetBounds, curves: BorderedSystem
) -> Array:
    """Return the (m,) coefficients at the minimum of the model, starting from 0.

    Args:
        local: derivatives at the stations.
        steps: steps between the stations.
        bounds: bounds of the offsets.
        curves: map from coefficients to offsets, station by station.
    """
    model, c = QuadraticModel(local, steps, bounds, curves), np.zeros(curves.curves.shape[1])
    k = model.kinks
    pairs = 2 * len(k.row) + int(model.counted.sum())
    whole = abs(local.worst * float(local.cost.max())) + float(steps.price.ravel() @ np.abs(steps.jump).ravel())
    mu, last = FIRST * whole / pairs, LAST * whole
    on = CentralPathState.at_first(model, mu)
    for _ in range(STEPS):
        step = model.step(c, on, mu)
        if step is None:
            break
        c = c + step
        gap = on.gap()
        if gap < last and on.taken > FULL:
            break
        mu = (FAST if on.taken > FULL else max(SLOW, 1.0 - on.taken)) * gap / pairs
    return c
