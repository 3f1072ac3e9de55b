"""Whitened hypotheses at all their shapes, with their sums by fold and cached products with the columns of models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from machopt.measurement.diagnosis.data_types.diagnosis_problem import EffectHypothesis, Shape
from machopt.measurement.diagnosis.statistics.fold_rows import (
    FoldRows,
    Ints,
    Rows,
    compute_own_products,
    compute_products_by_fold,
    index_rows_by_fold,
)
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import (
    ModelColumns,
    WhitenedModel,
    compute_column_units,
)
from machopt.measurement.diagnosis.statistics.whitening import ErrorWhitening
from machopt.numerics.array_types import Array

Products = WeakKeyDictionary[object, dict[int, tuple[Rows, Array, Array]]]
"""By column group or law, and by shape: rows of each fold, products by fold and their sum."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WhitenedHypothesis:
    """One whitened hypothesis at all its shapes; m = M, or fewer rows if it affects few coordinates."""

    hypothesis: EffectHypothesis
    X: Array  # (m, S, p)
    unit: Array  # (S, p) SI value of one fitted unit: columns have a whitened rms of one
    XX: Array  # (F, S, p, p)
    Xy: Array  # (F, S, p)
    size: int  # M
    y: Array  # (M,) right-hand side used for Xy
    rows: Ints | None = None  # (m,) ascending row indices; None: all
    index: int = 0
    products: Products = field(
        init=False, default_factory=WeakKeyDictionary, repr=False
    )  # cached products with model columns
    scores: WeakKeyDictionary[WhitenedModel, object] = field(
        init=False, default_factory=WeakKeyDictionary, repr=False
    )  # cached scores with models
    fits: WeakKeyDictionary[WhitenedModel, object] = field(
        init=False, default_factory=WeakKeyDictionary, repr=False
    )  # cached fits with models on all readings
    summed: list[Array] = field(init=False, default_factory=list, repr=False)  # cache: last residuals, sums by cluster
    fold_rows: list[tuple[Rows, FoldRows]] = field(init=False, default_factory=list, repr=False)  # cache: last folds

    def columns_at(self, shape: int) -> Array:
        """Return the whitened columns of one shape.

        Args:
            shape: Index of the shape.

        Returns:
            (M, p).
        """
        if self.rows is None:
            return np.asarray(self.X[:, shape])
        out = np.zeros((self.size, self.X.shape[2]))
        out[self.rows] = self.X[:, shape]
        return out

    def products_with(self, model: WhitenedModel) -> Array:
        """Return the products with a model's columns.

        Args:
            model: Whitened model.

        Returns:
            (S, p, P).
        """
        each = [self._find_products(part, model.rows)[2] for part in model.column_groups]
        return each[0] if len(each) == 1 else np.concatenate(each, axis=2)

    def products_by_fold(self, model: WhitenedModel) -> Array:
        """Return the products with a model's columns by fold, cached for each column group.

        Args:
            model: Whitened model.

        Returns:
            (F, S, p, P).
        """
        each = [self.products_with_model(part, model.rows) for part in model.column_groups]
        return each[0] if len(each) == 1 else np.concatenate(each, axis=3)

    def products_with_model(self, part: ModelColumns, folds: Rows) -> Array:
        """Return the products with one column group of a model by fold.

        Args:
            part: Column group.
            folds: Rows of each fold.

        Returns:
            (F, S, p, P).
        """
        return self._find_products(part, folds)[1]

    def _find_products(self, part: ModelColumns, folds: Rows) -> tuple[Rows, Array, Array]:
        """Return the cached products with a column group by fold (F, S, p, P), and their sum (S, p, P)."""
        known = self.products.setdefault(part if part.law is None else part.law, {})
        found = known.get(part.shape)
        if found is None or found[0] is not folds:
            products = compute_products_by_fold(self.X, part.X, self.rows_by_fold(folds))
            found = known[part.shape] = folds, products, products.sum(axis=0)
        return found

    def rows_by_fold(self, folds: Rows) -> FoldRows:
        """Return the rows of each fold, cached for the last folds.

        Args:
            folds: Rows of each fold.
        """
        if not self.fold_rows or self.fold_rows[0][0] is not folds:
            self.fold_rows[:] = [(folds, FoldRows.of(index_rows_by_fold(self.rows, self.size, folds)))]
        return self.fold_rows[0][1]

    @cached_property
    def sums(self) -> tuple[Array, Array]:
        """Sums of ``XX`` (S, p, p) and ``Xy`` (S, p) over the folds."""
        return np.asarray(self.XX.sum(axis=0)), np.asarray(self.Xy.sum(axis=0))

    @cached_property
    def precision_matrices(self) -> Array:
        """Prior precision (S, p, p) of the fitted coefficients."""
        precision = np.stack([self.precision(shape) for shape in range(len(self.shapes))])
        return precision[..., None] * np.eye(precision.shape[1])

    def products_by_cluster(self, w: ErrorWhitening, residual: Array) -> Array:
        """Return the products with a whitened residual by cluster of groups; cached for the last residual.

        Args:
            w: Whitening of the problem.
            residual: (M,) whitened residuals.

        Returns:
            (C, S, p).
        """
        if not self.summed or self.summed[0] is not residual:
            own = residual if self.rows is None else residual[self.rows]
            self.summed[:] = [residual, w.sum_by_cluster(self.X * own[:, None, None], self.rows)]
        return self.summed[1]

    def precision(self, shape: int) -> Array:
        """Return the prior precision of the fitted coefficients.

        Args:
            shape: Index of the shape.

        Returns:
            (p,), zero without a prior.
        """
        known = self.hypothesis.prior_sigma
        return np.zeros(self.X.shape[2]) if known is None else np.asarray((self.unit[shape] / known) ** 2)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        return self.hypothesis.shapes


def select_shape(law: WhitenedHypothesis, shape: int) -> WhitenedHypothesis:
    """Return a hypothesis with one of its shapes.

    Args:
        law: Whitened hypothesis.
        shape: Index of the shape.

    Returns:
        The hypothesis.
    """
    k = slice(shape, shape + 1)
    h = replace(law.hypothesis, shapes=(law.shapes[shape],))
    return replace(law, hypothesis=h, X=law.X[:, k], unit=law.unit[k], XX=law.XX[:, k], Xy=law.Xy[:, k])


def whiten_hypotheses(
    base: WhitenedModel, hypotheses: Sequence[EffectHypothesis], report_progress: Callable[[int], None] = lambda _: None
) -> list[WhitenedHypothesis]:
    """Whiten every hypothesis at every shape; those that change no reading are left out.

    Args:
        base: Whitened base model.
        hypotheses: The hypotheses.
        report_progress: Called with the number of finished hypotheses.

    Returns:
        The whitened hypotheses.
    """
    w, y = base.w, base.y
    out: list[WhitenedHypothesis] = []
    for done, h in enumerate(hypotheses):
        report_progress(done)
        raw, moved = _evaluate_columns(h, w)
        S, p = raw.shape[2:]
        flat = raw.reshape(*raw.shape[:2], S * p)
        X, rows = (w.whiten(flat), None) if moved is None else (w.whiten_rows(flat, moved), w.rows_of(moved))
        del raw, flat
        unit = compute_column_units(X, len(y))
        if not np.isfinite(X).all() or not np.any(X):
            continue
        X *= unit
        X = X.reshape(-1, S, p)
        parts = index_rows_by_fold(rows, len(y), base.rows)
        XX = np.stack([compute_own_products(X[k]) for k, _ in parts])
        Xy = np.stack([np.einsum("msp,m->sp", X[k], y[r]) for k, r in parts])
        out.append(
            WhitenedHypothesis(
                hypothesis=h,
                X=X,
                unit=unit.reshape(S, p),
                XX=XX,
                Xy=Xy,
                size=len(y),
                y=y,
                rows=rows,
                index=len(out),
            )
        )
    return out


def _evaluate_columns(h: EffectHypothesis, w: ErrorWhitening) -> tuple[Array, Ints | None]:
    """Return columns at all shapes, (N, D, S, p), or (N, d, S, p) with the few affected coordinates (d,)."""
    first = h.columns(h.shapes[0])
    N, D, p = first.shape
    moved = np.flatnonzero(np.any(first.any(axis=0), axis=1))
    alone = w.is_independent and 0 < 2 * len(moved) <= D
    out = np.empty((N, len(moved) if alone else D, len(h.shapes), p))
    for k, shape in enumerate(h.shapes):
        columns = first if k == 0 else h.columns(shape)
        if alone and np.count_nonzero(columns) > np.count_nonzero(columns[:, moved]):
            return np.stack([h.columns(s) for s in h.shapes], axis=2), None  # shapes affect different coordinates
        out[:, :, k] = columns[:, moved] if alone else columns
    return out, moved if alone else None
