"""Outlier rejection: outliers are few, isolated, unsystematic and not repeatable. Deviations of a whole session are
none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.statistics import replicate_noise
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]


def find_inlier_readings(problem: DiagnosisProblem, residual: Array, modelled: Array | None = None) -> Flags:
    """Find the readings without a gross error, judged by robust standard deviations.

    Laws of large effects are not exact. A reading that an effect moves by 100 standard deviations may deviate by more
    than noise does along the modelled displacement, and is no outlier. The robust standard deviation contains the law
    error of a typical reading.

    Args:
        problem: Problem with session, pose and replicate labels.
        residual: (N, D) residuals of a robust fit, SI.
        modelled: (N, D) displacement by fitted effects whose laws are not exact, SI; None without effects.

    Returns:
        (N,) True for readings that are used.
    """
    off = np.zeros(len(residual), bool)
    for family in problem.families:
        e = residual[:, list(family.columns)]
        typical = max(
            replicate_noise.compute_robust_sigma(e[problem.has_family(family)]),
            family.stated_uncertainty or 0.0,
            float(np.finfo(float).tiny),
        )
        if modelled is not None:
            e = _remove_law_error(e, modelled[:, list(family.columns)], problem.has_family(family))
        off |= (np.abs(e) > thresholds.LEVELS.outlier_sigma * typical).any(axis=1)
    if not off.any():
        return np.asarray(~off)
    if problem.channel == "torque":
        return ~off | find_repeated_deviations(problem, residual, off)
    shared = (
        find_mostly_outlying_groups(problem.session, off)
        | find_mostly_outlying_groups(problem.group, off)
        | find_common_direction_groups(problem.session, residual, off)
    )
    return ~off | shared | find_repeated_deviations(problem, residual, off)


def _remove_law_error(residual: Array, modelled: Array, measured: Flags) -> Array:
    """Return residuals without the part along the modelled displacement that an inexact law may leave.

    Args:
        residual: (N, d) residuals, SI.
        modelled: (N, d) modelled displacements, SI.
        measured: (N,) True where these coordinates were measured.

    Returns:
        (N, d) residuals.
    """
    size = np.linalg.norm(modelled, axis=1)
    typical = np.median(size[measured]) if measured.any() else 0.0
    allowed = np.sqrt(thresholds.SHARES.law_error) * np.maximum(size - typical, 0.0)  # amplitude of a share of power
    direction = modelled / np.maximum(size, np.finfo(float).tiny)[:, None]
    along = np.sum(residual * direction, axis=1)
    return np.asarray(residual - np.clip(along, -allowed, allowed)[:, None] * direction)


def find_mostly_outlying_groups(label: Ints, off: Flags) -> Flags:
    """Find deviating readings in groups where most readings deviate: a fault or an effect, no outliers.

    Args:
        label: (N,) group label.
        off: (N,) True for deviating readings.

    Returns:
        (N,) True for such readings.
    """
    _, part = np.unique(label, return_inverse=True)
    count = np.bincount(part.reshape(-1))
    share = np.bincount(part.reshape(-1), off) / count
    odd = (share > thresholds.SHARES.majority) & (count >= thresholds.COUNTS.min_repetitions)
    return np.asarray(off & odd[part.reshape(-1)])


def find_common_direction_groups(label: Ints, residual: Array, off: Flags) -> Flags:
    """Find deviating readings of a session that deviate in a common direction and are too many for outliers.

    Gross errors of a tracker have random directions. A settling floor or a moved stand shifts all readings in one
    direction.

    Args:
        label: (N,) session label.
        residual: (N, D) residuals, SI.
        off: (N,) True for deviating readings.

    Returns:
        (N,) True for such readings.
    """
    out = np.zeros(len(off), bool)
    for one in np.unique(label[off]):
        rows = off & (label == one)
        if rows.sum() < max(thresholds.COUNTS.min_repetitions, thresholds.SHARES.outliers * (label == one).sum()):
            continue
        e = residual[rows, :3]
        way = e / np.maximum(np.linalg.norm(e, axis=1, keepdims=True), np.finfo(float).tiny)
        if np.linalg.norm(way.mean(axis=0)) > thresholds.SHARES.agreement:
            out |= rows
    return out


def find_repeated_deviations(problem: DiagnosisProblem, residual: Array, off: Flags) -> Flags:
    """Find deviating readings whose replicates on another visit deviate equally.

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        off: (N,) True for deviating readings.

    Returns:
        (N,) True for such readings.
    """
    e = residual if problem.channel == "torque" else residual[:, :3]
    out = np.zeros(len(problem), bool)
    rows = np.flatnonzero((problem.replicate >= 0) & np.isin(problem.replicate, problem.replicate[off]))
    if not len(rows):
        return out
    kind = np.unique(problem.replicate[rows], return_inverse=True)[1].reshape(-1)
    visits, visit = np.unique(problem.replicate_visit[rows], return_inverse=True)
    own = np.unique(kind * len(visits) + visit.reshape(-1), return_inverse=True)[1].reshape(-1)
    replicates = np.bincount(kind)[kind] - np.bincount(own)[own]
    at = np.flatnonzero(off[rows] & (replicates > 0))
    one = e[rows[at]]
    other = np.empty_like(one)
    for c, column in enumerate(e[rows].T):
        other[:, c] = (np.bincount(kind, column)[kind[at]] - np.bincount(own, column)[own[at]]) / replicates[at]
    size, like = np.linalg.norm(one, axis=1), np.linalg.norm(other, axis=1)
    alike = np.einsum("nd,nd->n", one, other) > thresholds.SHARES.agreement * size * like
    out[rows[at]] = alike & (thresholds.RATIOS.stiffness_error * like > size)
    return out
