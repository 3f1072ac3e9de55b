"""Motion over straight legs from rest to rest that rounds the corners between them instead of stopping there.

Leg k over the step d_k has a cruising rate V_k (share of the leg per second). At node n the velocity changes from V_n d_n
to V_n+1 d_n+1 by one S-curve σ for all joints, which takes

    D_n = 1/A + A/J  where J ≥ A², else 2/√J,      A = min_i a_i/|Δv_i|,  J = min_i j_i/|Δv_i|                   (1)

with the limits a_i, j_i of acceleration and jerk and the change of velocity Δv. The velocity is a mean of both during
that time, so that the speed limits hold where V_k ≤ min_i v_i/|d_k,i|. A leg needs the time 1/V_k plus what its ends
leave of the S-curves; with K legs

    T = D_0/2 + Σ_k 1/V_k + D_K/2,      1/V_k ≥ (D_k-1 + D_k)/2,                                                  (2)

and the curve leaves leg k by the share V_k D_k/2 before its end, and the same for its begin. The curve is in the triangle
of corner and both of these places. The rates minimise T with that share at most ``most`` of each corner.

With exact stops (2) is the fastest jerk-limited motion from rest to rest.

Source: own derivation; linear moves with blends of constant acceleration: Paul 1981, Robot Manipulators, chapter 5; here
with limited jerk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

FIRST, LAST = 0.25, 0.004  # relative change of a rate: first and last tried
STARTS = (1.0, 0.8, 0.6, 0.4)  # of the rates with stops, from which the search begins
WINDOW = 3  # legs whose rates are changed together
HALVINGS = 60
SLACK = 1e-12
NO_TIME = 1e30  # s: not possible


@dataclass(frozen=True)
class CornerTiming:
    """Times of K legs from rest to rest."""

    rate: Array  # (K,) 1/s, share of the leg per second while cruising
    change: Array  # (K + 1,) s, D: how long the velocity changes at each node
    acceleration: Array  # (K + 1,) 1/s, A of the unit S-curve
    jerk: Array  # (K + 1,) 1/s², J of it

    @property
    def start(self) -> Array:
        """(K + 1,) s, when each change begins."""
        lengths = 1.0 / self.rate + (self.change[:-1] - self.change[1:]) / 2.0
        return np.concatenate([[0.0], np.cumsum(lengths)])

    @property
    def duration(self) -> float:
        """Time of the whole motion in s."""
        return float(self.change[0] / 2.0 + (1.0 / self.rate).sum() + self.change[-1] / 2.0)

    def get_rounded_shares(self, corner: int) -> tuple[float, float]:
        """Return the shares of the legs before and after an inner node over which the corner is rounded.

        Args:
            corner: node, 1 … K − 1.
        """
        half = 0.5 * float(self.change[corner])
        return float(self.rate[corner - 1]) * half, float(self.rate[corner]) * half

    def get_middle(self, corner: int) -> float:
        """Return the time in s at which the change at a node is half done.

        Args:
            corner: node, 0 … K.
        """
        return float(self.start[corner] + self.change[corner] / 2.0)

    def compute_shares(self, time: Array) -> Array:
        """Return (S, K) shares of the legs driven at times (S,) s."""
        passed = np.stack([self._integrate(n, time) for n in range(len(self.change))], axis=1)
        shares: Array = np.clip(self.rate * (passed[:, :-1] - passed[:, 1:]), 0.0, 1.0)
        return shares

    def _integrate(self, n: int, time: Array) -> Array:
        """(S,) s, integral of the S-curve of a node up to the times."""
        a, j, whole = float(self.acceleration[n]), float(self.jerk[n]), float(self.change[n])
        t = time - self.start[n]
        if whole <= 0.0:
            return np.asarray(np.maximum(t, 0.0))
        rise = min(a / j, whole / 2.0)
        x = np.clip(t, 0.0, whole)
        first = _integrate_half(np.minimum(x, whole - x), rise, j)
        mirrored = x - whole / 2.0 + first  # σ(D − t) = 1 − σ(t)
        return np.where(x <= whole / 2.0, first, mirrored) + np.maximum(t - whole, 0.0)


def _integrate_half(x: Array, rise: float, j: float) -> Array:
    """Integral of the S-curve at times (S,) s in its first half."""
    low = np.minimum(x, rise)
    rest = x - low
    out: Array = j * low**3 / 6.0 + rest * (j * rise**2 / 2.0 + rest * j * rise / 2.0)
    return out


def time_legs(steps: Array, limits: Array, most: Array) -> CornerTiming | None:
    """Return the fastest timing found of consecutive legs; None where stops at every corner take no longer.

    Args:
        steps: (K, n) rad or m, each with a joint that moves.
        limits: (3, n) speed, acceleration and jerk.
        most: (K − 1,) largest share of a leg over which each corner may be rounded, above 0, at most 0.5.
    """
    rate, stopping = _find_rates(np.ascontiguousarray(steps), np.ascontiguousarray(limits), np.ascontiguousarray(most))
    found = _build_timing(rate, steps, limits)
    return found if found.duration < stopping else None


def _build_timing(rate: Array, steps: Array, limits: Array) -> CornerTiming:
    velocity = np.vstack([np.zeros_like(steps[:1]), rate[:, None] * steps, np.zeros_like(steps[:1])])
    curves = np.array([_curve(change, limits) for change in np.diff(velocity, axis=0)])
    return CornerTiming(rate, curves[:, 0], curves[:, 1], curves[:, 2])


@jit_compile
def _curve(change: Array, limits: Array) -> Any:
    """Return duration, A and J of the unit S-curve over a change of velocity, equation (1)."""
    a, j = np.inf, np.inf
    for i in range(len(change)):
        size = abs(change[i])
        if size > 0.0:
            a, j = min(a, limits[1, i] / size), min(j, limits[2, i] / size)
    if not a < np.inf:
        return 0.0, 1.0, 1.0
    return (1.0 / a + a / j if j >= a * a else 2.0 / np.sqrt(j)), a, j


@jit_compile
def _duration(rate: Array, steps: Array, limits: Array, most: Array) -> float:
    """Duration (2) in s; NO_TIME where the rates are not possible."""
    count, axes = steps.shape
    change = np.empty(axes)
    before = 0.0
    total = 0.0
    for n in range(count + 1):
        for i in range(axes):
            change[i] = (rate[n] * steps[n, i] if n < count else 0.0) - (
                rate[n - 1] * steps[n - 1, i] if n > 0 else 0.0
            )
        whole = _curve(change, limits)[0]
        if n > 0:
            if 1.0 / rate[n - 1] < 0.5 * (before + whole) - SLACK:
                return NO_TIME
            total += 1.0 / rate[n - 1]
        if 0 < n < count and 0.5 * whole * max(rate[n - 1], rate[n]) > most[n - 1] + SLACK:
            return NO_TIME
        if n == 0 or n == count:
            total += 0.5 * whole
        before = whole
    return total


@jit_compile
def _find_stopping_rate(step: Array, limits: Array) -> float:
    """Rate of a leg between two stops: the largest with time for both S-curves."""
    top = np.inf
    for i in range(len(step)):
        if abs(step[i]) > 0.0:
            top = min(top, limits[0, i] / abs(step[i]))
    if 1.0 / top >= _curve(top * step, limits)[0]:
        return float(top)
    low, high = 0.0, top
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if 1.0 / middle >= _curve(middle * step, limits)[0]:
            low = middle
        else:
            high = middle
    return float(low)


@jit_compile
def _find_rates(steps: Array, limits: Array, most: Array) -> Any:
    """Return the rates (K,) 1/s of the shortest motion found, and the time in s with a stop at every corner.

    The search lowers, keeps or raises the rates of a few neighbouring legs by a factor, in every combination, as long as
    that is faster, and then by a smaller factor.
    """
    count = len(steps)
    window = min(count, WINDOW)
    stopping, top = np.empty(count), np.empty(count)
    with_stops = 0.0
    for k in range(count):
        stopping[k] = _find_stopping_rate(steps[k], limits)
        with_stops += 1.0 / stopping[k] + _curve(stopping[k] * steps[k], limits)[0]
        top[k] = np.inf
        for i in range(steps.shape[1]):
            if abs(steps[k, i]) > 0.0:
                top[k] = min(top[k], limits[0, i] / abs(steps[k, i]))
    best, best_time = stopping * 1e-3, NO_TIME
    for share in STARTS:
        rate = stopping * share
        time = _duration(rate, steps, limits, most)
        size = FIRST
        while size > LAST:
            better = False
            for first in range(count - window + 1):
                for code in range(3**window):
                    trial, rest = rate.copy(), code
                    for k in range(first, first + window):
                        trial[k] = min(trial[k] * (1.0 + size) ** (rest % 3 - 1), top[k])
                        rest //= 3
                    taken = _duration(trial, steps, limits, most)
                    if taken < time - SLACK:
                        rate, time, better = trial, taken, True
            if not better:
                size *= 0.5
        if time < best_time:
            best, best_time = rate, time
    return best, with_stops
