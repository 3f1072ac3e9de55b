"""Cross-validated errors: each pose is predicted by a fit without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.measurement import thresholds
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.numerics.array_types import Array, Ints

MAX_LEAVE_ONE_OUT_POSES = 60  # up to this number of poses each is left out individually
FOLDS = 20  # number of folds for more poses


@dataclass(frozen=True)
class HoldoutErrorSummary:
    """Root mean square errors without outliers."""

    rmse: float  # m per coordinate, of the three translations
    axes: Array  # (D,) m, rad, base axes
    rotation: float  # rad per coordinate, of the three rotations; NaN if not measured
    explained: float  # explained share of the sum of squares of the translations
    by_pose: Array  # (G,) m, rmse of the translations by pose; NaN if all are outliers


def summarise_residuals(fit: StiffnessFit, residual: Array) -> HoldoutErrorSummary:
    """Summarise the residuals of a fit.

    Args:
        fit: Weighted fit of the stiffness.
        residual: (N, D) residuals, m and rad.

    Returns:
        The summary.
    """
    counts = fit.weighting.robust > thresholds.SHARES.majority
    inliers = np.where(counts, residual, np.nan)
    total = np.where(counts, fit.experiment.measured, np.nan)
    turned = residual.shape[1] == 6
    by_pose = np.full(fit.clusters.poses, np.nan)
    for g in range(fit.clusters.poses):
        by_pose[g] = _compute_rms(inliers[fit.clusters.readings(g), :3])
    return HoldoutErrorSummary(
        rmse=_compute_rms(inliers[:, :3]),
        axes=np.array([_compute_rms(column) for column in inliers.T]),
        rotation=_compute_rms(inliers[:, 3:]) if turned else np.nan,
        explained=_compute_explained_share(inliers[:, :3], total[:, :3]),
        by_pose=by_pose,
    )


def compute_holdout_residuals(fit: StiffnessFit, settled: SettledCoefficients, rng: np.random.Generator) -> Array:
    """Compute cross-validated residuals: each reading is predicted by coefficients fitted without its pose.

    Above 60 poses, 20 random groups of poses are left out. Weights and outliers are those of the whole fit.

    Args:
        fit: Weighted fit of the stiffness.
        settled: Final coefficients with their identifiability.
        rng: Random generator.

    Returns:
        (N, D) m and rad; NaN for a single pose.
    """
    H, h = fit.normal.total()
    out = np.full(fit.y.shape, np.nan)
    for group in build_folds(fit.clusters.poses, rng):
        H_rest, h_rest = H - fit.normal.H[group].sum(axis=0), h - fit.normal.h[group].sum(axis=0)
        without = settled.solve(fit, H_rest, h_rest, matrices=bool(settled.has_projected_matrices))
        rows = np.concatenate([fit.clusters.readings(g) for g in group])
        out[rows] = fit.y[rows] - fit.A[rows] @ without
    return out


def build_folds(poses: int, rng: np.random.Generator) -> list[Ints]:
    """Build groups of poses that are left out together.

    Args:
        poses: Number of poses.
        rng: Random generator.

    Returns:
        Pose indices of each fold; empty for fewer than two poses.
    """
    if poses < 2:
        return []
    if poses <= MAX_LEAVE_ONE_OUT_POSES:
        return [np.array([g]) for g in range(poses)]
    return [np.sort(part) for part in np.array_split(rng.permutation(poses), FOLDS)]


def _compute_rms(values: Array) -> float:
    counts = np.isfinite(values)
    return float(np.sqrt(np.mean(values[counts] ** 2))) if counts.any() else float("nan")


def _compute_explained_share(residual: Array, measured: Array) -> float:
    counts = np.isfinite(residual)
    total = float(np.sum(measured[counts] ** 2))
    return 1.0 - float(np.sum(residual[counts] ** 2)) / total if total > 0 else float("nan")
