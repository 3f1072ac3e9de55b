"""Compiled steps of a time law: each with the largest jerk after which a full stop is still possible.

:mod:`machopt.planning.retiming.time_law` describes the constraints during a step and the stopping plans.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile

HOLD = 0.99  # share of the speed cap from which the speed is kept
CORNER = 0.75  # a corner is where the speed cap is below this share of its neighbourhood
CORNER_TIME = 0.1  # s of travel: how far to both sides
CORNER_LONG = 0.3  # s at its lowest cap: maximum duration of a corner
CORNER_SPEED = 0.97  # planned share of the lowest cap in a corner
BRAKING_SHARE = 0.9  # share of the limits used by the braking policy
LANDING_SHARE = 0.6  # share of the jerk limit at the end of braking
LONGEST_HOLD = 32  # steps at constant speed that are tried together
STEPS = 4_000_000  # the longest law


@jit_compile
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


@jit_compile
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


@jit_compile
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
    """Advance one step. Return code (0 good, 1 violates a limit, 2 leaves the curve), interval, u, v, a.

    ``check_start`` is never passed as a constant, nor is the first ``i``: numba would compile it once for each.
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


@jit_compile
def find_next_corners(un: Array, cap: Array, around: Array) -> Array:
    """Return (M, 3) of the next corner whose end lies ahead of each node: begin, end, speed; infinite where there is
    none.

    Args:
        un: (M,) m, path parameter of the nodes.
        cap: (M,) m/s, largest speed.
        around: (M,) receives the largest cap nearby, to either side.
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


@jit_compile
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
    """Return the jerk of the plan's next step: the hardest permitted that reaches the target speed with a = 0."""
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


@jit_compile
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
    """Follow the plan to a stop. Return code (as _advance) and the place where it stops or fails."""
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


@jit_compile
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
    """Try a step with jerk j and a stop after it. Return code (0: possible), the place of the stop, its plan.

    What is left of an acceleration must fade, at a share of the jerk limit, before the speed reaches its limit: beyond
    that only a hard brake is left, and the speed would go back and forth below its limit, step by step.
    """
    code, i, u, v, a = _advance(i, u, v, a, j, h, h > 0.0, un, Q, cap, al, jl)
    if code != 0:
        return code, u, 0.0, 0.0
    if a > 1e-9:
        allowed = cap[i] + (u - un[i]) / (un[i + 1] - un[i]) * (cap[i + 1] - cap[i])
        if v + 0.5 * a * h + 0.5 * a * a / (BRAKING_SHARE * min(easy[i], easy[i + 1])) > allowed * (1.0 + 1e-9):
            return 1, u, 0.0, 0.0
    code, place = _brake(i, u, v, a, 0.0, 0.0, h, un, Q, cap, easy, al, jl)
    c, x = corner[i, 2], corner[i, 1]
    if place < corner[i, 0] or (code == 0 and v <= c):
        return code, place, 0.0, 0.0
    after, there = _brake(i, u, v, a, c, x, h, un, Q, cap, easy, al, jl)
    if after == 2 and code == 0:  # the corner is where the curve ends
        return code, place, 0.0, 0.0
    return after, there, c, x


@jit_compile
def _find_largest_jerk(
    i: int,
    u: float,
    v: float,
    a: float,
    j: float,
    h: float,
    resting: bool,
    un: Array,
    Q: Array,
    cap: Array,
    easy: Array,
    corner: Array,
    al: Array,
    jl: Array,
) -> tuple[bool, float, float, float, float]:
    """Find the largest jerk above j whose step can be followed by a stop, by halving.

    Near the speed limit, the jerk that ends the acceleration is tried first.

    Returns:
        Whether there is one, the jerk, the place of the stop and its plan as in :func:`_try`.
    """
    found, stop, c, x = False, 0.0, 0.0, 0.0
    w = (u - un[i]) / (un[i + 1] - un[i])
    jlo, jhi, _, ahi = _window(i, w, v, a, 0.0, Q, al, jl, 1.0)
    top = min(jhi, (ahi - a) / h, easy[i], easy[i + 1]) * (1.0 - 1e-9)
    if v > HOLD * (cap[i] + w * (cap[i + 1] - cap[i])):
        middle = min(max(-a / h, jlo), top)
        code, place, cn, xn = _try(i, u, v, a, middle, h, un, Q, cap, easy, corner, al, jl)
        if code == 0:
            return True, middle, place, cn, xn
    if not top > j:
        return False, j, stop, c, x
    low, high = j, top
    code, place, cn, xn = _try(i, u, v, a, top, h, un, Q, cap, easy, corner, al, jl)
    if code == 0:
        return True, top, place, cn, xn
    for _ in range(30 if code == 2 or resting else 7):
        middle = 0.5 * (low + high)
        code, place, cn, xn = _try(i, u, v, a, middle, h, un, Q, cap, easy, corner, al, jl)
        if code == 0:
            low, j, stop, c, x, found = middle, middle, place, cn, xn, True
        else:
            high = middle
    return found, j, stop, c, x


@jit_compile
def _double_rows(rows: Array) -> Array:
    """Return the rows (K, 5) with room for as many again."""
    more = np.empty((2 * len(rows), 5))
    for k in range(len(rows)):
        for m in range(5):
            more[k, m] = rows[k, m]
    return more


@jit_compile
def _count_held_steps(
    i: int,
    u: float,
    v: float,
    h: float,
    un: Array,
    Q: Array,
    cap: Array,
    easy: Array,
    corner: Array,
    al: Array,
    jl: Array,
) -> tuple[int, float, float, float]:
    """Count the steps at constant speed near its limit after which a stop is still possible; each of them can then be
    taken without a trial of its own. Return the number (0: at most one), the place of the stop and its plan.
    """
    count, k, at = 0, i, u
    while count < LONGEST_HOLD:
        w = (at - un[k]) / (un[k + 1] - un[k])
        if not v > HOLD * (cap[k] + w * (cap[k + 1] - cap[k])):
            break
        code, k, at, _, _ = _advance(k, at, v, 0.0, 0.0, h, h > 0.0, un, Q, cap, al, jl)
        if code != 0:
            break
        count += 1
    while count > 1:
        k, at = i, u + (count - 1) * h * v
        while k < len(un) - 2 and un[k + 1] <= at:
            k += 1
        code, stop, c, x = _try(k, at, v, 0.0, 0.0, h, un, Q, cap, easy, corner, al, jl)
        if code == 0:
            return count, stop, c, x
        count //= 2
    return 0, 0.0, 0.0, 0.0


@jit_compile
def compute_greedy_time_law(
    un: Array, Q: Array, cap: Array, easy: Array, corner: Array, al: Array, jl: Array, h: float, i: int, again: bool
) -> tuple[int, Array]:
    """Return a code (0 good) and the (K, 5) rows of the law.

    Args:
        un: (M,) m, path parameter of the nodes.
        Q: (M, n, 3) q', q'', q''' of the joints.
        cap: (M,) m/s, largest speed.
        easy: (M,) scalar jerk limit for smooth speed changes.
        corner: (M, 3) of :func:`find_next_corners`.
        al: (n,) acceleration limits.
        jl: (n,) jerk limits.
        h: s, length of a step.
        i: first interval, 0.
        again: False: a start accepted by a trial step is not checked again.
    """
    rows = np.empty((4096, 5))
    n, t, u, v, a = 0, 0.0, un[0], 0.0, 0.0
    stop, end, c, x = u, un[-1], 0.0, 0.0
    constant_steps = 0  # steps at constant speed that remain of those tried together
    tolerance = min(0.5e-6, 0.01 * (end - u))
    while True:
        if n + 2 > len(rows):
            if n > STEPS:
                return 1, rows[:0]
            rows = _double_rows(rows)
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
        if constant_steps == 0 and a == 0.0 and not resting and not arriving:
            constant_steps, further, cn, xn = _count_held_steps(i, u, v, h, un, Q, cap, easy, corner, al, jl)
            if constant_steps > 0:
                stop, c, x = further, cn, xn
        if constant_steps > 0:
            j, found = 0.0, True
            constant_steps -= 1
        elif not arriving:
            found, new, place, cn, xn = _find_largest_jerk(i, u, v, a, j, h, resting, un, Q, cap, easy, corner, al, jl)
            if found:
                j, stop, c, x = new, place, cn, xn
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
