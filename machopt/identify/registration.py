"""The laser tracker in base_link and its target in the flange, found together from robot poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.errors import InputError
from machopt.identify.frames import fit_transform, refuse_line, refuse_sigma
from machopt.se3 import apply, rotation_from_vector, skew, transform

Array = NDArray[np.float64]

_TURN = 0.01  # rad, spread of orientations below which a target in the flange is a hundredfold its noise uncertain
_MOST_PAIRS = 20_000  # distances that the first stage looks at; more only cost time
_MOST_CONDITION = 1e8  # of the scaled Jacobian; beyond it half of the digits are gone
_STEPS = 50  # Gauss-Newton converges quadratically from the distances; ten do for residuals of millimetres
_CONVERGED = 1e-13  # m and rad, round-off over a few metres


@dataclass(frozen=True)
class Registration:
    """The tracker in base_link and the target in the flange, found together."""

    T_base_tracker: Array  # (4, 4)
    target_in_flange: Array  # (3,) m
    residuals: Array  # (N, 3) m, target by tracker − target by robot, in base_link
    rms: float  # m, root of the mean of |residual|²
    sigma: float  # m, standard deviation of one coordinate: the given one, or from 3N − 9 degrees of freedom
    covariance: Array  # (9, 9): twist of the tracker frame at its origin in base axes, then target_in_flange
    condition: float  # of the Jacobian with columns of unit length; above ~1e3 the poses are poorly chosen


def register_tracker(
    points_tracker: Array,
    T_base_flange: Array,
    *,
    method: Literal["joint", "distances"] = "joint",
    sigma: float | None = None,
) -> Registration:
    """Pose of the tracker in base_link and position of the target in the flange, from robot poses.

    T_base_tracker m_i = T_base_flange,i t for all poses i. "distances" finds t first, from
    |R_i t + p_i − R_j t − p_j| = |m_i − m_j| for pairs of poses, then the transform by a rigid fit; "joint" starts
    there and minimises Σ |T_base_tracker m_i − T_base_flange,i t|² over both.

    Args:
        points_tracker: (N, 3) m, the target as the tracker sees it, N ≥ 4.
        T_base_flange: (N, 4, 4) by the robot's kinematics.
        method: the paper's first stage alone, or the refinement as well.
        sigma: m, standard deviation of one coordinate, tracker and robot together; None takes it from the residuals.

    Returns:
        Transform, target, residuals by pose (the robot's own errors among them) and covariance; with "distances"
        the covariance is that of "joint", a lower bound.

    Raises:
        InputError: fewer than four poses, poses of one orientation or turned about one axis only, targets on a line,
            poses that leave something undetermined, shapes that differ, a number that is not finite.

    Source:
        tian2025, eqs. 17–19 (the first stage).
    """
    refuse_sigma(sigma)
    m, T = np.asarray(points_tracker, float), np.asarray(T_base_flange, float)
    _refuse_poor_poses(m, T)
    R, p = T[:, :3, :3], T[:, :3, 3]
    t = _target_by_distances(m, R, p)
    T_base_tracker = fit_transform(m, _by_robot(R, p, t), np.ones(len(m)))
    if method == "joint":
        T_base_tracker, t = _refine(m, R, p, T_base_tracker, t)
    seen = apply(T_base_tracker, m)
    residuals = seen - _by_robot(R, p, t)
    centre = seen.mean(axis=0)
    J = _jacobian(seen, centre, R)
    length = np.linalg.norm(J, axis=0)
    condition = float(np.linalg.cond(J / length))
    if condition > _MOST_CONDITION:
        raise InputError(
            f"these {len(m)} poses leave the tracker pose or the target undetermined "
            f"(condition number {condition:.1e}); poses turned about two axes and spread over the workspace would do"
        )
    if sigma is None:
        sigma = float(np.sqrt(np.sum(residuals**2) / (3 * len(m) - 9)))
    root = np.linalg.pinv(J / length) / length[:, None]
    root[:3] -= skew(T_base_tracker[:3, 3] - centre) @ root[3:6]  # v(origin) = v(centre) + ω × (origin − centre)
    rms = float(np.sqrt(np.mean(np.sum(residuals**2, axis=1))))
    return Registration(T_base_tracker, t, residuals, rms, sigma, sigma**2 * (root @ root.T), condition)


def _refuse_poor_poses(m: Array, T: Array) -> None:
    if m.ndim != 2 or m.shape[1] != 3 or T.shape != (len(m), 4, 4):
        raise InputError(f"found points {m.shape} and poses {T.shape}; expected (N, 3) and (N, 4, 4)")
    if len(m) < 4:
        raise InputError(
            f"found {len(m)} poses; registration needs four or more, better ten, that differ in orientation"
        )
    if not (np.isfinite(m).all() and np.isfinite(T).all()):
        raise InputError("a point or pose holds a number that is not finite; leave that pose out")
    R = T[:, :3, :3]
    _, s, axes = np.linalg.svd((R - R.mean(axis=0)).reshape(-1, 3), full_matrices=False)
    spread = s / np.sqrt(len(m))
    wanted = "poses that turn the flange about two different axes would do"
    if spread[0] <= _TURN:
        raise InputError(
            f"all {len(m)} poses have the same orientation (within {np.degrees(spread[0]):.2g}°), so the target in the "
            f"flange cannot be told from the place of the tracker; {wanted}"
        )
    if spread[2] <= _TURN:
        x, y, z = axes[2]
        raise InputError(
            f"all {len(m)} poses turn the flange about one axis, ({x:.2f}, {y:.2f}, {z:.2f}) in the flange, so the "
            f"target's place along it is open; {wanted}"
        )
    refuse_line(m, np.ones(len(m)), "the target positions seen by the tracker")


def _by_robot(R: Array, p: Array, t: Array) -> Array:
    """(N, 3) the target in base_link by the robot's poses."""
    return np.asarray(R @ t + p)


def _target_by_distances(m: Array, R: Array, p: Array) -> Array:
    """The target in the flange from distances between poses; of several minima the one that fits as a rigid body."""
    from scipy.optimize import least_squares

    n = len(m)
    apart = np.unique(np.linspace(1, n - 1, max(1, min(n - 1, 2 * _MOST_PAIRS // n))).astype(int))
    pairs = [(i, i + k) for k in apart.tolist() for i in range(n - k)]
    i, j = np.array(pairs).T
    A, b, d = R[i] - R[j], p[i] - p[j], np.linalg.norm(m[i] - m[j], axis=1)

    def mismatch(t: Array) -> Array:
        return np.asarray(np.linalg.norm(A @ t + b, axis=1) - d)

    def slope(t: Array) -> Array:
        chord = A @ t + b
        unit = chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-9)
        return np.asarray(np.einsum("ni,nij->nj", unit, A))

    reach = float(np.abs(np.linalg.norm(b, axis=1) - d).max())  # |A t| is at least that
    starts = [np.zeros(3), _lifted(A, b, d), *(sign * reach * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0))]
    best, least = np.zeros(3), np.inf
    for start in starts:
        t = least_squares(mismatch, start, slope, method="lm").x
        robot = _by_robot(R, p, t)
        misfit = float(np.sum((robot - apply(fit_transform(m, robot, np.ones(n)), m)) ** 2))
        if misfit < least:
            best, least = np.asarray(t, float), misfit
    return best


def _lifted(A: Array, b: Array, d: Array) -> Array:
    """2 bᵀA t + tᵀAᵀA t = d² − |b|², linear in t and in the six products of its components."""
    G = np.einsum("nki,nkj->nij", A, A)
    products = [G[:, i, j] * (1.0 if i == j else 2.0) for i in range(3) for j in range(i, 3)]
    M = np.column_stack([2.0 * np.einsum("nk,nki->ni", b, A), *products])
    t, *_ = np.linalg.lstsq(M, d**2 - np.sum(b**2, axis=1), rcond=None)
    return np.asarray(t[:3])


def _jacobian(seen: Array, at: Array, R: Array) -> Array:
    """(3N, 9) of the residuals: twist of the tracker frame at ``at`` in base axes, then the target in the flange."""
    ones = np.broadcast_to(np.eye(3), R.shape)
    return np.asarray(np.concatenate([ones, -skew(seen - at), -R], axis=2).reshape(-1, 9))


def _refine(m: Array, R: Array, p: Array, T: Array, t: Array) -> tuple[Array, Array]:
    """Gauss-Newton on transform and target together; a step that does not help is halved."""
    cost = np.sum((apply(T, m) - _by_robot(R, p, t)) ** 2)
    for _ in range(_STEPS):
        seen = apply(T, m)
        centre = seen.mean(axis=0)
        residual = (seen - _by_robot(R, p, t)).reshape(-1)
        step = np.asarray(np.linalg.lstsq(_jacobian(seen, centre, R), -residual, rcond=None)[0], float)
        while np.abs(step).max() > _CONVERGED:
            turn = rotation_from_vector(step[3:6])
            T_new = transform(turn, centre + step[:3] - turn @ centre) @ T
            t_new = t + step[6:]
            cost_new = np.sum((apply(T_new, m) - _by_robot(R, p, t_new)) ** 2)
            if cost_new <= cost:
                T, t, cost = T_new, t_new, cost_new
                break
            step = step / 2.0
        else:
            break
    return T, t
