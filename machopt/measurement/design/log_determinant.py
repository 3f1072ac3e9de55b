"""Log-determinant of many small matrices at once."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array


def compute_log_det_one_plus(G: Array) -> Array:
    """Compute log det(1 + G Gᵀ) by an LDLᵀ factorisation over all N at once.

    Args:
        G: (N, D, P) factors.

    Returns:
        (N,) log-determinants.
    """
    D = G.shape[1]
    S = [[np.einsum("np,np->n", G[:, i], G[:, j]) for j in range(i + 1)] for i in range(D)]
    total = np.zeros(len(G))
    pivot: list[Array] = []
    L: list[list[Array]] = []
    for i in range(D):
        row: list[Array] = []
        for j in range(i):
            s = S[i][j] - sum((row[k] * L[j][k] * pivot[k] for k in range(j)), np.zeros(len(G)))
            row.append(s / pivot[j])
        pivot.append(1.0 + S[i][i] - sum((row[k] ** 2 * pivot[k] for k in range(i)), np.zeros(len(G))))
        L.append(row)
        total += np.log(pivot[i])
    return total
