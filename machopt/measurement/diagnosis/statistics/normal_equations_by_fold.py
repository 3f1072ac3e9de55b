"""Whitened normal equations by fold, sufficient for all fits and their cross-validation.

A model is a set of whitened columns. Its sums XᵀX and Xᵀy per fold are enough to refit it without any fold, and to
predict that fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.statistics.fold_rows import Ints, Rows, list_rows_by_fold
from machopt.measurement.diagnosis.statistics.whitening import ErrorWhitening
from machopt.numerics.array_types import Array

RIDGE = 1e-9  # relative to each column's squared norm: regularises unobservable directions
MOST_FOLDS = 40
MIN_COLUMN_SQUARE = 1e-3  # least whitened squared norm of a column
EXTENSION_BYTES = 2**26  # memory of the extended models that a model keeps
FEWEST_EXTENSIONS, MOST_EXTENSIONS = 4, 64  # that a model keeps


class LawSums(Protocol):
    """What a model needs of a whitened law that it contains at one shape."""

    @property
    def y(self) -> Array:
        """Right-hand side (M,) used for ``Xy``."""
        ...

    @property
    def XX(self) -> Array:
        """Own products (F, S, p, p)."""
        ...

    @property
    def Xy(self) -> Array:
        """Products with the right-hand side (F, S, p)."""
        ...

    def columns_at(self, shape: int) -> Array:
        """Return the whitened columns (M, p) of one shape."""
        ...

    def precision(self, shape: int) -> Array:
        """Return the prior precision (p,) of the fitted coefficients."""
        ...

    def products_by_fold(self, model: WhitenedModel) -> Array:
        """Return the products (F, S, p, P) with a model's columns by fold."""
        ...


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """Group of columns that were added to a model together."""

    columns: Array | None  # (M, p); None: the columns of ``law``
    law: LawSums | None = None  # at ``shape``
    shape: int = 0

    @cached_property
    def X(self) -> Array:
        """Columns (M, p)."""
        if self.columns is not None:
            return self.columns
        assert self.law is not None  # a group has columns or a law
        return self.law.columns_at(self.shape)


@dataclass(frozen=True, kw_only=True)
class SessionSums:
    """Normal equations of a model by session."""

    rows: Rows
    groups: int  # least number of groups in a session
    XX: Array  # (D, P, P)
    Xy: Array  # (D, P)


@dataclass(frozen=True, kw_only=True, eq=False)
class WhitenedModel:
    """Whitened columns that are fitted together, with cached results. Immutable."""

    w: ErrorWhitening
    column_groups: tuple[ModelColumns, ...]
    y: Array  # (M,)
    fold: Ints  # (V,) fold of each visit
    folds: int
    XX: Array  # (F, P, P)
    Xy: Array  # (F, P)
    yy: Array  # (F,)
    prior: Array  # (P,) prior precision of the coefficients, zero without a prior
    rows: Rows  # rows of each fold
    extensions: dict[tuple[tuple[LawSums, int], ...], WhitenedModel] = field(
        init=False, default_factory=dict, repr=False
    )  # models with further laws, the last used one last

    @cached_property
    def X(self) -> Array:
        """All columns (M, P)."""
        return (
            self.column_groups[0].X
            if len(self.column_groups) == 1
            else np.concatenate([p.X for p in self.column_groups], axis=1)
        )

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.prior)

    @cached_property
    def normal(self) -> Array:
        """Normal matrix (P, P) of all readings, including priors."""
        return np.asarray(self.XX.sum(axis=0) + np.diag(self.prior))

    @cached_property
    def inverse(self) -> Array:
        return invert_with_ridge(self.normal)

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients (P,) of the fit to all readings."""
        return np.asarray(self.inverse @ self.Xy.sum(axis=0))

    @cached_property
    def residual(self) -> Array:
        """Whitened residuals (M,) of the fit to all readings."""
        x, at, out = self.coefficients, 0, self.y.copy()
        for part in self.column_groups:
            out -= part.X @ x[at : at + part.X.shape[1]]
            at += part.X.shape[1]
        return out

    @cached_property
    def rss(self) -> float:
        return float(np.sum(self.residual**2))

    @cached_property
    def residual_variance(self) -> float:
        """Variance of a whitened residual, at least 1. Noise beyond the noise model makes every test stricter."""
        return float(max(1.0, self.rss / max(len(self.y) - self.count, 1)))

    @cached_property
    def by_session(self) -> SessionSums:
        """Normal equations by session."""
        w = self.w
        labels, day = np.unique(w.session, return_inverse=True)
        of = np.repeat(day, np.diff(w.visit_starts))
        rows = tuple(np.flatnonzero(of == d) for d in range(len(labels)))
        each = [self.X[r] for r in rows]
        return SessionSums(
            rows=rows,
            groups=min(len(np.unique(w.group_of_visit[day == d])) for d in range(len(labels))),
            XX=np.stack([x.T @ x for x in each]),
            Xy=np.stack([x.T @ self.y[r] for x, r in zip(each, rows, strict=True)]),
        )

    def with_columns(self, more: Array, precision: Array | None = None) -> WhitenedModel:
        """Return the model with further whitened columns.

        Args:
            more: (M, p) whitened columns.
            precision: (p,) prior precision; None without a prior.
        """
        C = np.concatenate([np.stack([more[r].T @ p.X[r] for r in self.rows]) for p in self.column_groups], axis=2)
        own = np.stack([x.T @ x for x in (more[r] for r in self.rows)])
        with_y = np.stack([more[r].T @ self.y[r] for r in self.rows])
        return self._grown(ModelColumns(more), C, (own, with_y), precision)

    def with_law(self, law: LawSums, shape: int, with_prior: bool = False) -> WhitenedModel:
        """Return the model with a law at one shape, using the cached products of the law.

        Args:
            law: Hypothesis whitened for the same readings and folds.
            shape: Index of the shape.
            with_prior: Whether the prior of its coefficients is applied.
        """
        if law.y is not self.y:
            raise ValueError("a law keeps its products with other readings than this model's; with_columns would work")
        own = (law.XX[:, shape], law.Xy[:, shape])
        known = law.precision(shape) if with_prior else None
        return self._grown(ModelColumns(None, law, shape), law.products_by_fold(self)[:, shape], own, known)

    def extend_by_laws(self, laws: Sequence[tuple[LawSums, int]]) -> WhitenedModel:
        """Return the model with laws and their priors; the models used last are kept with their cached results.

        Args:
            laws: Hypotheses whitened for the same readings and folds, each with the index of its shape.
        """
        chain = tuple(laws)
        if not chain:
            return self
        known = next((n for n in range(len(chain), 0, -1) if chain[:n] in self.extensions), 0)
        model = self.extensions.pop(chain[:known]) if known else self
        if known:
            self.extensions[chain[:known]] = model
        for law, shape in chain[known:]:
            model = model.with_law(law, shape, with_prior=True)
        self.extensions[chain] = model
        size = 8 * model.count * (len(self.y) + self.folds * model.count)
        most = int(np.clip(EXTENSION_BYTES // size, FEWEST_EXTENSIONS, MOST_EXTENSIONS))
        while len(self.extensions) > most:
            del self.extensions[next(iter(self.extensions))]
        return model

    def _grown(self, part: ModelColumns, C: Array, own: tuple[Array, Array], precision: Array | None) -> WhitenedModel:
        prior = np.concatenate([self.prior, np.zeros(C.shape[1]) if precision is None else precision])
        upper = np.concatenate([self.XX, np.swapaxes(C, 1, 2)], axis=2)
        lower = np.concatenate([C, own[0]], axis=2)
        XX, Xy = np.concatenate([upper, lower], axis=1), np.concatenate([self.Xy, own[1]], axis=1)
        return replace(self, column_groups=(*self.column_groups, part), XX=XX, Xy=Xy, prior=prior)


def build_whitened_model(
    w: ErrorWhitening, X: Array, y: Array, fold: Ints, prior: Array, rows: Rows | None = None
) -> WhitenedModel:
    """Build a model from whitened columns.

    Args:
        w: Whitening of the problem.
        X: (M, P) whitened columns.
        y: (M,) whitened right-hand side.
        fold: (V,) cross-validation fold of each visit.
        prior: (P,) prior precision.
        rows: Rows of each fold; None: derived from ``fold``.
    """
    rows = list_rows_by_fold(w, fold) if rows is None else rows
    XX = np.stack([x.T @ x for x in (X[r] for r in rows)])
    Xy = np.stack([X[r].T @ y[r] for r in rows])
    return WhitenedModel(
        w=w,
        column_groups=(ModelColumns(X),),
        y=y,
        fold=fold,
        folds=len(rows),
        XX=XX,
        Xy=Xy,
        yy=np.array([y[r] @ y[r] for r in rows]),
        prior=prior,
        rows=rows,
    )


def copy_folds(one: WhitenedModel, like: WhitenedModel) -> WhitenedModel:
    """Rebuild a model with the folds of another one.

    Args:
        one: Model to rebuild.
        like: Model with the folds.
    """
    return build_whitened_model(one.w, one.X, one.y, like.fold, one.prior, like.rows)


def build_base_model(
    problem: DiagnosisProblem, w: ErrorWhitening, rng: np.random.Generator
) -> tuple[WhitenedModel, Array]:
    """Build the model of the base alone.

    Args:
        problem: Regression problem.
        w: Whitening of the problem.
        rng: Random generator of the folds.

    Returns:
        The model, and the SI value of each fitted unit (P,).
    """
    X = w.whiten(problem.base)
    unit = compute_column_units(X)
    known = np.array([np.inf if u.prior is None else u.prior for u in problem.unknowns])
    return build_whitened_model(w, X * unit, w.whiten(problem.y), _build_folds(w, rng), (unit / known) ** 2), unit


def invert_with_ridge(H: Array, size: Array | None = None) -> Array:
    """Invert one or many normal matrices with a small relative ridge.

    Args:
        H: (…, P, P) symmetric matrices.
        size: (P,) norms of the columns that the ridge is relative to; None: those of the matrices. Of a matrix that
            other columns were eliminated from, the norms before: an absorbed column stays absorbed.

    Returns:
        (…, P, P).
    """
    d = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), MIN_COLUMN_SQUARE)) if size is None else size
    scaled = H / (d[..., :, None] * d[..., None, :])
    scaled = scaled + RIDGE * np.eye(H.shape[-1])
    return np.asarray(np.linalg.inv(scaled) / (d[..., :, None] * d[..., None, :]))


def _build_folds(w: ErrorWhitening, rng: np.random.Generator) -> Ints:
    groups = len(w.groups)
    if groups <= MOST_FOLDS:
        return w.group_of_visit
    return rng.permutation(np.arange(groups) % MOST_FOLDS)[w.group_of_visit]


def compute_column_units(X: Array, rows: int = 0) -> Array:
    """Return factors that scale the rms of each column over all rows to one.

    Args:
        X: (M, P) whitened columns.
        rows: Number of all rows, if X omits rows of zeros.

    Returns:
        (P,).
    """
    size = np.sqrt(np.mean(X**2, axis=0))
    if rows > len(X):
        size = size * np.sqrt(len(X) / rows)
    return np.asarray(1.0 / np.where(size > 0, size, 1.0))


def compute_cluster_robust_fit(model: WhitenedModel) -> tuple[Array, Array, float]:
    """Fit a model with cluster-robust covariance (folds as clusters).

    Args:
        model: Whitened model.

    Returns:
        Coefficients (P,), covariance (P, P), degrees of freedom.
    """
    M, x = invert_with_ridge(model.normal), model.coefficients
    u = model.Xy - np.einsum("fij,j->fi", model.XX, x)
    G, P = model.folds, len(x)
    robust = M @ (u.T @ u) @ M * G / max(G - 1, 1)
    # with few groups the robust estimate is noisy: never below the model-based variance
    grow = np.sqrt(
        np.maximum(np.diag(M) * model.residual_variance / np.maximum(np.diag(robust), 1e-12 * np.diag(M)), 1.0)
    )
    return x, robust * np.outer(grow, grow), float(max(G - P // 2, 4))
