"""Joint torques of the weight of arm and tool, and their change with the joint angles; batched NumPy."""

from __future__ import annotations

import numpy as np

from machopt.kinematics.robot import ArmState, Robot, RobotMasses
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import cross_product


def compute_gravity_torque(robot: Robot, masses: RobotMasses, state: ArmState) -> tuple[Array, Array]:
    """Return joint torques of gravity and their derivative.

    g_i = z_i · Σ_{b ≥ i} (p_b − o_i) × m_b a, and ∂g_i/∂θ_j = (z_l × V_h)·a with l = min(i, j), h = max(i, j) and
    V_h = z_h × Σ_{b ≥ h} m_b (p_b − o_h): the Hessian of the potential, hence symmetric. Where the lines rotate by C q
    this is Cᵀ g and Cᵀ (∂g/∂θ) C. For a sliding line V_h is z_h Σ m_b, and ∂g_i/∂θ_j is zero where l slides.

    Args:
        robot: kinematic model.
        masses: of its links and tool.
        state: M configurations with bodies.

    Returns:
        g (M, n) N·m, torque of gravity on the joints (supported by springs: K (θ − θ_cmd) = g), and ∂g/∂θ (M, n, n).

    Raises:
        ValueError: a state without bodies.
    """
    z, V, torque = _compute_carried_weight(robot, masses, state)
    joints = np.arange(len(robot.axis))
    ordered = cross_product(masses.gravity, z) @ np.swapaxes(V, -1, -2)  # [..., l, h] = (z_l × V_h)·a, valid for l ≤ h
    slope = np.where(joints[:, None] <= joints, ordered, np.swapaxes(ordered, -1, -2))
    if robot.slides is not None:  # a sliding joint that moves all its load changes no lever
        slope = np.where(robot.slides[np.minimum.outer(joints, joints)], 0.0, slope)
    C = robot.coupling
    return (torque, np.asarray(slope)) if C is None else (torque @ C, C.T @ slope @ C)


def compute_weight_torque(robot: Robot, masses: RobotMasses, state: ArmState) -> Array:
    """Return g of :func:`compute_gravity_torque` alone, in a third of the time.

    Args:
        robot: kinematic model.
        masses: of its links and tool.
        state: M configurations with bodies.
    """
    torque = _compute_carried_weight(robot, masses, state)[2]
    return torque if robot.coupling is None else np.asarray(torque @ robot.coupling)


def _compute_carried_weight(robot: Robot, masses: RobotMasses, state: ArmState) -> tuple[Array, Array, Array]:
    """Return z and V (..., n, 3) of :func:`compute_gravity_torque`, and the torque of the weight about the lines
    (..., n).
    """
    if state.R_bodies is None or state.p_bodies is None:
        raise ValueError("an ArmState with bodies is needed")
    R, p = np.take(state.R_bodies, masses.body, axis=-3), np.take(state.p_bodies, masses.body, axis=-2)
    at = _rotate(R, masses.com) + p  # (..., B, 3)
    before = state.R_bodies[..., :-1, :, :]  # joint i sits in the body before it
    z = _rotate(before, robot.axis)
    origin = _rotate(before, robot.point) + state.p_bodies[..., :-1, :]
    carried = masses.body[None, :] >= np.arange(1, len(robot.axis) + 1)[:, None]  # (n, B)
    weight = carried * masses.mass
    moment = weight @ at - weight.sum(axis=1)[:, None] * origin
    V = cross_product(z, moment)
    if robot.slides is not None:
        V = np.where(robot.slides[:, None], weight.sum(axis=1)[:, None] * z, V)
    return z, V, np.asarray(V @ masses.gravity)


def _rotate(R: Array, v: Array) -> Array:
    """Return R v (..., B, 3) of constant vectors (B, 3), faster than ``einsum``."""
    return np.asarray(R[..., 0] * v[:, None, 0] + R[..., 1] * v[:, None, 1] + R[..., 2] * v[:, None, 2])
