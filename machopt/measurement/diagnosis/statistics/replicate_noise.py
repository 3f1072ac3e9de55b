"""How much of the scatter is noise, from readings that should agree: own, shared by a cycle, shared by a visit.

A model that lacks physics leaves residuals that look like noise; readings of the same thing (same pose, same load, on
another day) do not share that doubt. Each replicate is compared with the mean of its kind, so whatever the model
misses cancels, and what is left is split by moments: per cycle a shift and a gain are fitted; what they leave is a
reading's own error, their scatter is the cycle's and the visit's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import CoordinateFamily, DiagnosisProblem
from machopt.numerics.array_types import Array

Flags = NDArray[np.bool_]
LEAST_SIGMA = 1e-9  # m, rad or N·m: exact readings, made up or rounded to nothing, must not divide by zero


@dataclass(frozen=True)
class ReplicateNoise:
    """1 sigma of each family's errors, SI."""

    reading: Array  # (F,)
    cycle: Array  # (F,)
    visit: Array  # (F,)
    gain: float  # relative, shared by a cycle
    replicated: bool  # from twins; False: from residuals, what a model misses among it

    def total(self, family: int) -> float:
        return float(np.sqrt(self.reading[family] ** 2 + self.cycle[family] ** 2 + self.visit[family] ** 2))


def estimate_replicate_noise(problem: DiagnosisProblem, residual: Array, used: Flags) -> ReplicateNoise:
    """Split the noise of a problem.

    Args:
        problem: groups, visits, cycles and replicates.
        residual: (N, D) of any fit near the truth; only what differs between twins counts where there are twins.
        used: (N,) False: put aside.
    """
    contrast, twins = compute_replicate_contrast(problem, residual, used)
    replicated = int(twins.sum()) >= thresholds.NOISE.least_twins
    own, cycle, visit = (np.zeros(len(problem.families)) for _ in range(3))
    gain = 0.0
    for f, family in enumerate(problem.families):
        there = problem.has_family(family)
        repeated = replicated and int((twins & there).sum()) >= thresholds.NOISE.least_twins
        e, rows = (contrast, twins & there) if repeated else (residual, used & there)
        own[f], cycle[f], visit[f], found = _split_variance(problem, family, e, rows)
        if family.is_separate_instrument and family.stated_uncertainty:  # repeats do not show what errs alike each time
            own[f] = max(own[f], family.stated_uncertainty) if repeated else family.stated_uncertainty
            cycle[f], visit[f] = (cycle[f], visit[f]) if repeated else (0.0, 0.0)
        if f == 0:
            gain = found
    return ReplicateNoise(own, cycle, visit, gain, replicated)


def compute_replicate_contrast(problem: DiagnosisProblem, residual: Array, used: Flags) -> tuple[Array, Flags]:
    """Each reading less the mean of its kind, scaled to the variance of one reading; and which readings have a twin.

    Kinds count only with members in two visits or more.
    """
    rows = np.flatnonzero(used & (problem.replicate >= 0))
    out, twins = np.zeros_like(residual), np.zeros(len(residual), bool)
    if not len(rows):
        return out, twins
    kinds, label = np.unique(problem.replicate[rows], return_inverse=True)
    pairs = np.unique(np.stack([label, problem.visit[rows]]), axis=1)
    visits = np.bincount(pairs[0], minlength=len(kinds))
    keep = visits[label] > 1
    rows, label = rows[keep], label[keep]
    if not len(rows):
        return out, twins
    count = np.bincount(label, minlength=len(kinds)).astype(float)
    mean = (
        np.stack([np.bincount(label, residual[rows, d], len(kinds)) for d in range(residual.shape[1])], axis=1)
        / np.maximum(count, 1.0)[:, None]
    )
    out[rows] = (residual[rows] - mean[label]) / np.sqrt(1.0 - 1.0 / count[label])[:, None]
    twins[rows] = True
    return out, twins


def compute_robust_sigma(values: Array) -> float:
    """1 sigma from the median of |values|; 0 of nothing."""
    return float(1.4826 * np.median(np.abs(values))) if values.size else 0.0


def _split_variance(
    problem: DiagnosisProblem, family: CoordinateFamily, e: Array, rows: Flags
) -> tuple[float, float, float, float]:
    """Own, cycle, visit and gain of one family by moments."""
    columns = list(family.columns)
    x = e[:, columns]
    typical = compute_robust_sigma(x[rows])
    tiny = LEAST_SIGMA
    good = rows & (np.abs(x) <= thresholds.NOISE.gross * max(typical, tiny)).all(axis=1)
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
            # one load read again and again: what its force seems to change by is the sensor's noise, which errs with it
            if power > float(np.sum((thresholds.RESTING.same_load * scale[block]) ** 2)):
                b = float(np.sum(s * rest)) / power
                rest = rest - b * s
                # force noise errs along the displacement, where its gain would show: held against that direction's own
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
        # what a gain error adds to the shift of its cycle
        carried.append(0.0 if scale is None else float(np.mean(scale[block].mean(axis=0) ** 2)))
        visits.append(int(problem.visit[block[0]]))
    if not shifts:
        return max(typical, tiny), 0.0, 0.0, 0.0
    together = float(np.mean(x[good] ** 2)) if good.any() else typical**2
    if freedom < thresholds.NOISE.least_freedom:  # one reading a cycle: nothing tells its error from the cycle's
        return max(float(np.sqrt(together)), tiny), 0.0, 0.0, 0.0
    own2 = max(squares / freedom, tiny**2)
    gain2 = 0.0
    if len(slopes) > 3:  # by the power that gains take: so the parts add up to what twins differ by, and no more
        taken = np.array(powers)
        squared, own_along2, weight = np.array(slopes) ** 2, max(own2, along / free), taken
        if problem.visits_for_cycles:  # what cycles of a visit differ by lies along it too and is gain: nearly alike
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
    """Mean product of shifts of two different cycles of one visit: what they share."""
    total = count = 0.0
    for v in np.unique(visits):
        own = shifts[visits == v]
        if len(own) > 1:
            whole = own.sum(axis=0)
            total += float(np.sum(whole**2) - np.sum(own**2))
            count += len(own) * (len(own) - 1) * shifts.shape[1]
    return max(total / count, 0.0) if count else 0.0
