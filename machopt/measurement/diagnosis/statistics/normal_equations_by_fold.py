"""Whitened normal equations by fold, sufficient for all fits and their cross-validation.

A model is a set of whitened columns. Its sums XᵀX and Xᵀy per fold are enough to refit it without any fold, and to
predict that fold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, EffectHypothesis, Shape
from machopt.measurement.diagnosis.statistics.whitening import ErrorWhitening
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Rows = tuple[Ints, ...]
Products = WeakKeyDictionary[object, dict[int, tuple[Rows, Array]]]  # by column group or law, and by shape
RIDGE = 1e-9  # relative to each column's squared norm: regularises unobservable directions
MOST_FOLDS = 40
MAX_PADDING = 1.5  # padded rows over rows up to which the folds are multiplied together
MIN_COLUMN_SQUARE = 1e-3  # least whitened squared norm of a column


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """Group of columns that were added to a model together."""

    columns: Array | None  # (M, p); None: the columns of ``law``
    law: WhitenedHypothesis | None = None  # at ``shape``
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

    def with_columns(self, more: Array, held: Array | None = None) -> WhitenedModel:
        """Return the model with further whitened columns.

        Args:
            more: (M, p) whitened columns.
            held: (p,) prior precision; None without a prior.
        """
        C = np.concatenate([np.stack([more[r].T @ p.X[r] for r in self.rows]) for p in self.column_groups], axis=2)
        own = np.stack([x.T @ x for x in (more[r] for r in self.rows)])
        with_y = np.stack([more[r].T @ self.y[r] for r in self.rows])
        return self._grown(ModelColumns(more), C, (own, with_y), held)

    def with_law(self, law: WhitenedHypothesis, shape: int, held: bool = False) -> WhitenedModel:
        """Return the model with a law at one shape, using the cached products of the law.

        Args:
            law: Hypothesis whitened for the same readings and folds.
            shape: Index of the shape.
            held: Whether the prior of its coefficients is applied.
        """
        if law.y is not self.y:
            raise ValueError("a law keeps its products with other readings than this model's; with_columns would work")
        own = (law.XX[:, shape], law.Xy[:, shape])
        known = law.precision(shape) if held else None
        return self._grown(ModelColumns(None, law, shape), law.products_by_fold(self)[:, shape], own, known)

    def _grown(self, part: ModelColumns, C: Array, own: tuple[Array, Array], held: Array | None) -> WhitenedModel:
        prior = np.concatenate([self.prior, np.zeros(C.shape[1]) if held is None else held])
        upper = np.concatenate([self.XX, np.swapaxes(C, 1, 2)], axis=2)
        lower = np.concatenate([C, own[0]], axis=2)
        XX, Xy = np.concatenate([upper, lower], axis=1), np.concatenate([self.Xy, own[1]], axis=1)
        return replace(self, column_groups=(*self.column_groups, part), XX=XX, Xy=Xy, prior=prior)


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
        return np.asarray(self.products_by_fold(model).sum(axis=0))

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
        known = self.products.setdefault(part if part.law is None else part.law, {})
        found = known.get(part.shape)
        if found is None or found[0] is not folds:
            found = known[part.shape] = folds, compute_products_by_fold(self.X, part.X, self.rows_by_fold(folds))
        return found[1]

    def rows_by_fold(self, folds: Rows) -> FoldRows:
        """Return the rows of each fold, cached for the last folds.

        Args:
            folds: Rows of each fold.
        """
        if not self.fold_rows or self.fold_rows[0][0] is not folds:
            self.fold_rows[:] = [(folds, FoldRows.of(_index_rows_by_fold(self.rows, self.size, folds)))]
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
    unit = _compute_column_units(X)
    known = np.array([np.inf if u.prior is None else u.prior for u in problem.unknowns])
    return build_whitened_model(w, X * unit, w.whiten(problem.y), _build_folds(w, rng), (unit / known) ** 2), unit


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
        unit = _compute_column_units(X, len(y))
        if not np.isfinite(X).all() or not np.any(X):
            continue
        X *= unit
        X = X.reshape(-1, S, p)
        parts = _index_rows_by_fold(rows, len(y), base.rows)
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


def _index_rows_by_fold(rows: Ints | None, size: int, folds: Rows) -> list[tuple[Ints, Ints]]:
    """Return the rows of each fold as indices among ``rows`` and among all ``size`` rows."""
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


def invert_with_ridge(H: Array) -> Array:
    """Invert one or many normal matrices with a small relative ridge.

    Args:
        H: (…, P, P) symmetric matrices.

    Returns:
        (…, P, P).
    """
    d = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), MIN_COLUMN_SQUARE))
    scaled = H / (d[..., :, None] * d[..., None, :])
    scaled = scaled + RIDGE * np.eye(H.shape[-1])
    return np.asarray(np.linalg.inv(scaled) / (d[..., :, None] * d[..., None, :]))


def _build_folds(w: ErrorWhitening, rng: np.random.Generator) -> Ints:
    groups = len(w.groups)
    if groups <= MOST_FOLDS:
        return w.group_of_visit
    return rng.permutation(np.arange(groups) % MOST_FOLDS)[w.group_of_visit]


def _compute_column_units(X: Array, rows: int = 0) -> Array:
    """Return factors (P,) that scale the rms of each column over all rows to one; ``rows`` if X omits zero rows."""
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
