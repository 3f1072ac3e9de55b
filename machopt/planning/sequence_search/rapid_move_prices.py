"""Prices of rapid moves beyond their joint travel, as arrays of the compiled search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.planning.cost.rapid_time import RapidPricing, compute_rest_time


@dataclass(frozen=True)
class FlightPrices:
    """:class:`machopt.planning.cost.rapid_time.RapidPricing` of the arm at the stations."""

    need: Array  # (3, 6) s, s², s³ per rad
    external_need: Array  # (S, 3) s, s², s³
    prices: Array  # (3,) of a second, of a branch change, of a whole turn

    @classmethod
    def build(cls, rapid: RapidPricing | None, stations: int) -> FlightPrices:
        """Return the prices; zeros where there are none.

        Args:
            rapid: prices of the path, or None.
            stations: number of stations S.
        """
        if rapid is None:
            return cls(np.zeros((3, 6)), np.zeros((stations, 3)), np.zeros(3))
        prices = np.array([rapid.weights[0] * rapid.per_second, *rapid.price_changes()])
        return cls(np.ascontiguousarray(rapid.need[:, :6]), np.ascontiguousarray(rapid.external_need), prices)


@jit_compile
def price_flight(
    q: Any,
    turns: Any,
    here: tuple[int, int, int, int],
    before: tuple[int, int, int, int],
    loose: bool,
    travel: float,
    limit: float,
    need: Any,
    external_need: Any,
    prices: Any,
) -> Any:  # numba infers
    """Return the price of a rapid move; a value from ``limit`` on where it is not below it.

    Args:
        q: (S, R, B, 6) rad, joints without whole turns.
        turns: (T, 6) rad, whole turns.
        here: station, rotation, branch and turn of the end.
        before: the same of the start.
        loose: whole turns are free.
        travel: price per rad of the joints.
        limit: price from which on the exact value does not matter.
        need: (3, 6) s, s², s³ per rad.
        external_need: (S, 3) s, s², s³ of the external joints.
        prices: (3,) of :class:`FlightPrices`.
    """
    twopi = 2 * np.pi
    s, r, b, t = here
    su, ru, bu, tu = before
    length, whole = 0.0, 0.0
    for i in range(6):
        x = abs(q[s, r, b, i] + turns[t, i] - q[su, ru, bu, i] - turns[tu, i])
        if x > np.pi:
            if loose:
                x = abs(x - twopi * round(x / twopi))
            else:
                whole += round(x / twopi)
        length += x
    value = travel * length + prices[2] * whole
    if b != bu:
        value += prices[1]
    if not value < limit or not prices[0] > 0.0:
        return value
    slowness, inertia, harshness = external_need[s, 0], external_need[s, 1], external_need[s, 2]
    for i in range(6):
        x = abs(q[s, r, b, i] + turns[t, i] - q[su, ru, bu, i] - turns[tu, i])
        if loose and x > np.pi:
            x = abs(x - twopi * round(x / twopi))
        slowness, inertia = max(slowness, x * need[0, i]), max(inertia, x * need[1, i])
        harshness = max(harshness, x * need[2, i])
    if value + prices[0] * slowness >= limit:  # the time at the largest speed alone
        return value + prices[0] * slowness
    return value + prices[0] * compute_rest_time(slowness, inertia, harshness)
