"""Lower bound of a design's efficiency relative to the unknown optimum, without a search."""

from __future__ import annotations

import numpy as np

from machopt.measurement.design.d_optimal_search import compute_information_matrix
from machopt.measurement.design.design_problem import DesignProblem, ReadingDesign, index_readings_by_pose
from machopt.numerics.array_types import Array, Ints

NULL = 1e-10  # relative eigenvalue of the information that counts as rounding
MIN_RESPONSE = 1e-6  # relative response that counts as zero
MAX_EXACT_POSES = 400  # poses with an exact bound for pairs of loads; the others keep a looser bound


def compute_efficiency_bound(problem: DesignProblem, design: ReadingDesign, loads: int) -> float:
    """Compute a lower bound of the D-efficiency against every design of as many poses and loads: P/(n d).

    d = max over poses of tr(M⁻¹ I_pose) bounds tr(M⁻¹ M*)/n of any other M*, and det^(1/P) is at most a Pth of the
    trace. With one or two loads per pose d is exact. With more, or at poses far from the best, the shared pose error
    is neglected, which makes the bound looser but not wrong. If no reading determines some combination of the
    unknowns, the bound refers to the others. It is 0 if other readings would determine it.

    Args:
        problem: Design problem; its first model is used.
        design: Design of this problem.
        loads: Most loads at each pose.

    Returns:
        Lower bound, 0 to 1.

    Source:
        Atwood's inequality; Pukelsheim, Optimal Design of Experiments (2006), section 5.15.
    """
    m = problem.models[0]
    values, vectors = np.linalg.eigh(compute_information_matrix(problem, design.blocks))
    null = values <= NULL * max(values[-1], np.finfo(float).tiny)
    if null.all() or np.abs(m.response @ vectors[:, null]).max(initial=0.0) > MIN_RESPONSE * np.abs(m.response).max():
        return 0.0
    A = m.response @ (vectors[:, ~null] / np.sqrt(values[~null]))  # M = 1 in these unknowns
    slots = index_readings_by_pose(problem.pose)
    loads = min(loads, slots.shape[1])
    noise = m.covariance + problem.shared if loads == 1 else m.covariance
    trace = np.einsum("ndp,ndp->n", A, np.linalg.solve(noise, A))
    best = np.sort(np.where(slots >= 0, trace[slots], 0.0), axis=1)[:, -loads:].sum(axis=1)
    most = float(best.max())
    if loads == 2 and problem.shared.any():
        order = np.argsort(-best, kind="stable")
        most = 0.0
        for n, row in enumerate(order):
            if n >= MAX_EXACT_POSES or best[row] <= most:
                most = max(most, float(best[row]))
                break
            most = max(most, _find_best_pair(A, m.covariance, problem.shared, slots[row][slots[row] >= 0]))
    return float(min(1.0, A.shape[2] / (len(design.blocks) * most)))


def _find_best_pair(A: Array, covariance: Array, shared: Array, readings: Ints) -> float:
    """Return the largest trace of the information of two readings of one pose (of one if there is only one).

    With weights W_i = Σ_i⁻¹ and B_i = W_i A_i the information of i and j is A_iᵀ B_i + A_jᵀ B_j − (B_i + B_j)ᵀ (V⁻¹ +
    W_i + W_j)⁻¹ (B_i + B_j). (V⁻¹ + W)⁻¹ = V (1 + W V)⁻¹ also holds for a singular V.
    """
    if len(readings) == 1:
        noise = covariance[readings[0]] + shared
        return float(np.sum(A[readings[0]] * np.linalg.solve(noise, A[readings[0]])))
    W = np.linalg.inv(covariance[readings])
    B = W @ A[readings]
    own = np.einsum("idp,idp->i", A[readings], B)
    both = B[:, None] + B[None, :]
    middle = shared @ np.linalg.inv(np.eye(len(shared)) + (W[:, None] + W[None, :]) @ shared)
    trace = own[:, None] + own[None, :] - np.einsum("ijdp,ijde,ijep->ij", both, middle, both, optimize=True)
    np.fill_diagonal(trace, -np.inf)
    return float(trace.max())
