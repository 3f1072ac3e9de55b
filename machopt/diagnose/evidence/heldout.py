"""Residuals of readings whose group took no part in the coefficients that predict them, in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.evidence.grams import Model, ridged_inverse
from machopt.diagnose.evidence.noise import Noise
from machopt.diagnose.nouns.problem import Family, Problem
from machopt.diagnose.nouns.result import rms

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class OwnError:
    """What noise alone makes predictions of unseen readings err by, A √S x with white x, SI.

    A are the readings' columns, S the covariance of the coefficients that the other folds give. Readings of one group
    are predicted by the same coefficients: their held-out residuals share tr(A_i S Aᵀ_j), which is no mismatch.
    """

    columns: Array  # (N, D, P) SI
    root: Array  # (F, P, P) √S without each fold, SI
    fold: NDArray[np.int64]  # (N,)

    def of_mean(self, rows: NDArray[np.int64], coordinates: Sequence[int]) -> Array:
        """(d P,) of some coordinates' mean over readings of one group; the product of two such is what they share."""
        mean = self.columns[rows][:, list(coordinates)].mean(axis=0)
        return np.asarray((mean @ self.root[self.fold[rows[0]]]).reshape(-1))


@dataclass(frozen=True)
class Fitted:
    """A model with its columns in SI."""

    model: Model
    columns: Array  # (N, D, P) SI
    unit: Array  # (P,) SI coefficient per fitted one
    y: Array  # (N, D)

    @property
    def x(self) -> Array:
        """(P,) SI."""
        return np.asarray(self.model.coefficients * self.unit)

    @property
    def residual(self) -> Array:
        """(N, D) of the fit to all used readings."""
        return np.asarray(self.y - self.columns @ self.x)

    def heldout(self) -> Array:
        """(N, D); readings that were put aside get the fit to all, and so do all of a single group."""
        m = self.model
        out = self.residual
        if m.folds < 2:  # without its only group no fit is left to hold against it
            return out
        x = np.einsum("fij,fj->fi", ridged_inverse(m.normal - m.XX), m.Xy.sum(axis=0) - m.Xy) * self.unit
        for f, of in enumerate(m.rows):
            rows = m.w.reading[of]
            rows = rows[np.flatnonzero(np.diff(rows, prepend=-1))]
            out[rows] = self.y[rows] - self.columns[rows] @ x[f]
        return np.asarray(out)

    def own_error(self) -> OwnError | None:
        """How held-out predictions err; None where there is only one group, and nothing is held out."""
        m = self.model
        if m.folds < 2:
            return None
        value, V = np.linalg.eigh(ridged_inverse(m.normal - m.XX))
        root = self.unit[:, None] * V * np.sqrt(np.maximum(value, 0.0))[:, None, :]
        fold = np.zeros(len(self.y), np.int64)
        for f, of in enumerate(m.rows):
            fold[m.w.reading[of]] = f
        return OwnError(self.columns, root, fold)


def rmse(problem: Problem, residual: Array, used: Flags) -> float:
    """Per coordinate of the first family, in its report unit, outliers apart."""
    family = problem.families[0]
    return family.factor * rms(residual[used][:, list(family.columns)])


def floor(problem: Problem, noise: Noise, used: Flags) -> float:
    """What noise alone would leave in the first family, in its report unit."""
    family = problem.families[0]
    gain = 0.0
    if problem.scale is not None:
        gain = noise.gain * rms(problem.scale[used][:, list(family.columns)])
    return family.factor * float(np.hypot(noise.together(0), gain))


def better(problem: Problem, before: Array, after: Array, used: Flags) -> bool:
    """Whether groups are predicted better than before by more than chance, by any instrument of its own."""
    if _better(problem, before, after, used, problem.families[0]):
        return True
    return any(
        _better(problem, _only(f, before), _only(f, after), used & problem.measured(f), f)
        for f in problem.families
        if f.beside
    )


def said(problem: Problem, before: Array, after: Array, noise: Noise, used: Flags) -> tuple[str, ...]:
    """What instruments of their own say of readings that no fit saw, without and with what was found.

    Args:
        before, after: (N, D) held-out residuals, SI.
        noise: as found.
        used: (N,) readings that took part.
    """
    out = []
    for n, f in enumerate(problem.families):
        if not f.beside:
            continue
        rows = used & problem.measured(f)
        least, most = (f.factor * rms(r[rows][:, list(f.columns)]) for r in (after, before))
        out.append(
            f"{f.name}, {int(rows.sum())} readings held out: {most:.4f} {f.unit} by the base model, {least:.4f} "
            f"{f.unit} with what was found, noise {f.factor * noise.together(n):.4f} {f.unit}"
        )
    return tuple(out)


def _only(family: Family, residual: Array) -> Array:
    return np.where(np.isin(np.arange(residual.shape[1]), family.columns), residual, np.nan)


def _better(problem: Problem, before: Array, after: Array, used: Flags, family: Family) -> bool:
    """Paired, each group counting the same."""
    errors, _ = by_group(problem, (before, after), used, family)
    power = errors[np.isfinite(errors).all(axis=1)] ** 2
    if len(power) < 2:  # nothing to compare with
        return bool(np.sum(power[:, 1]) < np.sum(power[:, 0]))
    d = np.log(np.maximum(power[:, 0], 1e-300) / np.maximum(power[:, 1], 1e-300))
    error = float(d.std(ddof=1)) / np.sqrt(len(d))
    chance = float(stdtr(len(d) - 1, -float(d.mean()) / error)) if error > 0 else float(d.mean() <= 0)
    return chance <= calibrated.PROOF.surely_better or rms(after[used]) < calibrated.PROOF.half * rms(before[used])


def by_group(
    problem: Problem, residuals: Sequence[Array], used: Flags, family: Family | None = None
) -> tuple[Array, NDArray[np.int64]]:
    """(G, K) rmse of a family (the first) for each of K residuals, and the labels (G,)."""
    family = family or problem.families[0]
    groups, of = np.unique(problem.group[used], return_inverse=True)
    every = np.unique(problem.group)
    out = np.full((len(every), len(residuals)), np.nan)
    count = np.bincount(of) * len(family.columns)
    for k, r in enumerate(residuals):
        power = np.bincount(of, (r[used][:, list(family.columns)] ** 2).sum(axis=1)) / count
        out[np.searchsorted(every, groups), k] = family.factor * np.sqrt(power)
    return out, every
