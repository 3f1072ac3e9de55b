"""Maximin design for discrimination between several laws: maximise the separation of the worst pair.

A contest takes one law as true and refits a rival with all its unknowns. The remainder λ = min_a |s − A a|²_W is the
noncentrality of the test between both (Atkinson & Fedorov 1975, Biometrika 62, 57, eq. 2.2; for two laws Hunter &
Reiner 1965, Technometrics 7, 307). Over both directions and all pairs, a design maximises the least λ. Readings are
added greedily and then exchanged one by one (Fedorov's exchange). During the selection the error shared by a pose
counts as independent; the noncentrality of a finished design (:func:`compute_contest_noncentrality`) treats it as
shared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr, ndtri

from machopt.measurement.design.noncentrality import compute_noncentrality
from machopt.numerics.array_types import Array, Ints

SMOOTH, SHARP = 4.0, 40.0  # exponents of the power mean that approximates the minimum: smooth first, then sharp
MIN_NONCENTRALITY = 1e-3  # noncentrality that counts as zero
FIRST, LAST = 1.0, 1e-6  # prior information on each unknown: while few readings are selected, and at the end
FOCUS = 400  # readings that an exchange tries, the best individually
PASSES = 6
LEVEL, POWER = 0.01, 0.9


@dataclass(frozen=True)
class ModelContest:
    """One law as the truth against one that is refitted; R numbers per reading."""

    truth: int  # label of the law
    rival: int
    columns: Array  # (N, R, P) refitted columns: base and the rival's coefficients
    signal: Array  # (N, R) signal of the true law


def compute_required_noncentrality(level: float = LEVEL, chance: float = POWER) -> float:
    """Compute the noncentrality at which a χ² test with one degree of freedom has a given power; 14.9 by default.

    Args:
        level: Significance level.
        chance: Power of the test.

    Returns:
        Noncentrality.
    """
    critical = float(ndtri(level / 2.0) ** 2)
    guess = float((ndtri(chance) - ndtri(level / 2.0)) ** 2)
    assert abs(1.0 - float(chndtr(critical, 1, guess)) - chance) < 1e-3  # the opposite tail is negligible
    return guess


def select_maximin_readings(
    contests: Sequence[ModelContest],
    covariance: Array,
    shared: Array,
    pose: Ints,
    poses: int,
    loads: int,
    rng: np.random.Generator,
    starts: int = 1,
) -> tuple[tuple[int, ...], ...]:
    """Select poses with up to ``loads`` readings each.

    Args:
        contests: Contests of the same N readings; inseparable ones must be left out.
        covariance: (N, R, R) noise covariance of each reading.
        shared: (R, R) covariance of the error shared by the readings of a pose.
        pose: (N,) pose labels.
        poses: Number of poses.
        loads: Most readings per pose.
        rng: Random generator of the starts after the first.
        starts: Number of starts of the greedy search.

    Returns:
        Indices of readings, one tuple per pose.
    """
    search = _MaximinSearch(contests, covariance + shared, pose, poses, loads)
    best: list[int] = []
    value = -np.inf
    for start in range(max(starts, 1)):
        first = [] if start == 0 else search.random(rng, (poses + 1) // 2)
        chosen = search.exchange(search.exchange(search.greedy(first), SMOOTH), SHARP)
        v = search.value(chosen, SHARP)
        if v > value:
            best, value = chosen, v
    return _group_by_pose(best, pose)


def draw_random_readings(pose: Ints, poses: int, loads: int, rng: np.random.Generator) -> tuple[tuple[int, ...], ...]:
    """Draw readings at random poses under random loads, as a reference design.

    Args:
        pose: (N,) pose labels.
        poses: Number of poses.
        loads: Most readings per pose.
        rng: Random generator.

    Returns:
        Indices of readings, one tuple per pose.
    """
    out = []
    for p in rng.permutation(np.unique(pose))[:poses]:
        out.append(tuple(int(n) for n in rng.permutation(np.flatnonzero(pose == p))[:loads]))
    return tuple(out)


def compute_contest_noncentrality(
    contest: ModelContest, covariance: Array, shared: Array, pose: Ints, blocks: Sequence[Sequence[int]]
) -> float:
    """Compute the noncentrality of a design in one contest, with the pose error shared by its readings.

    Args:
        contest: One law as the truth against one that is refitted.
        covariance: (N, R, R) noise covariance of each reading.
        shared: (R, R) covariance of the error shared by the readings of a pose.
        pose: (N,) pose labels.
        blocks: Selected readings, grouped by pose.

    Returns:
        Noncentrality.
    """
    rows = np.array(sorted(n for b in blocks for n in b), np.int64)
    at = {int(n): k for k, n in enumerate(rows)}
    inner = [[at[n] for n in b] for b in blocks]
    return compute_noncentrality(
        contest.columns[rows], contest.signal[rows], covariance[rows], pose[rows], shared, inner
    )


def compute_noncentrality_by_pose(contest: ModelContest, covariance: Array, blocks: Sequence[Sequence[int]]) -> Array:
    """Compute the contribution of each pose to λ, with independent readings.

    Args:
        contest: One law as the truth against one that is refitted.
        covariance: (N, R, R) noise covariance of each reading.
        blocks: Selected readings, grouped by pose.

    Returns:
        (B,) contributions.
    """
    sizes = [len(b) for b in blocks]
    rows = np.array([n for b in blocks for n in b], np.int64)
    rest, _ = _compute_rival_residual(
        replace(contest, columns=contest.columns[rows], signal=contest.signal[rows]), covariance[rows]
    )
    return np.asarray(np.add.reduceat(np.sum(rest**2, axis=1), np.cumsum([0, *sizes[:-1]])))


def compute_total_noncentrality(contest: ModelContest, covariance: Array) -> tuple[float, float]:
    """Compute λ of all N readings together, and the squared signal, both in units of the noise.

    Args:
        contest: One law as the truth against one that is refitted.
        covariance: (N, R, R) noise covariance of each reading.

    Returns:
        Noncentrality, squared signal.
    """
    rest, y = _compute_rival_residual(contest, covariance)
    return float(np.sum(rest**2)), float(np.sum(y**2))


def _compute_rival_residual(contest: ModelContest, covariance: Array) -> tuple[Array, Array]:
    """Return the whitened residual (N, R) of the refitted rival, and the whitened signal."""
    W = np.linalg.inv(np.linalg.cholesky(covariance))
    A = W @ contest.columns
    y = np.einsum("nij,nj->ni", W, contest.signal)
    A = A.reshape(-1, A.shape[2])
    size = np.sqrt(np.mean(A**2, axis=0))
    A = A / np.where(size > 0, size, 1.0)
    x = np.linalg.lstsq(A, y.reshape(-1), rcond=1e-10)[0]
    return y - (A @ x).reshape(y.shape), y


@dataclass(frozen=True)
class _ContestSums:
    """Whitened AᵀA, Aᵀs, sᵀs of each reading in one contest; unknowns scaled."""

    AA: Array  # (N, P, P)
    As: Array  # (N, P)
    ss: Array  # (N,)

    def compute_after_addition(self, chosen: Sequence[int], ridge: float, among: Ints) -> Array:
        """Compute λ after the addition of each of several readings.

        Args:
            chosen: Selected readings.
            ridge: Prior information on each unknown.
            among: Candidate readings.

        Returns:
            (n,) noncentralities.
        """
        rows = list(chosen)
        A = self.AA[rows].sum(axis=0) + ridge * np.eye(self.AA.shape[1]) + self.AA[among]
        b = self.As[rows].sum(axis=0) + self.As[among]
        s = float(self.ss[rows].sum()) + self.ss[among]
        x = np.linalg.solve(A, b[..., None])[..., 0]
        return np.asarray(np.maximum(s - np.einsum("np,np->n", b, x), 0.0))

    def compute_noncentrality(self, chosen: Sequence[int]) -> float:
        """Compute λ of selected readings.

        Args:
            chosen: Selected readings.

        Returns:
            Noncentrality.
        """
        rows = list(chosen)
        A = self.AA[rows].sum(axis=0) + LAST * np.eye(self.AA.shape[1])
        b = self.As[rows].sum(axis=0)
        return max(float(self.ss[rows].sum() - b @ np.linalg.solve(A, b)), 0.0)


class _MaximinSearch:
    def __init__(self, contests: Sequence[ModelContest], covariance: Array, pose: Ints, poses: int, loads: int) -> None:
        self.pose, self.poses, self.loads = pose, poses, loads
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        grams: dict[int, tuple[Array, Array]] = {}  # contests of one rival share its columns
        self.sums = []
        for c in contests:
            if id(c.columns) not in grams:
                A = W @ c.columns
                most = np.sqrt(np.einsum("nrp,nrp->np", A, A).max(axis=0))
                A = A / np.where(most > 0.0, most, 1.0)
                grams[id(c.columns)] = A, np.swapaxes(A, 1, 2) @ A
            A, AA = grams[id(c.columns)]
            s = np.einsum("nij,nj->ni", W, c.signal)
            self.sums.append(_ContestSums(AA, np.einsum("nrp,nr->np", A, s), np.einsum("nr,nr->n", s, s)))

    def value(self, chosen: Sequence[int], sharpness: float) -> float:
        """Compute the power mean of the noncentralities of all contests.

        Args:
            chosen: Selected readings.
            sharpness: Exponent of the power mean.

        Returns:
            Value; larger is better.
        """
        return float(
            _compute_power_mean(np.array([[s.compute_noncentrality(chosen)] for s in self.sums]), sharpness)[0]
        )

    def greedy(self, chosen: list[int], among: NDArray[np.bool_] | None = None, sharpness: float = SMOOTH) -> list[int]:
        """Add the best reading until there are enough.

        Args:
            chosen: Selected readings.
            among: (N,) True for candidates; None: all.
            sharpness: Exponent of the power mean.

        Returns:
            Selected readings.
        """
        chosen = list(chosen)
        while len(chosen) < self.poses * self.loads:
            free = self._free(chosen)
            free = free if among is None else free[among[free]]
            if not len(free):
                break
            ridge = FIRST if len(chosen) < self.poses * self.loads / 2 else LAST
            chosen.append(int(free[np.argmax(self._compute_values(chosen, free, ridge, sharpness))]))
        return chosen

    def exchange(self, chosen: list[int], sharpness: float) -> list[int]:
        """Exchange single readings, and poses with their readings, for better ones among the most promising.

        Args:
            chosen: Selected readings.
            sharpness: Exponent of the power mean.

        Returns:
            Selected readings.
        """
        chosen = list(chosen)
        everything = np.arange(len(self.pose))
        order = np.argsort(-self._compute_values(chosen, everything, LAST, sharpness), kind="stable")
        focus = np.zeros(len(self.pose), bool)
        focus[order[:FOCUS]] = True
        value = self.value(chosen, sharpness)
        for _ in range(PASSES):
            before = value
            for k in range(len(chosen)):
                rest = chosen[:k] + chosen[k + 1 :]
                free = self._free(rest)
                free = free[focus[free]]
                if not len(free):
                    continue
                values = self._compute_values(rest, free, LAST, sharpness)
                best = int(np.argmax(values))
                if values[best] > value * (1.0 + 1e-9):
                    chosen[k], value = int(free[best]), float(values[best])
            for p in np.unique(self.pose[chosen]):
                again = self.greedy([n for n in chosen if self.pose[n] != p], focus, sharpness)
                v = self.value(again, sharpness)
                if len(again) == len(chosen) and v > value * (1.0 + 1e-9):
                    chosen, value = again, v
            if value <= before * (1.0 + 1e-3):
                break
        return chosen

    def random(self, rng: np.random.Generator, poses: int) -> list[int]:
        return [n for b in draw_random_readings(self.pose, poses, self.loads, rng) for n in b]

    def _compute_values(self, chosen: Sequence[int], among: Ints, ridge: float, sharpness: float) -> Array:
        return _compute_power_mean(
            np.stack([s.compute_after_addition(chosen, ridge, among) for s in self.sums]), sharpness
        )

    def _free(self, chosen: Sequence[int]) -> Ints:
        """Return readings that may still be added: unselected, with a free place at their pose, within the number of
        poses.
        """
        open_, count = np.unique(self.pose[list(chosen)], return_counts=True)
        free = np.ones(len(self.pose), bool)
        free[list(chosen)] = False
        free &= ~np.isin(self.pose, open_[count >= self.loads])
        if len(open_) >= self.poses:
            free &= np.isin(self.pose, open_)
        return np.flatnonzero(free)


def _compute_power_mean(noncentralities: Array, sharpness: float) -> Array:
    """Return the power mean (n,) over the contests (C, n), an approximation of the minimum."""
    x = noncentralities + MIN_NONCENTRALITY
    least = x.min(axis=0)
    return np.asarray(least * np.mean((x / least) ** -sharpness, axis=0) ** (-1.0 / sharpness))


def _group_by_pose(chosen: Sequence[int], pose: Ints) -> tuple[tuple[int, ...], ...]:
    out: dict[int, list[int]] = {}
    for n in chosen:
        out.setdefault(int(pose[n]), []).append(n)
    return tuple(tuple(b) for b in out.values())
