"""Motion over straight legs from rest to rest that rounds the corners between them instead of stopping there.

The rate of a leg is the share of it driven per second. At a corner the rate falls from r⁻ on the leg before, over the
step d, and rises to r⁺ on the leg behind, over the step e, both by one S-curve σ. Along a leg the rate changes by
S-curves from r⁺ of its first corner to a peak and from there to r⁻ of its last one; it is 0 where the motion begins and
ends. A change Δv of the joint velocities takes

    D = 1/A + A/J  where J ≥ A², else 2/√J,      A = min_i a_i/|Δv_i|,  J = min_i j_i/|Δv_i|                      (1)

with the limits a_i, j_i of acceleration and jerk; at a corner Δv = r⁺ e − r⁻ d. The velocity is a mean of both in the
meantime, so that the speed limits hold where each rate keeps those of its leg. S-curves are symmetric: the corner is
rounded over the shares r⁻ D/2 and r⁺ D/2 of its legs, and a change along a leg from r to s covers (r + s) D/2 of it.
The peak is the highest that fits between the corners. The rates at the corners minimise the time of the whole motion,
with these shares at most ``most``.

Without corners this is the fastest jerk-limited motion from rest to rest. The curve at a corner lies in the triangle of
the corner and the places on its legs where the rounding begins and ends.

Source: own derivation from limits of speed, acceleration and jerk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

FIRST, LAST = 0.4, 0.02  # relative change of a rate: first and last tried
STARTS = (0.6, 0.2)  # rates at the corners from which the search begins, as shares of the peaks with stops
WINDOW = 2  # rates that are changed together
HALVINGS = 40
SLACK = 1e-12
NO_TIME = 1e30  # s: not possible


@dataclass(frozen=True, kw_only=True)
class CornerTiming:
    """Times of K legs from rest to rest; M S-curves in order."""

    start: Array  # (M,) s
    length: Array  # (M,) s, D
    acceleration: Array  # (M,) 1/s, A of the S-curve from 0 to 1
    jerk: Array  # (M,) 1/s², J of it
    weight: Array  # (K, M) 1/s, by which each changes the rate of each leg
    duration: float  # s, of the whole motion

    def get_curve(self, corner: int) -> int:
        """Return the number of the S-curve of a corner.

        Args:
            corner: 1 … K − 1.
        """
        return 3 * corner - 1

    def get_rounded_shares(self, corner: int) -> tuple[float, float]:
        """Return the shares of the legs before and behind a corner over which it is rounded.

        Args:
            corner: 1 … K − 1.
        """
        m = self.get_curve(corner)
        half = 0.5 * float(self.length[m])
        return -float(self.weight[corner - 1, m]) * half, float(self.weight[corner, m]) * half

    def compute_shares(self, time: Array) -> Array:
        """Return (S, K) shares of the legs driven at times (S,) s."""
        passed = np.stack([self._integrate(m, time) for m in range(len(self.start))], axis=1)
        return np.asarray(np.clip(passed @ self.weight.T, 0.0, 1.0))

    def _integrate(self, m: int, time: Array) -> Array:
        """(S,) s, integral of an S-curve up to the times."""
        a, j, whole = float(self.acceleration[m]), float(self.jerk[m]), float(self.length[m])
        t = time - self.start[m]
        if whole <= 0.0:
            return np.asarray(np.maximum(t, 0.0))
        rise = min(a / j, whole / 2.0)
        x = np.clip(t, 0.0, whole)
        first = _integrate_half(np.minimum(x, whole - x), rise, j)
        mirrored = x - whole / 2.0 + first  # σ(D − t) = 1 − σ(t)
        return np.asarray(np.where(x <= whole / 2.0, first, mirrored) + np.maximum(t - whole, 0.0))


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
    steps, limits = np.ascontiguousarray(steps), np.ascontiguousarray(limits)
    rate, time, stopping = _find_rates(steps, limits, np.ascontiguousarray(most))
    return _build_timing(rate, steps, limits) if time < stopping else None


def measure_fastest_time(steps: Array, limits: Array, rounded: bool, most: Array | None = None) -> float:
    """Return the time in s of consecutive legs, with every corner rounded as far as it may, or with stops.

    Args:
        steps: (K, n) rad or m, each with a joint that moves.
        limits: (3, n) speed, acceleration and jerk.
        rounded: whether corners may be rounded.
        most: (K − 1,) largest share of a leg over which each corner may be rounded; None: half of it.
    """
    steps, limits = np.ascontiguousarray(steps), np.ascontiguousarray(limits)
    shares = np.full(len(steps) - 1, 0.5) if most is None else np.ascontiguousarray(most)
    _, time, stopping = _find_rates(steps, limits, shares)
    return float(min(time, stopping) if rounded and len(steps) > 1 else stopping)


def _build_timing(rate: Array, steps: Array, limits: Array) -> CornerTiming:
    """Return the S-curves of the rates at the corners, (2K,) as :func:`_find_rates` has them."""
    count = len(steps)
    line = np.array([_measure_line(step, limits) for step in steps])
    curves, weight, start = [], np.zeros((count, 3 * count - 1)), 0.0
    rounded = [0.0] * (count + 1)
    turns: list[Any] = [None] * (count + 1)
    for k in range(1, count):
        turns[k] = _curve(rate[2 * k] * steps[k] - rate[2 * k - 1] * steps[k - 1], limits)
        rounded[k] = 0.5 * turns[k][0]
    for k in range(count):
        begin, end = rate[2 * k], rate[2 * k + 1]
        room = 1.0 - begin * rounded[k] - end * rounded[k + 1]
        peak = _find_peak(begin, end, room, line[k])
        rise, fall = (_change(peak - r, line[k]) for r in (begin, end))
        way = 0.5 * (begin + peak) * rise + 0.5 * (peak + end) * fall
        for m, (size, length) in enumerate(((peak - begin, rise), (end - peak, fall))):
            of = abs(size) if size else 1.0
            curves.append((start, length, line[k, 1] / of, line[k, 2] / of))
            weight[k, 3 * k + m] = size
            start += length + (max(room - way, 0.0) / peak if m == 0 else 0.0)
        if k + 1 < count:
            length, a, j = turns[k + 1]
            curves.append((start, length, a, j))
            weight[k, 3 * k + 2], weight[k + 1, 3 * k + 2] = -end, rate[2 * k + 2]
            start += length
    table = np.array(curves)
    return CornerTiming(
        start=table[:, 0],
        length=table[:, 1],
        acceleration=table[:, 2],
        jerk=table[:, 3],
        weight=weight,
        duration=start,
    )


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
def _measure_line(step: Array, limits: Array) -> Any:
    """Return the limits of the rate of a leg and its derivatives."""
    v, a, j = np.inf, np.inf, np.inf
    for i in range(len(step)):
        size = abs(step[i])
        if size > 0.0:
            v, a, j = min(v, limits[0, i] / size), min(a, limits[1, i] / size), min(j, limits[2, i] / size)
    return v, a, j


@jit_compile
def _change(size: float, line: Any) -> Any:
    """Time of a change of the rate along a leg, equation (1)."""
    if size <= 0.0:
        return 0.0
    a, j = line[1], line[2]
    return size / a + a / j if size * j >= a * a else 2.0 * np.sqrt(size / j)


@jit_compile
def _find_peak(begin: float, end: float, room: float, line: Any) -> float:
    """Highest rate between two rates over a share of a leg; below 0 where not even the change between them fits."""
    low = max(begin, end)
    if 0.5 * (begin + end) * _change(abs(end - begin), line) > room + SLACK:
        return -1.0
    high = line[0]
    if low > high:
        return -1.0
    if 0.5 * (begin + high) * _change(high - begin, line) + 0.5 * (high + end) * _change(high - end, line) <= room:
        return float(high)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        way = 0.5 * (begin + middle) * _change(middle - begin, line) + 0.5 * (middle + end) * _change(
            middle - end, line
        )
        if way <= room:
            low = middle
        else:
            high = middle
    return float(low)


@jit_compile
def _fit_corner(rate: Array, k: int, steps: Array, limits: Array, most: float) -> float:
    """Lower both rates at the corner behind leg k, by the same factor, until it is rounded over no more than ``most``
    of either leg; return the duration of its change in s.
    """
    change = rate[2 * k + 2] * steps[k + 1] - rate[2 * k + 1] * steps[k]
    _, a, j = _curve(change, limits)
    largest = max(rate[2 * k + 1], rate[2 * k + 2])
    turn = 1.0 / a + a / j if j >= a * a else 2.0 / np.sqrt(j)
    if 0.5 * turn * largest <= most:
        return float(turn)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        f = 0.5 * (low + high)
        turn = f / a + a / j if j * f >= a * a else 2.0 * np.sqrt(f / j)
        if 0.5 * turn * f * largest <= most:
            low = f
        else:
            high = f
    rate[2 * k + 1] *= low
    rate[2 * k + 2] *= low
    return float(low / a + a / j if j * low >= a * a else 2.0 * np.sqrt(low / j))


@jit_compile
def _compute_duration(rate: Array, steps: Array, lines: Array, limits: Array, most: Array) -> float:
    """Time in s with some rates at the corners; NO_TIME where they are not possible.

    Rates are lowered where a corner would be rounded too far.
    """
    count = len(steps)
    total, before = 0.0, 0.0
    for k in range(count):
        turn = _fit_corner(rate, k, steps, limits, most[k]) if k + 1 < count else 0.0
        begin, end = rate[2 * k], rate[2 * k + 1]
        room = 1.0 - 0.5 * begin * before - 0.5 * end * turn
        peak = _find_peak(begin, end, room, lines[k])
        if peak <= 0.0:
            return NO_TIME
        rise, fall = _change(peak - begin, lines[k]), _change(peak - end, lines[k])
        way = 0.5 * (begin + peak) * rise + 0.5 * (peak + end) * fall
        total += rise + fall + max(room - way, 0.0) / peak + turn
        before = turn
    return total


@jit_compile
def _find_rates(steps: Array, limits: Array, most: Array) -> Any:
    """Return the rates at begin and end of each leg, (2K,) 1/s, of the shortest motion found, its time in s, and the
    time with a stop at every corner.

    The search lowers, keeps or raises neighbouring rates by a factor, in every combination, as long as that is faster,
    and then by a smaller factor.
    """
    count = len(steps)
    lines = np.empty((count, 3))
    peaks, stopping = np.empty(count), 0.0
    for k in range(count):
        lines[k, 0], lines[k, 1], lines[k, 2] = _measure_line(steps[k], limits)
        peaks[k] = _find_peak(0.0, 0.0, 1.0, lines[k])
        rise = _change(peaks[k], lines[k])
        stopping += 2.0 * rise + (1.0 - peaks[k] * rise) / peaks[k]
    best, best_time = np.zeros(2 * count), NO_TIME
    for share in STARTS:
        rate = np.zeros(2 * count)
        for k in range(1, 2 * count - 1):
            rate[k] = share * peaks[k // 2]
        time = _compute_duration(rate, steps, lines, limits, most)
        size = FIRST
        while size > LAST:
            better = False
            for first in range(1, 2 * count - 1 - WINDOW + 1):
                for code in range(3**WINDOW):
                    trial, rest = rate.copy(), code
                    for k in range(first, first + WINDOW):
                        trial[k] = min(trial[k] * (1.0 + size) ** (rest % 3 - 1), lines[k // 2, 0])
                        rest //= 3
                    taken = _compute_duration(trial, steps, lines, limits, most)
                    if taken < time - SLACK:
                        rate, time, better = trial, taken, True
            if not better:
                size *= 0.5
        if time < best_time:
            best, best_time = rate, time
    return best, best_time, stopping
