"""Time law u(t) of one curve from rest to rest: as fast as feed and joint limits allow, jerk piecewise constant.

With q', q'', q''' the joints' derivatives along the curve, speed v = u̇, acceleration a and jerk j,

    |q' v| ≤ v_max      |q'' v² + q' a| ≤ a_max      |q''' v³ + 3 q'' v a + q' j| ≤ j_max      |p'| v ≤ feed

Every step takes the largest j for which these hold during the step *and* during a way to a full stop after it.
That way is a *plan* (c, x): brake to the speed c, keep it as far as u = x, then brake to standstill. Tried are
(0, ·) and, ahead of a sharp corner, the speed the corner allows and its far side. A plan depends on the state only,
so its next step is always at hand as a way to go on: the law cannot run into a state without continuation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.compiled import compiled

FEED = 0.999  # of the programmed feed is aimed at
HOLD = 0.99  # of the speed cap: from here on the speed is kept, not hunted
ACCELERATION_SHARE = 0.9  # of the limit that path curvature alone may use
JERK_SHARE = 0.85
CORNER = 0.75  # a corner is where the speed cap is below this share of what it is to both sides
CORNER_TIME = 0.1  # s of travel: how far to both sides
CORNER_LONG = 0.3  # s at its lowest cap: what takes longer is no corner
CORNER_SPEED = 0.97  # of the lowest cap in a corner is planned with
BRAKING_SHARE = 0.9  # of the limits that the braking policy reckons with
LANDING_SHARE = 0.6  # of the jerk limit with which braking ends
SOFT = 4.0  # steps that a change of speed by the whole feed takes at least
STEPS = 4_000_000  # the longest law


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
        return float(self.time[-1])

    def at(self, time: Array) -> tuple[Array, Array, Array, Array]:
        """u, v, a, j at times within [0, duration]."""
        k = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        t = time - self.time[k]
        a = self.a[k] + self.j[k] * t
        v = self.v[k] + t * (self.a[k] + 0.5 * self.j[k] * t)
        return self.u[k] + t * (self.v[k] + t * (0.5 * self.a[k] + self.j[k] / 6.0 * t)), v, a, self.j[k]

    def slower(self, factor: float) -> TimeLaw:
        """The same motion in ``factor`` times the time."""
        f = factor
        return TimeLaw(self.time * f, self.u, self.v / f, self.a / f**2, self.j / f**3)

    def stretched(self, u0: float, u1: float) -> TimeLaw:
        """Scaled in u to end exactly at u1."""
        f = (u1 - u0) / (self.u[-1] - self.u[0])
        u = u0 + (self.u - self.u[0]) * f
        u[-1] = u1
        return TimeLaw(self.time, u, self.v * f, self.a * f, self.j * f)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """What limits the speed at the nodes of a curve."""

    u: Array  # (M,)
    derivatives: Array  # (M, n, 3) q', q'', q''' of the axes that move
    cap: Array  # (M,) m/s largest v
    velocity: Array  # (n,) limits, already scaled
    acceleration: Array
    jerk: Array


def node_caps(D: Array, feed_cap: Array, velocity: Array, acceleration: Array, jerk: Array) -> tuple[Array, Array]:
    """Largest v (M,) at each node, and what each joint allows by velocity, acceleration and jerk alone (M, n, 3)."""
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


def time_law(bounds: Bounds, step: float) -> TimeLaw:
    """The fastest law found; where the greedy search gets stuck, one gentle profile slowed down until it fits."""
    b = bounds
    Q, cap = np.ascontiguousarray(b.derivatives), np.ascontiguousarray(b.cap)
    easy = (b.jerk / np.maximum(np.abs(Q[:, :, 0]), 1e-9)).min(axis=1)  # scalar jerk at standstill
    brake = 2.0 * np.sqrt(np.median(cap) / np.median(easy))  # s, about the time of a stop
    step = float(np.clip(brake / 40.0, step, 3.0 * step))
    around = np.empty(len(cap))
    corners = _corners(b.u, cap, around)
    easy = np.minimum(easy, around / (SOFT * step) ** 2)
    code, rows = _law(b.u, Q, cap, easy, corners, b.acceleration, b.jerk, step, 0, False)
    if code != 0:
        return _gentle(b)
    law = TimeLaw(*(np.ascontiguousarray(rows[:, k]) for k in range(5)))
    gap = (b.u[-1] - b.u[0]) / (law.u[-1] - law.u[0])
    return law.stretched(float(b.u[0]), float(b.u[-1])).slower(max(gap, 1.0))


def _gentle(b: Bounds) -> TimeLaw:
    """Rest to rest with a quintic, in the shortest time that holds every limit at the nodes and between them."""
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


@compiled
def _window(
    i: int, w: float, v: float, a: float, h: float, Q: Array, al: Array, jl: Array, share: float
) -> tuple[float, float, float, float]:
    """Intervals of jerk and of acceleration that the joints allow, h s after the acceleration was a."""
    jlo, jhi, alo, ahi = -1e30, 1e30, -1e30, 1e30
    for d in range(Q.shape[1]):
        g = Q[i, d, 0] + w * (Q[i + 1, d, 0] - Q[i, d, 0])
        if abs(g) < 1e-9:
            continue
        g2 = Q[i, d, 1] + w * (Q[i + 1, d, 1] - Q[i, d, 1])
        g3 = Q[i, d, 2] + w * (Q[i + 1, d, 2] - Q[i, d, 2])
        lever = g + 3.0 * g2 * v * h
        if abs(lever) > 1e-9:
            c = -(g3 * v * v + 3.0 * g2 * a) * v / lever
            r = share * jl[d] / abs(lever)
            jlo, jhi = max(jlo, c - r), min(jhi, c + r)
        c = -g2 * v * v / g
        r = share * al[d] / abs(g)
        alo, ahi = max(alo, c - r), min(ahi, c + r)
    return jlo, jhi, alo, ahi


@compiled
def _holds(i: int, w: float, v: float, a: float, j: float, Q: Array, cap: Array, al: Array, jl: Array) -> bool:
    if v > (cap[i] + w * (cap[i + 1] - cap[i])) * (1.0 + 1e-9):
        return False
    for d in range(Q.shape[1]):
        g = Q[i, d, 0] + w * (Q[i + 1, d, 0] - Q[i, d, 0])
        g2 = Q[i, d, 1] + w * (Q[i + 1, d, 1] - Q[i, d, 1])
        if abs(g2 * v * v + g * a) > al[d]:
            return False
        g3 = Q[i, d, 2] + w * (Q[i + 1, d, 2] - Q[i, d, 2])
        if abs((g3 * v * v + 3.0 * g2 * a) * v + g * j) > jl[d]:
            return False
    return True


@compiled
def _advance(
    i: int,
    u: float,
    v: float,
    a: float,
    j: float,
    h: float,
    check_start: bool,
    un: Array,
    Q: Array,
    cap: Array,
    al: Array,
    jl: Array,
) -> tuple[int, int, float, float, float]:
    """One step. Returns code (0 good, 1 breaks a limit, 2 leaves the curve), interval, u, v, a.

    ``check_start`` is never given as a constant, nor is the first ``i``: numba would compile it once for each.
    """
    a1 = a + j * h
    v1 = v + h * (a + 0.5 * j * h)
    u1 = u + h * (v + h * (0.5 * a + j * h / 6.0))
    if v1 < 0.0:
        return 1, i, u, v, a
    if u1 > un[-1]:
        return 2, i, u, v, a
    if a > 0.0 > a1 and v - 0.5 * a * a / j > max(cap[i], cap[i + 1]):
        return 1, i, u, v, a
    if check_start and not _holds(i, (u - un[i]) / (un[i + 1] - un[i]), v, a, j, Q, cap, al, jl):
        return 1, i, u, v, a
    while i < len(un) - 2 and un[i + 1] <= u1:
        i += 1
        f = (un[i] - u) / (u1 - u) if u1 > u else 1.0
        if not _holds(i, 0.0, v + f * (v1 - v), a + f * (a1 - a), j, Q, cap, al, jl):
            return 1, i, u, v, a
    if not _holds(i, (u1 - un[i]) / (un[i + 1] - un[i]), v1, a1, j, Q, cap, al, jl):
        return 1, i, u, v, a
    return 0, i, u1, v1, a1


@compiled
def _corners(un: Array, cap: Array, around: Array) -> Array:
    """(M, 3) of the next corner whose end lies ahead of each node: begin, end, speed; infinite where there is none.

    Fills ``around`` with the largest cap nearby, to either side.
    """
    n = len(un)
    ahead, behind = cap.copy(), cap.copy()
    for k in range(1, n):
        behind[k] = max(cap[k], behind[k - 1] - (un[k] - un[k - 1]) / CORNER_TIME)
        m = n - 1 - k
        ahead[m] = max(cap[m], ahead[m + 1] - (un[m + 1] - un[m]) / CORNER_TIME)
    for k in range(n):
        around[k] = max(ahead[k], behind[k])
    found = np.empty((n, 3))
    count, k = 0, 0
    while k < n:
        last = k
        if (k == 0 or cap[k] <= cap[k - 1]) and cap[k] < CORNER * min(ahead[k], behind[k]):
            speed, first = cap[k], k
            while last < n - 1 and cap[last + 1] <= speed / CORNER:  # grow while about as slow, or slower
                last += 1
                speed = min(speed, cap[last])
            while first > 0 and cap[first] <= speed / CORNER:
                first -= 1
            begin, finish = un[first], un[min(last + 1, n - 1)]
            if count > 0:
                before = found[count - 1]
                if begin - before[1] <= max(finish - begin, before[1] - before[0]):  # both flanks of one corner
                    begin, speed = min(begin, before[0]), min(speed, before[2])
                    count -= 1
            found[count, 0], found[count, 1], found[count, 2] = begin, finish, speed
            count += 1
        k = last + 1
    out = np.empty((n, 3))
    c = 0
    for k in range(n):
        out[k, 0] = out[k, 1] = out[k, 2] = np.inf
        while c < count and (found[c, 1] <= un[k] or found[c, 1] - found[c, 0] > CORNER_LONG * found[c, 2]):
            c += 1
        if c < count:
            out[k, 0], out[k, 1], out[k, 2] = found[c, 0], found[c, 1], CORNER_SPEED * found[c, 2]
    return out


@compiled
def _policy(
    i: int,
    u: float,
    v: float,
    a: float,
    c: float,
    x: float,
    h: float,
    un: Array,
    Q: Array,
    easy: Array,
    al: Array,
    jl: Array,
) -> float:
    """Jerk of the plan's next step: as hard as allowed, yet so that the speed aimed at is reached with a = 0."""
    jlo, jhi, _, _ = _window(i, (u - un[i]) / (un[i + 1] - un[i]), v, a, 0.0, Q, al, jl, BRAKING_SHARE)
    v1 = max(v + a * h, 0.0)
    u1 = min(u + 0.5 * (v + v1) * h, un[-1])
    k = i
    while k < len(un) - 2 and un[k + 1] <= u1:
        k += 1
    lo, hi, alo, _ = _window(k, (u1 - un[k]) / (un[k + 1] - un[k]), v1, a, h, Q, al, jl, BRAKING_SHARE)
    soft = min(easy[i], easy[i + 1])
    jlo, jhi = max(jlo, lo, -soft), min(jhi, hi, soft)
    K = LANDING_SHARE * soft
    over = v - (c if u < x else 0.0)
    even = a + min(max(-a, jlo * h), jhi * h)
    if over <= 0.0:
        return float((even - a) / h)
    landing = 0.5 * (K * h - math.sqrt(max(K * K * h * h + 4.0 * K * (2.0 * over + a * h), 0.0)))
    a1 = max(a + jlo * h, alo, landing)
    if u < x and a1 > 0.0 >= a:  # arrived
        a1 = even
    return float((a1 - a) / h)


@compiled
def _brake(
    i: int,
    u: float,
    v: float,
    a: float,
    c: float,
    x: float,
    h: float,
    un: Array,
    Q: Array,
    cap: Array,
    easy: Array,
    al: Array,
    jl: Array,
) -> tuple[int, float]:
    """Follow the plan to a stop. Returns code (as _advance) and where it stops or fails."""
    for _ in range(100_000):
        if v < 1e-12:
            return (0 if abs(a) < 1e-6 else 1), u
        if a < 0.0 and 2.0 * v <= -a * h * (1.0 + 1e-9):
            if a * a / (2.0 * v) > min(easy[i], easy[i + 1]):
                return 1, u
            u += -2.0 * v * v / (3.0 * a)
            return (2 if u > un[-1] else 0), u
        j = _policy(i, u, v, a, c, x, h, un, Q, easy, al, jl)
        code, i, u, v, a = _advance(i, u, v, a, j, h, h > 0.0, un, Q, cap, al, jl)
        if code != 0:
            return code, u
    return 1, u


@compiled
def _try(
    i: int,
    u: float,
    v: float,
    a: float,
    j: float,
    h: float,
    un: Array,
    Q: Array,
    cap: Array,
    easy: Array,
    corner: Array,
    al: Array,
    jl: Array,
) -> tuple[int, float, float, float]:
    """A step with jerk j and a way to a stop after it. Returns code (0: there is one), where it stops, its plan."""
    code, i, u, v, a = _advance(i, u, v, a, j, h, h > 0.0, un, Q, cap, al, jl)
    if code != 0:
        return code, u, 0.0, 0.0
    code, place = _brake(i, u, v, a, 0.0, 0.0, h, un, Q, cap, easy, al, jl)
    c, x = corner[i, 2], corner[i, 1]
    if place < corner[i, 0] or (code == 0 and v <= c):
        return code, place, 0.0, 0.0
    after, there = _brake(i, u, v, a, c, x, h, un, Q, cap, easy, al, jl)
    if after == 2 and code == 0:  # the corner is where the curve ends
        return code, place, 0.0, 0.0
    return after, there, c, x


@compiled
def _law(
    un: Array, Q: Array, cap: Array, easy: Array, corner: Array, al: Array, jl: Array, h: float, i: int, again: bool
) -> tuple[int, Array]:
    """The law from interval ``i`` = 0; ``again`` = False: a start that a try found good is not checked again."""
    rows = np.empty((4096, 5))
    n, t, u, v, a = 0, 0.0, un[0], 0.0, 0.0
    stop, end, c, x = u, un[-1], 0.0, 0.0
    tolerance = min(0.5e-6, 0.01 * (end - u))
    while True:
        if n + 2 > len(rows):
            if n > STEPS:
                return 1, rows[:0]
            more = np.empty((2 * len(rows), 5))
            for k in range(n):
                for m in range(5):
                    more[k, m] = rows[k, m]
            rows = more
        resting = v < 1e-12
        arriving = end - stop < tolerance
        if resting and arriving:
            break
        landing = a < 0.0 and 2.0 * v <= -a * h * (1.0 + 1e-9)
        if resting:
            v, a, j = 0.0, 0.0, 0.0
        elif landing:
            j = a * a / (2.0 * v)
        else:
            j = _policy(i, u, v, a, c, x, h, un, Q, easy, al, jl)
        found = False
        if not arriving:
            w = (u - un[i]) / (un[i + 1] - un[i])
            jlo, jhi, _, ahi = _window(i, w, v, a, 0.0, Q, al, jl, 1.0)
            top = min(jhi, (ahi - a) / h, easy[i], easy[i + 1]) * (1.0 - 1e-9)
            if v > HOLD * (cap[i] + w * (cap[i + 1] - cap[i])):
                middle = min(max(-a / h, jlo), top)
                code, place, cn, xn = _try(i, u, v, a, middle, h, un, Q, cap, easy, corner, al, jl)
                if code == 0:
                    j, stop, c, x, found = middle, place, cn, xn, True
            if not found and top > j:
                low, high, middle, halvings = j, top, top, -1
                while halvings < 0:
                    code, place, cn, xn = _try(i, u, v, a, middle, h, un, Q, cap, easy, corner, al, jl)
                    if code == 0:
                        j, stop, c, x, found = middle, place, cn, xn, True
                        break
                    halvings = 30 if code == 2 or resting else 7
                for _ in range(halvings):
                    middle = 0.5 * (low + high)
                    code, place, cn, xn = _try(i, u, v, a, middle, h, un, Q, cap, easy, corner, al, jl)
                    if code == 0:
                        low, j, stop, c, x, found = middle, middle, place, cn, xn, True
                    else:
                        high = middle
            if resting and not found:
                return 2, rows[:0]
        rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3], rows[n, 4] = t, u, v, a, j
        n += 1
        if landing and not found:
            t += -2.0 * v / a
            u += -2.0 * v * v / (3.0 * a)
            v, a = 0.0, 0.0
            while i < len(un) - 2 and un[i + 1] <= u:
                i += 1
        else:
            code, i, u, v, a = _advance(i, u, v, a, j, h, again, un, Q, cap, al, jl)
            if code != 0:
                return 3, rows[:0]
            t += h
    rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3], rows[n, 4] = t, u, 0.0, 0.0, 0.0
    return 0, rows[: n + 1]
