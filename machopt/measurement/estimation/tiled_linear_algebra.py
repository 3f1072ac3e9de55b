"""Dense linear algebra in tiles so small that BLAS uses a single thread.

OpenBLAS divides larger products among threads that wait by spinning. If all cores are busy, an inverse of 768
unknowns then takes seconds instead of 50 ms. The thread pools of NumPy and SciPy disturb each other even on an idle
machine. Tiles of 64 keep each product below that size.
"""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array

TILE = 64  # OpenBLAS computes up to 64³ multiplications in one thread


def invert_positive_definite(A: Array) -> tuple[Array, float]:
    """Invert a symmetric positive definite matrix by block Gauss–Jordan sweeps.

    Args:
        A: (n, n) matrix with a diagonal near one, for accuracy.

    Returns:
        Inverse (n, n) and log-determinant.

    Raises:
        numpy.linalg.LinAlgError: The matrix is not positive definite.
    """
    n = len(A)
    tiles = -(-n // TILE)
    padded = np.eye(tiles * TILE)
    padded[:n, :n] = A
    T = np.ascontiguousarray(
        padded.reshape(tiles, TILE, tiles, TILE).swapaxes(1, 2)
    )  # only the lower tiles are updated
    row, other = np.tril_indices(tiles - 1)
    log = 0.0
    for k in range(tiles):
        sign, part = np.linalg.slogdet(T[k, k])
        P = np.linalg.inv(T[k, k]) if sign > 0 else -np.eye(TILE)
        if not (np.diag(P) > 0).all():  # inexpensive necessary condition for a definite tile
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
    """Multiply two matrices, a few rows at a time.

    Args:
        A: (m, k) matrix.
        B: (k, n) matrix.

    Returns:
        (m, n).
    """
    rows = max(TILE**3 // max(B.size, 1), 1)
    return np.concatenate([A[a : a + rows] @ B for a in range(0, len(A), rows)])


def multiply_vector(A: Array, v: Array) -> Array:
    """Multiply a matrix by a vector.

    Args:
        A: (m, n) matrix.
        v: (n,) vector.

    Returns:
        (m,).
    """
    return np.asarray(np.einsum("ij,j->i", A, v))
