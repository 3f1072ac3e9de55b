"""Normal equations of the base and of all laws at all shapes, computed once: subsets are small linear algebra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    MIN_COLUMN_SQUARE,
    ModelColumns,
    WhitenedModel,
    invert_with_ridge,
)
from machopt.measurement.diagnosis.statistics.whitened_hypothesis import WhitenedHypothesis
from machopt.numerics.array_types import Array, Ints

MOST_SHAPES = 8  # most shapes of a law that is no harmonic
FOLDS = 10


@dataclass(frozen=True)
class LawColumnGroup:
    """Columns of one law at one shape."""

    law: WhitenedHypothesis
    shape: int
    columns: slice  # position among all columns


@dataclass(frozen=True, kw_only=True)
class NormalEquationSums:
    """Normal equations of the base columns, the columns of all groups, and y, in this order."""

    total: Array  # (C + 1, C + 1)
    folds: tuple[Array, ...]
    fold_rows: tuple[int, ...]  # rows of each fold
    groups: tuple[LawColumnGroup, ...]
    base: int  # number of base columns
    rows: int

    @cached_property
    def sizes(self) -> Array:
        """Norms (C + 1,) of all columns and of y."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.total), MIN_COLUMN_SQUARE)))

    @cached_property
    def groups_by_width(self) -> tuple[tuple[Ints, Ints], ...]:
        """Indices (K,) and columns (K, p) of all groups with p columns, for each p."""
        width = np.array([g.columns.stop - g.columns.start for g in self.groups])
        start = np.array([g.columns.start for g in self.groups])
        each = [(np.flatnonzero(width == p), p) for p in np.unique(width).tolist()]
        return tuple((which, start[which][:, None] + np.arange(p)) for which, p in each)

    @cached_property
    def beside_base(self) -> Array:
        """Normal equations (C + 1, C + 1) without the base columns."""
        return eliminate_columns(self.total, np.arange(self.base))


class CachedSums:
    """Lazily computed sums of a base and laws, with a limited number of shapes per law."""

    def __init__(self, model: WhitenedModel, laws: Sequence[WhitenedHypothesis]) -> None:
        """Store base and laws; nothing is computed yet.

        Args:
            model: Whitened base model.
            laws: Hypotheses. If some are sums of harmonics, other harmonics of the same effect and place are left
                out: the pursuit selects orders one by one.
        """
        self.model, self.laws = model, laws

    @cached_property
    def sum_all(self) -> NormalEquationSums:
        """Sums of the base and all laws."""
        model, groups, at = self.model, [], self.model.count
        waves = {t.hypothesis.name for t in self.laws if t.hypothesis.sum_name}
        for t in self.laws:
            if t.hypothesis.name in waves and not t.hypothesis.sum_name:
                continue
            p, count = t.X.shape[2], len(t.shapes)
            most = count if t.hypothesis.sum_name else min(count, MOST_SHAPES)
            for s in np.linspace(0, count - 1, most).astype(int).tolist():
                groups.append(LawColumnGroup(t, s, slice(at, at + p)))
                at += p
        total, parts, size = np.zeros((at + 1, at + 1)), list[Array](), list[int]()
        for some in np.array_split(np.arange(model.folds), min(FOLDS, model.folds)):
            rows = np.concatenate([model.rows[f] for f in some])
            A = np.concatenate(
                [model.X[rows], *(g.law.columns_at(g.shape)[rows] for g in groups), model.y[rows, None]], axis=1
            )
            parts.append(A.T @ A)
            size.append(len(rows))
            total += parts[-1]
        _add_priors(total, model, groups)
        return NormalEquationSums(
            total=total,
            folds=tuple(parts),
            fold_rows=tuple(size),
            groups=tuple(groups),
            base=model.count,
            rows=len(model.y),
        )

    def select_groups(
        self, first: Sequence[tuple[WhitenedHypothesis, int]], among: Callable[[WhitenedHypothesis], bool]
    ) -> NormalEquationSums:
        """Return sums of the base, of given laws, and of further laws that fulfil a condition.

        Args:
            first: Laws with a shape index, in this order.
            among: Condition on the other laws.

        Returns:
            Sums without folds.
        """
        model, whole = self.model, self.sum_all
        others = [g for g in whole.groups if among(g.law)]
        columns = np.array(
            [*range(whole.base), *(c for g in others for c in range(g.columns.start, g.columns.stop))], int
        )
        at, groups = len(columns), []
        for law, shape in first:
            p = law.X.shape[2]
            groups.append(LawColumnGroup(law, shape, slice(at, at + p)))
            at += p
        total, stop = np.zeros((at + 1, at + 1)), whole.base
        n = np.append(np.arange(len(columns)), at)
        total[np.ix_(n, n)] = whole.total[np.ix_(np.append(columns, -1), np.append(columns, -1))]
        moved = []
        for g in others:
            p = g.columns.stop - g.columns.start
            moved.append(replace(g, columns=slice(stop, stop + p)))
            stop += p
        for k, g in enumerate(groups):
            base = g.law.products_with(model)[g.shape]
            _add_symmetric_block(total, g.columns, slice(0, whole.base), base)
            _add_symmetric_block(total, g.columns, slice(at, at + 1), g.law.Xy[:, g.shape].sum(axis=0)[:, None])
            _add_symmetric_block(total, g.columns, g.columns, g.law.XX[:, g.shape].sum(axis=0))
            part = ModelColumns(None, g.law, g.shape)
            for o in (*groups[:k], *moved):
                _add_symmetric_block(
                    total, o.columns, g.columns, o.law.products_with_model(part, model.rows)[:, o.shape].sum(axis=0)
                )
        _add_priors(total, None, groups)
        return NormalEquationSums(
            total=total, folds=(), fold_rows=(), groups=(*groups, *moved), base=whole.base, rows=whole.rows
        )


def _add_symmetric_block(total: Array, rows: slice, columns: slice, block: Array) -> None:
    """Add a block and its transpose to a symmetric matrix."""
    total[rows, columns], total[columns, rows] = block, block.T


def _add_priors(total: Array, model: WhitenedModel | None, groups: Sequence[LawColumnGroup]) -> None:
    """Add the prior precisions of base and groups to the diagonal."""
    if model is not None:
        k = np.arange(model.count)
        total[k, k] += model.prior
    for g in groups:
        n = np.arange(g.columns.start, g.columns.stop)
        total[n, n] += g.law.precision(g.shape)


def eliminate_columns(sums: Array, columns: Ints) -> Array:
    """Eliminate columns from normal equations (Schur complement).

    Args:
        sums: (C, C) normal equations.
        columns: Indices of the fitted columns.

    Returns:
        (C, C) reduced normal equations.
    """
    C = sums[columns]
    return np.asarray(sums - C.T @ invert_with_ridge(C[:, columns]) @ C)


def compute_group_gains(left: Array, sums: NormalEquationSums) -> Array:
    """Compute the gain of each group in addition to the eliminated columns; absorbed directions contribute nothing.

    Args:
        left: Reduced normal equations, see :func:`eliminate_columns`.
        sums: Complete normal equations.

    Returns:
        (G,) gains.
    """
    out = np.zeros(len(sums.groups))
    for which, at in sums.groups_by_width:
        out[which] = _compute_gains(left[at[:, :, None], at[:, None, :]], left[at, -1], sums.sizes[at])
    return out


def compute_gains_beside(sums: NormalEquationSums, columns: Ints) -> Array:
    """Compute the gain of each group in addition to the base and to few further columns.

    The same as :func:`compute_group_gains` of the columns eliminated, without the products between groups.

    Args:
        sums: Complete normal equations.
        columns: (k,) indices of the further columns.

    Returns:
        (G,) gains.
    """
    H = sums.beside_base
    K = H[columns]
    W = invert_with_ridge(K[:, columns], sums.sizes[columns]) @ K
    out = np.zeros(len(sums.groups))
    for which, at in sums.groups_by_width:
        S = H[at[:, :, None], at[:, None, :]] - np.einsum("cki,ckj->kij", K[:, at], W[:, at])
        out[which] = _compute_gains(S, H[at, -1] - np.einsum("cki,c->ki", K[:, at], W[:, -1]), sums.sizes[at])
    return out


def _compute_gains(S: Array, u: Array, size: Array) -> Array:
    """Return gains (K,) of groups with normal equations (K, p, p), (K, p) and column norms (K, p)."""
    if u.shape[1] == 1:
        value, w = S[:, :, 0] / size**2, u / size
    else:
        value, V = np.linalg.eigh(S / (size[:, :, None] * size[:, None, :]))
        w = np.einsum("kij,ki->kj", V, u / size)
    seen = value > thresholds.SHARES.rank
    return np.asarray(np.sum(np.where(seen, w**2 / np.where(seen, value, 1.0), 0.0), axis=1))
