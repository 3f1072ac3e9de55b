"""Whitened equations summed up by fold: all that fits and what is held out of them need.

A model is a set of whitened columns; its sums XᵀX, Xᵀy per fold are enough to refit it without any of them, and to hold
that one against it.
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
Products = WeakKeyDictionary[object, dict[int, tuple[Rows, Array]]]  # by part or law, and by shape
RIDGE = 1e-9  # of each column's own square: keeps directions that no reading shows from exploding
MOST_FOLDS = 40
MIN_COLUMN_SQUARE = 1e-3  # whitened square of a column that moves nothing


@dataclass(frozen=True, eq=False)
class ModelColumns:
    """Columns of a model that came together."""

    columns: Array | None  # (M, p); None: those of a law
    law: WhitenedHypothesis | None = None  # at ``shape``
    shape: int = 0

    @cached_property
    def X(self) -> Array:
        """(M, p)."""
        if self.columns is not None:
            return self.columns
        assert self.law is not None  # a part is one or the other
        return self.law.columns_at(self.shape)


@dataclass(frozen=True, kw_only=True)
class SessionSums:
    """Sums of a model's columns by session."""

    rows: Rows
    groups: int  # of the session that has fewest
    XX: Array  # (D, P, P)
    Xy: Array  # (D, P)


@dataclass(frozen=True, kw_only=True, eq=False)
class WhitenedModel:
    """Columns that are fitted together, whitened; what follows of them is worked out once and never written to."""

    w: ErrorWhitening
    column_groups: tuple[ModelColumns, ...]
    y: Array  # (M,)
    fold: Ints  # (V,) which visits are held out together
    folds: int
    XX: Array  # (F, P, P)
    Xy: Array  # (F, P)
    yy: Array  # (F,)
    prior: Array  # (P,) precision of what is known beforehand, zero for what is not
    rows: Rows  # of each fold

    @cached_property
    def X(self) -> Array:
        """(M, P)."""
        return (
            self.column_groups[0].X
            if len(self.column_groups) == 1
            else np.concatenate([p.X for p in self.column_groups], axis=1)
        )

    @property
    def count(self) -> int:
        """Columns."""
        return len(self.prior)

    @cached_property
    def normal(self) -> Array:
        """(P, P) of all readings and of what is known beforehand."""
        return np.asarray(self.XX.sum(axis=0) + np.diag(self.prior))

    @cached_property
    def inverse(self) -> Array:
        return invert_with_ridge(self.normal)

    @cached_property
    def coefficients(self) -> Array:
        """(P,) of all readings."""
        return np.asarray(self.inverse @ self.Xy.sum(axis=0))

    @cached_property
    def residual(self) -> Array:
        """(M,) whitened, of the fit to all readings."""
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
        """Variance of a whitened residual, at least 1: what the noise model leaves out makes every test stricter."""
        return float(max(1.0, self.rss / max(len(self.y) - self.count, 1)))

    @cached_property
    def by_session(self) -> SessionSums:
        """The same by session."""
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
        """The model with further whitened columns (M, p), and the precision (p,) that they are known with."""
        C = np.concatenate([np.stack([more[r].T @ p.X[r] for r in self.rows]) for p in self.column_groups], axis=2)
        own = np.stack([x.T @ x for x in (more[r] for r in self.rows)])
        with_y = np.stack([more[r].T @ self.y[r] for r in self.rows])
        return self._grown(ModelColumns(more), C, (own, with_y), held)

    def with_law(self, law: WhitenedHypothesis, shape: int, held: bool = False) -> WhitenedModel:
        """The same with a law at one shape, by the products that it keeps.

        Args:
            law: whitened and held out as this model is, against the same readings.
            shape: which.
            held: what is known of its coefficients counts.
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
class WhitenedHypothesis:
    """One hypothesis, whitened, at all its shapes; m = M, or fewer rows where it moves few coordinates of readings."""

    hypothesis: EffectHypothesis
    X: Array  # (m, S, p)
    unit: Array  # (S, p) SI coefficient per fitted one: columns are scaled to a whitened rms of one
    XX: Array  # (F, S, p, p)
    Xy: Array  # (F, S, p)
    size: int  # M
    y: Array  # (M,) what Xy was worked out with
    rows: Ints | None = None  # (m,) ascending, which of the M rows; None: all
    index: int = 0
    products: Products = field(init=False, default_factory=WeakKeyDictionary, repr=False)  # with columns met before
    summed: list[Array] = field(init=False, default_factory=list, repr=False)  # residuals last met, sums by cluster

    def columns_at(self, shape: int) -> Array:
        """(M, p) whitened columns of one shape."""
        if self.rows is None:
            return np.asarray(self.X[:, shape])
        out = np.zeros((self.size, self.X.shape[2]))
        out[self.rows] = self.X[:, shape]
        return out

    def products_with(self, model: WhitenedModel) -> Array:
        """(S, p, P) products with a model's columns."""
        return np.asarray(self.products_by_fold(model).sum(axis=0))

    def products_by_fold(self, model: WhitenedModel) -> Array:
        """(F, S, p, P) products with a model's columns, by its folds; worked out once for each part of it."""
        each = [self.products_with_model(part, model.rows) for part in model.column_groups]
        return each[0] if len(each) == 1 else np.concatenate(each, axis=3)

    def products_with_model(self, part: ModelColumns, folds: Rows) -> Array:
        """(F, S, p, P) products with one part of a model."""
        known = self.products.setdefault(part if part.law is None else part.law, {})
        found = known.get(part.shape)
        if found is None or found[0] is not folds:
            own = _index_rows_by_fold(self.rows, self.size, folds)
            found = known[part.shape] = (
                folds,
                np.stack([compute_cross_products(self.X[k], part.X[r]) for k, r in own]),
            )
        return found[1]

    def products_by_cluster(self, w: ErrorWhitening, residual: Array) -> Array:
        """(C, S, p) products with a whitened residual (M,), by clusters of groups; of the last residual at no cost."""
        if not self.summed or self.summed[0] is not residual:
            own = residual if self.rows is None else residual[self.rows]
            self.summed[:] = [residual, w.sum_by_cluster(self.X * own[:, None, None], self.rows)]
        return self.summed[1]

    def precision(self, shape: int) -> Array:
        """(p,) of what is known of the fitted coefficients beforehand, zero where nothing is."""
        known = self.hypothesis.prior_sigma
        return np.zeros(self.X.shape[2]) if known is None else np.asarray((self.unit[shape] / known) ** 2)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        return self.hypothesis.shapes


def build_whitened_model(
    w: ErrorWhitening, X: Array, y: Array, fold: Ints, prior: Array, rows: Rows | None = None
) -> WhitenedModel:
    """Sum up whitened columns by fold."""
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
    """A model with the folds of another one."""
    return build_whitened_model(one.w, one.X, one.y, like.fold, one.prior, like.rows)


def list_rows_by_fold(w: ErrorWhitening, fold: Ints) -> Rows:
    """Rows of each fold, ascending."""
    of = np.repeat(fold, np.diff(w.visit_starts))
    order = np.argsort(of, kind="stable")
    return tuple(np.split(order, np.searchsorted(of[order], np.arange(1, int(fold.max()) + 1))))


def build_base_model(
    problem: DiagnosisProblem, w: ErrorWhitening, rng: np.random.Generator
) -> tuple[WhitenedModel, Array]:
    """The base alone, and the SI value of each fitted unit (P,)."""
    X = w.whiten(problem.base)
    unit = _compute_column_units(X)
    known = np.array([np.inf if u.prior is None else u.prior for u in problem.unknowns])
    return build_whitened_model(w, X * unit, w.whiten(problem.y), _build_folds(w, rng), (unit / known) ** 2), unit


def whiten_hypotheses(
    base: WhitenedModel, hypotheses: Sequence[EffectHypothesis], told: Callable[[int], None] = lambda _: None
) -> list[WhitenedHypothesis]:
    """Whiten every hypothesis at every shape; those without any column that moves a reading are left out.

    Args:
        base: beside which they will be fitted.
        hypotheses: the laws.
        told: how many are done, after each.
    """
    w, y = base.w, base.y
    out: list[WhitenedHypothesis] = []
    for done, h in enumerate(hypotheses):
        told(done)
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
    """Columns at all shapes, (N, D, S, p); or (N, d, S, p) of the few coordinates (d,) that they move, with these."""
    first = h.columns(h.shapes[0])
    N, D, p = first.shape
    moved = np.flatnonzero(np.any(first.any(axis=0), axis=1))
    alone = w.is_independent and 0 < 2 * len(moved) <= D
    out = np.empty((N, len(moved) if alone else D, len(h.shapes), p))
    for k, shape in enumerate(h.shapes):
        columns = first if k == 0 else h.columns(shape)
        if alone and np.count_nonzero(columns) > np.count_nonzero(columns[:, moved]):
            return np.stack([h.columns(s) for s in h.shapes], axis=2), None  # other shapes move other coordinates
        out[:, :, k] = columns[:, moved] if alone else columns
    return out, moved if alone else None


def _index_rows_by_fold(rows: Ints | None, size: int, folds: Rows) -> list[tuple[Ints, Ints]]:
    """Rows of each fold among ``rows`` of all ``size``, as numbers among these and among all."""
    if rows is None:
        return [(r, r) for r in folds]
    place = np.full(size, -1, np.int64)
    place[rows] = np.arange(len(rows))
    return [(place[r][place[r] >= 0], r[place[r] >= 0]) for r in folds]


def compute_own_products(x: Array) -> Array:
    """Σ_m x_msi x_msj of columns (m, S, p), (S, p, p); matmul, because einsum does not use BLAS here."""
    t = x.transpose(1, 2, 0)
    return np.asarray(t @ x.transpose(1, 0, 2))


def compute_cross_products(x: Array, y: Array) -> Array:
    """Σ_m x_msi y_mp of columns (m, S, p) and (m, P), (S, p, P)."""
    m, S, p = x.shape
    return np.asarray(x.reshape(m, S * p).T @ y).reshape(S, p, -1)


def invert_with_ridge(H: Array) -> Array:
    """Inverse of one or many normal matrices with a relative ridge."""
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
    """(P,) that make the rms of each column over all rows one; ``rows`` where X has fewer, the others being zero."""
    size = np.sqrt(np.mean(X**2, axis=0))
    if rows > len(X):
        size = size * np.sqrt(len(X) / rows)
    return np.asarray(1.0 / np.where(size > 0, size, 1.0))


def compute_cluster_robust_fit(model: WhitenedModel) -> tuple[Array, Array, float]:
    """Coefficients, cluster-robust covariance (folds as clusters) and degrees of freedom."""
    M, x = invert_with_ridge(model.normal), model.coefficients
    u = model.Xy - np.einsum("fij,j->fi", model.XX, x)
    G, P = model.folds, len(x)
    robust = M @ (u.T @ u) @ M * G / max(G - 1, 1)
    # few groups: the robust part alone is noisy, and too small as often as too large
    grow = np.sqrt(
        np.maximum(np.diag(M) * model.residual_variance / np.maximum(np.diag(robust), 1e-12 * np.diag(M)), 1.0)
    )
    return x, robust * np.outer(grow, grow), float(max(G - P // 2, 4))
