"""Errors shared by readings: random shifts per load cycle and per visit to a pose, and the resulting weights.

Three coordinates of reading n (its translation or its rotation: a *channel*) have the error s · (single error + shift
of its cycle + shift of its visit) with covariances V_n (3, 3), ρ_cycle I and ρ_visit I. A shift is the same vector
for all readings of its group. The inverse needs one 3 × 3 matrix per group (Woodbury). The cost grows linearly with
the number of readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from machopt.measurement import thresholds
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment
from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True, kw_only=True)
class ErrorClusters:
    """Readings with shared errors: cycles nested in visits nested in poses, all numbered from 0."""

    cycle: Ints  # (N,) cycle; the visit if cycles are not distinguishable
    visit_of_cycle: Ints  # (K,) visit of each cycle; a visit is one pose in one session
    pose_of_visit: Ints  # (U,)
    order: Ints  # (N,) readings sorted by pose
    starts: Ints  # (G + 1,) where each pose begins in ``order``
    has_cycle: bool  # replicates separate the errors of cycle, reading and visit
    has_visit: bool  # replicates separate the errors of visit and reading

    @property
    def poses(self) -> int:
        return len(self.starts) - 1

    @property
    def pose(self) -> Ints:
        """Pose index (N,) of each reading."""
        return np.asarray(self.pose_of_visit[self.visit_of_cycle[self.cycle]])

    @cached_property
    def cycle_matrix(self) -> csr_matrix:
        """Matrix (K, N) that sums readings by cycle."""
        return _build_indicator_matrix(self.cycle, len(self.visit_of_cycle))

    @cached_property
    def visit_matrix(self) -> csr_matrix:
        """Matrix (U, K) that sums cycles by visit."""
        return _build_indicator_matrix(self.visit_of_cycle, len(self.pose_of_visit))

    @cached_property
    def pose_matrix(self) -> tuple[csr_matrix, csr_matrix]:
        """Matrices (G, K) and (G, U) that sum cycles and visits by pose."""
        return (
            _build_indicator_matrix(self.pose_of_visit[self.visit_of_cycle], self.poses),
            _build_indicator_matrix(self.pose_of_visit, self.poses),
        )

    def readings(self, pose: int) -> Ints:
        """Return the readings of one pose.

        Args:
            pose: Pose index.

        Returns:
            Reading indices.
        """
        return self.order[self.starts[pose] : self.starts[pose + 1]]


def build_error_clusters(experiment: LoadTestExperiment) -> ErrorClusters:
    """Group the readings of a recording by its labels.

    Args:
        experiment: Load tests.

    Returns:
        The clusters.
    """
    _, pose = np.unique(experiment.pose, return_inverse=True)
    _, first, visit = np.unique(
        np.stack([pose.reshape(-1), experiment.session], axis=1), axis=0, return_index=True, return_inverse=True
    )
    pose, visit = pose.reshape(-1), visit.reshape(-1)
    pose_of_visit = pose[first]
    _, first, cycle = np.unique(
        np.stack([visit, experiment.cycle], axis=1), axis=0, return_index=True, return_inverse=True
    )
    cycle, visit_of_cycle = cycle.reshape(-1), visit[first]
    n, k, u = len(pose), len(visit_of_cycle), len(pose_of_visit)
    has_replicates = n - k >= thresholds.COUNTS.min_comparisons  # readings that repeat a cycle
    has_visit = (k if has_replicates else n) - u >= thresholds.COUNTS.min_comparisons
    has_cycle = has_replicates and has_visit
    if has_replicates and not has_visit:  # one cycle per visit: both are one level
        has_visit = True
    if not has_cycle:
        cycle, visit_of_cycle = visit, np.arange(u)
    order = np.argsort(pose, kind="stable")
    starts = np.searchsorted(pose[order], np.arange(pose.max() + 2))
    return ErrorClusters(
        cycle=cycle.astype(np.int64),
        visit_of_cycle=visit_of_cycle.astype(np.int64),
        pose_of_visit=pose_of_visit.astype(np.int64),
        order=order,
        starts=starts.astype(np.int64),
        has_cycle=has_cycle,
        has_visit=has_visit,
    )


@dataclass(frozen=True)
class VarianceComponents:
    """Variance components of one channel, as multiples of the covariance V_n of a single reading."""

    scale: float = 1.0  # s²
    cycle: float = 0.0  # ρ_cycle, in m² or rad² per unit of s²
    visit: float = 0.0  # ρ_visit


@dataclass(frozen=True, kw_only=True)
class ClusterSums:
    """Equations of a channel summed by cycle and pose for s² = 1, sufficient for any variance components."""

    S: Array  # (K, 3, 3) Σ Q_n, Q_n the inverse of V_n
    B: Array  # (K, 3, P) Σ Q_n A_n
    r: Array  # (K, 3) Σ Q_n y_n
    AQA: Array  # (G, P, P)
    AQy: Array  # (G, P)
    quadratic: float  # Σ yᵀ Q y
    count: float  # effective number of coordinates


@dataclass(frozen=True)
class NormalEquations:
    """Normal equations by pose: Σ_g H_g x = Σ_g h_g."""

    H: Array  # (G, P, P)
    h: Array  # (G, P)
    yy: float  # yᵀ W y
    logdet: float  # of the covariance, up to a constant that no component changes

    def total(self) -> tuple[Array, Array]:
        return self.H.sum(axis=0), self.h.sum(axis=0)

    def add(self, other: NormalEquations) -> NormalEquations:
        """Add the equations of another channel.

        Args:
            other: Equations to add.

        Returns:
            The sum.
        """
        return NormalEquations(self.H + other.H, self.h + other.h, self.yy + other.yy, self.logdet + other.logdet)


def sum_channel_equations(clusters: ErrorClusters, Q: Array, A: Array, y: Array, count: float) -> ClusterSums:
    """Sum the equations of a channel by cluster.

    Args:
        clusters: Clusters of readings with shared errors.
        Q: (N, 3, 3) inverse covariance of a single reading.
        A: (N, 3, P) columns.
        y: (N, 3) displacements.
        count: Effective number of coordinates (outliers excluded).

    Returns:
        The sums.
    """
    P = A.shape[2]
    QA, Qy = Q @ A, np.einsum("nij,nj->ni", Q, y)
    AQA, AQy = np.empty((clusters.poses, P, P)), np.empty((clusters.poses, P))
    for g in range(clusters.poses):
        rows = clusters.readings(g)
        flat = A[rows].reshape(-1, P)
        AQA[g] = flat.T @ QA[rows].reshape(-1, P)
        AQy[g] = flat.T @ Qy[rows].reshape(-1)
    group = clusters.cycle_matrix
    return ClusterSums(
        S=_sum_by_group(group, Q),
        B=_sum_by_group(group, QA),
        r=_sum_by_group(group, Qy),
        AQA=AQA,
        AQy=AQy,
        quadratic=float(np.einsum("ni,ni->", y, Qy)),
        count=count,
    )


def build_normal_equations(
    clusters: ErrorClusters, sums: ClusterSums, components: VarianceComponents
) -> NormalEquations:
    """Build the normal equations for given variance components.

    Args:
        clusters: Clusters of readings with shared errors.
        sums: Sums of the channel.
        components: Variance components.

    Returns:
        Normal equations by pose.
    """
    H, h, yy = sums.AQA.copy(), sums.AQy.copy(), sums.quadratic
    logdet = sums.count * np.log(components.scale)
    S, B, r = sums.S, sums.B, sums.r
    for level, ratio in enumerate((components.cycle, components.visit)):
        if ratio > 0:
            K, log = _invert_with_shift(S, ratio)
            KB, Kr = K @ B, np.einsum("kij,kj->ki", K, r)
            group = clusters.pose_matrix[level]
            H -= _sum_by_group(group, np.swapaxes(B, 1, 2) @ KB)
            h -= _sum_by_group(group, np.einsum("kip,ki->kp", B, Kr))
            yy -= float(np.einsum("ki,ki->", r, Kr))
            logdet += log
            B, r, S = B - S @ KB, r - np.einsum("kij,kj->ki", S, Kr), S - S @ K @ S
        if level == 0:
            S, B, r = (_sum_by_group(clusters.visit_matrix, part) for part in (S, B, r))
    s2 = components.scale
    return NormalEquations(H / s2, h / s2, yy / s2, logdet)


def predict_cluster_shifts(clusters: ErrorClusters, Q: Array, e: Array, components: VarianceComponents) -> Array:
    """Predict the shifts of each reading's cycle and visit from residuals (best linear unbiased prediction).

    Args:
        clusters: Clusters of readings with shared errors.
        Q: (N, 3, 3) inverse covariance of a single reading.
        e: (N, 3, …) residuals.
        components: Variance components.

    Returns:
        (N, 3, …) expected shifts.
    """
    flat = e.reshape(*e.shape[:2], -1)
    cycle, visit = clusters.cycle_matrix, clusters.visit_matrix
    S, r = _sum_by_group(cycle, Q), _sum_by_group(cycle, Q @ flat)
    K_cycle = _invert_with_shift(S, components.cycle)[0] if components.cycle > 0 else np.zeros_like(S)
    S_up, r_up = _sum_by_group(visit, S - S @ K_cycle @ S), _sum_by_group(visit, r - S @ K_cycle @ r)
    if components.visit > 0:
        b_visit = (_invert_with_shift(S_up, components.visit)[0] @ r_up)[clusters.visit_of_cycle]
    else:
        b_visit = np.zeros_like(r)
    b_cycle = K_cycle @ (r - S @ b_visit)
    return np.asarray((b_visit + b_cycle)[clusters.cycle].reshape(e.shape))


def _invert_with_shift(S: Array, ratio: float) -> tuple[Array, float]:
    """Return (S + I/ρ)⁻¹ for each group, and the sum of the log-determinants of I + ρ S."""
    M = np.eye(3) + ratio * S
    return np.asarray(ratio * np.linalg.inv(M), float), float(np.log(np.linalg.det(M)).sum())


def _build_indicator_matrix(label: Ints, groups: int) -> csr_matrix:
    n = len(label)
    return csr_matrix((np.ones(n), (label, np.arange(n))), shape=(groups, n))


def _sum_by_group(group: csr_matrix, x: Array) -> Array:
    return np.asarray(group @ x.reshape(len(x), -1)).reshape(-1, *x.shape[1:])
