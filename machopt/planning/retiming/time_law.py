"""Time law u(t) of one curve from rest to rest: as fast as feed and joint limits allow, jerk piecewise constant.

With q', q'', q''' the joints' derivatives along the curve, speed v = u̇, acceleration a and jerk j,

    |q' v| ≤ v_max      |q'' v² + q' a| ≤ a_max      |q''' v³ + 3 q'' v a + q' j| ≤ j_max      |p'| v ≤ feed

Every step takes the largest j for which these hold during the step *and* during a full stop after it.
The stop is a *plan* (c, x): brake to the speed c, keep it as far as u = x, then brake to standstill. Tried are
(0, ·) and, ahead of a sharp corner, the speed the corner allows and its far side. A plan depends on the state only.
Its next step is therefore always available as a continuation: the law cannot reach a state without continuation.
An acceleration is taken only as far as it can fade before the speed reaches its limit, so that the speed settles there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.retiming.time_law_kernels import compute_greedy_time_law, find_next_corners

FEED = 0.999  # target share of the programmed feed
ACCELERATION_SHARE = 0.9  # share of the limit that path curvature alone may use
JERK_SHARE = 0.85
SOFT = 4.0  # minimum number of steps for a speed change by the whole feed


@dataclass(frozen=True)
class TimeLaw:
    """Steps of constant jerk."""

    time: Array  # (K,) s, beginning of each step; the last entry is the end
    u: Array  # (K,) m
    v: Array  # (K,) m/s
    a: Array  # (K,) m/s²
    j: Array  # (K,) m/s³

    @property
    def duration(self) -> float:
        """Duration in s."""
        return float(self.time[-1])

    def at(self, time: Array) -> tuple[Array, Array, Array, Array]:
        """Return u, v, a, j at given times.

        Args:
            time: s, within [0, duration].
        """
        k = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        t = time - self.time[k]
        a = self.a[k] + self.j[k] * t
        v = self.v[k] + t * (self.a[k] + 0.5 * self.j[k] * t)
        return self.u[k] + t * (self.v[k] + t * (0.5 * self.a[k] + self.j[k] / 6.0 * t)), v, a, self.j[k]

    def slower(self, factor: float) -> TimeLaw:
        """Return the same motion slowed down.

        Args:
            factor: factor of the duration.
        """
        f = factor
        return TimeLaw(self.time * f, self.u, self.v / f, self.a / f**2, self.j / f**3)

    def stretched(self, u0: float, u1: float) -> TimeLaw:
        """Return the law scaled in u to end exactly at u1.

        Args:
            u0: m, first value of u.
            u1: m, last value of u.
        """
        f = (u1 - u0) / (self.u[-1] - self.u[0])
        u = u0 + (self.u - self.u[0]) * f
        u[-1] = u1
        return TimeLaw(self.time, u, self.v * f, self.a * f, self.j * f)


@dataclass(frozen=True, kw_only=True)
class SpeedBounds:
    """Speed bounds at the nodes of a curve."""

    u: Array  # (M,)
    derivatives: Array  # (M, n, 3) q', q'', q''' of the axes that move
    cap: Array  # (M,) m/s largest v
    velocity: Array  # (n,) limits, already scaled
    acceleration: Array
    jerk: Array


def compute_node_speed_limits(
    D: Array, feed_cap: Array, velocity: Array, acceleration: Array, jerk: Array
) -> tuple[Array, Array]:
    """Return the largest v (M,) at each node, and what each joint allows by velocity, acceleration and jerk (M, n, 3).

    Args:
        D: (M, n, 3) q', q'', q''' of the joints.
        feed_cap: (M,) m/s, largest v by the feed.
        velocity: (n,) scaled limits.
        acceleration: (n,) scaled limits.
        jerk: (n,) scaled limits.
    """
    with np.errstate(divide="ignore"):
        single = np.stack(
            [
                velocity / np.abs(D[:, :, 0]),
                np.sqrt(ACCELERATION_SHARE * acceleration / np.abs(D[:, :, 1])),
                np.cbrt(JERK_SHARE * jerk / np.abs(D[:, :, 2])),
            ],
            axis=-1,
        )
    return np.minimum(FEED * feed_cap, single.min(axis=(1, 2))), single


def compute_time_law(bounds: SpeedBounds, step: float) -> TimeLaw:
    """Return the fastest law found; where the greedy search fails, one smooth profile slowed down until it fits.

    Args:
        bounds: speed bounds at the nodes.
        step: s, length of the steps.
    """
    b = bounds
    Q, cap = np.ascontiguousarray(b.derivatives), np.ascontiguousarray(b.cap)
    easy = (b.jerk / np.maximum(np.abs(Q[:, :, 0]), 1e-9)).min(axis=1)  # scalar jerk at standstill
    brake = 2.0 * np.sqrt(np.median(cap) / np.median(easy))  # s, about the time of a stop
    step = float(np.clip(brake / 40.0, step, 3.0 * step))
    around = np.empty(len(cap))
    corner = find_next_corners(b.u, cap, around)
    easy = np.minimum(easy, around / (SOFT * step) ** 2)
    code, rows = compute_greedy_time_law(b.u, Q, cap, easy, corner, b.acceleration, b.jerk, step, 0, False)
    if code != 0:
        return _gentle(b)
    law = TimeLaw(*(np.ascontiguousarray(rows[:, k]) for k in range(5)))
    gap = (b.u[-1] - b.u[0]) / (law.u[-1] - law.u[0])
    return law.stretched(float(b.u[0]), float(b.u[-1])).slower(max(gap, 1.0))


def _gentle(b: SpeedBounds) -> TimeLaw:
    """Return a quintic from rest to rest, in the shortest time that keeps every limit at the nodes and between them."""
    length = b.u[-1] - b.u[0]
    t = np.linspace(0.0, 1.0, 2 * len(b.u) + 200)
    s = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    v, a, j = 30 * t**2 * (1 - t) ** 2, 60 * t * (1 - t) * (1 - 2 * t), 60 * (1 - 6 * t + 6 * t**2)
    v, a, j, u = v * length, a * length, j * length, b.u[0] + s * length
    order = np.argsort(np.r_[b.u, u], kind="stable")
    at = np.r_[b.u, u][order]
    V, A, J = (np.interp(at, u, x)[:, None] for x in (v, a, j))
    D = np.stack(
        [
            np.stack([np.interp(at, b.u, b.derivatives[:, d, k]) for d in range(b.derivatives.shape[1])], 1)
            for k in range(3)
        ],
        2,
    )
    need = [
        (V[:, 0] / np.interp(at, b.u, b.cap)).max(),
        np.sqrt((np.abs(D[..., 1] * V**2 + D[..., 0] * A) / b.acceleration).max()),
        np.cbrt((np.abs(D[..., 2] * V**3 + 3 * D[..., 1] * V * A + D[..., 0] * J) / b.jerk).max()),
    ]
    T = 1.02 * max(need)
    k = np.diff(a, append=a[-1]) / (t[1] * T**3)
    return TimeLaw(t * T, u, v / T, a / T**2, k)
