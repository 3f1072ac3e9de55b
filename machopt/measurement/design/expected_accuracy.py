"""Expected accuracy of a design: standard uncertainties, confounded unknowns, required number of poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array, Bools

LEAST = 1e-6  # least information on an unknown: 1 sigma of 1000 times its scale counts as unobserved
NULL = 1e-10  # relative eigenvalue of the scaled information that counts as rounding
SHARE = 1e-3  # component in the null space from which on an unknown counts as unobserved


@dataclass(frozen=True)
class ExpectedAccuracy:
    """Expected accuracy of P unknowns, in the unit of their scaled responses (relative to each value)."""

    covariance: Array  # (P, P); undefined in the rows of unobserved unknowns
    sigma: Array  # (P,) 1 sigma; inf for unobserved unknowns
    condition: float  # condition number of the whitened design, without unobserved directions
    unidentified_groups: tuple[tuple[int, ...], ...]  # confounded unknowns; an unobserved unknown forms its own group

    @property
    def is_identified(self) -> Bools:
        """Unknowns (P,) with a finite sigma."""
        return np.asarray(np.isfinite(self.sigma))

    def rms(self, among: Bools) -> float:
        """Return the root mean square of sigma over some unknowns.

        Args:
            among: (P,) True for these unknowns.

        Returns:
            rms; NaN for none.
        """
        return float(np.sqrt(np.mean(self.sigma[among] ** 2))) if among.any() else float("nan")

    def worst(self, among: Bools) -> float:
        """Return the largest sigma of some unknowns.

        Args:
            among: (P,) True for these unknowns.

        Returns:
            Largest sigma; NaN for none.
        """
        return float(self.sigma[among].max()) if among.any() else float("nan")


def compute_expected_accuracy(M: Array) -> ExpectedAccuracy:
    """Compute the expected accuracy from an information matrix; rank deficiency is distinguished from noise.

    Args:
        M: (P, P) information matrix.

    Returns:
        The accuracy.
    """
    is_observed = np.diag(M) > LEAST
    size = np.where(is_observed, np.sqrt(np.maximum(np.diag(M), LEAST)), 1.0)
    values, vectors = np.linalg.eigh(np.where(np.outer(is_observed, is_observed), M / np.outer(size, size), 0.0))
    null = values <= NULL * max(values.max(), np.finfo(float).tiny)
    null_vectors, range_vectors = vectors[:, null], vectors[:, ~null]
    is_unobserved = np.linalg.norm(null_vectors, axis=1) > SHARE
    covariance = (range_vectors / values[~null]) @ range_vectors.T / np.outer(size, size)
    sigma = np.where(is_unobserved, np.inf, np.sqrt(np.diag(covariance)))
    spread = np.linalg.eigvalsh(covariance[np.ix_(~is_unobserved, ~is_unobserved)])
    condition = float(np.sqrt(spread[-1] / spread[0])) if len(spread) and spread[0] > 0.0 else np.inf
    return ExpectedAccuracy(covariance, sigma, condition, _group_confounded_unknowns(null_vectors, is_unobserved))


def compute_design_efficiency(
    expected_accuracy: ExpectedAccuracy, reference: ExpectedAccuracy
) -> tuple[float, float, float]:
    """Compute the D-, A- and E-efficiency relative to another design, over the unknowns that the reference
    identifies.

    D: (det C*/det C)^(1/P); A: tr C*/tr C; E: λ_max(C*)/λ_max(C), with C the covariance.

    Args:
        expected_accuracy: Accuracy of the design.
        reference: Accuracy of the reference design.

    Returns:
        D, A, E; 1 means equal, 0 if an unknown is not identified.
    """
    among = reference.is_identified
    if not among.any() or not expected_accuracy.is_identified[among].all():
        return 0.0, 0.0, 0.0
    C, best = (a.covariance[np.ix_(among, among)] for a in (expected_accuracy, reference))
    d = float(np.exp((np.linalg.slogdet(best)[1] - np.linalg.slogdet(C)[1]) / len(C)))
    e = float(np.linalg.eigvalsh(best)[-1] / np.linalg.eigvalsh(C)[-1])
    return d, float(np.trace(best) / np.trace(C)), e


def find_smallest_number(reaches: Callable[[int], float], target: float, first: int, most: int) -> int | None:
    """Find the smallest n ≤ ``most`` with ``reaches(n)`` ≤ ``target``.

    Args:
        reaches: Accuracy of the best design of n poses; decreases approximately as 1/√n.
        target: Required accuracy, in the same unit.
        first: First n to try.
        most: Largest n.

    Returns:
        n, or None if ``most`` does not suffice.
    """
    known: dict[int, float] = {}

    def value(n: int) -> float:
        if n not in known:
            known[n] = reaches(n)
        return known[n]

    low, high, n = 0, most + 1, min(max(first, 1), most)  # low does not reach the target, high does
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
    """Group unknowns that are connected by unobserved directions."""
    if not lost.shape[1]:
        return ()
    P = lost @ lost.T  # projector onto the unobserved space
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
