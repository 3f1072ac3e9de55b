"""Minimisation of the objective along one run in the coefficients of a spline, by Newton's method.

J is a sum of smooth prices of places, absolute values and maxima of functions linear in the coefficients, and the worst
cost. Its kinks are smoothed with a width ε that goes to zero,

    |v| → s = √(v² + ε²),    max(x₁ … xₙ) → ε log Σ exp(xᵢ/ε),

and leaving the corridor costs the square of the distance, with an increasing price. All prices depend on the offsets at
the stations, each on one or two neighbours, so the Hessian is tridiagonal there and banded in the coefficients; the
worst cost adds one dyad.

Source of the step for the absolute values: Chan, Golub & Mulet 1999 (SIAM J. Sci. Comput. 20:1964–1977). It linearises
z s = v with a separate dual z ∈ [−1, 1] instead of v/s, which keeps Newton's steps long as ε goes to zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import compute_preference_cost
from machopt.planning.smoothing.corridor import SmoothingStretch, StretchEnds
from machopt.planning.smoothing.cost_interpolation import CostInterpolation
from machopt.planning.smoothing.cubic_curves import compute_cubic_basis

WIDTHS = np.r_[np.geomspace(3e-2, 3e-7, 16), 3e-7, 3e-7]  # ε in rad, and in c₀ for the worst cost
STIFF = np.r_[np.geomspace(3e3, 3e5, 16), 3e6, 3e7]  # price per rad² outside the corridor, at each width
STEPS = 6  # maximum number of Newton steps at one width
ENOUGH = 1e-9  # share of J: a step with a smaller predicted gain is not taken
LEAST = 1e-4  # share of the predicted gain that a step must achieve
RIDGE = 1e-12  # added to the Hessian, of its largest entry
HALVINGS = 8
SECOND = (1.0, -2.0, 1.0)  # second difference


class SplineBasis:
    """Basis of a cubic spline at n places: four consecutive coefficients at each."""

    def __init__(self, knots: Array, places: Array) -> None:
        self.n, self.m = len(places), len(knots) - 4
        self.columns, self.weights = compute_cubic_basis(knots, places)
        # positions of products of two coefficients in a band: of one place, and of a place and the next
        a, b = np.tril_indices(4)
        own = self.columns[:, a], self.columns[:, b], self.weights[:, a] * self.weights[:, b]
        a, b = (x.ravel() for x in np.indices((4, 4)))
        i, j = self.columns[:-1, a], self.columns[1:, b]
        tied = i, j, self.weights[:-1, a] * self.weights[1:, b] * np.where(i == j, 2.0, 1.0)
        self._at = [np.abs(i - j) * self.m + np.minimum(i, j) for i, j, _ in (own, tied)]
        self._products = own[2], tied[2]
        self.lags = max(int(max(at.max(initial=0) for at in self._at)) // self.m, min(2, self.m - 1)) + 1

    def values(self, c: Array) -> Array:
        """Return the (n,) values of the spline.

        Args:
            c: (m,) coefficients.
        """
        return np.asarray((self.weights * c[self.columns]).sum(axis=1))

    def transposed(self, v: Array) -> Array:
        """Return (m,) Bᵀv.

        Args:
            v: (n,) values at the places.
        """
        return np.asarray(np.bincount(self.columns.ravel(), (self.weights * v[:, None]).ravel(), self.m), float)

    def hessian(self, diagonal: Array, beside: Array) -> Array:
        """Return the lower band (lags, m) of BᵀTB, with T a symmetric tridiagonal matrix.

        Args:
            diagonal: (n,) diagonal of T.
            beside: (n − 1,) off-diagonal of T.
        """
        own, tied = (
            np.bincount(at.ravel(), (p * d[:, None]).ravel(), self.lags * self.m)
            for at, p, d in zip(self._at, self._products, (diagonal, beside), strict=True)
        )
        return np.asarray((own + tied).reshape(self.lags, self.m))


@dataclass(frozen=True, kw_only=True)
class _RatedPlaces:
    """Prices of the n places by themselves, and their derivatives with respect to the rotations."""

    value: float
    gradient: Array  # (n,)
    diagonal: Array  # (n,)
    delta: Array  # (n,) rad, from the middle of the corridor
    cost: Array  # (n,) index in units of c₀
    slope: Array  # (n,) 1/rad, its derivative
    hollow: Array  # (n,) 1/rad², its second derivative where positive


@dataclass(frozen=True, kw_only=True)
class RoundedObjective:
    """Smoothed objective at one point: value, and gradient and Hessian in the offsets (n,)."""

    value: float
    gradient: Array  # (n,)
    diagonal: Array  # (n,) of the Hessian, without the absolute values along the stations
    first: Array  # (n − 1,) contribution of lost time for the previous station, the next one, and both
    last: Array
    both: Array
    dyad: Array  # (n,) ``dyad dyadᵀ`` is to be added to the Hessian
    price: Array  # (7, n − 1) of every absolute value v along the stations
    slope: Array  # (7, n − 1) v/s
    size: Array  # (7, n − 1) s


class SplineObjective:
    """J of one stretch as a function of the coefficients (m,) of its spline."""

    def __init__(
        self,
        part: SmoothingStretch,
        table: CostInterpolation,
        basis: SplineBasis,
        bending: float,
        ends: StretchEnds,
        elsewhere: float,
    ) -> None:
        """Prepare the constant terms of the objective.

        Args:
            part: stretch of stations.
            table: interpolated cost.
            basis: basis of the spline at the stations.
            bending: price of the sum of squares of the coefficients' second differences; no part of J.
            ends: joints before and after the rapid moves at its ends.
            elsewhere: the worst cost of the other stretches, in units of c₀.
        """
        band, terms, w = part.band, part.terms, part.terms.weights
        self.part, self.table, self.basis, self.bending, self.elsewhere = part, table, basis, bending, elsewhere
        self.crowded = None if band.crowded is None else CostInterpolation(band.crowded, band.step)
        self.low, self.high = part.bounds()
        # absolute values along the stations: six joints and the rotation, all linear in two neighbouring offsets
        lean = np.vstack([band.slope.T, np.ones(len(band.q))])
        self.back, self.on = np.ascontiguousarray(-lean[:, :-1]), np.ascontiguousarray(lean[:, 1:])
        self.jump = np.diff(np.vstack([band.q.T, band.phi]), axis=1)
        self.price = np.tile(w.travel * terms.travel[1:], (7, 1))
        self.price[6] = w.rotation * terms.rotation[1:]
        self.lost, self.seconds, self.slowness = w.feed * terms.lost[1:], terms.seconds[1:], terms.slowness[:, None]
        # and at the ends: station, slope and distance of the joints, price
        flown = ((0, ends.before, w.travel * terms.travel[0]), (-1, ends.after, ends.onward))
        self.flights = [(i, band.slope[i], band.q[i] - q, price) for i, q, price in flown if q is not None]

    def _rate_places(self, phi: Array, stiff: float) -> _RatedPlaces:
        """Return mean index, preference, clearance and the price of leaving the corridor at phi (n,) rad."""
        part, terms, w = self.part, self.part.terms, self.part.terms.weights
        delta = phi - part.band.phi
        cost, slope, bend = self.table.at(delta)
        share, hollow = terms.share, np.maximum(bend, 0.0)
        value = float(w.mean * (share @ cost))
        gradient, diagonal = w.mean * share * slope, w.mean * share * hollow
        if terms.liking is not None:
            away = phi + terms.offset - terms.liking.rotation
            value += float(share @ compute_preference_cost(np.cos(away), terms.liking.weight))
            half = 0.5 * terms.liking.weight * share
            gradient += half * np.sin(away)
            diagonal += half * np.maximum(np.cos(away), 0.0)
        if self.crowded is not None:
            near, rise, bent = self.crowded.at(delta)
            value += float(w.clearance * (share @ near))
            gradient += w.clearance * share * rise
            diagonal += w.clearance * share * np.maximum(bent, 0.0)
        out = np.minimum(delta - self.low, 0.0) + np.maximum(delta - self.high, 0.0)
        value += stiff * float(out @ out)
        gradient += 2.0 * stiff * out
        diagonal += 2.0 * stiff * (out != 0.0)
        return _RatedPlaces(
            value=value, gradient=gradient, diagonal=diagonal, delta=delta, cost=cost, slope=slope, hollow=hollow
        )

    def _add_flights(self, value: float, gradient: Array, diagonal: Array, delta: Array, width: float) -> float:
        """Add the prices of the rapid moves to gradient and diagonal (n,), in place; return the value with them."""
        for i, lean, apart, flight in self.flights:
            f = apart + lean * delta[i]
            r = np.sqrt(f * f + width * width)
            value += flight * float(r.sum())
            gradient[i] += flight * float((lean * f / r).sum())
            diagonal[i] += flight * float((lean**2 * width * width / r**3).sum())
        return value

    def model(self, c: Array, width: float, stiff: float) -> RoundedObjective:
        """Return the smoothed J, with the price of leaving the corridor and without that of bending.

        Args:
            c: (m,) coefficients.
            width: ε, in rad, and in c₀ for the worst cost.
            stiff: price per rad² outside the corridor.
        """
        terms, w = self.part.terms, self.part.terms.weights
        nodes = self._rate_places(self.basis.values(c), stiff)
        value, gradient, diagonal = nodes.value, nodes.gradient, nodes.diagonal
        delta, slope = nodes.delta, nodes.slope
        # the worst cost: a smoothed maximum, with the shares p of the places that contribute
        high = np.where(terms.counted, nodes.cost, -np.inf)
        top = max(float(high.max()), self.elsewhere)
        p = np.exp((high - top) / width)
        whole = float(p.sum()) + float(np.exp((self.elsewhere - top) / width))
        p /= whole
        value += w.worst * (top + width * float(np.log(whole)))
        gradient += w.worst * p * slope
        diagonal += w.worst * p * (nodes.hollow + slope**2 / width)
        value = self._add_flights(value, gradient, diagonal, delta, width)
        v = self.jump + self.back * delta[:-1] + self.on * delta[1:]
        s = np.sqrt(v * v + width * width)
        z, price = v / s, self.price
        value += float((price * s).sum())
        first = last = both = np.zeros(len(delta) - 1)
        if self.lost.any():  # the slowest axis, a smoothed maximum with the shares e, and 0 where it is in time
            narrow = width * float(self.slowness.max())  # s
            over = (s[:6] * self.slowness - self.seconds) / narrow
            most = np.maximum(over.max(axis=0), 0.0)
            e = np.exp(over - most)
            total = e.sum(axis=0) + np.exp(-most)
            e /= total
            value += float(self.lost @ (narrow * (most + np.log(total))))
            price = price.copy()
            price[:6] += self.lost * e * self.slowness
            g, a, b = self.slowness * z[:6], self.back[:6], self.on[:6]
            eg, ega, egb, weight = e * g, e * g * a, e * g * b, self.lost / narrow
            pa, pb = ega.sum(axis=0), egb.sum(axis=0)
            first = weight * ((ega * g * a).sum(axis=0) - pa * pa)
            last = weight * ((egb * g * b).sum(axis=0) - pb * pb)
            both = weight * ((eg * g * a * b).sum(axis=0) - pa * pb)
        pull = price * z
        gradient[:-1] += (pull * self.back).sum(axis=0)
        gradient[1:] += (pull * self.on).sum(axis=0)
        return RoundedObjective(
            value=value,
            gradient=gradient,
            diagonal=diagonal,
            first=first,
            last=last,
            both=both,
            dyad=w.worst**0.5 * p * slope / width**0.5,
            price=price,
            slope=z,
            size=s,
        )

    def solve(self, start: Array) -> Array:
        """Return (m,) coefficients of a local minimum.

        Args:
            start: (m,) initial coefficients.
        """
        c, duals = start.copy(), None
        for width, stiff in zip(WIDTHS, STIFF, strict=True):
            here = self.model(c, width, stiff)
            if duals is None:
                duals = here.slope
            for _ in range(STEPS):
                curve = (1.0 - duals * here.slope) / here.size
                step, promised = self._step(c, here, here.price * curve)
                total, share, there = here.value + self._compute_bending(c), 1.0, here
                if not promised > ENOUGH * (1.0 + abs(total)):
                    break
                for _ in range(HALVINGS):
                    there = self.model(c + share * step, width, stiff)
                    if there.value + self._compute_bending(c + share * step) <= total - LEAST * share * promised:
                        break
                    share *= 0.5
                else:
                    break
                c = c + share * step
                turn = share * self.basis.values(step)
                duals = np.clip(here.slope + curve * (self.back * turn[:-1] + self.on * turn[1:]), -1.0, 1.0)
                here = there
        return c

    def _compute_bending(self, c: Array) -> float:
        second = np.diff(c, 2)
        return self.bending * float(second @ second)

    def hessian(self, here: RoundedObjective, curved: Array) -> tuple[Array, Array]:
        """Return both diagonals, (n,) and (n − 1,), of the Hessian in the offsets.

        Args:
            here: smoothed objective.
            curved: (7, n − 1) second derivatives of the absolute values.
        """
        diagonal = here.diagonal.copy()
        diagonal[:-1] += here.first + (curved * self.back * self.back).sum(axis=0)
        diagonal[1:] += here.last + (curved * self.on * self.on).sum(axis=0)
        return diagonal, here.both + (curved * self.back * self.on).sum(axis=0)

    def _step(self, c: Array, here: RoundedObjective, curved: Array) -> tuple[Array, float]:
        """Return Newton's step, and half of its first-order gain; ``curved`` as in :meth:`hessian`."""
        H = self.basis.hessian(*self.hessian(here, curved))
        second = 2.0 * self.bending * np.diff(c, 2)
        gradient, dyad = self.basis.transposed(here.gradient), self.basis.transposed(here.dyad)
        n = len(second)
        for k, by in enumerate(SECOND):
            gradient[k : k + n] += by * second
            for j in range(k + 1):
                H[k - j, j : j + n] += 2.0 * self.bending * by * SECOND[j]
        H[0] += RIDGE * (1.0 + H[0].max())
        try:
            solved = solveh_banded(H, np.column_stack([gradient, dyad]), lower=True, check_finite=False)
        except LinAlgError:  # not positive definite by rounding
            return np.zeros_like(c), 0.0
        left = 1.0 - float(dyad @ solved[:, 1])  # Sherman & Morrison; positive while the Hessian is
        step = -solved[:, 0]
        if left > RIDGE:
            step -= solved[:, 1] * (float(dyad @ solved[:, 0]) / left)
        return step, -0.5 * float(gradient @ step)
