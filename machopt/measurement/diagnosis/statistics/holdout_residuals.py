"""Cross-validated residuals in SI: each reading is predicted by coefficients that were fitted without its group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import CoordinateFamily, DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import compute_rms
from machopt.measurement.diagnosis.statistics.normal_equations_by_fold import WhitenedModel, invert_with_ridge
from machopt.measurement.diagnosis.statistics.replicate_noise import ReplicateNoise
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class PredictionNoise:
    """Prediction error of held-out readings caused by noise alone, A √S x with white x, SI.

    A are the columns of the readings, S is the covariance of the coefficients from the other folds. Readings of one
    group are predicted by the same coefficients. Their held-out residuals share tr(A_i S Aᵀ_j), which is no mismatch.
    """

    columns: Array  # (N, D, P) SI
    root: Array  # (F, P, P) √S without each fold, SI
    fold: NDArray[np.int64]  # (N,)

    def compute_mean_error(self, rows: NDArray[np.int64], coordinates: Sequence[int]) -> Array:
        """Return the factor of the mean prediction error over readings of one group. The inner product of two is
        their covariance.

        Args:
            rows: Readings of one group.
            coordinates: Coordinates to include.

        Returns:
            (d P,) SI.
        """
        mean = self.columns[rows][:, list(coordinates)].mean(axis=0)
        return np.asarray((mean @ self.root[self.fold[rows[0]]]).reshape(-1))


@dataclass(frozen=True)
class FittedModel:
    """Fitted model with its columns in SI."""

    model: WhitenedModel
    columns: Array  # (N, D, P) SI
    unit: Array  # (P,) SI value of one fitted unit
    y: Array  # (N, D)

    @property
    def x(self) -> Array:
        """Coefficients (P,) SI."""
        return np.asarray(self.model.coefficients * self.unit)

    @property
    def residual(self) -> Array:
        """Residuals (N, D) of the fit to all used readings."""
        return np.asarray(self.y - self.columns @ self.x)

    def heldout(self) -> Array:
        """Return cross-validated residuals (N, D); excluded readings and a single group use the fit to all."""
        m = self.model
        out = self.residual
        if m.folds < 2:  # a single group cannot be cross-validated
            return out
        x = np.einsum("fij,fj->fi", invert_with_ridge(m.normal - m.XX), m.Xy.sum(axis=0) - m.Xy) * self.unit
        for f, of in enumerate(m.rows):
            rows = m.w.reading[of]
            rows = rows[np.flatnonzero(np.diff(rows, prepend=-1))]
            out[rows] = self.y[rows] - self.columns[rows] @ x[f]
        return np.asarray(out)

    def compute_prediction_noise(self) -> PredictionNoise | None:
        """Return the prediction noise; None for a single group."""
        m = self.model
        if m.folds < 2:
            return None
        value, V = np.linalg.eigh(invert_with_ridge(m.normal - m.XX))
        root = self.unit[:, None] * V * np.sqrt(np.maximum(value, 0.0))[:, None, :]
        fold = np.zeros(len(self.y), np.int64)
        for f, of in enumerate(m.rows):
            fold[m.w.reading[of]] = f
        return PredictionNoise(self.columns, root, fold)


def compute_rmse(problem: DiagnosisProblem, residual: Array, used: Flags) -> float:
    """Compute the rmse per coordinate of the first family, without outliers.

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        used: (N,) True for readings that are used.

    Returns:
        rmse in the family's report unit.
    """
    family = problem.families[0]
    return family.factor * compute_rms(residual[used][:, list(family.columns)])


def compute_noise_floor(problem: DiagnosisProblem, noise: ReplicateNoise, used: Flags) -> float:
    """Compute the rmse of the first family that noise alone would cause.

    Args:
        problem: Regression problem.
        noise: Estimated noise.
        used: (N,) True for readings that are used.

    Returns:
        rmse in the family's report unit.
    """
    family = problem.families[0]
    gain = 0.0
    if problem.scale is not None:
        gain = noise.gain * compute_rms(problem.scale[used][:, list(family.columns)])
    return family.factor * float(np.hypot(noise.total(0), gain))


def is_better_predicted(problem: DiagnosisProblem, before: Array, after: Array, used: Flags) -> bool:
    """Return whether groups are predicted significantly better than before, in the first family or an independent
    instrument.

    Args:
        problem: Regression problem.
        before: (N, D) held-out residuals before, SI.
        after: (N, D) held-out residuals after, SI.
        used: (N,) True for readings that are used.

    Returns:
        True if significant.
    """
    if _is_family_better(problem, before, after, used, problem.families[0]):
        return True
    return any(
        _is_family_better(problem, _select_family(f, before), _select_family(f, after), used & problem.has_family(f), f)
        for f in problem.families
        if f.is_separate_instrument
    )


def describe_other_instruments(
    problem: DiagnosisProblem, before: Array, after: Array, noise: ReplicateNoise, used: Flags
) -> tuple[str, ...]:
    """Describe the held-out errors of independent instruments, without and with the findings.

    Args:
        problem: Regression problem.
        before: (N, D) held-out residuals without findings, SI.
        after: (N, D) held-out residuals with findings, SI.
        noise: Estimated noise.
        used: (N,) True for readings that are used.

    Returns:
        One sentence per instrument.
    """
    out = []
    for n, f in enumerate(problem.families):
        if not f.is_separate_instrument:
            continue
        rows = used & problem.has_family(f)
        least, most = (f.factor * compute_rms(r[rows][:, list(f.columns)]) for r in (after, before))
        out.append(
            f"{f.name}, {int(rows.sum())} readings held out: {most:.4f} {f.unit} by the base model, {least:.4f} "
            f"{f.unit} with what was found, noise {f.factor * noise.total(n):.4f} {f.unit}"
        )
    return tuple(out)


def _select_family(family: CoordinateFamily, residual: Array) -> Array:
    return np.where(np.isin(np.arange(residual.shape[1]), family.columns), residual, np.nan)


def _is_family_better(
    problem: DiagnosisProblem, before: Array, after: Array, used: Flags, family: CoordinateFamily
) -> bool:
    """Return whether a family improves in a paired test with equal weight for each group."""
    errors, _ = compute_rmse_by_group(problem, (before, after), used, family)
    power = errors[np.isfinite(errors).all(axis=1)] ** 2
    if len(power) < 2:  # too few groups to compare
        return bool(np.sum(power[:, 1]) < np.sum(power[:, 0]))
    d = np.log(np.maximum(power[:, 0], 1e-300) / np.maximum(power[:, 1], 1e-300))
    error = float(d.std(ddof=1)) / np.sqrt(len(d))
    chance = float(stdtr(len(d) - 1, -float(d.mean()) / error)) if error > 0 else float(d.mean() <= 0)
    return chance <= thresholds.LEVELS.holdout_significance_level or compute_rms(
        after[used]
    ) < thresholds.SHARES.half_power_amplitude * compute_rms(before[used])


def compute_rmse_by_group(
    problem: DiagnosisProblem, residuals: Sequence[Array], used: Flags, family: CoordinateFamily | None = None
) -> tuple[Array, NDArray[np.int64]]:
    """Compute the rmse of a family by group.

    Args:
        problem: Regression problem.
        residuals: K residuals (N, D), SI.
        used: (N,) True for readings that are used.
        family: Coordinate family; None: the first one.

    Returns:
        (G, K) rmse in the report unit, and group labels (G,).
    """
    family = family or problem.families[0]
    groups, of = np.unique(problem.group[used], return_inverse=True)
    every = np.unique(problem.group)
    out = np.full((len(every), len(residuals)), np.nan)
    count = np.bincount(of) * len(family.columns)
    for k, r in enumerate(residuals):
        power = np.bincount(of, (r[used][:, list(family.columns)] ** 2).sum(axis=1)) / count
        out[np.searchsorted(every, groups), k] = family.factor * np.sqrt(power)
    return out, every
