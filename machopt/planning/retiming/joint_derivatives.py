"""Joints along a curve of poses, with three exact derivatives, for any 6R arm.

With the spatial Jacobian J_s = [S_1 … S_6] (screws in base_link) and V the twist of the pose along the curve:

    V   = J_s q'
    V'  = J_s q'' + J_s' q'
    V'' = J_s q''' + 2 J_s' q'' + J_s'' q'      S_i' = ad(ν_i) S_i,  ν_i = Σ_{l<i} S_l q_l'
"""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.kinematics.inverse.newton_iteration import (
    _compute_pose_and_jacobian,
    _compute_pose_error,
    _solve_linear_system,
)
from machopt.kinematics.machine import multiply_jets
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import build_transform
from machopt.planning.retiming.path_curve import PathCurve
from machopt.planning.retiming.taylor_series import compute_twist_derivatives

CONVERGED = 1e-11  # m, rad
STRAY = 0.3  # rad: a node at a point farther than this from the given joints is on another branch
SWING = 1.2  # rad more half way between two points: joints are curved near a singularity; branches are π apart


def compute_poses_along_curve(curve: PathCurve, u: Array, T_base_workpiece: Array) -> tuple[Array, Array, Array, Array]:
    """Return TCP poses (M, 4, 4) in base_link, spatial twists with two derivatives (M, 3, 6), phi (M,), |dp/du| (M,).

    Args:
        curve: rounded path of the run.
        u: (M,) m, increasing path parameter.
        T_base_workpiece: (4, 4), or its jets (M, 4, 4, 4) where external joints move; dp is relative to the workpiece.
    """
    jets, phi = curve.jets(u)
    if T_base_workpiece.ndim == 4:
        T = np.zeros_like(T_base_workpiece)
        T[:, :, :3, :3], T[:, :, :3, 3], T[:, 0, 3, 3] = jets.rotation, jets.position, 1.0
        T = multiply_jets(T_base_workpiece, T)
        twist = compute_twist_derivatives(T[:, :, :3, 3], T[:, :, :3, :3])
        return np.ascontiguousarray(T[:, 0]), twist, phi, np.linalg.norm(jets.position[:, 1], axis=1)
    R = T_base_workpiece[:3, :3]
    position = jets.position @ R.T
    position[:, 0] += T_base_workpiece[:3, 3]
    rotation = R @ jets.rotation
    twist = compute_twist_derivatives(position, rotation)
    return build_transform(rotation[:, 0], position[:, 0]), twist, phi, np.linalg.norm(position[:, 1], axis=1)


def compute_joints_at_nodes(
    robot: Robot, T_flange_tcp: Array, u: Array, pose: Array, twist: Array, rough: Array, share: Array
) -> tuple[Array, int]:
    """Return the joints and their derivatives at the nodes.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        u: (M,) m, path parameter of the nodes.
        pose: (M, 4, 4) TCP poses in base_link.
        twist: (M, 3, 6) spatial twists with two derivatives.
        rough: (M, 6) rad, the joints given at the points, interpolated.
        share: (M,) 0 to 1, position of each node between the previous and the next point.

    Returns:
        (M, 4, 6) rad/mᵏ, and the first node that failed or −1.
    """
    end = robot.T_base_flange_zero @ T_flange_tcp
    stray = STRAY + SWING * 4.0 * share * (1.0 - share)
    out, failed = _chain(robot.axis, robot.point, end, u, pose, twist, robot.compute_line_angles(rough), stray)
    return robot.compute_joint_positions(out), int(failed)


def solve_joints_near_seeds(robot: Robot, T_flange_tcp: Array, pose: Array, seed: Array) -> tuple[Array, int]:
    """Return joints (M, 6) in rad at poses from close seeds, and the first that failed or −1.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
        pose: (M, 4, 4) TCP poses in base_link.
        seed: (M, 6) rad.
    """
    end = robot.T_base_flange_zero @ T_flange_tcp
    q, failed = _refine(robot.axis, robot.point, end, pose, robot.compute_line_angles(seed))
    return robot.compute_joint_positions(q), int(failed)


@jit_compile
def _newton(axis: Array, point: Array, end: Array, goal: Array, q: Array, J: Array, T: Array, e: Array) -> bool:
    """Iterate Newton's method from q in place; J receives the Jacobian (TCP origin, base_link axes) of the solution."""
    last, A = np.inf, np.empty((6, 6))
    for i in range(12):
        _compute_pose_and_jacobian(axis, point, end, q, J, T)
        error = _compute_pose_error(T, goal, e)
        if error < CONVERGED:
            return True
        if not error < 4.0 * last or i == 11:
            return False
        last = error
        for k in range(6):
            for c in range(6):
                A[k, c] = J[k, c]
        if not _solve_linear_system(A, e):
            return False
        for k in range(6):
            if not abs(e[k]) < 1.0:
                return False
            q[k] += e[k]
    return False


@jit_compile
def _refine(axis: Array, point: Array, end: Array, pose: Array, seed: Array) -> tuple[Array, int]:
    q = seed.copy()
    J, T, e = np.empty((6, 6)), np.zeros((4, 4)), np.empty(6)
    for m in range(len(q)):
        if not _newton(axis, point, end, pose[m], q[m], J, T, e):
            return q, m
    return q, -1


@jit_compile
def _bracket(a: Array, b: Array, out: Array) -> None:
    """out += ad(a) b for twists (linear, angular)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] += a[3 + i] * b[j] - a[3 + j] * b[i] + a[i] * b[3 + j] - a[j] * b[3 + i]
        out[3 + k] += a[3 + i] * b[3 + j] - a[3 + j] * b[3 + i]


@jit_compile
def _chain(
    axis: Array, point: Array, end: Array, u: Array, pose: Array, twist: Array, rough: Array, stray: Array
) -> tuple[Array, int]:
    n = len(u)
    out = np.zeros((n, 4, 6))
    J, T, e = np.empty((6, 6)), np.zeros((4, 4)), np.empty(6)
    S, A = np.empty((3, 6, 6)), np.empty((6, 6))
    for m in range(n):
        q = out[m, 0]
        good = False
        if m > 0:
            h = u[m] - u[m - 1]
            for k in range(6):
                d = out[m - 1]
                q[k] = d[0, k] + h * (d[1, k] + h * (0.5 * d[2, k] + h / 6.0 * d[3, k]))
                if not abs(q[k] - rough[m, k]) < stray[m]:
                    q[k] = rough[m, k]
            good = _newton(axis, point, end, pose[m], q, J, T, e)
        if good:
            for k in range(6):
                good = good and abs(q[k] - rough[m, k]) < stray[m]
        if not good:
            for k in range(6):
                q[k] = rough[m, k]
            if not _newton(axis, point, end, pose[m], q, J, T, e):
                return out, m
            for k in range(6):
                if not abs(q[k] - rough[m, k]) < stray[m]:
                    return out, m
        for order in range(3):
            if not differentiate(J, T, twist[m], out[m], order, S, A):
                return out, m
    return out, -1


@jit_compile
def differentiate(J: Any, T: Any, twist: Any, out: Any, order: int, S: Any, A: Any) -> Any:  # numba infers
    """Fill the next derivative of the joints at a pose, and return whether the Jacobian has an inverse there.

    Args:
        J: (6, 6) Jacobian at the TCP, in base_link axes.
        T: (4, 4) pose of the TCP in base_link.
        twist: (3, 6) spatial twist with two derivatives.
        out: (4, 6) the joints and their derivatives up to ``order``; the next row is filled in.
        order: 0, 1 or 2.
        S: (3, 6, 6) work space: screws at the origin of base_link and their derivatives.
        A: (6, 6) work space.
    """
    nu, nu1, rhs = np.zeros(6), np.zeros(6), np.empty(6)
    for k in range(6):
        rhs[k] = twist[order, k]
    for i in range(6):  # columns at the TCP → screws at the origin of base_link
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            S[0, i, k] = J[k, i] + T[a, 3] * J[3 + b, i] - T[b, 3] * J[3 + a, i]
            S[0, i, 3 + k] = J[3 + k, i]
        if order == 0:
            continue
        for k in range(6):
            S[1, i, k] = S[2, i, k] = 0.0
        _bracket(nu, S[0, i], S[1, i])
        _bracket(nu1, S[0, i], S[2, i])
        _bracket(nu, S[1, i], S[2, i])
        for k in range(6):
            nu[k] += S[0, i, k] * out[1, i]
            nu1[k] += S[0, i, k] * out[2, i] + S[1, i, k] * out[1, i]
            if order == 1:
                rhs[k] -= S[1, i, k] * out[1, i]
            else:
                rhs[k] -= 2.0 * S[1, i, k] * out[2, i] + S[2, i, k] * out[1, i]
    for i in range(6):
        for k in range(6):
            A[k, i] = S[0, i, k]
    if not _solve_linear_system(A, rhs):
        return False
    for k in range(6):
        out[order + 1, k] = rhs[k]
    return True
