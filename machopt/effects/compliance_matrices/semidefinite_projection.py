"""Nearest positive semidefinite compliance matrix, in the metric of the readings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools

ROUNDS, MOST = 60, 2000
LEVER_SCALE = 1e3  # rad/(N·m) per 1/N: scales rotations with a lever arm of 1 mm
MIN_EIGENVALUE = 1e-6  # relative eigenvalue above which a direction counts as observed
CONVERGENCE_TOLERANCE = 1e-9  # relative


def _compute_direction_scales(
    values: Array, pairs: Sequence[tuple[int, int]], curvature: Array, unseen: Bools
) -> Array:
    """Return the scale (n,) of each direction, so that metres and radians are comparable.

    Args:
        values: (p,) entries of the matrix, SI.
        pairs: Row and column of each entry.
        curvature: (p,) increase of the residual sum for a change of each entry.
        unseen: (n,) directions that no reading determines.
    """
    unit = 1.0 / np.sqrt(np.maximum(curvature, np.finfo(float).tiny))
    size = np.ones(len(unseen))
    for v, u, (i, j) in zip(values, unit, pairs, strict=True):
        if i == j and not unseen[i]:
            size[i] = np.sqrt(max(float(v), float(u)))
    for i in np.flatnonzero(unseen).tolist():
        with_seen = [
            abs(float(v)) / size[a + b - i]
            for v, (a, b) in zip(values, pairs, strict=True)
            if i in (a, b) and not unseen[a + b - i]
        ]
        size[i] = max(with_seen)
    return size


def find_nearest_semidefinite(values: Array, pairs: Sequence[tuple[int, int]], metric: Array) -> Array:
    """Find the coefficients of a positive semidefinite matrix that increase the residual sum of squares least.

    Cutting-plane method: every direction v with vᵀC v < 0 adds the plane vᵀC v ≥ 0. The nearest point that satisfies
    all planes so far is a least-distance problem (Lawson & Hanson 1974, ch. 23).

    Args:
        values: (p,) entries of a symmetric matrix, SI; entries not listed are zero.
        pairs: Row and column of each entry.
        metric: (p, p) increase of the residual sum for a change of ``values``. A diagonal entry that no reading
            determines takes the least value that its couplings require.

    Returns:
        (p,) coefficients; unchanged if they are already admissible.
    """
    from scipy.optimize import nnls  # takes a second to load, and few need it

    n = 1 + max(j for _, j in pairs)
    rows, columns = np.array(pairs).T
    twice = np.where(rows == columns, 1.0, 2.0)
    unseen = _find_unobserved_directions(values, pairs, np.diag(metric), n)
    size = _compute_direction_scales(values, pairs, np.diag(metric), unseen)
    scale = size[rows] * size[columns]
    x0 = np.where((rows == columns) & unseen[rows], 1.0, values / scale)
    eigen, axes = np.linalg.eigh(metric * np.outer(scale, scale))
    root = np.sqrt(np.maximum(eigen, CONVERGENCE_TOLERANCE * eigen[-1]))
    farthest = float(np.linalg.norm(root * (axes.T @ x0)))  # to the zero matrix, which is admissible
    root /= farthest if farthest > 0.0 else 1.0
    back = axes / root  # of z = root axesᵀ (x − x0); |z|² is proportional to the increase of the residual sum

    def matrix(x: Array) -> Array:
        C = np.zeros((n, n))
        C[rows, columns] = C[columns, rows] = x
        return C

    x, planes = x0, np.zeros((0, len(pairs)))
    for _ in range(ROUNDS):
        w, V = np.linalg.eigh(matrix(x))
        below = w < -CONVERGENCE_TOLERANCE * max(float(w[-1]), 1.0)
        if not below.any():
            break
        planes = np.concatenate([planes, (V[rows][:, below] * V[columns][:, below]).T * twice])
        G, h = planes @ back, -planes @ x0
        long = np.linalg.norm(G, axis=1)
        u, _ = nnls(np.concatenate([(G / long[:, None]).T, (h / long)[None]]), np.eye(len(pairs) + 1)[-1], maxiter=MOST)
        r = np.concatenate([(G / long[:, None]).T @ u, [(h / long) @ u - 1.0]])
        x = x0 - back @ (r[:-1] / r[-1])
    if x is x0 and not unseen.any():
        return values
    w, V = np.linalg.eigh(matrix(x))
    C = (V * np.maximum(w, 0.0)) @ V.T
    if unseen.any():
        B = C[np.ix_(~unseen, unseen)]
        C[np.ix_(unseen, unseen)] = (
            B.T @ np.linalg.pinv(C[np.ix_(~unseen, ~unseen)], rcond=MIN_EIGENVALUE, hermitian=True) @ B
        )
    return np.asarray(C[rows, columns] * scale)


def _find_unobserved_directions(
    values: Array, pairs: Sequence[tuple[int, int]], metric: Array, n: int
) -> NDArray[np.bool_]:
    """Return (n,) True for directions whose diagonal entry the readings would not show even if it dominated its
    couplings.
    """
    coupled = np.zeros(n)
    for v, (i, j) in zip(values, pairs, strict=True):
        if i != j:
            coupled[[i, j]] = np.maximum(coupled[[i, j]], abs(float(v)))
    out = np.zeros(n, bool)
    for m, (i, j) in zip(metric, pairs, strict=True):
        if i == j:
            out[i] = coupled[i] > 0.0 and m * (LEVER_SCALE * coupled[i]) ** 2 < CONVERGENCE_TOLERANCE
    return out
