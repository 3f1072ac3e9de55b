"""Lower and upper bounds of the distance of two bodies (compiled); both are valid whatever their gap.

Upper bound: the distance of two points, one of each body. Lower bound: along a direction u, the least u·b minus the
greatest u·a. For two convex parts both meet at the shortest vector between them, which the algorithm of Gilbert,
Johnson and Keerthi (1988) finds: u is the shortest known vector, and the extreme points along u give the next one.
Boxes around parts are skipped where they are separated, along their own axes or along the shortest vector, by at
least the distance found.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile
from machopt.verification.motion.collision.convex_parts import ConvexParts

BOUND_GAP_M = 1e-8  # m between the two bounds, at which they are close enough
ROUNDING_M = 1e-10  # m, far above the rounding of metres
MAX_GJK_STEPS = 60  # of the walk between two convex parts
FAR_DISTANCE_M = 1e9  # m
CLAIM_MARGIN_M = 0.05  # m beyond a claim, to which bounds are made close: they last for rows to come
MAX_STACK_SIZE = 256  # pairs of boxes: both trees are at most 40 boxes deep


def bound_distances(
    a: ConvexParts,
    b: ConvexParts,
    T: Array,
    rows: Ints | None = None,
    way: Array | None = None,
    claim: Array | None = None,
) -> tuple[Array, Array]:
    """Return (K,) lower and (K,) upper bounds of the distance, m; 0 and 0 in contact.

    Parts are solid: one inside another is in contact with it. It is fastest where neighbouring rows are neighbouring
    poses.

    Args:
        a: Parts of the first body.
        b: Parts of the second body.
        T: (K, 4, 4) poses of b in a's frame.
        rows: (L,) rows to bound, all by default; the others get the bounds 0 … ∞.
        way: (K,) cumulative motion, m: no point of b moves against a by more than the difference of two entries.
            Without it no row bounds another.
        claim: (K,) stated distances, m: it is enough to show that the distance is not below them. Then the bound of
            an earlier row is reused where it suffices, and bounds far above the claim are not refined.
    """
    every = np.arange(len(T)) if rows is None else np.asarray(rows, np.int64)
    if way is None:
        way = np.arange(0.0, FAR_DISTANCE_M * len(T), FAR_DISTANCE_M)
    if claim is None:
        claim = np.full(len(T), np.inf)
    return _bound_rows(*_list_part_arrays(a), *_list_part_arrays(b), np.ascontiguousarray(T), every, way, claim)


def _list_part_arrays(parts: ConvexParts) -> tuple[Array, Ints, Array, Array, Array, Array]:
    return parts.points, parts.first, parts.disc, parts.ball, parts.box_centres, parts.half_size


@jit_compile
def _find_support_point(
    points: Array, begin: int, end: int, disc: float, x: float, y: float, z: float, out: Array
) -> None:
    """The point of a hull, grown by a disc across z, that lies farthest along (x, y, z)."""
    best, at = -np.inf, begin
    for k in range(begin, end):
        along = points[k, 0] * x + points[k, 1] * y + points[k, 2] * z
        if along > best:
            best, at = along, k
    across = np.sqrt(x * x + y * y)
    grown = disc / across if across > 0.0 else 0.0
    out[0], out[1], out[2] = points[at, 0] + grown * x, points[at, 1] + grown * y, points[at, 2]


@jit_compile
def _project_on_simplex(S: Array, k: int, i: int, j: int, size: int, x: Array) -> bool:
    """The point of the plane (line) through entry k of S and i (and j) nearest to the origin, where it lies between."""
    if size == 2:
        e = aa = 0.0
        for c in range(3):
            d = S[i, c] - S[k, c]
            e += d * d
            aa -= S[k, c] * d
        if not (0.0 < aa < e):
            return False
        f = aa / e
        for c in range(3):
            x[c] = S[k, c] + f * (S[i, c] - S[k, c])
        return True
    uu = uv = vv = pu = pv = 0.0
    for c in range(3):
        u, v = S[i, c] - S[k, c], S[j, c] - S[k, c]
        uu, uv, vv, pu, pv = uu + u * u, uv + u * v, vv + v * v, pu - S[k, c] * u, pv - S[k, c] * v
    flat = uu * vv - uv * uv
    if not flat > 1e-14 * uu * vv:
        return False
    f, g = (pu * vv - pv * uv) / flat, (pv * uu - pu * uv) / flat
    if not (f > 0.0 and g > 0.0 and f + g < 1.0):
        return False
    for c in range(3):
        x[c] = S[k, c] + f * (S[i, c] - S[k, c]) + g * (S[j, c] - S[k, c])
    return True


@jit_compile
def _is_origin_inside(S: Array) -> bool:
    """The origin lies in the tetrahedron of the four entries of S: on the inner side of each of its faces."""
    for k in range(4):
        i, j, m = (k + 1) % 4, (k + 2) % 4, (k + 3) % 4
        ux, uy, uz = S[j, 0] - S[i, 0], S[j, 1] - S[i, 1], S[j, 2] - S[i, 2]
        vx, vy, vz = S[m, 0] - S[i, 0], S[m, 1] - S[i, 1], S[m, 2] - S[i, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        inner = (S[k, 0] - S[i, 0]) * nx + (S[k, 1] - S[i, 1]) * ny + (S[k, 2] - S[i, 2]) * nz
        own = -(S[i, 0] * nx + S[i, 1] * ny + S[i, 2] * nz)
        if not inner * own > 0.0:
            return False
    return True


@jit_compile
def _reduce_simplex(S: Array, size: int, x: Array, trial: Array, keep: Ints) -> int:
    """The shortest vector x of the hull of ``size`` ≤ 4 entries of S, of those with the last entry in it.

    The entries that make it are moved to the front; returns their number, 0 where the origin is inside, −1 where
    nothing is shorter than x.
    """
    last, best, found = size - 1, x[0] * x[0] + x[1] * x[1] + x[2] * x[2], 0
    old = best
    if size == 4 and _is_origin_inside(S):
        return 0
    for i in range(-1, last):
        for j in range(-1, max(i, 0)):
            if i < 0:
                for c in range(3):
                    trial[c] = S[last, c]
            elif not _project_on_simplex(S, last, i, j, 2 if j < 0 else 3, trial):
                continue
            now = trial[0] * trial[0] + trial[1] * trial[1] + trial[2] * trial[2]
            if now < best:
                best = now
                found = 1 + (i >= 0) + (j >= 0)
                keep[0], keep[1] = i, j
                x[0], x[1], x[2] = trial[0], trial[1], trial[2]
    if not best < old:
        return -1
    for c in range(3):
        p = S[keep[0], c] if found > 1 else 0.0
        q = S[keep[1], c] if found > 2 else 0.0
        S[0, c] = S[last, c]
        if found > 1:
            S[1, c] = p
        if found > 2:
            S[2, c] = q
    return found


@jit_compile
def _bound_hull_distance(
    pa: Array,
    a0: int,
    a1: int,
    da: float,
    pb: Array,
    b0: int,
    b1: int,
    db: float,
    T: Array,
    most: float,
    u: Array,
    S: Array,
    work: Array,
    keep: Ints,
) -> tuple[float, float]:
    """m below and above the distance of two hulls with discs, b moved by T; u begins as a guess of the way from a to b.

    Ends as soon as the bound below reaches ``most``; u becomes the shortest way found, of unit length.
    """
    x, a, b, trial = work[0], work[1], work[2], work[3]
    below, above, size = 0.0, np.inf, 0
    for _ in range(MAX_GJK_STEPS):
        _find_support_point(pa, a0, a1, da, u[0], u[1], u[2], a)
        bx = -(T[0, 0] * u[0] + T[1, 0] * u[1] + T[2, 0] * u[2])
        by = -(T[0, 1] * u[0] + T[1, 1] * u[1] + T[2, 1] * u[2])
        bz = -(T[0, 2] * u[0] + T[1, 2] * u[1] + T[2, 2] * u[2])
        _find_support_point(pb, b0, b1, db, bx, by, bz, b)
        along = 0.0
        for c in range(3):
            S[size, c] = T[c, 0] * b[0] + T[c, 1] * b[1] + T[c, 2] * b[2] + T[c, 3] - a[c]
            along += S[size, c] * u[c]
        below = max(below, along)
        if below >= most or above - below <= BOUND_GAP_M:
            break
        if size == 0:
            x[0], x[1], x[2] = S[0, 0], S[0, 1], S[0, 2]
            size = 1
        else:
            left = _reduce_simplex(S, size + 1, x, trial, keep)
            if left == 0:
                return 0.0, 0.0
            if left < 0:  # the point farthest along was there before: nothing is shorter, to rounding
                break
            size = left
        above = np.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        if above <= ROUNDING_M:
            return 0.0, 0.0
        u[0], u[1], u[2] = x[0] / above, x[1] / above, x[2] / above
    return below, above


@jit_compile
def _bound_box_distance(ma: Array, ha: Array, k: int, mb: Array, hb: Array, m: int, T: Array, u: Array) -> float:
    """m by which box k of a and box m of b, moved by T, are apart at least."""
    d = (
        T[0, 0] * mb[m, 0] + T[0, 1] * mb[m, 1] + T[0, 2] * mb[m, 2] + T[0, 3] - ma[k, 0],
        T[1, 0] * mb[m, 0] + T[1, 1] * mb[m, 1] + T[1, 2] * mb[m, 2] + T[1, 3] - ma[k, 1],
        T[2, 0] * mb[m, 0] + T[2, 1] * mb[m, 1] + T[2, 2] * mb[m, 2] + T[2, 3] - ma[k, 2],
    )
    first = second = 0.0
    way = d[0] * u[0] + d[1] * u[1] + d[2] * u[2]
    for c in range(3):
        o = abs(d[c]) - ha[k, c] - abs(T[c, 0]) * hb[m, 0] - abs(T[c, 1]) * hb[m, 1] - abs(T[c, 2]) * hb[m, 2]
        if o > 0.0:
            first += o * o
        along = T[0, c] * d[0] + T[1, c] * d[1] + T[2, c] * d[2]
        o = abs(along) - hb[m, c] - abs(T[0, c]) * ha[k, 0] - abs(T[1, c]) * ha[k, 1] - abs(T[2, c]) * ha[k, 2]
        if o > 0.0:
            second += o * o
        way -= abs(u[c]) * ha[k, c] + abs(T[0, c] * u[0] + T[1, c] * u[1] + T[2, c] * u[2]) * hb[m, c]
    return float(max(np.sqrt(max(first, second)), way))


@jit_compile
def _bound_distance(
    pa: Array,
    fa: Ints,
    da: Array,
    ra: Array,
    ma: Array,
    ha: Array,
    pb: Array,
    fb: Ints,
    db: Array,
    rb: Array,
    mb: Array,
    hb: Array,
    T: Array,
    most: float,
    guess: Ints,
    waiting: Ints,
    gaps: Array,
    S: Array,
    work: Array,
    keep: Ints,
) -> tuple[float, float]:
    """m below and above the distance, close where that is below ``most``; ``guess`` (2,) are two parts that may be the
    nearest, and become them."""
    na, nb = len(ma) // 2, len(mb) // 2
    u, v = work[4], work[5]
    if not u[0] * u[0] + u[1] * u[1] + u[2] * u[2] > 0.5:
        u[0], u[1], u[2] = 0.0, 0.0, 1.0
    i, j = guess[0], guess[1]
    below, above = _bound_hull_distance(
        pa, fa[i], fa[i + 1], da[i], pb, fb[j], fb[j + 1], db[j], T, np.inf, u, S, work, keep
    )
    below, above = below - ra[i] - rb[j], above - ra[i] - rb[j]
    waiting[0, 0], waiting[0, 1], gaps[0], depth = 1, 1, -np.inf, 1
    while depth and above > 0.0:
        depth -= 1
        k, m = waiting[depth, 0], waiting[depth, 1]
        if gaps[depth] >= min(above - BOUND_GAP_M, most):
            below = min(below, gaps[depth])
            continue
        if k >= na and m >= nb:
            p, q = k - na, m - nb
            if p == guess[0] and q == guess[1]:
                continue
            for c in range(3):
                v[c] = u[c]
            grown = ra[p] + rb[q]
            low, high = _bound_hull_distance(
                pa,
                fa[p],
                fa[p + 1],
                da[p],
                pb,
                fb[q],
                fb[q + 1],
                db[q],
                T,
                min(above - BOUND_GAP_M, most) + grown,
                v,
                S,
                work,
                keep,
            )
            below = min(below, low - grown)
            if high - grown < above:
                above, i, j = high - grown, p, q
                for c in range(3):
                    u[c] = v[c]
            continue
        wide = max(ha[k, 0], ha[k, 1], ha[k, 2]) >= max(hb[m, 0], hb[m, 1], hb[m, 2])
        if m >= nb or (k < na and wide):
            k1, k2, m1, m2 = 2 * k, 2 * k + 1, m, m
        else:
            k1, k2, m1, m2 = k, k, 2 * m, 2 * m + 1
        g1, g2 = np.inf, np.inf
        if ha[k1, 0] >= 0.0 and hb[m1, 0] >= 0.0:
            g1 = _bound_box_distance(ma, ha, k1, mb, hb, m1, T, u)
        if ha[k2, 0] >= 0.0 and hb[m2, 0] >= 0.0:
            g2 = _bound_box_distance(ma, ha, k2, mb, hb, m2, T, u)
        if g1 < g2:  # the nearer one is looked into first
            k1, k2, m1, m2, g1, g2 = k2, k1, m2, m1, g2, g1
        if g1 < np.inf:
            waiting[depth, 0], waiting[depth, 1], gaps[depth] = k1, m1, g1
            depth += 1
        if g2 < np.inf:
            waiting[depth, 0], waiting[depth, 1], gaps[depth] = k2, m2, g2
            depth += 1
    guess[0], guess[1] = i, j
    if above <= 0.0:
        return 0.0, 0.0
    return max(min(below, above) - ROUNDING_M, 0.0), above + ROUNDING_M


@jit_compile
def _bound_rows(
    pa: Array,
    fa: Ints,
    da: Array,
    ra: Array,
    ma: Array,
    ha: Array,
    pb: Array,
    fb: Ints,
    db: Array,
    rb: Array,
    mb: Array,
    hb: Array,
    T: Array,
    rows: Ints,
    way: Array,
    claim: Array,
) -> tuple[Array, Array]:
    below, above = np.zeros(len(T)), np.full(len(T), np.inf)
    guess, waiting, gaps = np.zeros(2, np.int64), np.empty((MAX_STACK_SIZE, 2), np.int64), np.empty(MAX_STACK_SIZE)
    S, work, keep = np.empty((4, 3)), np.zeros((6, 3)), np.empty(2, np.int64)
    known, since = -np.inf, 0.0
    for n in rows:
        below[n] = known - abs(way[n] - since)
        if below[n] >= claim[n]:
            continue
        known, above[n] = _bound_distance(
            pa,
            fa,
            da,
            ra,
            ma,
            ha,
            pb,
            fb,
            db,
            rb,
            mb,
            hb,
            T[n],
            claim[n] + CLAIM_MARGIN_M,
            guess,
            waiting,
            gaps,
            S,
            work,
            keep,
        )
        below[n], since = known, way[n]
    return below, above
