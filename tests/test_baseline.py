"""Baselines: CAM default rotation, and jiao2022 sections 3.2 and 4, compared with the equations of the paper."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_cell import pose, small_cell
from test_planning_path import Rows, at_point, toolpath

from machopt.data_types.cell import Cell, Tool, Workpiece
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.baselines import (
    LEAST_TILT,
    STEP,
    _compute_roll,
    _group_key_points,
    plan_cam_default,
    plan_jiao2022,
)
from machopt.planning.cost.stiffness_index import compute_load_directions
from machopt.planning.pipeline.planning_setup import PlanningSetup, prepare_planning
from machopt.planning.sampling.joint_path import JointAssignment
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path, compute_tcp_poses
from machopt.stiffness.joint_compliance import compute_jiao_index

C, R = MoveKind.CUT, MoveKind.RAPID
K = np.array([1.4e6, 4.0e5, 9.4e5, 3.6e5, 3.7e5, 3.8e5])  # N·m/rad, of the magnitude of a KR240
OPTIONS = PlanOptions(collision=False)


def facing_cell(folder: FilePath, pitch: float = -90.0, height: float = 1.4) -> Cell:
    """Return a cell with a wall in front of the robot and the spindle perpendicular to axis 6. At pitch −90° the
    tool axis is along base x."""
    cell = small_cell(folder, stiffness=ArmStiffness(joints=K))
    T_tcp = pose(0.25, 0.0, 0.15, np.pi / 2)  # tool axis along the flange's x
    wall = pose(1.55, 0.0, height, np.radians(pitch))
    return replace(cell, tool=Tool(T_flange_tcp=T_tcp, mass=20.0), workpiece=Workpiece("world", wall, ()), obstacles=())


def milling(tilt: float = 0.0, n: int = 21) -> Toolpath:
    """Return one pass across the wall with an oscillating tool axis (amplitude ``tilt`` rad)."""
    rows: Rows = []
    for k, y in enumerate(np.linspace(-0.15, 0.25, n)):
        axis = (np.sin(tilt * np.sin(0.3 * k)), np.sin(tilt * np.cos(0.2 * k)), 1.0)
        rows.append(((0.02 * np.sin(k), y, 0.0), axis, R if k == 0 else C))
    return toolpath([((0.0, -0.15, 0.05), rows[0][1], R), *((p, a, C) for p, a, _ in rows)])


def holes(tilt: float = 0.0) -> Toolpath:
    """Return unevenly spaced holes along base y, each entered from a rapid point above."""
    rows: Rows = []
    for k, y in enumerate([-0.2, -0.12, 0.0, 0.03, 0.2, 0.3]):
        axis = np.array([np.sin(tilt * k / 5), 0.0, np.cos(tilt * k / 5)])
        p = np.array([0.01 * k, y, 0.0])
        rows += [(tuple(p + 0.02 * axis), tuple(axis), R), (tuple(p - 0.01 * axis), tuple(axis), C)]
    return toolpath(rows, kind="point")


def prepare_path(cell: Cell, tp: Toolpath, options: PlanOptions = OPTIONS) -> tuple[PlanningSetup, PlanningPath]:
    return prepare_planning(cell, options), build_planning_path(tp)


def paper(setup: PlanningSetup, path: PlanningPath, options: PlanOptions = OPTIONS) -> JointAssignment:
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    return plan_jiao2022(path, setup.arm, setup.elasticity, d, None, setup.cell.home, options)


def paper_roll(setup: PlanningSetup, path: PlanningPath, phi: np.ndarray) -> np.ndarray:
    """Compute γ of Eq. 27 with SciPy: tool axes as in the paper (its x is the tool axis), Rz Ry Rx in base."""
    every = np.arange(len(path.index), dtype=np.int32)
    T = setup.arm.machine.T_base_workpiece_zero @ compute_tcp_poses(path, every, np.nan_to_num(phi))
    permuted = T[:, :3, [2, 0, 1]]
    return Rotation.from_matrix(permuted).as_euler("ZYX")[:, 2]


# --- CAM default -------------------------------------------------------------------------------------------


def test_cam_default_has_zero_rotation_and_is_reachable(tmp_path: FilePath) -> None:
    for tp in (milling(0.1), holes(0.2)):
        setup, path = prepare_path(facing_cell(tmp_path), tp)
        a = plan_cam_default(path, setup.arm, setup.cell.home)
        np.testing.assert_allclose(wrap_angle(a.phi + path.offset), 0, atol=1e-12)
        ok = a.reason == InfeasibilityReason.OK
        assert ok.mean() > 0.9
        every = np.flatnonzero(ok).astype(np.int32)
        wanted = setup.arm.machine.T_base_workpiece_zero @ compute_tcp_poses(path, every, a.phi[ok])
        np.testing.assert_allclose(setup.robot.compute_fk(a.q[ok], setup.arm.T_flange_tcp), wanted, atol=1e-9)
        assert np.isnan(a.q[a.branch < 0]).all()
        assert (a.q[ok] >= setup.arm.lower).all()
        assert (a.q[ok] <= setup.arm.upper).all()


def test_cam_default_starts_nearest_to_home_and_is_continuous(tmp_path: FilePath) -> None:
    setup, path = prepare_path(facing_cell(tmp_path), milling())
    a = plan_cam_default(path, setup.arm, setup.cell.home)
    first = setup.arm.solver.solve(
        setup.arm.machine.T_base_workpiece_zero
        @ compute_tcp_poses(path, np.zeros(1, np.int32), a.phi[:1])
        @ np.linalg.inv(setup.arm.T_flange_tcp)
    ).q[0]
    every = (first[:, None] + setup.arm.turns).reshape(-1, 6)
    inside = (every >= setup.arm.lower).all(axis=1) & (every <= setup.arm.upper).all(axis=1)
    nearest = every[inside][np.abs(every[inside] - setup.cell.home).max(axis=1).argmin()]
    np.testing.assert_allclose(a.q[0], nearest, atol=1e-9)
    ok = np.flatnonzero(a.reason == InfeasibilityReason.OK)
    assert len(ok) > 10
    steps = np.abs(np.diff(a.q[ok], axis=0)).max(axis=1)[np.diff(ok) == 1]
    # more would be a change of configuration; the path oscillates, and so does the rotation
    assert np.degrees(steps.max()) < 60
    assert len(set(a.branch[ok].tolist())) == 1
    np.testing.assert_array_equal(
        np.isin(a.reason, [InfeasibilityReason.OK, InfeasibilityReason.NO_PATH]), a.branch >= 0
    )


# --- jiao2022 ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_roll_angle_equals_equation_27_where_defined(tmp_path: FilePath, tilt: float) -> None:
    setup, path = prepare_path(facing_cell(tmp_path), milling(tilt))
    every = np.arange(len(path.index), dtype=np.int32)
    np.testing.assert_allclose(
        wrap_angle(_compute_roll(path, setup.arm, every) - paper_roll(setup, path, np.zeros(len(every)))), 0, atol=1e-9
    )
    for phi in (-2.0, 0.7):  # and it increases with phi with slope 1
        np.testing.assert_allclose(
            wrap_angle(paper_roll(setup, path, np.full(len(every), phi)) - _compute_roll(path, setup.arm, every) - phi),
            0,
            atol=1e-9,
        )


def test_roll_angle_is_constant_where_the_spindle_points_down(tmp_path: FilePath) -> None:
    """Eq. 27 is singular at β = ±90°: there an oscillating tool axis would change the roll by a full turn."""
    setup, path = prepare_path(facing_cell(tmp_path, pitch=0.0, height=0.7), milling(0.15))
    every = np.arange(len(path.index), dtype=np.int32)
    literal, used = paper_roll(setup, path, np.zeros(len(every))), _compute_roll(path, setup.arm, every)
    assert np.ptp(np.unwrap(literal)) > np.radians(90)
    assert np.ptp(np.unwrap(used)) < np.radians(15)
    down = np.degrees(LEAST_TILT)
    # between a vertical spindle (Table 2 of the paper) and one perpendicular to the wall (its figures)
    assert 20 < down < 45


@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_trajectory_rolls_in_proportion_to_the_index_and_reaches_the_end(tmp_path: FilePath, tilt: float) -> None:
    """Eqs. 33–37: ψ_i = ψ_1 + (i − 1)/(n − 1) (ψ_n − ψ_1), also for tilted axes."""
    setup, path = prepare_path(facing_cell(tmp_path), milling(tilt))
    a = paper(setup, path)
    rows = np.flatnonzero(path.counted)
    psi = np.unwrap(paper_roll(setup, path, a.phi)[rows])
    expected = psi[0] + np.arange(len(rows)) / (len(rows) - 1) * (psi[-1] - psi[0])
    np.testing.assert_allclose(psi, expected, atol=1e-9)
    assert abs(psi[-1] - psi[0]) <= np.pi + 1e-9  # the shorter direction
    for p in rows[[0, -1]]:  # Eq. 26: whole steps of 10° from the initial posture
        steps = a.phi[p] / STEP
        assert abs(steps - round(steps)) < 1e-6


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_holes_roll_in_proportion_to_the_coordinate_and_reach_the_end(tmp_path: FilePath, tilt: float) -> None:
    """Eq. 34, along the axis with the longest travel (here y)."""
    setup, path = prepare_path(facing_cell(tmp_path), holes(tilt))
    a = paper(setup, path)
    keys, rows, fraction = _group_key_points(path, setup.arm)[0]
    assert path.index[keys].tolist() == [path.index[rows[0]], path.index[rows[-1]]]
    y = np.repeat([-0.2, -0.12, 0.0, 0.03, 0.2, 0.3], np.bincount(path.run[rows]))
    np.testing.assert_allclose(fraction, (y + 0.2) / 0.5, atol=1e-9)
    psi = np.unwrap(paper_roll(setup, path, a.phi)[rows])
    np.testing.assert_allclose(psi, psi[0] + fraction * (psi[-1] - psi[0]), atol=1e-9)
    for first, last in path.runs:  # the rotation is constant from the rapid point to the bottom of the hole
        assert np.ptp(a.phi[first : last + 1]) < 1e-9


def test_key_points_use_the_stiffest_ten_degree_rotation(tmp_path: FilePath) -> None:
    """Steps 1–5 of section 3.2, evaluated one by one in the selected branch."""
    setup, path = prepare_path(facing_cell(tmp_path), milling())
    a = paper(setup, path)
    rows = np.flatnonzero(path.counted)
    R_bw = setup.arm.machine.T_base_workpiece_zero[:3, :3]
    for p in (rows[0], rows[-1]):
        scores = {}
        for step in range(-18, 18):
            T = setup.arm.machine.T_base_workpiece_zero @ compute_tcp_poses(
                path, np.array([p], np.int32), np.array([step * STEP])
            )
            q = setup.arm.solver.solve(T @ np.linalg.inv(setup.arm.T_flange_tcp)).q[0, a.branch[p]]
            every = q + setup.arm.turns
            inside = ((every >= setup.arm.lower) & (every <= setup.arm.upper)).all(axis=1)
            if np.isfinite(q).all() and inside.any() and _is_regular(setup, T, a.branch[p]):
                _, J = setup.robot.compute_fk_jacobian(q, setup.arm.T_flange_tcp)
                scores[step] = compute_jiao_index(J, K, R_bw @ path.axis[p])
        best = max(scores, key=lambda s: scores[s])
        assert wrap_angle(a.phi[p] - best * STEP) == pytest.approx(0.0, abs=1e-9)
        assert len(scores) < 36  # some rotations are infeasible


def _is_regular(setup: PlanningSetup, T: np.ndarray, b: int) -> bool:
    found = setup.arm.solver.solve(T @ np.linalg.inv(setup.arm.T_flange_tcp))
    m = setup.arm.margins
    return bool(found.wrist[0, b] >= m.wrist and found.elbow[0, b] >= m.elbow and found.shoulder[0, b] >= m.shoulder)


def test_user_bounds_hold_at_the_key_points(tmp_path: FilePath) -> None:
    low, high = np.radians([35.0, 75.0])
    setup, path = prepare_path(facing_cell(tmp_path), milling())
    a = paper(setup, path, replace(OPTIONS, rotation_range=(low, high)))
    rows = np.flatnonzero(path.counted)
    gamma = wrap_angle(a.phi + path.offset)[rows[[0, -1]]]
    assert (gamma >= low - 1e-9).all()
    assert (gamma <= high + 1e-9).all()


def test_each_milling_run_has_its_own_key_points(tmp_path: FilePath) -> None:
    rows: Rows = []
    for x in (-0.1, 0.0, 0.1):
        rows += [((x, -0.1, 0.05), (0, 0, 1), R), ((x, -0.1, 0.0), (0, 0, 1), C), ((x, 0.1, 0.0), (0, 0, 1), C)]
    setup, path = prepare_path(facing_cell(tmp_path), toolpath(rows))
    groups = _group_key_points(path, setup.arm)
    assert len(groups) == 3
    for k, (keys, inside, fraction) in enumerate(groups):
        counted = np.flatnonzero(path.counted & (path.run == k))
        assert keys.tolist() == [counted[0], counted[-1]]
        np.testing.assert_array_equal(inside, counted)
        assert fraction[0] == 0.0
        assert fraction[-1] == 1.0
    a = paper(setup, path)
    for k in range(3):
        assert np.isfinite(a.phi[path.run == k]).all()
        p = at_point(path, 3 * k)
        assert a.phi[p] == pytest.approx(a.phi[p + 1])  # the rapid point has the rotation of the following hole


def test_unreachable_path_is_data_not_an_exception(tmp_path: FilePath) -> None:
    cell = facing_cell(tmp_path)
    far = replace(cell, workpiece=Workpiece("world", pose(9.0, 0, 1.4, -np.pi / 2), ()))
    setup, path = prepare_path(far, milling())
    for a in (paper(setup, path), plan_cam_default(path, setup.arm, cell.home)):
        assert (a.reason == InfeasibilityReason.UNREACHABLE).all()
        assert np.isnan(a.q).all()
        assert (a.branch == -1).all()
