"""Which of many placements bring two surfaces nearer than a limit: yes or no, without the distance (compiled).

A limit prunes more than a distance that is still unknown, so the two trees of boxes (:mod:`machopt.model.triangles`)
are gone down without moving the second surface first: a box of it is placed when it is looked at, as the box along the
first one's axes around the turned box, and triangles only in boxes that come near each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.compiled import compiled
from machopt.model.threads import side_by_side
from machopt.model.triangles import DEPTH, Mesh, triangles

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
BLOCK = 2048  # placements of one task, whatever the number of cores
TOUCH = 1e-9  # m, below which surfaces cross


def nearer(a: Mesh, b: Mesh, T: Array, limit: float) -> Bools:
    """(S,) whether the surfaces cross or are nearer than ``limit`` m, with b moved by T (S, 4, 4) seen from a.

    Quickest where neighbouring rows are neighbouring placements. What is wholly inside is apart.
    """
    T = np.ascontiguousarray(T, float)
    limit = max(limit, TOUCH)

    def block(start: int) -> Bools:
        found: Bools = _rows(
            a.corners, a.normals, a.low, a.high, a.child, a.first, a.count, a.order,
            b.corners, b.normals, b.low, b.high, b.child, b.first, b.count, b.order, T[start : start + BLOCK], limit,
        )  # fmt: skip
        return found

    return np.concatenate([np.zeros(0, bool), *side_by_side(block, range(0, len(T), BLOCK))])


@compiled
def _placed(T: Array, triangle: Array, normal: Array, out: Array, turned: Array) -> None:
    """A triangle (3, 3) and its normal, moved by T (4, 4)."""
    for c in range(3):
        turned[c] = T[c, 0] * normal[0] + T[c, 1] * normal[1] + T[c, 2] * normal[2]
        for v in range(3):
            out[v, c] = T[c, 0] * triangle[v, 0] + T[c, 1] * triangle[v, 1] + T[c, 2] * triangle[v, 2] + T[c, 3]


@compiled
def _apart(low: Array, high: Array, k: int, lo: Array, hi: Array, m: int, T: Array) -> float:
    """m² by which box k is apart, at least, from box m moved by T."""
    gap = 0.0
    for c in range(3):
        middle, half = T[c, 3], 0.0
        for i in range(3):
            middle += 0.5 * T[c, i] * (lo[m, i] + hi[m, i])
            half += 0.5 * abs(T[c, i]) * (hi[m, i] - lo[m, i])
        way = max(low[k, c] - middle - half, middle - half - high[k, c], 0.0)
        gap += way * way
    return gap


@compiled
def _rows(
    a: Array, na: Array, low: Array, high: Array, child: Ints, first: Ints, count: Ints, order: Ints,
    b: Array, nb: Array, lo: Array, hi: Array, inner: Ints, begin: Ints, number: Ints, sequence: Ints,
    T: Array, limit: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """As :func:`nearer` says, ``limit`` at least TOUCH; a … order and b … sequence as in :class:`Mesh`."""
    out = np.zeros(len(T), np.bool_)
    waiting, work = np.empty((DEPTH, 2), np.int64), np.empty((7, 3))
    moved, turned = np.empty((3, 3)), np.empty(3)
    i, j = -1, -1  # the two triangles that were near in the row before
    for n in range(len(T)):
        if i >= 0:
            _placed(T[n], b[j], nb[j], moved, turned)
            d, exact = triangles(a[i], na[i], moved, turned, limit, work)
            if exact and d < limit:
                out[n] = True
                continue
        waiting[0, 0], waiting[0, 1], depth = 0, 0, 1
        while depth and not out[n]:
            depth -= 1
            k, m = waiting[depth, 0], waiting[depth, 1]
            if _apart(low, high, k, lo, hi, m, T[n]) >= limit * limit:
                continue
            if child[k] < 0 and inner[m] < 0:
                for t in range(begin[m], begin[m] + number[m]):
                    w = sequence[t]
                    _placed(T[n], b[w], nb[w], moved, turned)
                    for s in range(first[k], first[k] + count[k]):
                        v = order[s]
                        d, exact = triangles(a[v], na[v], moved, turned, limit, work)
                        if exact and d < limit:
                            out[n], i, j = True, v, w
                            break
                    if out[n]:
                        break
            # the box with more triangles is divided
            elif inner[m] < 0 or (child[k] >= 0 and count[k] >= number[m]):
                waiting[depth, 0], waiting[depth, 1] = child[k], m
                waiting[depth + 1, 0], waiting[depth + 1, 1] = child[k] + 1, m
                depth += 2
            else:
                waiting[depth, 0], waiting[depth, 1] = k, inner[m]
                waiting[depth + 1, 0], waiting[depth + 1, 1] = k, inner[m] + 1
                depth += 2
    return out
