"""Dexterity, characteristic length and K_C, compared with definitions, finite differences and loaded springs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.stiffness.joint_compliance import compute_constrained_stiffness, compute_directional_compliance
from machopt.stiffness.kinetostatic_indices import (
    compute_characteristic_length,
    compute_conditioning_index,
    compute_directional_stiffness,
    compute_frobenius_condition,
    compute_geometric_influence,
    compute_geometric_stiffness,
    compute_jacobian_derivative,
    compute_loaded_compliance,
)

CELL = Path(__file__).resolve().parent.parent / "cells" / "kr240_drilling"
LOAD = np.array([300.0, -800.0, -2000.0, 200.0, -150.0, 120.0])  # N, N·m


@pytest.fixture(scope="module")
def arm() -> tuple[Robot, np.ndarray, np.ndarray]:
    cell = load_cell(CELL)
    assert cell.stiffness is not None
    return load_robot(cell), cell.tool.T_flange_tcp, cell.stiffness.joints


def postures(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.7, 0.7, (n, 6)) + np.radians([0, -70, 100, 20, -60, 30.0])


def build_stretched_wrist() -> np.ndarray:
    """Return the wrist singularity: axes 4 and 6 aligned."""
    return np.array([0.3, -1.2, 1.5, 0.4, 0.0, 0.2])


# --- condition number --------------------------------------------------------------------------------------


def test_condition_number_equals_equation_11(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    robot, tool, _ = arm
    J = robot.compute_fk_jacobian(postures(20, 0), tool)[1]
    kappa = compute_frobenius_condition(J, 0.7)
    for i in range(20):
        N = np.diag([1 / 0.7] * 3 + [1.0] * 3) @ J[i]
        literal = np.sqrt(np.trace(N.T @ N) * np.trace(np.linalg.inv(N.T @ N))) / 6
        assert kappa[i] == pytest.approx(literal, rel=1e-8)  # the literal form squares the condition number
    np.testing.assert_allclose(compute_conditioning_index(J, 0.7) * kappa, 1.0, rtol=1e-14)
    assert compute_frobenius_condition(np.diag([2.0] * 3 + [1.0] * 3), 2.0) == pytest.approx(1.0)  # isotropic
    shaped = compute_frobenius_condition(J.reshape(4, 5, 6, 6), 0.7)
    np.testing.assert_array_equal(shaped.ravel(), kappa)


def test_singular_and_invalid_jacobians_give_nan(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    robot, tool, _ = arm
    J = robot.compute_fk_jacobian(np.array([build_stretched_wrist(), postures(1, 1)[0]]), tool)[1]
    J = np.concatenate([J, np.zeros((1, 6, 6)), np.full((1, 6, 6), np.nan)])
    np.testing.assert_array_equal(np.isinf(compute_frobenius_condition(J, 0.7)), [True, False, True, False])
    index = compute_conditioning_index(J, 0.7)
    assert index[0] == 0.0
    assert 0.0 < index[1] < 1.0
    assert index[2] == 0.0
    assert np.isnan(index[3])


# --- characteristic length ---------------------------------------------------------------------------------


def test_characteristic_length_is_a_minimum_over_length_and_configuration(
    arm: tuple[Robot, np.ndarray, np.ndarray],
) -> None:
    robot, tool, _ = arm
    found = compute_characteristic_length(robot, tool, starts=512, refined=6)
    again = compute_characteristic_length(robot, tool, starts=512, refined=6)
    assert (found.length, found.condition) == (again.length, again.condition)

    def condition(q: np.ndarray, length: float) -> float:
        return float(compute_frobenius_condition(robot.compute_fk_jacobian(q, tool)[1], length))

    assert found.condition == pytest.approx(condition(found.q, found.length), rel=1e-10)
    rng = np.random.default_rng(3)
    for step in (1e-3, 1e-2, 0.1):
        assert condition(found.q, found.length * (1 + step)) > found.condition
        assert condition(found.q, found.length * (1 - step)) > found.condition
        for _ in range(50):
            assert condition(found.q + step * rng.normal(size=6), found.length) >= found.condition - 1e-12
    scattered = robot.compute_fk_jacobian(rng.uniform(-np.pi, np.pi, (5000, 6)), tool)[1]
    best = min(compute_frobenius_condition(scattered, x).min() for x in np.geomspace(0.2, 2.0, 9))
    assert best > found.condition  # no random configuration with any length is better
    bounded = compute_characteristic_length(robot, tool, (robot.lower, robot.upper), starts=512, refined=6)
    assert bounded.condition >= found.condition - 1e-12
    assert ((bounded.q >= robot.lower) & (bounded.q <= robot.upper)).all()


def test_characteristic_length_scales_with_the_arm(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    """An arm of twice the size has twice the length and the same κ_F; joint 1 has no effect."""
    robot, tool, _ = arm
    T, big = robot.T_base_flange_zero.copy(), tool.copy()
    T[:3, 3] *= 2
    big[:3, 3] *= 2
    double = Robot(
        joints=robot.joints,
        axis=robot.axis,
        point=2 * robot.point,
        T_base_flange_zero=T,
        lower=robot.lower,
        upper=robot.upper,
    )
    one = compute_characteristic_length(robot, tool, starts=512, refined=6)
    two = compute_characteristic_length(double, big, starts=512, refined=6)
    assert two.condition == pytest.approx(one.condition, rel=1e-9)
    assert two.length == pytest.approx(2 * one.length, rel=1e-5)  # a minimum is flat, so its location is less exact
    turned = one.q + np.array([0.8, 0, 0, 0, 0, 0])
    assert compute_frobenius_condition(robot.compute_fk_jacobian(turned, tool)[1], one.length) == pytest.approx(
        one.condition
    )


# --- K_C ---------------------------------------------------------------------------------------------------


def test_jacobian_derivative_and_geometric_stiffness_match_finite_differences(
    arm: tuple[Robot, np.ndarray, np.ndarray],
) -> None:
    robot, tool, _ = arm
    q, h = postures(10, 4).reshape(2, 5, 6), 1e-6
    J = robot.compute_fk_jacobian(q, tool)[1]
    dJ, K_C = compute_jacobian_derivative(J), compute_geometric_stiffness(J, LOAD)
    for i in range(6):
        step = h * np.eye(6)[i]
        numeric = (robot.compute_fk_jacobian(q + step, tool)[1] - robot.compute_fk_jacobian(q - step, tool)[1]) / (
            2 * h
        )
        # central differences: truncation h² times curvature (1e-12) and rounding 1e-16/h of numbers near 3
        np.testing.assert_allclose(dJ[..., i, :, :], numeric, atol=2e-9)
        torque = np.swapaxes(numeric, -1, -2) @ LOAD
        np.testing.assert_allclose(K_C[..., :, i], torque, atol=2e-9 * np.abs(LOAD).sum())


def test_only_the_moment_makes_geometric_stiffness_unsymmetric(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    robot, tool, _ = arm
    J = robot.compute_fk_jacobian(postures(10, 5), tool)[1]
    force = compute_geometric_stiffness(J, np.r_[LOAD[:3], 0, 0, 0])
    np.testing.assert_allclose(force, np.swapaxes(force, -1, -2), atol=1e-10)
    K_C, z = compute_geometric_stiffness(J, LOAD), J[:, 3:, :]
    for k in range(6):
        for i in range(k + 1, 6):
            gap = np.cross(z[:, :, k], z[:, :, i]) @ LOAD[3:]
            np.testing.assert_allclose(K_C[:, i, k] - K_C[:, k, i], gap, atol=1e-10)
    assert np.abs(K_C - np.swapaxes(K_C, -1, -2)).max() > 100.0  # N·m/rad: of the size of the moment, not rounding


def test_loaded_springs_deflect_by_the_loaded_compliance(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    """With K_C the error of the displacement is of third instead of second order in the load."""
    robot, tool, k = arm
    q = postures(1, 6)[0]
    J = robot.compute_fk_jacobian(q, tool)[1]
    errors = []
    for scale in (1.0, 0.5):
        w = scale * LOAD
        x = q
        for _ in range(60):
            x = q + robot.compute_fk_jacobian(x, tool)[1].T @ w / k
        torque = np.linalg.solve(np.diag(k) - compute_geometric_stiffness(J, w), J.T @ w)
        np.testing.assert_allclose(compute_loaded_compliance(J, k, compute_geometric_stiffness(J, w)) @ w, J @ torque)
        errors.append((np.linalg.norm(x - q - torque), np.linalg.norm(x - q - J.T @ w / k)))
    assert (
        errors[0][0] < 0.05 * errors[0][1]
    )  # 3.7 %: the next order is smaller by about a joint deflection times its lever arm
    assert errors[0][0] / errors[1][0] == pytest.approx(8.0, rel=0.05)  # third order
    assert errors[0][1] / errors[1][1] == pytest.approx(4.0, rel=0.05)  # second order


def test_load_beyond_equilibrium_is_nan_and_zero_load_has_no_influence(
    arm: tuple[Robot, np.ndarray, np.ndarray],
) -> None:
    robot, tool, k = arm
    J = robot.compute_fk_jacobian(postures(3, 7), tool)[1]
    C = J @ np.diag(1 / k) @ np.swapaxes(J, -1, -2)
    np.testing.assert_allclose(compute_loaded_compliance(J, k, np.zeros((6, 6))), C, rtol=1e-10, atol=1e-18)
    crushing = compute_geometric_stiffness(J, np.array([0, 0, -1e7, 0, 0, 0]))
    assert np.isnan(compute_loaded_compliance(J, k, crushing)).all()
    none = compute_geometric_influence(J, k, np.zeros((6, 6)), np.zeros(6))
    np.testing.assert_array_equal(none.nu_p, 0.0)
    np.testing.assert_array_equal(none.nu_r, 0.0)


# --- stiffness along a direction ---------------------------------------------------------------------------


def test_stiffness_along_a_direction_depends_on_the_constraints(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    robot, tool, k = arm
    J = robot.compute_fk_jacobian(postures(20, 8), tool)[1]
    e = np.random.default_rng(9).normal(size=(20, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    free, line, pose = (compute_directional_stiffness(J, k, e, fixed) for fixed in ("nothing", "position", "pose"))  # type: ignore[arg-type]
    np.testing.assert_allclose(free, 1 / compute_directional_compliance(J, k, e), rtol=1e-12)
    C_tt = (J @ np.diag(1 / k) @ np.swapaxes(J, -1, -2))[:, :3, :3]
    np.testing.assert_allclose(line, np.einsum("ni,nij,nj->n", e, np.linalg.inv(C_tt), e), rtol=1e-8)
    K_fd = compute_constrained_stiffness(J, np.broadcast_to(k, (20, 6)))
    np.testing.assert_allclose(pose, np.einsum("ni,nij,nj->n", e, K_fd, e), rtol=1e-7)
    assert (line >= free * (1 - 1e-9)).all()
    assert (pose >= line * (1 - 1e-9)).all()


def test_singularity_matters_only_with_a_constrained_orientation(arm: tuple[Robot, np.ndarray, np.ndarray]) -> None:
    robot, _, k = arm
    at, near = (
        robot.compute_fk_jacobian(build_stretched_wrist() + d, np.eye(4))[1]
        for d in (np.zeros(6), np.r_[0, 0, 0, 0, 1e-3, 0])
    )
    # with axes 4 and 6 aligned the wrist lacks one rotation; compensating a rotation of axis 1 needs this rotation
    across = np.array([-np.sin(-0.3), np.cos(0.3), 0.0])
    assert np.isfinite(compute_directional_stiffness(at, k, across, "nothing"))
    assert np.isfinite(compute_directional_stiffness(at, k, across, "position"))
    assert np.isinf(compute_directional_stiffness(at, k, across, "pose"))
    assert compute_directional_stiffness(near, k, across, "nothing") == pytest.approx(
        float(compute_directional_stiffness(at, k, across, "nothing")), rel=1e-2
    )
    assert compute_directional_stiffness(near, k, across, "pose") > 1e3 * compute_directional_stiffness(
        near, k, across, "position"
    )
    assert np.isinf(compute_directional_stiffness(np.zeros((6, 6)), k, across, "nothing"))
