"""Rows of each cross-validation fold, and products of columns over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis.statistics.whitening import ErrorWhitening
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Rows = tuple[Ints, ...]
MAX_PADDING = 1.5  # padded rows over rows up to which the folds are multiplied together


@dataclass(frozen=True, kw_only=True, eq=False)
class FoldRows:
    """Rows of each fold, as indices among the rows of a hypothesis and among all rows.

    Folds of similar size are padded to the longest, so that their products are one batched multiplication.
    """

    pairs: list[tuple[Ints, Ints]]
    own: Ints | None = None  # (F, m) among the hypothesis' rows, padded; None: the folds are too unequal
    whole: Ints | None = None  # (F, m) among all rows
    present: Array | None = None  # (F, m, 1) 1, or 0 in the padding

    @classmethod
    def of(cls, pairs: list[tuple[Ints, Ints]]) -> FoldRows:
        """Return the rows, padded where that adds at most half of them.

        Args:
            pairs: Rows of each fold.
        """
        lengths = np.array([len(k) for k, _ in pairs])
        longest = int(lengths.max(initial=0))
        if len(pairs) * longest > MAX_PADDING * lengths.sum():
            return cls(pairs=pairs)
        present = np.arange(longest) < lengths[:, None]
        own, whole = np.zeros((2, *present.shape), np.int64)
        own[present] = np.concatenate([k for k, _ in pairs])
        whole[present] = np.concatenate([r for _, r in pairs])
        return cls(pairs=pairs, own=own, whole=whole, present=present[..., None].astype(float))


def list_rows_by_fold(w: ErrorWhitening, fold: Ints) -> Rows:
    """List the rows of each fold in ascending order.

    Args:
        w: Whitening of the problem.
        fold: (V,) cross-validation fold of each visit.

    Returns:
        Rows of each fold.
    """
    of = np.repeat(fold, np.diff(w.visit_starts))
    order = np.argsort(of, kind="stable")
    return tuple(np.split(order, np.searchsorted(of[order], np.arange(1, int(fold.max()) + 1))))


def index_rows_by_fold(rows: Ints | None, size: int, folds: Rows) -> list[tuple[Ints, Ints]]:
    """Return the rows of each fold as indices among some rows and among all rows.

    Args:
        rows: (m,) ascending row indices; None: all.
        size: Number of all rows.
        folds: Rows of each fold.

    Returns:
        For each fold, indices among ``rows`` and among all rows.
    """
    if rows is None:
        return [(r, r) for r in folds]
    place = np.full(size, -1, np.int64)
    place[rows] = np.arange(len(rows))
    return [(place[r][place[r] >= 0], r[place[r] >= 0]) for r in folds]


def compute_own_products(x: Array) -> Array:
    """Compute Σ_m x_msi x_msj; by matmul, because einsum does not use BLAS here.

    Args:
        x: (m, S, p) columns.

    Returns:
        (S, p, p).
    """
    t = x.transpose(1, 2, 0)
    return np.asarray(t @ x.transpose(1, 0, 2))


def compute_products_by_fold(x: Array, y: Array, folds: FoldRows) -> Array:
    """Compute Σ_m x_msi y_mp over the rows of each fold.

    Args:
        x: (m, S, p) columns of a hypothesis.
        y: (M, P) columns of a model.
        folds: Rows of each fold in x and in y.

    Returns:
        (F, S, p, P).
    """
    m, S, p = x.shape
    flat = x.reshape(m, S * p)
    if folds.own is None or folds.whole is None or folds.present is None:
        each = [flat[k].T @ y[r] for k, r in folds.pairs]
        return np.stack(each).reshape(len(each), S, p, -1)
    products = np.swapaxes(flat[folds.own], 1, 2) @ (y[folds.whole] * folds.present)
    return np.asarray(products.reshape(len(folds.pairs), S, p, -1))
