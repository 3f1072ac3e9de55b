"""Newton's equations of offsets along a path, in the coefficients of their curves: a band matrix with a border.

With z = M c and a matrix K that couples each station with itself and the next, H = MᵀKM. Ordered along the path, a
spline coefficient is coupled only with nearby ones, so H is banded. Coefficients that several runs share come last, as
a
border. The Cholesky factor of the band and the Schur complement of the border solve it (Golub & Van Loan 2013, sections
4.3.5 and 4.5.1). The map from the entries of K to those of H is linear and the same for all K. It is computed once.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.lapack import dpbtrf, dpbtrs

from machopt.numerics.array_types import Array, Bools


class BorderedSystem:
    """Solver of (MᵀKM + ridge) x = right for one M."""

    def __init__(self, curves: sparse.csr_matrix, d: int, shared: Bools) -> None:
        """Prepare the map from the entries of K to those of MᵀKM.

        Args:
            curves: (n·d, m) M, station by station.
            d: number of offsets per station.
            shared: (m,) coefficients of the border.
        """
        rows, m = curves.shape
        self.curves, self.back, n = curves, curves.T.tocsr(), rows // d
        width = int(np.diff(curves.indptr).max(initial=1))
        columns, values = np.zeros((rows, width), np.intp), np.zeros((rows, width))
        row = np.repeat(np.arange(rows), np.diff(curves.indptr))
        place = np.arange(curves.nnz) - curves.indptr[row]
        columns[row, place], values[row, place] = curves.indices, curves.data
        first = np.full(m, rows)
        np.minimum.at(first, curves.indices, row)
        self.order = np.lexsort((np.arange(m), first // d, shared))
        rank = np.empty(m, np.intp)
        rank[self.order] = np.arange(m)
        columns = rank[columns]
        self.inner, self.border = m - int(shared.sum()), int(shared.sum())
        z = np.arange(rows).reshape(n, d)
        own = np.broadcast_arrays(z[:, :, None], z[:, None, :])
        on = np.broadcast_arrays(z[1:, :, None], z[:-1, None, :])
        a, b = (np.r_[x.ravel(), y.ravel()] for x, y in zip(own, on, strict=True))  # K's entries, as `solved` has them
        i, j, entry = np.broadcast_arrays(
            columns[a][:, :, None], columns[b][:, None, :], np.arange(len(a))[:, None, None]
        )
        share = values[a][:, :, None] * values[b][:, None, :]
        onward = entry >= n * d * d  # also represents its mirror image
        share = np.where(onward & (i == j), 2.0 * share, share)
        keep = (share != 0.0) & (onward | (i >= j))
        i, j, entry, share = np.maximum(i, j)[keep], np.minimum(i, j)[keep], entry[keep], share[keep]
        inside = i < self.inner
        self.band = int((i - j)[inside].max(initial=0))
        self.size = (self.band + 1) * self.inner
        at = np.where(inside, (i - j) * self.inner + j, self.size + (i - self.inner) * m + j)
        self.sums = sparse.csr_matrix((share, (at, entry)), shape=(self.size + self.border * m, len(a)))

    def along(self, c: Array) -> Array:
        """Return the (n·d,) offsets z = M c.

        Args:
            c: (m,) coefficients.
        """
        return np.asarray(self.curves @ c)

    def summed(self, z: Array) -> Array:
        """Return (m,) Mᵀz.

        Args:
            z: (n·d,) offsets.
        """
        return np.asarray(self.back @ z)

    def solved(self, own: Array, on: Array, ridge: float, share: float, right: Array) -> Array | None:
        """Return the (m, r) solution of (MᵀKM + ridge) x = right; None where rounding makes the matrix not positive
        definite.

        Args:
            own: (n, d, d) diagonal blocks of K.
            on: (n − 1, d, d) blocks below it, of a station (rows) and the previous one (columns).
            ridge: value added to the diagonal.
            share: additional value on the diagonal, as a share of the largest entry.
            right: (m, r) right-hand sides.
        """
        entries = self.sums @ np.r_[own.ravel(), on.ravel()]
        more = ridge + share * (1.0 + float(np.abs(entries).max(initial=0.0)))
        band = entries[: self.size].reshape(self.band + 1, self.inner)
        band[0] += more
        low = entries[self.size :].reshape(self.border, self.inner + self.border)
        right = right[self.order]
        factor, failed = dpbtrf(band, lower=1) if self.inner else (band, 0)
        if failed:
            return None
        inner, below = right[: self.inner], right[self.inner :]
        if self.border:
            side, corner = low[:, : self.inner], low[:, self.inner :]
            corner = np.tril(corner) + np.tril(corner, -1).T + more * np.eye(self.border)
            first = _solve_band(factor, np.hstack([inner, side.T]))
            try:
                schur = cho_factor(corner - side @ first[:, right.shape[1] :], lower=True)
            except LinAlgError:
                return None
            below = cho_solve(schur, below - side @ first[:, : right.shape[1]])
            inner = first[:, : right.shape[1]] - first[:, right.shape[1] :] @ below
        else:
            inner = _solve_band(factor, inner)
        out = np.empty_like(right)
        out[self.order] = np.vstack([inner, below])
        return out


def _solve_band(factor: Array, right: Array) -> Array:
    return np.asarray(dpbtrs(factor, right, lower=1)[0]) if len(right) else right
