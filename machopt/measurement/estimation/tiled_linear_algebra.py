"""Dense linear algebra in tiles so small that BLAS stays in one thread.

OpenBLAS splits larger products among threads that wait for each other by spinning: on a machine whose cores are all
busy an inverse of 768 unknowns then takes seconds instead of 50 ms, and NumPy's and SciPy's own pools hinder each other
even on a quiet one. Tiles of 64 keep each product below the size at which it does that.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

TILE = 64  # 64³ multiplications are the most that OpenBLAS leaves to one thread


def invert_positive_definite(A: Array) -> tuple[Array, float]:
    """Inverse and log-determinant of a symmetric positive definite matrix (n, n) by block Gauss–Jordan sweeps.

    Args:
        A: of a diagonal near one, for the sake of rounding.

    Raises:
        numpy.linalg.LinAlgError: not positive definite.
    """
    n = len(A)
    tiles = -(-n // TILE)
    padded = np.eye(tiles * TILE)
    padded[:n, :n] = A
    T = np.ascontiguousarray(padded.reshape(tiles, TILE, tiles, TILE).swapaxes(1, 2))  # lower ones are kept up to date
    row, other = np.tril_indices(tiles - 1)
    log = 0.0
    for k in range(tiles):
        sign, part = np.linalg.slogdet(T[k, k])
        P = np.linalg.inv(T[k, k]) if sign > 0 else -np.eye(TILE)
        if not (np.diag(P) > 0).all():  # of what a definite tile must be, the cheap half; rounding fails it first
            raise np.linalg.LinAlgError("the matrix is not positive definite")
        log += float(part)
        column = np.concatenate([T[k, :k].swapaxes(-1, -2), T[k + 1 :, k]])
        swept = column @ P
        others = np.delete(np.arange(tiles), k)
        T[others[row], others[other]] -= swept[row] @ column[other].swapaxes(-1, -2)
        T[k, :k], T[k + 1 :, k], T[k, k] = swept[:k].swapaxes(-1, -2), swept[k:], -P
    out = -T.swapaxes(1, 2).reshape(tiles * TILE, -1)[:n, :n]
    low = np.tril_indices(n, -1)
    out[low[1], low[0]] = out[low]
    return out, log


def multiply_matrices(A: Array, B: Array) -> Array:
    """A B for matrices (m, k), (k, n), a few rows of A at a time."""
    rows = max(TILE**3 // max(B.size, 1), 1)
    return np.concatenate([A[a : a + rows] @ B for a in range(0, len(A), rows)])


def multiply_vector(A: Array, v: Array) -> Array:
    """A v of a matrix (m, n) and a vector (n,)."""
    return np.asarray(np.einsum("ij,j->i", A, v))
