"""Closed-form inverse kinematics: FK∘IK is the identity, all branches exist, margins and shortfall are correct."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize
from small_cell import real_cell, small_cell
from spherical_wrist_reference import Reference, reference_reasons

from machopt.cell.cell_reader import load_cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.inverse.solver import (
    SingularityMargins,
    build_solver,
    check_branches,
    compute_branch_reasons,
    list_whole_turns,
    refine_by_newton,
)
from machopt.kinematics.inverse.spherical_wrist import SphericalWristSolver, find_wrist_centre
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.rigid_transforms import compute_axis_rotation, wrap_angle

CELLS = Path(__file__).resolve().parent.parent / "cells"
SPHERICAL = ("kr500_milling", "kr240_drilling", "irb6700_drilling", "s420f_handling")
REAL = ("kr210l150", "kr500_r2800_2", "m20ia", "rx160")
EXACT = 1e-9  # m and rad, the required accuracy of candidates
MARGINS = SingularityMargins(wrist=np.radians(5), elbow=np.radians(3), shoulder=0.05, limit=0.0)


def robot_named(name: str, folder: Path) -> tuple[Robot, np.ndarray, np.ndarray]:
    cell = load_cell(CELLS / name) if name in SPHERICAL else real_cell(folder, name)
    robot = load_robot(cell)
    return robot, np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)


def small_robot(folder: Path) -> Robot:
    return load_robot(small_cell(folder))


def with_shoulder_offset(robot: Robot, offset: float) -> Robot:
    """Return the arm shifted along axis 2 from axis 2 on: the wrist centre is not in the plane of axis 1."""
    point, flange = robot.point.copy(), robot.T_base_flange_zero.copy()
    shift = offset * robot.axis[1]
    point[1:] += shift
    flange[:3, 3] += shift
    return Robot(
        joints=robot.joints,
        axis=robot.axis,
        point=point,
        T_base_flange_zero=flange,
        lower=robot.lower,
        upper=robot.upper,
    )


def with_bent_elbow(robot: Robot, angle: float) -> Robot:
    """Return the arm with axes 4 to 6 tilted about the vertical:
    a spherical wrist that is not perpendicular to axis 3."""
    W = find_wrist_centre(robot)
    assert W is not None
    R = compute_axis_rotation(np.array([0.0, 0.0, 1.0]), np.array(angle))
    axis, point, flange = robot.axis.copy(), robot.point.copy(), robot.T_base_flange_zero.copy()
    axis[3:] = axis[3:] @ R.T
    point[3:] = W
    flange[:3, :3] = R @ flange[:3, :3]
    flange[:3, 3] = W + R @ (flange[:3, 3] - W)
    return Robot(
        joints=robot.joints, axis=axis, point=point, T_base_flange_zero=flange, lower=robot.lower, upper=robot.upper
    )


def arms(folder: Path) -> dict[str, Robot]:
    plain = small_robot(folder)
    return {
        "plain": plain,
        "shoulder offset": with_shoulder_offset(plain, 0.12),
        "oblique wrist": with_bent_elbow(plain, 0.2),
    }


# --- identity and completeness -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", SPHERICAL + REAL)
def test_every_branch_reaches_and_contains_the_original_configuration(name: str, tmp_path: Path) -> None:
    robot, low, high = robot_named(name, tmp_path)
    q = np.random.default_rng(0).uniform(low, high, (1000, 6))
    T = robot.compute_fk(q)
    solver = build_solver(robot)
    assert isinstance(solver, SphericalWristSolver)
    found = solver.solve(T)
    assert found.q.shape == (1000, 8, 6)
    exists = np.isfinite(found.q).all(axis=-1)
    # all joints of a branch are finite, or none
    np.testing.assert_array_equal(exists, np.isfinite(found.q).any(axis=-1))
    assert (found.q[exists] > -np.pi).all()
    assert (found.q[exists] <= np.pi).all()
    # Near the wrist singularity acos of the closed form loses half of the digits; Newton restores them where the
    # margins allow the planner to go, so the bound of 1e-9 applies there.
    regular = exists & (found.wrist > 1e-2) & (found.elbow > 1e-2) & (found.shoulder > 1e-2)
    reached = robot.compute_fk(np.where(exists[..., None], found.q, 0.0))
    error = np.abs(reached - T[:, None]).max(axis=(2, 3))
    assert error[regular].max() < EXACT
    assert error[exists].max() < 1e-6
    near = np.nanmin(np.abs(wrap_angle(found.q - q[:, None])).max(axis=-1), axis=1)
    own = np.nanargmin(np.where(exists, np.abs(wrap_angle(found.q - q[:, None])).max(axis=-1), np.nan), axis=1)
    rows = np.arange(1000)
    clear = np.minimum(np.minimum(found.wrist[rows, own], found.elbow[rows, own]), found.shoulder[rows, own]) > 1e-2
    assert clear.mean() > 0.9
    assert near[clear].max() < EXACT
    assert (found.shortfall == 0).all()


@pytest.mark.parametrize("kind", ["plain", "shoulder offset", "oblique wrist"])
def test_branches_are_distinct_and_complete_by_newton_restarts(kind: str, tmp_path: Path) -> None:
    """Newton's method from many random starts finds no solution that is not a branch."""
    robot = arms(tmp_path)[kind]
    rng = np.random.default_rng(1)
    q = rng.uniform(-np.pi, np.pi, (12, 6))
    T = robot.compute_fk(q)
    found = SphericalWristSolver(robot).solve(T)
    newton_found = 0
    for i in range(len(q)):
        exists = np.isfinite(found.q[i]).all(axis=1)
        branches = found.q[i][exists]
        assert exists.sum() in (2, 4, 6, 8)
        apart = np.abs(wrap_angle(branches[:, None] - branches[None])).max(axis=-1) + 10 * np.eye(len(branches))
        assert apart.min() > 1e-3
        assert np.abs(robot.compute_fk(branches) - T[i]).max() < EXACT
        start = rng.uniform(-np.pi, np.pi, (300, 6))
        with np.errstate(all="ignore"):
            x, error = refine_by_newton(robot, np.broadcast_to(T[i], (300, 4, 4)), start, np.eye(4), iterations=25)
        solutions = x[(error < 1e-10)]
        solutions = solutions[np.abs(robot.compute_fk(solutions) - T[i]).max(axis=(1, 2)) < 1e-9]
        distance = np.abs(wrap_angle(solutions[:, None] - branches[None])).max(axis=-1)
        assert (distance.min(axis=1) < 1e-6).all()
        newton_found += len(np.unique(distance.argmin(axis=1)))
    assert newton_found > 40  # most branches are included in the comparison


def test_branch_index_is_shoulder_elbow_wrist_along_a_path(tmp_path: Path) -> None:
    robot = small_robot(tmp_path)
    a, b = np.radians([[10, -100, 95, 20, 40, -30], [35, -80, 70, 60, 70, 40.0]])
    q = a + np.linspace(0, 1, 200)[:, None] * (b - a)
    found = SphericalWristSolver(robot).solve(robot.compute_fk(q))
    index = np.nanargmin(np.abs(wrap_angle(found.q - q[:, None])).max(axis=-1), axis=1)
    assert len(set(index.tolist())) == 1
    whole = np.flatnonzero(np.isfinite(found.q).all(axis=(1, 2)))[0]
    at = found.q[whole].reshape(2, 2, 2, 6)
    # a wrist flip does not change joints 1 to 3
    np.testing.assert_allclose(at[:, :, 0, :3], at[:, :, 1, :3], atol=1e-12)
    np.testing.assert_allclose(wrap_angle(at[:, :, 0, 3] - at[:, :, 1, 3] - np.pi), 0, atol=1e-9)
    np.testing.assert_allclose(at[:, 0, :, 0], at[:, 1, :, 0], atol=1e-12)  # an elbow flip does not change joint 1
    np.testing.assert_allclose(np.abs(wrap_angle(at[0, :, :, 0] - at[1, :, :, 0])), np.pi, atol=1e-9)


def test_arms_of_another_kind_are_refused(tmp_path: Path) -> None:
    robot = load_robot(load_cell(CELLS / "cutting_cobot"))
    assert not SphericalWristSolver.is_applicable(robot)
    with pytest.raises(ValueError, match="no spherical wrist"):
        SphericalWristSolver(robot)
    plain = small_robot(tmp_path)
    point = plain.point.copy()
    point[5] += [0, 0, 0.001]  # axis 6 has a distance of 1 mm from the wrist centre
    assert not SphericalWristSolver.is_applicable(
        Robot(
            joints=plain.joints,
            axis=plain.axis,
            point=point,
            T_base_flange_zero=plain.T_base_flange_zero,
            lower=plain.lower,
            upper=plain.upper,
        )
    )


# --- outside the workspace -----------------------------------------------------------------------------------


def geometric_shortfall(robot: Robot, target: np.ndarray) -> float:
    """Return the smallest distance of the wrist centre to a point over joints 1 to 3, by minimisation."""
    W = find_wrist_centre(robot)
    assert W is not None

    def miss(x: np.ndarray) -> float:
        p = robot.compute_link_poses(np.r_[x, 0, 0, 0])[3]
        return float(np.sum((p[:3, :3] @ W + p[:3, 3] - target) ** 2))

    starts = [np.array([a, b, c]) for a in (0.0, 2.0, -2.0) for b, c in ((-1.5, 0.2), (0.0, 2.0), (0.0, -2.0))]
    return float(np.sqrt(min(minimize(miss, x, method="BFGS", options={"gtol": 1e-12}).fun for x in starts)))


@pytest.mark.parametrize("beyond", [0.001, 0.25])
def test_out_of_reach_is_nan_with_the_missing_length(tmp_path: Path, beyond: float) -> None:
    robot = small_robot(tmp_path)
    W = find_wrist_centre(robot)
    assert W is not None
    link, fore = np.linalg.norm(robot.point[2] - robot.point[1]), np.linalg.norm(W - robot.point[2])
    rng = np.random.default_rng(2)
    for near in (False, True):
        length = link - fore - beyond if near else link + fore + beyond
        yaw, lift = rng.uniform(-1, 1), rng.uniform(0.2, 0.6)
        heading = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        shoulder = 0.35 * heading + [0, 0, 0.675]
        wrist = shoulder + length * (np.cos(lift) * heading + [0, 0, np.sin(lift)])
        T = robot.compute_fk(rng.uniform(-1, 1, 6))
        zero = robot.T_base_flange_zero
        R06 = T[:3, :3] @ zero[:3, :3].T
        T[:3, 3] = wrist - R06 @ (W - zero[:3, 3])
        found = SphericalWristSolver(robot).solve(T[None])
        expected = geometric_shortfall(robot, wrist)
        if expected > 1e-6:  # a point too near in front may be reachable with the arm folded back
            assert np.isnan(found.q).all()
            assert (compute_branch_reasons(found, MARGINS) == InfeasibilityReason.UNREACHABLE).all()
        assert found.shortfall[0] == pytest.approx(expected, abs=1e-6)  # BFGS converges to 1e-6 m
        if not near:
            assert expected == pytest.approx(beyond, abs=1e-6)


def test_pose_too_near_axis_1_is_reported_by_the_shoulder_offset(tmp_path: Path) -> None:
    robot = with_shoulder_offset(small_robot(tmp_path), 0.12)
    W = find_wrist_centre(robot)
    assert W is not None
    T = robot.compute_fk(np.zeros(6))
    wrist = np.array([0.03, 0.04, 1.9])  # 50 mm from axis 1; at least 120 mm are needed
    R06 = T[:3, :3] @ robot.T_base_flange_zero[:3, :3].T
    T[:3, 3] = wrist - R06 @ (W - robot.T_base_flange_zero[:3, 3])
    found = SphericalWristSolver(robot).solve(T[None])
    assert np.isnan(found.q).all()
    assert found.shortfall[0] == pytest.approx(0.07, abs=1e-9)
    assert geometric_shortfall(robot, wrist) == pytest.approx(0.07, abs=1e-6)


# --- singularities -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["plain", "shoulder offset", "oblique wrist"])
def test_margins_are_the_named_angles_and_lengths(kind: str, tmp_path: Path) -> None:
    robot = arms(tmp_path)[kind]
    W = find_wrist_centre(robot)
    assert W is not None
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (300, 6))
    found = SphericalWristSolver(robot).solve(robot.compute_fk(q))
    own = np.nanargmin(np.abs(wrap_angle(found.q - q[:, None])).max(axis=-1), axis=1)
    rows = np.arange(len(q))
    poses = robot.compute_link_poses(q)
    axis = np.einsum("mkij,kj->mki", poses[:, 1:, :3, :3], robot.axis)
    point = np.einsum("mkij,kj->mki", poses[:, 1:, :3, :3], robot.point) + poses[:, 1:, :3, 3]
    wrist = np.einsum("mij,j->mi", poses[:, 3, :3, :3], W) + poses[:, 3, :3, 3]
    if kind != "oblique wrist":  # with the oblique wrist the two solutions do not merge at aligned axes
        between = np.arccos(np.clip(np.abs(np.sum(axis[:, 3] * axis[:, 5], axis=1)), 0, 1))
        np.testing.assert_allclose(found.wrist[rows, own], between, atol=1e-6)
    a, b = point[:, 2] - point[:, 1], wrist - point[:, 2]
    a, b = (v - np.sum(v * axis[:, 1], axis=1, keepdims=True) * axis[:, 1] for v in (a, b))
    cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    np.testing.assert_allclose(found.elbow[rows, own], np.arccos(np.clip(np.abs(cosine), 0, 1)), atol=1e-6)
    # the lever arm of joint 1: distance of the wrist centre from the plane through axis 1 and the direction of axis 2
    normal = np.cross(robot.axis[0], axis[:, 1])
    lever = np.abs(np.sum((wrist - robot.point[0]) * normal, axis=1))
    np.testing.assert_allclose(found.shoulder[rows, own], lever, atol=1e-6)


@pytest.mark.parametrize("which", ["wrist", "elbow", "shoulder"])
def test_each_singularity_is_named_as_its_margin_vanishes(which: str, tmp_path: Path) -> None:
    """The rank of the Jacobian decreases exactly where the margin becomes zero,
    and the reason names the singularity."""
    robot = small_robot(tmp_path)
    W = find_wrist_centre(robot)
    assert W is not None
    regular = np.radians([20.0, -80, 70, 30, 50, 10])
    straight = np.arctan2(0.041, 1.0)  # joint 3 with the wrist centre on the line of the upper arm
    codes = {
        "wrist": InfeasibilityReason.SINGULAR_WRIST,
        "elbow": InfeasibilityReason.SINGULAR_ELBOW,
        "shoulder": InfeasibilityReason.SINGULAR_SHOULDER,
    }
    previous, smallest = np.inf, []
    for gap in (0.3, 0.1, 0.03, 0.01, 1e-3):
        q = regular.copy()
        if which == "wrist":
            q[4] = gap
        elif which == "elbow":
            q[2] = straight + gap
        else:  # joint 2 sets the distance of the wrist centre from axis 1 to ``gap``
            v = (
                compute_axis_rotation(robot.axis[2], np.array(q[2])) @ (W - robot.point[2])
                + robot.point[2]
                - robot.point[1]
            )
            reach, angle = np.hypot(v[0], v[2]), np.arctan2(-v[2], v[0])
            q[1] = -np.arccos((gap - 0.35) / reach) - angle
        found = SphericalWristSolver(robot).solve(robot.compute_fk(q)[None])
        b = np.nanargmin(np.abs(wrap_angle(found.q[0] - q)).max(axis=-1))
        margin = float(getattr(found, which)[0, b])
        assert margin == pytest.approx(gap, rel=1e-4)
        assert margin < previous
        previous = margin
        limit = getattr(MARGINS, which)
        assert compute_branch_reasons(found, MARGINS)[0, b] == (codes[which] if gap < limit else InfeasibilityReason.OK)
        smallest.append(np.linalg.svd(robot.compute_fk_jacobian(q)[1])[1][-1])
    assert smallest[-1] < 2e-3 * max(smallest[0], 0.1) * 10  # converges to zero with the gap
    assert np.log(smallest[-2] / smallest[-1]) / np.log(10) == pytest.approx(1.0, abs=0.1)  # linear convergence


def test_exactly_singular_poses_are_never_ok(tmp_path: Path) -> None:
    robot = small_robot(tmp_path)
    aligned = np.radians([20.0, -80, 70, 30, 0, 10])
    found = SphericalWristSolver(robot).solve(robot.compute_fk(aligned)[None])
    reasons = compute_branch_reasons(found, MARGINS)[0]
    assert not (reasons == InfeasibilityReason.OK)[np.abs(np.nan_to_num(found.q[0, :, 4], nan=9)) < 0.05].any()
    assert (reasons == InfeasibilityReason.SINGULAR_WRIST).any()
    W = find_wrist_centre(robot)
    assert W is not None
    T = robot.compute_fk(aligned)
    R06 = T[:3, :3] @ robot.T_base_flange_zero[:3, :3].T
    T[:3, 3] = np.array([0.0, 0.0, 2.3]) - R06 @ (W - robot.T_base_flange_zero[:3, 3])  # wrist centre on axis 1
    found = SphericalWristSolver(robot).solve(T[None])
    assert not (compute_branch_reasons(found, MARGINS) == InfeasibilityReason.OK).any()
    assert found.shortfall[0] < 1e-9


def test_reasons_follow_the_given_margins(tmp_path: Path) -> None:
    robot = small_robot(tmp_path)
    q = np.random.default_rng(5).uniform(-np.pi, np.pi, (200, 6))
    found = SphericalWristSolver(robot).solve(robot.compute_fk(q))
    none = compute_branch_reasons(found, SingularityMargins(0.0, 0.0, 0.0, 0.0))
    exists = np.isfinite(found.q).all(axis=-1)
    np.testing.assert_array_equal(none == InfeasibilityReason.OK, exists)
    np.testing.assert_array_equal(none == InfeasibilityReason.UNREACHABLE, ~exists)


# --- turns -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("low", "high"), [(-350, 350), (-185, 185), (-140, -5), (-120, 155), (10, 400), (-400, -10), (-540, 540), (-90, 90)]
)
def test_whole_turns_return_every_angle_into_the_limits(low: float, high: float) -> None:
    lower, upper = np.radians(np.full(6, float(low))), np.radians(np.full(6, float(high)))
    every = list_whole_turns(lower, upper)
    np.testing.assert_array_equal(every[0], np.zeros(6))
    assert len(np.unique(every.round(9), axis=0)) == len(every)
    k = np.unique(every[:, 0] / (2 * np.pi))
    for angle in np.linspace(lower[0], upper[0], 401)[1:-1]:
        assert np.isclose(wrap_angle(np.array(angle)) + 2 * np.pi * k, angle).any()
    assert len(every) == len(k) ** 6
    for n in k[k != 0]:  # whole turns that would never be within the limits are excluded
        assert lower[0] <= np.pi + 2 * np.pi * n
        assert upper[0] > -np.pi + 2 * np.pi * n


def test_refinement_ends_at_the_pose(tmp_path: Path) -> None:
    robot, tool = small_robot(tmp_path), small_cell(tmp_path).tool.T_flange_tcp
    q = np.random.default_rng(6).uniform(-0.3, 0.3, (50, 6)) + np.radians([0, -90, 90, 0, 45, 0.0])
    x, error = refine_by_newton(robot, robot.compute_fk(q, tool), q + 0.03, tool, iterations=5)
    assert error.max() < 1e-12
    np.testing.assert_allclose(x, q, atol=1e-10)


# --- compiled kernel and NumPy -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["plain", "shoulder offset", "oblique wrist"])
def test_kernel_equals_the_closed_form_in_numpy(kind: str, tmp_path: Path) -> None:
    """Same branches in the same order, same margins, shortfall and reasons, inside and outside the workspace."""
    robot = arms(tmp_path)[kind]
    rng = np.random.default_rng(7)
    T = robot.compute_fk(rng.uniform(-np.pi, np.pi, (3000, 6)))
    T[::2, :3, 3] *= rng.uniform(0.0, 3.0, (1500, 1))  # half of them at any position: too far, too near, at axis 1
    found, known = SphericalWristSolver(robot).solve(T), Reference(robot).solve(T)
    np.testing.assert_array_equal(np.isnan(found.q), np.isnan(known.q))
    assert 0.2 < np.isnan(known.q).mean() < 0.8
    for name, off in (("shoulder", 1e-12), ("elbow", 1e-12), ("wrist", 1e-10)):  # acos has a steep slope near 0
        np.testing.assert_allclose(getattr(found, name), getattr(known, name), atol=off)
    np.testing.assert_allclose(found.shortfall, known.shortfall, atol=1e-12)
    assert (known.shortfall > 0).mean() > 0.1
    np.testing.assert_array_equal(compute_branch_reasons(found, MARGINS), reference_reasons(known, MARGINS))
    regular = (known.wrist > 0.01) & (known.elbow > 0.01) & (known.shoulder > 0.01)
    assert np.nanmax(np.abs(wrap_angle(found.q - known.q)).max(axis=-1)[regular]) < 1e-11
    nothing = SphericalWristSolver(robot).solve(np.full((1, 4, 4), np.nan))
    assert np.isnan(nothing.q).all()
    assert (compute_branch_reasons(nothing, MARGINS) == InfeasibilityReason.UNREACHABLE).all()


def test_angles_within_the_limits_or_the_limit_is_the_reason(tmp_path: Path) -> None:
    robot = small_robot(tmp_path)
    lower, upper = np.radians([-170, -130, 20, -350, -120, -350.0]), np.radians([170, -20, 150, 350, 120, 350.0])
    every = list_whole_turns(lower, upper)
    found = SphericalWristSolver(robot).solve(
        robot.compute_fk(np.random.default_rng(8).uniform(-np.pi, np.pi, (400, 6)))
    )
    why, fits = check_branches(found, MARGINS, every, lower, upper)
    before = reference_reasons(found, MARGINS)
    with np.errstate(invalid="ignore"):
        inside = ((found.q[:, :, None] + every >= lower) & (found.q[:, :, None] + every <= upper)).all(axis=-1)
    inside &= (before == InfeasibilityReason.OK)[..., None]
    np.testing.assert_array_equal(fits, inside)
    np.testing.assert_array_equal(
        why, np.where((before == InfeasibilityReason.OK) & ~inside.any(axis=2), InfeasibilityReason.LIMIT, before)
    )
    assert {int(w) for w in np.unique(why)} >= {
        InfeasibilityReason.OK,
        InfeasibilityReason.UNREACHABLE,
        InfeasibilityReason.LIMIT,
        InfeasibilityReason.SINGULAR_WRIST,
    }
