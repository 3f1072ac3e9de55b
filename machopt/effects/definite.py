"""The nearest symmetric matrix that gives way against no load, nearest as the readings count it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from machopt.arrays import Array

ROUNDS, MOST = 60, 2000
TIGHT = 1e-9  # relative


def nearest_definite(values: Array, pairs: Sequence[tuple[int, int]], metric: Array) -> Array:
    """Coefficients of a positive semidefinite matrix that lose the least.

    By cutting planes: every direction v that gives way against the load adds the plane vᵀC v ≥ 0, and the nearest
    point above all planes so far is a least distance problem (Lawson & Hanson 1974, ch. 23).

    Args:
        values: (p,) entries of a symmetric matrix, SI; those that it does not name are zero.
        pairs: where each stands.
        metric: (p, p) how the sum of squares grows with a change of ``values``.

    Returns:
        (p,) the same ones where they are possible already.
    """
    from scipy.optimize import nnls  # takes a second to load, and few need it

    n = 1 + max(j for _, j in pairs)
    rows, columns = np.array(pairs).T
    twice = np.where(rows == columns, 1.0, 2.0)
    unit = 1.0 / np.sqrt(np.maximum(np.diag(metric), np.finfo(float).tiny))
    size = np.ones(n)  # of each direction, so that metres and radians weigh alike
    for v, u, (i, j) in zip(values, unit, pairs, strict=True):
        if i == j:
            size[i] = np.sqrt(max(float(v), float(u)))
    scale = size[rows] * size[columns]
    x0 = values / scale
    eigen, axes = np.linalg.eigh(metric * np.outer(scale, scale))
    root = np.sqrt(np.maximum(eigen, TIGHT * eigen[-1]))
    back = axes / root  # of z = root axesᵀ (x − x0), whose length is what is lost

    def matrix(x: Array) -> Array:
        C = np.zeros((n, n))
        C[rows, columns] = C[columns, rows] = x
        return C

    x, planes = x0, np.zeros((0, len(pairs)))
    for _ in range(ROUNDS):
        w, V = np.linalg.eigh(matrix(x))
        below = w < -TIGHT * max(float(w[-1]), 1.0)
        if not below.any():
            break
        planes = np.concatenate([planes, (V[rows][:, below] * V[columns][:, below]).T * twice])
        G, h = planes @ back, -planes @ x0
        long = np.linalg.norm(G, axis=1)
        u, _ = nnls(np.concatenate([(G / long[:, None]).T, (h / long)[None]]), np.eye(len(pairs) + 1)[-1], maxiter=MOST)
        r = np.concatenate([(G / long[:, None]).T @ u, [(h / long) @ u - 1.0]])
        x = x0 - back @ (r[:-1] / r[-1])
    if x is x0:
        return values
    w, V = np.linalg.eigh(matrix(x))
    C = (V * np.maximum(w, 0.0)) @ V.T
    return np.asarray(C[rows, columns] * scale)
