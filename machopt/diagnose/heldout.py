"""Residuals of readings whose group took no part in the coefficients that predict them, in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from machopt.arrays import Array
from machopt.diagnose import calibrated
from machopt.diagnose.grams import Model, ridged_inverse
from machopt.diagnose.noise import Noise
from machopt.diagnose.problem import Problem
from machopt.diagnose.result import rms

Flags = NDArray[np.bool_]


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
        D = self.y.shape[1]
        for f, of in enumerate(m.rows):
            rows = m.w.index[of[::D] // D]
            out[rows] = self.y[rows] - self.columns[rows] @ x[f]
        return np.asarray(out)


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
    """Whether groups are predicted better than before by more than chance: paired, each group counting the same."""
    errors, _ = by_group(problem, (before, after), used)
    power = errors[np.isfinite(errors).all(axis=1)] ** 2
    if len(power) < 2:  # nothing to compare with
        return bool(np.sum(power[:, 1]) < np.sum(power[:, 0]))
    d = np.log(np.maximum(power[:, 0], 1e-300) / np.maximum(power[:, 1], 1e-300))
    error = float(d.std(ddof=1)) / np.sqrt(len(d))
    chance = float(stdtr(len(d) - 1, -float(d.mean()) / error)) if error > 0 else float(d.mean() <= 0)
    return chance <= calibrated.PROOF.surely_better or rms(after[used]) < calibrated.PROOF.half * rms(before[used])


def by_group(problem: Problem, residuals: Sequence[Array], used: Flags) -> tuple[Array, NDArray[np.int64]]:
    """(G, K) rmse of the first family for each of K residuals, and the labels (G,)."""
    family = problem.families[0]
    groups, of = np.unique(problem.group[used], return_inverse=True)
    every = np.unique(problem.group)
    out = np.full((len(every), len(residuals)), np.nan)
    count = np.bincount(of) * len(family.columns)
    for k, r in enumerate(residuals):
        power = np.bincount(of, (r[used][:, list(family.columns)] ** 2).sum(axis=1)) / count
        out[np.searchsorted(every, groups), k] = family.factor * np.sqrt(power)
    return out, every
