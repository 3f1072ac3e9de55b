"""What an information matrix promises: standard uncertainties, what cannot be told apart, how many poses it takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array, Bools

LEAST = 1e-6  # information on an unknown by itself: 1 sigma of 1000 times its scale is no knowledge
NULL = 1e-10  # of the largest eigenvalue, unknowns scaled alike: less is rounding
SHARE = 1e-3  # of a unit vector in the unseen space from which an unknown counts as unseen


@dataclass(frozen=True)
class ExpectedAccuracy:
    """Expected accuracy of P unknowns, in the unit their responses were scaled to (relative: a share of each)."""

    covariance: Array  # (P, P); meaningless in the rows of unknowns that are not seen
    sigma: Array  # (P,) 1 sigma; inf where the design does not see the unknown
    condition: float  # of the whitened design: √(largest/least eigenvalue) of what is seen
    unidentified_groups: tuple[
        tuple[int, ...], ...
    ]  # unknowns that only appear together, or not at all (alone in its group)

    @property
    def is_identified(self) -> Bools:
        """(P,) which unknowns have a finite sigma."""
        return np.asarray(np.isfinite(self.sigma))

    def rms(self, among: Bools) -> float:
        """Root mean square of sigma over some unknowns; NaN of none."""
        return float(np.sqrt(np.mean(self.sigma[among] ** 2))) if among.any() else float("nan")

    def worst(self, among: Bools) -> float:
        """Largest sigma of some unknowns; NaN of none."""
        return float(self.sigma[among].max()) if among.any() else float("nan")


def compute_expected_accuracy(M: Array) -> ExpectedAccuracy:
    """Read an information matrix M (P, P); rank deficits are told apart from noise."""
    felt = np.diag(M) > LEAST
    size = np.where(felt, np.sqrt(np.maximum(np.diag(M), LEAST)), 1.0)
    values, vectors = np.linalg.eigh(np.where(np.outer(felt, felt), M / np.outer(size, size), 0.0))
    null = values <= NULL * max(values.max(), np.finfo(float).tiny)
    lost, kept = vectors[:, null], vectors[:, ~null]
    unseen = np.linalg.norm(lost, axis=1) > SHARE
    covariance = (kept / values[~null]) @ kept.T / np.outer(size, size)
    sigma = np.where(unseen, np.inf, np.sqrt(np.diag(covariance)))
    spread = np.linalg.eigvalsh(covariance[np.ix_(~unseen, ~unseen)])
    condition = float(np.sqrt(spread[-1] / spread[0])) if len(spread) and spread[0] > 0.0 else np.inf
    return ExpectedAccuracy(covariance, sigma, condition, _group_confounded_unknowns(lost, unseen))


def compute_design_efficiency(found: ExpectedAccuracy, reference: ExpectedAccuracy) -> tuple[float, float, float]:
    """D-, A- and E-efficiency of one design against another, over the unknowns that the reference sees; 1: equal.

    D: (det C*/det C)^(1/P); A: tr C*/tr C; E: λ_max(C*)/λ_max(C), C the covariance. 0 where one of them is not seen.
    """
    among = reference.is_identified
    if not among.any() or not found.is_identified[among].all():
        return 0.0, 0.0, 0.0
    C, best = (a.covariance[np.ix_(among, among)] for a in (found, reference))
    d = float(np.exp((np.linalg.slogdet(best)[1] - np.linalg.slogdet(C)[1]) / len(C)))
    e = float(np.linalg.eigvalsh(best)[-1] / np.linalg.eigvalsh(C)[-1])
    return d, float(np.trace(best) / np.trace(C)), e


def find_smallest_number(reaches: Callable[[int], float], target: float, first: int, most: int) -> int | None:
    """The smallest n ≤ ``most`` with ``reaches(n)`` ≤ ``target``; None where not even ``most`` does.

    Args:
        reaches: accuracy of the best design of n poses; falls with n nearly as 1/√n.
        target: in the same unit.
        first: n to begin with.
        most: largest n asked.
    """
    known: dict[int, float] = {}

    def value(n: int) -> float:
        if n not in known:
            known[n] = reaches(n)
        return known[n]

    low, high, n = 0, most + 1, min(max(first, 1), most)  # low misses the target, high reaches it
    while high - low > 1:
        v = value(n)
        if v <= target:
            high = n
        else:
            low = n
        guess = int(np.ceil(n * (v / target) ** 2)) if np.isfinite(v) else 2 * n
        n = min(max(guess, low + 1), high - 1)
    return high if high <= most else None


def _group_confounded_unknowns(lost: Array, unseen: Bools) -> tuple[tuple[int, ...], ...]:
    """Unknowns joined by the directions that are not seen."""
    if not lost.shape[1]:
        return ()
    P = lost @ lost.T  # projector onto what is not seen
    linked = np.abs(P) > SHARE**2
    left = set(np.flatnonzero(unseen).tolist())
    out = []
    while left:
        group, todo = set(), {min(left)}
        while todo:
            i = todo.pop()
            group.add(i)
            todo |= {j for j in left if linked[i, j]} - group
        left -= group
        out.append(tuple(sorted(group)))
    return tuple(out)
