"""Inverse kinematics of arms without a spherical wrist: complete, exact, and equal to independent solvers.

pinocchio checks the exactness on a URDF that is written here, so errors of our own forward kinematics would be found.
"""

from __future__ import annotations

import functools
import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from property_example_count import scale_example_count

from machopt.errors import InputError
from machopt.kinematics import axis_geometry
from machopt.kinematics.inverse.compiled_vectors import wrap_angle
from machopt.kinematics.inverse.general_solver import GeneralSolver, solve_general
from machopt.kinematics.inverse.general_solver_adapter import GeneralBranches
from machopt.kinematics.inverse.newton_iteration import compute_pose_deviation
from machopt.kinematics.robot import Robot
from machopt.numerics.rigid_transforms import (
    build_transform,
    compute_axis_rotation,
    compute_rpy_matrix,
    normalise_vectors,
)
from machopt.numerics.rigid_transforms import (
    wrap_angle as numerics_wrap_angle,
)

Array = NDArray[np.float64]
SAME = 1e-5  # rad; a double root is accurate to √rounding only; distinct roots of random poses are far apart
EXACT = 1e-9  # m and rad, the accuracy that the solver guarantees
JOINTS = ("j1", "j2", "j3", "j4", "j5", "j6")
FULL = np.full(6, np.pi)


# ---------------------------------------------------------------- arms


def from_dh(d: list[float], a: list[float], alpha: list[float]) -> Robot:
    """Standard Denavit–Hartenberg rows (m, rad): Rz(q) Tz(d) Tx(a) Rx(alpha)."""
    T, axis, point = np.eye(4), [], []
    for di, ai, twist in zip(d, a, alpha, strict=True):
        axis.append(T[:3, 2])
        point.append(T[:3, 3])
        T = T @ build_transform(compute_rpy_matrix(np.array([twist, 0.0, 0.0])), np.array([ai, 0.0, di]))
    return Robot(
        joints=JOINTS, axis=np.array(axis), point=np.array(point), T_base_flange_zero=T, lower=-FULL, upper=FULL
    )


def from_lines(axis: list[list[float]], point: list[list[float]], flange: list[float]) -> Robot:
    T = build_transform(compute_rpy_matrix(np.array([0.3, np.pi / 2, -0.2])), np.array(flange))
    return Robot(
        joints=JOINTS,
        axis=normalise_vectors(np.array(axis, float)),
        point=np.array(point, float),
        T_base_flange_zero=T,
        lower=-FULL,
        upper=FULL,
    )


def random_arm(seed: int) -> Robot:
    g = np.random.default_rng(seed)
    point = np.cumsum(g.uniform(-0.5, 0.5, (6, 3)), axis=0)
    return from_lines(g.normal(size=(6, 3)).tolist(), point.tolist(), (point[-1] + 0.1).tolist())


P = np.pi / 2
# Universal Robots, published DH parameters of UR5 and UR10 (CB series)
UR5 = from_dh([0.089159, 0, 0, 0.10915, 0.09465, 0.0823], [0, -0.425, -0.39225, 0, 0, 0], [P, 0, 0, P, -P, 0])
UR10 = from_dh([0.1273, 0, 0, 0.163941, 0.1157, 0.0922], [0, -0.612, -0.5723, 0, 0, 0], [P, 0, 0, P, -P, 0])
# Tian 2025, Table 5
TIAN = from_dh([0.196, 0, 0, 0.114, 0.098, 0.089], [0, 0.418, 0.398, 0, 0, 0], [P, 0, 0, P, P, 0])
# FANUC CRX-10iA/L: the wrist centre is 150 mm away from axis 4
CRX = from_lines(
    [[0, 0, 1], [0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, -1, 0], [-1, 0, 0]],
    [[0, 0, 0.245], [0, 0, 0.245], [0, 0, 0.955], [0, 0, 0.955], [0.54, -0.15, 0.955], [0.7, -0.15, 0.955]],
    [0.7, -0.15, 0.955],
)
INDUSTRIAL = [[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]]


def industrial(below: float, beside: float, tilt: float = 0.0) -> Robot:
    """A KUKA-like arm: axes 5 and 6 miss axis 4 by ``below`` and ``beside`` m; axis 3 is tilted by ``tilt`` rad."""
    axis = [list(map(float, a)) for a in INDUSTRIAL]
    axis[2] = [0.0, np.cos(tilt), np.sin(tilt)]
    z = 1.784 + below
    point = [[0, 0, 0], [0.35, 0, 0.675], [0.35, 0, 1.825], [0.9, 0, 1.784], [1.55, 0, z], [1.55, beside, z]]
    return from_lines(axis, point, [1.79, beside, z])


CLOSED = {"ur5": UR5, "ur10": UR10, "tian2025": TIAN}
GENERAL = {
    "crx": CRX,
    "offset wrist 50": industrial(0.05, 0.0),
    "offset wrist 50, 200": industrial(0.05, 0.2),
    "offset wrist, 2 not parallel 3": industrial(0.05, 0.1, tilt=0.1),
    "spherical wrist": industrial(0.0, 0.0),
    "random": random_arm(1),
}
ARMS = list(CLOSED | GENERAL)


@functools.cache
def solver_of(name: str) -> GeneralSolver:
    """Build the solver at its first use: choosing its eliminations takes a second."""
    return GeneralSolver.for_robot((CLOSED | GENERAL)[name])


def random_poses(arm: Robot, count: int, seed: int) -> tuple[Array, Array]:
    q = np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, 6))
    return q, arm.compute_fk(q)


def gaps(q: Array, wanted: Array) -> Array:
    """Return the largest joint difference modulo 2π between each branch (M, B, 6)
    and ``wanted`` (M, 6); inf if none."""
    return np.nan_to_num(np.abs(numerics_wrap_angle(q - wanted[:, None])).max(axis=-1), nan=np.inf)


def counts(q: Array) -> Array:
    return np.isfinite(q[..., 0]).sum(axis=-1)


def pinocchio_poses(arm: Robot, folder: Path, q: Array) -> Array:
    """Return flange poses (K, 4, 4) by pinocchio from a URDF of the same arm;
    its joint frames are parallel to the base."""
    import pinocchio as pin

    T = arm.T_base_flange_zero
    rpy = pin.rpy.matrixToRpy(T[:3, :3])
    links = "".join(f'<link name="l{i}"/>' for i in range(8))
    xml, last = [], np.zeros(3)
    for i, (a, p) in enumerate(zip(arm.axis, arm.point, strict=True)):
        xml.append(
            f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{text(p - last)}"/><axis xyz="{text(a)}"/>'
            '<limit lower="-4" upper="4" effort="1" velocity="1"/></joint>'
        )
        last = p
    xml.append(
        '<joint name="flange" type="fixed"><parent link="l6"/><child link="l7"/>'
        f'<origin xyz="{text(T[:3, 3] - last)}" rpy="{text(rpy)}"/></joint>'
    )
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{"".join(xml)}</robot>')
    model = pin.buildModelFromUrdf(str(path))
    data, frame = model.createData(), model.getFrameId("l7")
    out = np.empty((len(q), 4, 4))
    for k in range(len(q)):
        pin.framesForwardKinematics(model, data, q[k])
        out[k] = data.oMf[frame].homogeneous
    return out


def text(v: Array) -> str:
    return " ".join(f"{x:.17g}" for x in v)


# ---------------------------------------------------------------- exact and complete


@pytest.mark.parametrize("name", ARMS)
def test_every_solution_reaches_its_pose_by_pinocchio(name: str, tmp_path: Path) -> None:
    arm, solver = (CLOSED | GENERAL)[name], solver_of(name)
    _, T = random_poses(arm, 200, seed=3)
    q = solver.solve(T)
    assert q.shape == (200, solver.branches, 6)
    pose, branch = np.nonzero(np.isfinite(q[..., 0]))
    found = q[pose, branch]
    assert np.all(found > -np.pi)
    assert np.all(found <= np.pi)
    reached = pinocchio_poses(arm, tmp_path, found)
    turn = reached[:, :3, :3] @ np.swapaxes(T[pose, :3, :3], 1, 2) - np.eye(3)
    assert np.linalg.norm(reached[:, :3, 3] - T[pose, :3, 3], axis=1).max() < EXACT
    # the Frobenius norm of a small rotation is √2 times its angle
    assert np.linalg.norm(turn, axis=(1, 2)).max() < EXACT * np.sqrt(2)


@pytest.mark.parametrize("name", ARMS)
def test_original_configuration_is_among_the_branches(name: str) -> None:
    arm, solver = (CLOSED | GENERAL)[name], solver_of(name)
    q, T = random_poses(arm, 1000, seed=4)
    missing = int((gaps(solver.solve(T), q).min(axis=1) > SAME).sum())
    assert missing <= (0 if name in CLOSED else 5), f"{missing} of 1000 configurations not found again"


@pytest.mark.parametrize("seed", range(3, 8))
def test_random_arms_are_solved_completely(seed: int) -> None:
    arm = random_arm(seed)
    q, T = random_poses(arm, 300, seed)
    found = solve_general(arm, T)
    assert (gaps(found, q).min(axis=1) > SAME).sum() <= 1
    assert np.mean(counts(found) % 2 == 0) > 0.99  # complex roots come in pairs


# with the fixed order of the closed form, coinciding roots occur at both indices
@pytest.mark.parametrize("name", GENERAL)
def test_no_general_solution_appears_twice(name: str) -> None:
    _, T = random_poses(GENERAL[name], 200, seed=5)
    q = solver_of(name).solve(T)
    for a, b in itertools.combinations(range(q.shape[1]), 2):
        apart = np.abs(numerics_wrap_angle(q[:, a] - q[:, b])).max(axis=-1)
        assert not np.any(apart < 1e-6)


def test_calibrated_arm_keeps_all_its_branches() -> None:
    """The axes deviate by about 0.1 mrad and 0.1 mm: no closed form applies,
    and the exact structure is almost reached."""
    g = np.random.default_rng(8)
    arm = Robot(
        joints=JOINTS,
        axis=normalise_vectors(UR5.axis + 1e-4 * g.normal(size=(6, 3))),
        point=UR5.point + 1e-4 * g.normal(size=(6, 3)),
        T_base_flange_zero=UR5.T_base_flange_zero,
        lower=-FULL,
        upper=FULL,
    )
    solver = GeneralSolver.for_robot(arm)
    assert solver.kind == "general"
    q, T = random_poses(arm, 1000, seed=9)
    assert (gaps(solver.solve(T), q).min(axis=1) > SAME).sum() <= 5


def test_axes_rounded_to_few_decimals_use_the_closed_form_exactly() -> None:
    a = 1.5708
    arm = from_dh([0.089159, 0, 0, 0.10915, 0.09465, 0.0823], [0, -0.425, -0.39225, 0, 0, 0], [a, 1e-6, 0, a, -a, 0])
    solver = GeneralSolver.for_robot(arm)
    assert solver.kind == "three_parallel"
    q, T = random_poses(arm, 500, seed=10)
    found = solver.solve(T)
    reached = arm.compute_fk(found)
    assert np.nanmax(np.abs(reached - T[:, None])) < EXACT
    assert (gaps(found, q).min(axis=1) > SAME).sum() <= 1  # lost only where the nominal arm is just out of reach


@pytest.mark.parametrize("name", ["ur5", "tian2025"])
def test_quick_error_bound_of_a_branch_is_an_upper_bound(name: str) -> None:
    """A branch below the bound needs no Newton step: the bound is compared with small displacements of known size."""
    arm, g = CLOSED[name], np.random.default_rng(5)
    q, T = random_poses(arm, 300, seed=5)
    for size in (1e-12, 1e-9, 1e-6):
        turn, way = g.normal(size=(300, 3)), g.normal(size=(300, 3))
        turn *= size * g.random((300, 1)) / np.linalg.norm(turn, axis=1, keepdims=True)
        way *= size * g.random((300, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
        goal = T.copy()
        goal[:, :3, :3] += np.cross(turn[:, None], np.swapaxes(T[:, :3, :3], 1, 2)).swapaxes(1, 2)
        goal[:, :3, 3] += way
        values = np.array(
            [
                compute_pose_deviation(arm.axis, arm.point, arm.T_base_flange_zero, *row)
                for row in zip(q, goal, strict=True)
            ]
        )
        real = np.maximum(np.linalg.norm(turn, axis=1), np.linalg.norm(way, axis=1))
        assert (values >= real * (1 - 1e-5) - 1e-14).all()
        assert (values <= 1.5 * real + 1e-14).all()


def test_margins_of_three_parallel_axes() -> None:
    """The shoulder margin follows from the intersection of axes 5 and 6, the others from angles between link axes."""
    branches = GeneralBranches(UR5)
    _, T = random_poses(UR5, 100, seed=6)
    found = branches.solve(T)
    m, b = np.nonzero(np.isfinite(found.q[..., 0]))
    links, h, p = UR5.compute_link_poses(found.q[m, b]), UR5.axis, UR5.point

    def line(link: int, v: Array) -> Array:
        return np.asarray(links[:, link, :3, :3] @ v)

    def angle(u: Array, v: Array) -> Array:
        return np.arcsin(np.minimum(np.linalg.norm(np.cross(normalise_vectors(u), normalise_vectors(v)), axis=1), 1.0))

    meeting = line(4, p[4]) + links[:, 4, :3, 3]
    plane = normalise_vectors(np.cross(np.tile(h[0], (len(m), 1)), line(1, h[1])))
    np.testing.assert_allclose(found.shoulder[m, b], np.abs(np.sum((meeting - p[0]) * plane, axis=1)), atol=1e-9)
    np.testing.assert_allclose(found.elbow[m, b], angle(line(2, p[2] - p[1]), line(3, p[3] - p[2])), atol=1e-6)
    np.testing.assert_allclose(found.wrist[m, b], angle(line(4, h[3]), line(5, h[5])), atol=1e-6)
    assert np.isnan(
        found.margin[np.isnan(found.q[..., 0]).nonzero()[0], :, np.isnan(found.q[..., 0]).nonzero()[1]]
    ).all()


@pytest.mark.parametrize(
    "angle", [0.0, np.pi, -np.pi, 3.2, -3.2, 1e-300, 7.0, -20.0, np.nextafter(np.pi, 4), -np.pi - 1e-15]
)
def test_angles_equal_within_a_turn(angle: float) -> None:
    assert wrap_angle(angle) == np.pi - np.remainder(np.pi - angle, 2 * np.pi)
    assert abs(wrap_angle(angle)) <= np.pi


# ---------------------------------------------------------------- comparison with independent solvers


def ssik_arm(arm: Robot) -> object:
    """The arm of ssik ends in a frame parallel to the base; :func:`as_ssik` therefore contains a rotation."""
    ssik = pytest.importorskip("ssik")
    ends = np.vstack([np.zeros(3), arm.point, arm.T_base_flange_zero[:3, 3]])
    return ssik.Manipulator.from_axes(arm.axis, np.diff(ends, axis=0))


def as_ssik(arm: Robot, T: Array) -> Array:
    out = T.copy()
    out[:, :3, :3] = T[:, :3, :3] @ arm.T_base_flange_zero[:3, :3].T
    return out


@pytest.mark.parametrize("name", ["ur5", "tian2025", "spherical wrist"])
def test_same_solutions_as_ssik(name: str) -> None:
    arm = (CLOSED | GENERAL)[name]
    other = ssik_arm(arm)
    _, T = random_poses(arm, 100, seed=11)
    mine = solver_of(name).solve(T)
    for m, wanted in enumerate(as_ssik(arm, T)):
        theirs = [s.q for s in other.solve(wanted, respect_limits=False)]  # type: ignore[attr-defined]
        assert len(theirs) == counts(mine[m])
        for q in theirs:
            assert gaps(mine[m : m + 1], q[None]).min() < SAME


def test_same_solutions_as_ssik_on_an_offset_wrist() -> None:
    """ssik contains this arm with its own derivation, read from the manufacturer's URDF."""
    crx = pytest.importorskip("ssik.prebuilt.fanuc.crx10ial_ik")
    T, axis, point = np.eye(4), [], []
    for joint in crx._KB.joints:
        T = T @ joint.T_left
        axis.append(T[:3, :3] @ joint.axis)
        point.append(T[:3, 3])
        T = T @ joint.T_right
    arm = Robot(
        joints=JOINTS,
        axis=np.array(axis),
        point=np.array(point),
        T_base_flange_zero=np.asarray(crx.T_HOME),
        lower=-FULL,
        upper=FULL,
    )
    _, poses = random_poses(arm, 100, seed=12)
    mine = solve_general(arm, poses)
    for m in range(len(poses)):
        theirs = [s.q for s in crx.solve(poses[m], respect_limits=False)]
        assert counts(mine[m]) == len(theirs)
        for q in theirs:
            assert gaps(mine[m : m + 1], q[None]).min() < SAME


@pytest.mark.parametrize("name", ["ur5", "tian2025", "spherical wrist"])
def test_same_solutions_as_eaik(name: str) -> None:
    eaik = pytest.importorskip("eaik.IK_HP")
    arm = (CLOSED | GENERAL)[name]
    ends = np.vstack([np.zeros(3), arm.point, arm.T_base_flange_zero[:3, 3]])
    other = eaik.HPRobot(arm.axis, np.diff(ends, axis=0))
    _, T = random_poses(arm, 100, seed=13)
    mine = solver_of(name).solve(T)
    total = 0
    for m, wanted in enumerate(as_ssik(arm, T)):
        answer = other.IK(wanted)
        exact = [q for q, approximate in zip(answer.Q, answer.is_LS, strict=True) if not approximate]
        total += len(exact)
        for q in exact:
            assert gaps(mine[m : m + 1], np.asarray(q)[None]).min() < SAME
    assert total == counts(mine).sum()


# ---------------------------------------------------------------- along a path and around the tool


def machining_grid(arm: Robot, points: int, rotations: int, seed: int) -> Array:
    """A path with changing position and orientation; the flange rotates about the axis of an inclined tool."""
    g = np.random.default_rng(seed)
    start = g.uniform(-2.0, 2.0, 6)
    T = arm.compute_fk(start + np.linspace(0.0, 1.0, points)[:, None] * g.uniform(-0.3, 0.3, 6))
    turn = compute_axis_rotation(np.array([0.0, 0.0, 1.0]), np.arange(rotations) * 2 * np.pi / rotations)
    tool = build_transform(compute_rpy_matrix(np.array([0.6, 0.0, 0.0])), np.array([0.05, 0.0, 0.15]))
    return T[:, None] @ build_transform(turn, np.zeros((rotations, 3))) @ tool


@pytest.mark.parametrize("name", ["crx", "offset wrist 50, 200", "random"])
@pytest.mark.parametrize("seed", [1, 2])
def test_grid_solutions_equal_those_of_single_poses(name: str, seed: int) -> None:
    arm, solver = GENERAL[name], solver_of(name)
    T = machining_grid(arm, 25, 72, seed)
    grid = solver.solve_grid(T)
    single = solver.solve(T.reshape(-1, 4, 4)).reshape(grid.shape)
    assert np.all(counts(grid) <= counts(single))
    # feasible regions smaller than the coarse grid may be missed
    assert counts(grid).sum() >= 0.999 * counts(single).sum()
    exists = np.isfinite(grid[..., 0])
    gap = np.abs(numerics_wrap_angle(grid[..., :, None, :] - single[..., None, :, :])).max(axis=-1)
    assert np.all(np.nanmin(np.where(np.isnan(gap), np.inf, gap), axis=-1)[exists] < SAME)


@pytest.mark.parametrize("name", ARMS)
def test_one_index_is_one_branch_along_the_path(name: str) -> None:
    arm, solver = (CLOSED | GENERAL)[name], solver_of(name)
    q0 = np.array([0.3, -0.6, 1.2, 0.4, 0.9, 0.2])
    T = np.repeat(arm.compute_fk(q0)[None], 40, axis=0)
    T[:, :3, 3] += np.linspace(-0.01, 0.01, 40)[:, None] * np.array([0.6, 0.0, 0.8])
    q = solver.solve_grid(T[:, None])[:, 0]
    jump = np.abs(numerics_wrap_angle(np.diff(q, axis=0))).max(axis=-1)
    start = gaps(q[19:20], q0[None])[0].argmin()
    assert np.isfinite(q[:, start]).all()
    assert jump[:, start].max() < 0.01  # steps of 0.5 mm at the length of the arm
    assert np.nanmax(jump) < 0.5


@given(st.integers(0, 10**6))
@settings(max_examples=scale_example_count(30), deadline=None)
def test_closed_form_indices_name_the_assembly_mode(seed: int) -> None:
    """Rotating the base changes q1 of every branch by the same angle and nothing else, index by index."""
    _, T = random_poses(UR5, 1, seed)
    angle = 0.7
    turned = build_transform(compute_axis_rotation(UR5.axis[0], np.array(angle)), np.zeros(3)) @ T
    a, b = solver_of("ur5").solve(T)[0], solver_of("ur5").solve(turned)[0]
    both = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    assert both.any()
    assert np.abs(numerics_wrap_angle(b - a - angle * np.eye(6)[0]))[both].max() < SAME


# ---------------------------------------------------------------- special cases


def test_unreachable_poses_are_nan_and_do_not_affect_others() -> None:
    for name in ("ur5", "crx"):
        arm, solver = (CLOSED | GENERAL)[name], solver_of(name)
        _, T = random_poses(arm, 3, seed=14)
        alone = solver.solve(T[1:2])
        T[0, :3, 3] = 50.0
        T[2] = np.nan
        q = solver.solve(T)
        assert counts(q)[0] == 0
        assert counts(q)[2] == 0
        assert np.array_equal(counts(q[1:2]), counts(alone))
        assert solver.solve(T[:0]).shape == (0, solver.branches, 6)
        assert solver.solve_grid(T[:0, None]).shape == (0, 1, solver.branches, 6)


def test_stretched_and_wrist_singular_poses_are_solved() -> None:
    q = np.array([[0.2, -0.7, 0.0, 0.3, 0.8, 0.1], [0.2, -0.7, 1.1, 0.3, 0.0, 0.1]])
    found = solver_of("ur5").solve(UR5.compute_fk(q))
    assert np.all(counts(found) > 0)
    assert np.nanmax(np.abs(UR5.compute_fk(found) - UR5.compute_fk(q)[:, None])) < EXACT


def test_arm_without_six_degrees_of_freedom_is_refused() -> None:
    axis = UR5.axis.copy()
    axis[4] = axis[3]  # four parallel axes
    with pytest.raises(InputError, match="six directions"):
        GeneralSolver.for_robot(
            Robot(
                joints=JOINTS,
                axis=axis,
                point=UR5.point,
                T_base_flange_zero=UR5.T_base_flange_zero,
                lower=-FULL,
                upper=FULL,
            )
        )


def test_kinds_of_geometry_are_recognised() -> None:
    assert all(axis_geometry.is_three_parallel(arm) for arm in CLOSED.values())
    assert not any(axis_geometry.is_three_parallel(arm) for arm in GENERAL.values())
    assert [n for n, arm in (CLOSED | GENERAL).items() if axis_geometry.is_spherical_wrist(arm)] == ["spherical wrist"]
    assert axis_geometry.has_axis_intersection(UR5, 4, 5)
    assert not axis_geometry.has_axis_intersection(UR5, 3, 5)
    assert axis_geometry.compute_axis_distance(UR5, 1, 2) == pytest.approx(0.425)
    centre, gap = axis_geometry.compute_common_point(GENERAL["spherical wrist"], (3, 4, 5))
    assert gap < 1e-12
    assert centre == pytest.approx([1.55, 0.0, 1.784])


@pytest.mark.parametrize("arm", [industrial(0.05, 0.0), industrial(0.0, 0.12), industrial(0.05, 0.1), CRX])
@pytest.mark.parametrize("q4", [0.0, np.pi, 1e-7])
def test_forearm_in_the_plane_of_the_arm_loses_no_configuration(arm: Robot, q4: float) -> None:
    """On every path with an upright tool two solutions have an angle in common; a quarter of them was lost."""
    q = np.random.default_rng(4).uniform(-2.0, 2.0, (60, 6))
    q[:, 3] = q4
    found = GeneralSolver.for_robot(arm).solve(arm.compute_fk(q))
    off_by = np.abs(numerics_wrap_angle(found - q[:, None])).max(axis=-1)
    assert np.mean(np.nanmin(off_by, axis=1) < SAME) > 0.98


def test_angles_at_zero_and_a_full_turn_are_neighbours() -> None:
    """Rounding gives 1e-16 for one angle and 2π − 1e-16 for an equal one: they must be recognised as adjacent."""
    elimination = GeneralSolver.for_robot(CRX).eliminations[0]
    q, pose = np.full((6, 6), -1e-12), np.array([7, 8, 7, 9, 9, 3])
    q[2] = 1e-12
    q[4] = 0.5  # pose 9 has two, separate ones; poses 3 and 8 have one each
    assert elimination.find_shared_eigenvalues(q, pose).tolist() == [7]
