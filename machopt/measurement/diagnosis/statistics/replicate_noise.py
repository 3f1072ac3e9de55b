"""Noise estimated from replicates: variance of a single reading, shared by a cycle, shared by a visit.

Residuals of an incomplete model look like noise. Replicates (same pose, same load, another visit) are free of this.
Each is compared with the mean of its replicates, so model errors cancel. The rest is split by moments: a shift and a
gain are fitted per cycle. Their residuals give the error of a single reading; their scatter gives the errors of cycle
and visit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import CoordinateFamily, DiagnosisProblem
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
LEAST_SIGMA = 1e-9  # m, rad or N·m: avoids division by zero for exact (synthetic) readings


@dataclass(frozen=True)
class ReplicateNoise:
    """Standard deviations of the errors of each family, SI."""

    reading: Array  # (F,)
    cycle: Array  # (F,)
    visit: Array  # (F,)
    gain: float  # relative gain error, shared by a cycle
    replicated: bool  # from replicates; False: from residuals, which include model errors

    def total(self, family: int) -> float:
        """Return the total standard deviation of a family without gain error.

        Args:
            family: Index of the family.

        Returns:
            Standard deviation, SI.
        """
        return float(np.sqrt(self.reading[family] ** 2 + self.cycle[family] ** 2 + self.visit[family] ** 2))


def estimate_replicate_noise(problem: DiagnosisProblem, residual: Array, used: Flags) -> ReplicateNoise:
    """Estimate the variance components of the noise.

    Args:
        problem: Problem with group, visit, cycle and replicate labels.
        residual: (N, D) residuals of an approximate fit, SI; with replicates only their differences matter.
        used: (N,) True for readings that are used.

    Returns:
        The noise.
    """
    contrast, is_replicate = compute_replicate_contrast(problem, residual, used)
    replicated = int(is_replicate.sum()) >= thresholds.COUNTS.min_degrees_of_freedom
    own, cycle, visit = (np.zeros(len(problem.families)) for _ in range(3))
    gain = 0.0
    for f, family in enumerate(problem.families):
        there = problem.has_family(family)
        repeated = replicated and int((is_replicate & there).sum()) >= thresholds.COUNTS.min_degrees_of_freedom
        e, rows = (contrast, is_replicate & there) if repeated else (residual, used & there)
        own[f], cycle[f], visit[f], found = _split_variance(problem, family, e, rows)
        if family.is_separate_instrument and family.stated_uncertainty:  # replicates do not show systematic errors
            own[f] = max(own[f], family.stated_uncertainty) if repeated else family.stated_uncertainty
            cycle[f], visit[f] = (cycle[f], visit[f]) if repeated else (0.0, 0.0)
        if f == 0:
            gain = found
    return ReplicateNoise(own, cycle, visit, gain, replicated)


def compute_replicate_contrast(problem: DiagnosisProblem, residual: Array, used: Flags) -> tuple[Array, Flags]:
    """Compute each reading minus the mean of its replicates over visits, scaled to the variance of one reading.

    Replicates count only if they occur on two visits or more.

    Args:
        problem: Regression problem.
        residual: (N, D) residuals, SI.
        used: (N,) True for readings that are used.

    Returns:
        (N, D) contrasts, and (N,) True for readings with a replicate.
    """
    rows = np.flatnonzero(used & (problem.replicate >= 0))
    out, has_replicate = np.zeros_like(residual), np.zeros(len(residual), bool)
    if not len(rows):
        return out, has_replicate
    kinds, label = np.unique(problem.replicate[rows], return_inverse=True)
    stays, stay = np.unique(np.stack([label, problem.replicate_visit[rows]]), axis=1, return_inverse=True)
    keep = np.bincount(stays[0], minlength=len(kinds))[label] > 1
    if not keep.any():
        return out, has_replicate
    rows, label, stay = rows[keep], label[keep], stay.reshape(-1)[keep]
    there, stay = np.unique(stay, return_inverse=True)
    kind = stays[0][there]
    inside = _compute_group_means(residual[rows], stay, len(there))
    whole = _compute_group_means(inside, kind, len(kinds))
    visits = np.bincount(kind, minlength=len(kinds)).astype(float)
    # both parts are scaled on their own: readings of one visit share its error, and show less than the whole noise
    out[rows] = (residual[rows] - inside[stay]) + ((inside - whole[kind]) / np.sqrt(1.0 - 1.0 / visits[kind])[:, None])[
        stay
    ]
    has_replicate[rows] = True
    return out, has_replicate


def _compute_group_means(values: Array, label: NDArray[np.int64], groups: int) -> Array:
    """Return the means (groups, D) of values (M, D) by label."""
    count = np.maximum(np.bincount(label, minlength=groups).astype(float), 1.0)
    return np.asarray(np.stack([np.bincount(label, v, groups) for v in values.T], axis=1) / count[:, None])


def compute_robust_sigma(values: Array) -> float:
    """Compute the standard deviation from the median of absolute values.

    Args:
        values: Values with zero mean.

    Returns:
        Standard deviation; 0 without values.
    """
    return float(1.4826 * np.median(np.abs(values))) if values.size else 0.0


def _split_variance(
    problem: DiagnosisProblem, family: CoordinateFamily, e: Array, rows: Flags
) -> tuple[float, float, float, float]:
    """Return the standard deviations of reading, cycle and visit and the gain of one family, by moments."""
    columns = list(family.columns)
    x = e[:, columns]
    typical = compute_robust_sigma(x[rows])
    tiny = LEAST_SIGMA
    good = rows & (np.abs(x) <= thresholds.LEVELS.outlier_sigma * max(typical, tiny)).all(axis=1)
    scale = None if problem.scale is None else problem.scale[:, columns]
    at = np.flatnonzero(good)
    order = at[np.argsort(problem.cycle[at], kind="stable")]
    starts = np.flatnonzero(np.r_[True, np.diff(problem.cycle[order]) != 0]) if len(order) else np.zeros(1, np.int64)
    squares, freedom, along, free = 0.0, 0.0, 0.0, 0
    shifts, leverage, visits, slopes, powers, carried = [], [], [], [], [], []
    for block in np.split(order, starts[1:]) if len(order) else []:
        y, n = x[block], len(block)
        mean = y.mean(axis=0)
        rest = y - mean
        lost = float(len(columns))
        if scale is not None and n > 2:
            s = scale[block] - scale[block].mean(axis=0)
            power = float(np.sum(s * s))
            # repeated readings of one load: the apparent force change is correlated sensor noise
            if power > float(np.sum((thresholds.SHARES.load_tolerance * scale[block]) ** 2)):
                b = float(np.sum(s * rest)) / power
                rest = rest - b * s
                # force noise acts along the displacement, as a gain does: compare with the scatter in that direction
                along += float(np.sum((rest @ np.linalg.svd(s, full_matrices=False)[2][0]) ** 2))
                free += n - 2
                slopes.append(b)
                powers.append(power)
                lost += 1.0
        if n > 1:
            squares += float(np.sum(rest**2))
            freedom += n * len(columns) - lost
        shifts.append(mean)
        leverage.append(1.0 / n)
        # contribution of a gain error to the shift of its cycle
        carried.append(0.0 if scale is None else float(np.mean(scale[block].mean(axis=0) ** 2)))
        visits.append(int(problem.visit[block[0]]))
    if not shifts:
        return max(typical, tiny), 0.0, 0.0, 0.0
    together = float(np.mean(x[good] ** 2)) if good.any() else typical**2
    if (
        freedom < thresholds.COUNTS.min_degrees_of_freedom
    ):  # one reading per cycle: its error is not separable from the cycle's
        return max(float(np.sqrt(together)), tiny), 0.0, 0.0, 0.0
    own2 = max(squares / freedom, tiny**2)
    gain2 = 0.0
    if len(slopes) > 3:  # by the power of the gains, so that the components add up to the total
        taken = np.array(powers)
        squared, own_along2, weight = np.array(slopes) ** 2, max(own2, along / free), taken
        if problem.visits_for_cycles:  # differences between cycles of a visit act like a gain
            own_along2 = own2
            weight = 1.0 / (own2 / taken + np.median(squared))
        gain2 = max(float(np.sum(weight * (squared - own_along2 / taken)) / np.sum(weight)), 0.0)
    mean2 = np.mean(np.array(shifts) ** 2, axis=1) - gain2 * np.array(carried)
    shift2 = max(float(np.mean(mean2 - own2 * np.array(leverage))), 0.0)
    visit2 = min(_compute_shared_variance(np.array(shifts), np.array(visits)), shift2)
    return (
        max(float(np.sqrt(own2)), tiny),
        float(np.sqrt(shift2 - visit2)),
        float(np.sqrt(visit2)),
        float(np.sqrt(gain2)),
    )


def _compute_shared_variance(shifts: Array, visits: NDArray[np.int64]) -> float:
    """Return the mean product of shifts of two cycles of one visit: their shared variance."""
    total = count = 0.0
    for v in np.unique(visits):
        own = shifts[visits == v]
        if len(own) > 1:
            whole = own.sum(axis=0)
            total += float(np.sum(whole**2) - np.sum(own**2))
            count += len(own) * (len(own) - 1) * shifts.shape[1]
    return max(total / count, 0.0) if count else 0.0
