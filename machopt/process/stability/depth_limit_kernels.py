"""Compiled search for the smallest depth of cut at which the regenerative loop reaches the limit of stability.

With F = a H (r − r_T), H averaged over a revolution and without a column for the axial displacement, the modes obey
Λ_i q_i = a p c_iᵀ (b_1 q_1 + b_2 q_2 + …) with Λ_i = ω_i² − ω² + 2 i ζ_i ω_i ω, b_i = (travel, normal) of the
mass-normalised shape u_i and c_i = Hᵀ u_i. Hence the loop has a pole at iω where a p(ω) µ(ω) = 1 for an eigenvalue µ of
the 2 × 2 matrix R(ω) = Σ b_i c_iᵀ / Λ_i. The limit is the least a > 0 over all ω where Im(p µ) = 0 and Re(p µ) > 0.
Two laws of the delay T are searched: p = iωT + ω²T²/2 (second order, for ωT up to 1) and p = 1 − exp(−iωT). A third is
period doubling of a highly interrupted cut, which an averaged H does not show: with one impulse a T H (r − r_T) in each
period the modes obey 2 a T ν = 1 for an eigenvalue ν of Σ b_i c_iᵀ S_i, S_i the response at every second period,
S = −e sin(ω_d T) / (ω_d (1 + 2 e cos(ω_d T) + e²)) with e = exp(−ζωT).

Both eigenvalues are followed over a grid of frequencies that turns evenly through each mode's circle in the complex
plane. Sign changes of the imaginary part are refined by regula falsi.
"""

from __future__ import annotations

import math

import numpy as np

from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile

SECOND_ORDER, EXACT, DOUBLING = 0, 1, 2  # laws of the delay
SECOND_ORDER_RANGE = 1.0  # largest ωT of the second-order law; on the reference sets of the tests it is not above there
CIRCLE_POINTS = 14  # frequencies for each mode, evenly spaced on its circle
LOW_POINTS = 10  # frequencies below the lowest mode, each twice the one before
TAIL_POINTS = 3  # frequencies above the highest
DELAY_STEP = 0.35  # rad of ωT between frequencies
AMBIGUOUS = 0.4  # ratio of the costs of both pairings of eigenvalues from which an interval is divided
DIVISIONS = 8
GRAZING = 0.15  # of the change over an interval: with a smaller imaginary part at both ends the interval is divided, as
# an arc of a circle of 14 points lies up to 0.06 of its chord away from it
PRUNED = 0.8  # share of the largest Re(p µ) so far below which an interval is skipped: on a circle of 14 points its
# largest value is 1 % above that of its ends
REFINEMENTS = 40  # at most; regula falsi ends after about six
RESIDUAL = 1e-7  # of the imaginary part, relative to the modulus: the limit is as exact
ACCEPTED = 1e-3  # larger: a jump between both eigenvalues, not a crossing


@jit_compile
def _solve_pair(r00: complex, r01: complex, r10: complex, r11: complex) -> tuple[complex, complex]:
    """Both eigenvalues of a 2 × 2 matrix."""
    half = 0.5 * (r00 + r11)
    diff = 0.5 * (r00 - r11)
    d = diff * diff + r01 * r10
    size = math.sqrt(d.real * d.real + d.imag * d.imag)
    re = math.sqrt(max(0.5 * (size + d.real), 0.0))
    im = math.sqrt(max(0.5 * (size - d.real), 0.0))
    root = complex(re, im if d.imag >= 0.0 else -im)
    return half + root, half - root


@jit_compile
def _compute_delay_factor(w: float, T: float, law: int) -> complex:
    if law == EXACT:
        return complex(1.0 - math.cos(w * T), math.sin(w * T))
    return complex(0.5 * w * w * T * T, w * T)


@jit_compile
def _evaluate(w: float, n: int, omega: Array, zeta: Array, g: Array) -> tuple[complex, complex]:
    """Both eigenvalues of R at one frequency; g: (4, n) products b cᵀ of the modes."""
    r00, r01, r10, r11 = 0.0j, 0.0j, 0.0j, 0.0j
    for i in range(n):
        re = omega[i] * omega[i] - w * w
        im = 2.0 * zeta[i] * omega[i] * w
        q = 1.0 / (re * re + im * im)
        x, y = re * q, -im * q
        r00 += complex(g[0, i] * x, g[0, i] * y)
        r01 += complex(g[1, i] * x, g[1, i] * y)
        r10 += complex(g[2, i] * x, g[2, i] * y)
        r11 += complex(g[3, i] * x, g[3, i] * y)
    return _solve_pair(r00, r01, r10, r11)


@jit_compile
def _evaluate_grid(n: int, omega: Array, zeta: Array, g: Array, grid: Array, sums: Array, found: Array) -> None:
    """The same at every frequency of a grid; real and imaginary parts of both eigenvalues fill four rows."""
    count = len(grid)
    sums[:, :count] = 0.0
    x, y = sums[8], sums[9]
    for i in range(n):
        square, damping = omega[i] * omega[i], 2.0 * zeta[i] * omega[i]
        for k in range(count):
            w = grid[k]
            re = square - w * w
            im = damping * w
            q = np.divide(1.0, re * re + im * im)
            x[k], y[k] = re * q, -im * q
        for part in range(4):
            gain, real, imaginary = g[part, i], sums[2 * part], sums[2 * part + 1]
            for k in range(count):
                real[k] += gain * x[k]
                imaginary[k] += gain * y[k]
    for k in range(count):
        one, two = _solve_pair(
            complex(sums[0, k], sums[1, k]),
            complex(sums[2, k], sums[3, k]),
            complex(sums[4, k], sums[5, k]),
            complex(sums[6, k], sums[7, k]),
        )
        found[0, k], found[1, k], found[2, k], found[3, k] = one.real, one.imag, two.real, two.imag


@jit_compile
def _compute_modulus(z: complex) -> float:
    """|z|, faster than with safety against overflow."""
    return math.sqrt(z.real * z.real + z.imag * z.imag)


@jit_compile
def _refine(
    low: float,
    high: float,
    f_low: complex,
    f_high: complex,
    T: float,
    law: int,
    n: int,
    omega: Array,
    zeta: Array,
    g: Array,
) -> tuple[float, complex]:
    """Frequency where the followed eigenvalue of p R is real, and the eigenvalue; regula falsi (Illinois)."""
    ya, yb = f_low.imag, f_high.imag
    w, f = low, f_low
    for _ in range(REFINEMENTS):
        share = min(max(ya / (ya - yb), 1e-6), 1.0 - 1e-6)
        w = low + share * (high - low)
        one, two = _evaluate(w, n, omega, zeta, g)
        p = _compute_delay_factor(w, T, law)
        one, two = p * one, p * two
        near_one, near_two = (
            _compute_modulus(f_low - one) + _compute_modulus(f_high - one),
            _compute_modulus(f_low - two) + _compute_modulus(f_high - two),
        )
        f = one if near_one <= near_two else two
        if abs(f.imag) <= RESIDUAL * _compute_modulus(f) or high - low <= 1e-13 * high:
            break
        if (f.imag > 0.0) == (f_low.imag > 0.0):
            low, f_low, ya = w, f, f.imag
            yb *= 0.5
        else:
            high, f_high, yb = w, f, f.imag
            ya *= 0.5
    return w, f


@jit_compile
def _fill_grid(T: float, exact: bool, n: int, omega: Array, zeta: Array, tangents: Array, grid: Array) -> int:
    """Fill the ascending frequencies at which the eigenvalues are evaluated; return their number.

    Each mode has its own frequencies up to the middle between it and its neighbour.
    """
    count, step = 0, DELAY_STEP / T
    top = np.inf if exact else SECOND_ORDER_RANGE / T
    for k in range(LOW_POINTS):
        grid[count] = 0.7 * min(omega[0], top) * 0.5 ** (LOW_POINTS - 1 - k)
        count += 1
    last = grid[count - 1]
    for i in range(n):
        end = 0.5 * (omega[i] + omega[i + 1]) if i + 1 < n else omega[i] * 1.3
        for k in range(len(tangents) + 1):
            w = min(omega[i] * (1.0 + zeta[i] * tangents[k]), end) if k < len(tangents) else end
            w = min(w, top)
            count = _add_frequencies(w, last, step, grid, count)
            last = max(last, w)
            if w >= end or w >= top:
                break
    if exact:  # a large depth raises the frequency of a mode by much: up to one turn of the delay
        w = omega[n - 1] + 2.0 * math.pi / T
        count = _add_frequencies(w, last, step, grid, count)
        last = max(last, w)
    for k in range(TAIL_POINTS):
        w = min(omega[n - 1] * (1.8 + 0.6 * k), top)
        count = _add_frequencies(w, last, np.inf, grid, count)
        last = max(last, w)
    return _insert_frequency(SECOND_ORDER_RANGE / T, grid, count) if exact else count


@jit_compile
def _insert_frequency(w: float, grid: Array, count: int) -> int:
    """Insert the end of the second-order law into the ascending frequencies, so that it is searched up to its end."""
    at = count
    while at > 0 and grid[at - 1] > w * (1.0 - 1e-12):
        at -= 1
    if at == count or grid[at] <= w * (1.0 + 1e-12):
        return count
    for k in range(count, at, -1):
        grid[k] = grid[k - 1]
    grid[at] = w
    return count + 1


@jit_compile
def _add_frequencies(w: float, last: float, step: float, grid: Array, count: int) -> int:
    """Add a frequency above the last one, with others between them where they are farther apart than the step."""
    if w <= last * (1.0 + 1e-12):
        return count
    parts = min(int((w - last) / step) + 1, len(grid) - count)
    for k in range(parts):
        grid[count] = last + (w - last) * (k + 1.0) / parts
        count += 1
    return count


@jit_compile
def _search_interval(
    ends: tuple[float, float],
    left: tuple[complex, complex],
    right: tuple[complex, complex],
    needed: float,
    grazes: bool,
    T: float,
    law: int,
    n: int,
    omega: Array,
    zeta: Array,
    g: Array,
) -> tuple[float, float]:
    """Largest Re(p µ) above ``needed`` at which p µ is real between two frequencies, and its frequency."""
    best, at = needed, np.nan
    straight = _compute_modulus(left[0] - right[0]) + _compute_modulus(left[1] - right[1])
    crossed = _compute_modulus(left[0] - right[1]) + _compute_modulus(left[1] - right[0])
    parts = DIVISIONS if grazes or min(straight, crossed) > AMBIGUOUS * max(straight, crossed) else 1
    x0, p1, p2 = ends[0], left[0], left[1]
    for part in range(parts):
        if part == parts - 1:
            x1, q1, q2 = ends[1], right[0], right[1]
        else:
            x1 = ends[0] + (ends[1] - ends[0]) * (part + 1.0) / parts
            q1, q2 = _evaluate(x1, n, omega, zeta, g)
            p = _compute_delay_factor(x1, T, law)
            q1, q2 = p * q1, p * q2
        if _compute_modulus(p1 - q1) + _compute_modulus(p2 - q2) > _compute_modulus(p1 - q2) + _compute_modulus(
            p2 - q1
        ):
            q1, q2 = q2, q1
        for branch in range(2):
            fa, fb = (p1, q1) if branch == 0 else (p2, q2)
            if (fa.imag > 0.0) == (fb.imag > 0.0) or max(fa.real, fb.real) < PRUNED * best:
                continue
            w, f = _refine(x0, x1, fa, fb, T, law, n, omega, zeta, g)
            if f.real > best and abs(f.imag) <= ACCEPTED * f.real:
                best, at = f.real, w
        x0, p1, p2 = x1, q1, q2
    return best, at


@jit_compile
def _is_grazing(l1: complex, l2: complex, r1: complex, r2: complex, least: float) -> bool:
    """Whether an eigenvalue of size ``least`` may cross the real axis twice between two frequencies."""
    straight, crossed = _compute_modulus(l1 - r1), _compute_modulus(l1 - r2)
    if straight + _compute_modulus(l2 - r2) > crossed + _compute_modulus(l2 - r1):
        r1, r2 = r2, r1
    for branch in range(2):
        a, b = (l1, r1) if branch == 0 else (l2, r2)
        is_near = min(abs(a.imag), abs(b.imag)) < GRAZING * _compute_modulus(a - b)
        if is_near and (a.imag > 0.0) == (b.imag > 0.0) and max(a.real, b.real) > least:
            return True
    return False


@jit_compile
def _find_crossing(
    T: float,
    law: int,
    needed: float,
    n: int,
    omega: Array,
    zeta: Array,
    g: Array,
    grid: Array,
    found: Array,
) -> tuple[float, float]:
    """Largest Re(p µ) above ``needed`` at which p µ is real with one law of the delay, and its frequency."""
    at, top = np.nan, SECOND_ORDER_RANGE / T * (1.0 + 1e-9) if law == SECOND_ORDER else np.inf
    known, was_small = False, True
    l1, l2 = 0.0j, 0.0j
    for k in range(len(grid)):
        if grid[k] > top:
            break
        one, two = complex(found[0, k], found[1, k]), complex(found[2, k], found[3, k])
        bound = max(one.real * one.real + one.imag * one.imag, two.real * two.real + two.imag * two.imag)
        turn = grid[k] * T
        small = law == EXACT and min(4.0, turn * turn) * bound < (PRUNED * needed) ** 2  # |p| ≤ 2 and |p| ≤ ωT
        if small and was_small:  # neither end of the interval can count
            known = False
            continue
        was_small = small
        if not known and k > 0:
            p = _compute_delay_factor(grid[k - 1], T, law)
            l1, l2 = p * complex(found[0, k - 1], found[1, k - 1]), p * complex(found[2, k - 1], found[3, k - 1])
        p = _compute_delay_factor(grid[k], T, law)
        r1, r2 = p * one, p * two
        if k > 0:
            positive = (l1.imag > 0.0) + (l2.imag > 0.0) + (r1.imag > 0.0) + (r2.imag > 0.0)
            most = max(l1.real, l2.real, r1.real, r2.real)
            grazes = most > PRUNED * needed and _is_grazing(l1, l2, r1, r2, PRUNED * needed)
            if (grazes or 0 < positive < 4) and most > PRUNED * needed:
                ends = grid[k - 1], grid[k]
                best, w = _search_interval(ends, (l1, l2), (r1, r2), needed, grazes, T, law, n, omega, zeta, g)
                if best > needed:
                    needed, at = best, w
        known = True
        l1, l2 = r1, r2
    return needed, at


@jit_compile
def _compute_doubling(T: float, n: int, omega: Array, zeta: Array, g: Array) -> float:
    """1 / a of period doubling; 0 or less without limit."""
    r00, r01, r10, r11 = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        damped = omega[i] * math.sqrt(1.0 - zeta[i] * zeta[i])
        e = math.exp(-zeta[i] * omega[i] * T)
        s = -e * math.sin(damped * T) / (damped * (1.0 + 2.0 * e * math.cos(damped * T) + e * e))
        r00 += g[0, i] * s
        r01 += g[1, i] * s
        r10 += g[2, i] * s
        r11 += g[3, i] * s
    d = 0.25 * (r00 - r11) ** 2 + r01 * r10
    return 2.0 * T * (0.5 * (r00 + r11) + math.sqrt(d)) if d >= 0.0 else 0.0


@jit_compile
def _collect_modes(omega: Array, zeta: Array, b: Array, c: Array, om: Array, ze: Array, g: Array, index: Ints) -> int:
    """Write frequency, damping, products of shapes and index of the modes above 0; returns their number."""
    used = 0
    for i in range(len(omega)):
        if omega[i] > 0.0:
            om[used], ze[used], index[used] = omega[i], zeta[i], i
            for k in range(4):
                g[k, used] = b[i, k // 2] * c[i, k % 2]
            used += 1
    return used


@jit_compile
def find_depth_limits(
    delay: Array,
    laws: tuple[bool, bool, bool],
    largest: float,
    omega: Array,
    zeta: Array,
    b: Array,
    c: Array,
    limit: Array,
    frequency: Array,
    mode: Ints,
    delay_points: int,
) -> None:
    """Fill limit, chatter frequency and governing mode of P sets of modes.

    Args:
        delay: (P,) s.
        laws: whether the second-order delay, the exact one, and period doubling count; the smallest limit holds.
        largest: m, depth above which a limit does not count: inf is filled.
        omega: (P, n) rad/s, in ascending order; modes of 0 are left out.
        zeta: (P, n).
        b: (P, n, 2) 1/√kg, shape in travel and normal.
        c: (P, n, 2) Hᵀ u.
        limit: (P,) m, filled.
        frequency: (P,) rad/s, filled; NaN without limit.
        mode: (P,) index of the mode that takes the largest part, filled; −1 without limit.
        delay_points: room for frequencies that resolve the delay.
    """
    n = omega.shape[1]
    tangents = np.empty(CIRCLE_POINTS)
    for k in range(CIRCLE_POINTS):
        tangents[k] = math.tan(math.pi * ((k + 0.5) / CIRCLE_POINTS - 0.5))
    size = n * (CIRCLE_POINTS + 1) + LOW_POINTS + TAIL_POINTS + delay_points + 2
    grid, sums, found = np.empty(size), np.empty((10, size)), np.empty((4, size))
    om, ze, g = np.empty(n), np.empty(n), np.empty((4, n))
    index = np.empty(n, np.int64)
    for row in range(omega.shape[0]):
        limit[row], frequency[row], mode[row] = np.inf, np.nan, -1
        used = _collect_modes(omega[row], zeta[row], b[row], c[row], om, ze, g, index)
        if used == 0:
            continue
        count = _fill_grid(delay[row], laws[1], used, om, ze, tangents, grid)
        _evaluate_grid(used, om, ze, g, grid[:count], sums, found)
        needed = 1.0 / largest  # smallest Re(p µ) that counts
        if laws[DOUBLING]:
            doubling = _compute_doubling(delay[row], used, om, ze, g)
            if doubling > needed:
                needed = doubling
                limit[row], frequency[row] = 1.0 / needed, math.pi / delay[row]
        for law in range(2):
            if laws[law]:
                needed, at = _find_crossing(delay[row], law, needed, used, om, ze, g, grid[:count], found)
                if at > 0.0:
                    limit[row], frequency[row] = 1.0 / needed, at
        if frequency[row] > 0.0:
            mode[row] = index[_find_governing_mode(frequency[row], used, om, ze, g)]


@jit_compile
def _find_governing_mode(w: float, n: int, omega: Array, zeta: Array, g: Array) -> int:
    """Mode whose share of R is largest."""
    most, found = -1.0, 0
    for i in range(n):
        re = omega[i] * omega[i] - w * w
        im = 2.0 * zeta[i] * omega[i] * w
        part = (g[0, i] ** 2 + g[1, i] ** 2 + g[2, i] ** 2 + g[3, i] ** 2) / (re * re + im * im)
        if part > most:
            most, found = part, i
    return found
