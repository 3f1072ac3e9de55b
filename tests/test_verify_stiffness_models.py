"""Stiffness models of the verifier compared with those of the planner on any arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.stiffness import ArmStiffness, StiffnessGrid, StiffnessTerm
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.planning.stations.planning_path import build_planning_path
from machopt.planning.uncertainty.stiffness_uncertainty import ComplianceCovariance
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.urdf_inventory import check_inventory
from machopt.verification.motion.kinematics import posture
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry import reference_direction as reference_direction_module
from machopt.verification.motion.stiffness.arm_compliance import ComplianceModel

CELLS = Path(__file__).resolve().parents[1] / "cells"
K = np.array([1.4e6, 4.0e5, 9.4e5, 3.6e5, 3.7e5, 3.8e5])  # N·m/rad
FULL = (np.diag([3e-9, 2e-9, 4e-9, 5e-8, 6e-8, 7e-8]) + 2e-10).tolist()
TERMS = {
    "coupling": StiffnessTerm("joint_coupling", "joint:4-5", {"compliance_rad_per_Nm": 4e-7}),
    "harmonics": StiffnessTerm(
        "joint_pose_dependent_stiffness",
        "joint:2",
        {"cos_rad_per_Nm": 3e-7, "sin_rad_per_Nm": -2e-7, "cos2_rad_per_Nm": 1e-7, "sin2_rad_per_Nm": 5e-8},
    ),
    "sector": StiffnessTerm(
        "joint_pose_dependent_stiffness",
        "joint:3",
        {"law": "sector", "extra_rad_per_Nm": 6e-7, "centre_deg": 40.0, "width_deg": 30.0},
    ),
    "creep": StiffnessTerm("joint_creep", "joint:1", {"extra_rad_per_Nm": 2e-7, "time_constant_s": 10.0}),
    "knee": StiffnessTerm(
        "joint_nonlinear_stiffness", "joint:3", {"law": "knee", "extra_rad_per_Nm": 8e-7, "knee_Nm": 900.0}
    ),
    "knees": StiffnessTerm(
        "joint_nonlinear_stiffness",
        "joint:2",
        {"law": "knees", "extra_rad_per_Nm": [5e-7, 3e-7], "knees_Nm": [300.0, 1200.0]},
    ),
    "softening": StiffnessTerm("joint_nonlinear_stiffness", "joint:2", {"law": "cubic", "cubic_rad_per_Nm3": 2e-13}),
    "hardening": StiffnessTerm("joint_nonlinear_stiffness", "joint:2", {"law": "cubic", "cubic_rad_per_Nm3": -4e-13}),
    "backlash": StiffnessTerm("joint_backlash", "joint:5", {"width_arcmin": 0.8, "transition_Nm": 60.0}),
    "hysteresis": StiffnessTerm(
        "joint_hysteresis", "joint:4", {"weights_rad_per_Nm": [4e-7, 2e-7], "thresholds_Nm": [20.0, 90.0]}
    ),
    "used up": StiffnessTerm(
        "joint_hysteresis",
        "joint:4",
        {"law": "used_up", "half_clearance_arcmin": 0.3, "threshold_Nm": 20.0, "reach_Nm": 60.0},
    ),
    "rounded": StiffnessTerm(
        "joint_hysteresis", "joint:4", {"law": "bouc_wen", "drag_arcmin": 0.02, "reach_Nm": 70.0, "beta": 0.65}
    ),
    "balancer": StiffnessTerm(
        "gravity_compensator",
        "joint:2",
        {"force_times_length_Nm": 4e3, "rate_times_length2_Nm": 3e4, "ratio": 0.3, "angle_deg": 50.0},
    ),
    "link beam": StiffnessTerm("link_compliance", "link:2", {"EI_Nm2": 3e6, "GJ_Nm2": 2e6, "EA_N": 5e8}),
    "link box": StiffnessTerm(
        "link_compliance", "link:3", {"EI_Nm2": 3e6, "EI_across_Nm2": 9e5, "GJ_Nm2": 2e6, "normal": [0.1, 1.0, 0.2]}
    ),
    "link box, rigid in a plane": StiffnessTerm(
        "link_compliance", "link:2", {"EI_across_Nm2": 9e5, "normal": [0.0, 1.0, 0.0]}
    ),
    "link tube": StiffnessTerm(
        "link_compliance",
        "link:3",
        {
            "EI_Nm2": 3e6,
            "EI_across_Nm2": 9e5,
            "GJ_Nm2": 2e6,
            "normal": [0.1, 1.0, 0.2],
            "taper": 0.6,
            "shear": 0.04,
        },
    ),
    "link tube, round": StiffnessTerm("link_compliance", "link:2", {"EI_Nm2": 9e5, "EA_N": 5e7, "taper": 1.4}),
    "link box, rigid across": StiffnessTerm("link_compliance", "link:2", {"EI_Nm2": 9e5, "normal": [0.0, 1.0, 0.0]}),
    "tool box": StiffnessTerm(
        "tool_compliance", "tool", {"EI_Nm2": 4e4, "EI_across_Nm2": 2e4, "EA_N": 5e7, "normal": [0.0, 1.0, 0.3]}
    ),
    "link placed": StiffnessTerm(
        "link_compliance", "link:4", {"EI_Nm2": 8e5, "from_mm": [1.5e3, 0, 700], "to_mm": [2.2e3, 0, 710]}
    ),
    "link matrix": StiffnessTerm("link_compliance", "link:3", {"compliance": FULL}),
    "base": StiffnessTerm(
        "base_compliance", "base", {"compliance_diagonal": [2e-9, 2e-9, 1e-9, 3e-8, 3e-8, 1e-8], "at_mm": [10, 20, 30]}
    ),
    "tool beam": StiffnessTerm("tool_compliance", "tool", {"EI_Nm2": 4e4, "GJ_Nm2": 3e4}),
    "tool matrix": StiffnessTerm("tool_compliance", "tool", {"compliance": FULL}),
    "tool stack": StiffnessTerm(
        "tool_compliance",
        "tool",
        {
            "cylinders": [
                {"diameter_mm": 60, "length_mm": 120, "youngs_GPa": 210, "bore_mm": 20},
                {"diameter_mm": 16, "length_mm": 80, "youngs_GPa": 600, "poisson": 0.22},
            ],
            "sensor_N_per_mm": [4e4, 4e4, 9e4],
            "sensor_Nm_per_rad": [5e4, 5e4, 8e4],
            "scale": 1.1,
        },
    ),
    "K_C": StiffnessTerm("geometric_stiffness", "arm", {}),
}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    """The small cell with a mass in every link, and with base_link rotated and tilted in world."""
    made = small_cell(tmp_path_factory.mktemp("cell"))
    text = made.urdf.read_text()
    inertial = (
        '<inertial><origin xyz="0.2 0.05 0.1"/><mass value="{}"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    for n in range(1, 7):
        text = text.replace(f'<link name="link_{n}">', f'<link name="link_{n}">' + inertial.format(160 - 20 * n))
    made.urdf.write_text(text)
    tool = replace(made.tool, com=np.array([0.02, -0.03, 0.12]))
    tilt = np.eye(4)
    tilt[:3, :3] = np.array([[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]])
    tilt[:3, 3] = 0.1, -0.2, 0.3
    return replace(made, tool=tool, T_world_base=tilt)


def poses(cell: Cell, n: int = 12) -> np.ndarray:
    rng = np.random.default_rng(7)
    lower, upper = cell.limits.lower, cell.limits.upper
    return np.asarray(lower + (upper - lower) * (0.2 + 0.6 * rng.random((n, 6))))


@pytest.mark.parametrize("name", [*TERMS, "everything"])
def test_every_term_of_a_stiffness_file_is_recomputed(cell: Cell, name: str) -> None:
    """Small-load compliance, displacement under load and the paper's index agree to a relative rounding of 1e-9."""
    terms = (
        (TERMS[name],)
        if name != "everything"
        else tuple(
            TERMS[n]
            for n in (
                "coupling",
                "harmonics",
                "knee",
                "backlash",
                "hysteresis",
                "balancer",
                "link beam",
                "base",
                "tool stack",
                "K_C",
            )
        )
    )
    stiffness = ArmStiffness(joints=K, terms=terms)
    robot, arm, q = load_robot(cell), UrdfKinematics(cell), poses(cell)
    theirs = ArmElasticity(
        robot, cell.tool.T_flange_tcp, stiffness, (cell.limits.lower, cell.limits.upper), load_masses(cell)
    ).evaluate(q)
    stance = arm.compute_configuration(q)
    ours = ComplianceModel(cell, arm, stiffness).evaluate(stance, stance.tcp[:, :3, 3])
    rng = np.random.default_rng(3)
    e = rng.normal(size=(len(q), 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    for size in (5.0, 800.0):
        np.testing.assert_allclose(
            ours.compute_displacement(size * e), theirs.compute_deflection(size * e), rtol=1e-7, atol=1e-13
        )
    np.testing.assert_allclose(ours.compute_stiffness_along(e), 1.0 / theirs.compute_compliance_along(e), rtol=1e-9)
    np.testing.assert_allclose(ours.compute_jiao_stiffness(e), theirs.compute_jiao_index(e), rtol=1e-6)
    np.testing.assert_allclose(
        ours.compute_axial_gradient(e), theirs.compute_sensitivity(e, e, small=True), rtol=1e-9, atol=1e-15
    )


def test_grid_and_uncertainty_are_recomputed(cell: Cell) -> None:
    rng = np.random.default_rng(5)
    joints = K * rng.uniform(0.8, 1.2, (8, 6))
    grid = StiffnessGrid(np.array([0.0, -2.0, -1.0]), 2.0, (2, 2, 2), joints, 0.05 * joints)
    A = rng.normal(size=(6, 6)) * 1e-8
    stiffness = ArmStiffness(joints=K, covariance=A @ A.T, grid=grid)
    arm, q = UrdfKinematics(cell), poses(cell, 20)
    position = rng.uniform(-1.5, 4.5, (20, 3))
    position[3] = [2.0, 0.0, 1.0]  # a corner of all eight cells
    position[4] = [2.0, 0.5, 0.3]  # a face of two cells
    law = ComplianceModel(cell, arm, stiffness)
    soft = law.evaluate(arm.compute_configuration(q), position)
    theirs = ComplianceCovariance.build(stiffness, position)
    gradient = rng.normal(size=(20, 6))
    np.testing.assert_allclose(law.compute_std(soft, gradient), theirs.point_std(gradient), rtol=1e-9)
    assert len(soft.cell_sensitivities[3][0]) == 8
    assert len(soft.cell_sensitivities[4][0]) == 2


@pytest.mark.parametrize("name", ["kr500_milling", "cutting_cobot", "irb6700_drilling"])
def test_configuration_class_equals_that_of_the_solver(name: str) -> None:
    """The branch and the distance from the singularities agree for 200 random configurations."""
    cell = load_cell(CELLS / name)
    robot, arm = load_robot(cell), UrdfKinematics(cell)
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 6))
    found = build_solver(robot).solve(robot.compute_fk(q))
    off = np.abs(np.angle(np.exp(1j * (found.q - q[:, None])))).max(axis=2)
    branch = np.where(np.isfinite(off), off, np.inf).argmin(axis=1)
    rows = np.flatnonzero(off[np.arange(200), branch] < 1e-6)  # near a singularity some solutions are less exact
    assert len(rows) > 190
    placed = posture.compute_posture(arm.compute_configuration(q[rows]))
    assert placed.branch is not None
    np.testing.assert_array_equal(placed.branch, branch[rows])
    at = rows, branch[rows]
    least = np.minimum(np.minimum(found.wrist[at], found.elbow[at]), np.arctan(found.shoulder[at]))
    np.testing.assert_allclose(placed.singularity, least, atol=1e-7)


def some_path(kind: str) -> Toolpath:
    """Return a path that plunges, ramps, rotates its axis, stops and drills, with rapid moves in between."""
    rng = np.random.default_rng(11)
    n = 40
    position = np.cumsum(rng.normal(scale=0.01, size=(n, 3)), axis=0)
    axis = np.array([0.0, 0.0, 1.0]) + 0.2 * np.cumsum(rng.normal(scale=0.05, size=(n, 3)), axis=0)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    axis[20:26] = axis[20]
    position[22] = position[21] - 0.02 * axis[21]  # a plunge
    position[30] = position[29]  # a repeated point
    move = np.full(n, MoveKind.CUT, np.int8)
    move[[0, 8, 19, 33]] = MoveKind.RAPID
    move[[1, 34]] = MoveKind.APPROACH
    reference_direction = np.full((n, 3), np.nan)
    if kind == "given":
        reference_direction[5:15] = [0.3, 0.5, 0.1]
    drilling = "point" if kind == "drilling" else "trajectory"
    return Toolpath(
        position=position,
        axis=axis,
        move=move,
        feed=np.where(move == MoveKind.RAPID, np.nan, 0.02),
        operation=np.zeros(n, np.int32),
        operations=(ToolpathOperation("a", drilling),),
        reference=reference_direction,
        tolerance=np.full(n, np.nan),
        line=np.arange(1, n + 1, dtype=np.int32),
        source="p",  # type: ignore[arg-type]
        format="csv",
        sha256="",
    )


@pytest.mark.parametrize("kind", ["travel", "given", "drilling"])
def test_reference_direction_equals_that_of_the_planner(kind: str) -> None:
    """gamma = 0 and the direction of travel agree at every point of a path."""
    toolpath = some_path(kind)
    path = build_planning_path(toolpath)
    known = reference_direction_module.compute_directions_at_points(toolpath)
    at = np.flatnonzero(path.is_point)
    tcp = np.zeros((len(toolpath), 4, 4))
    tcp[:, :3, 0], tcp[:, :3, 2] = path.reference[at], -toolpath.axis
    apart = np.abs((known.compute_rotation_angle(tcp) - path.offset[at][:, None] + np.pi) % (2 * np.pi) - np.pi)
    assert np.nanmin(apart, axis=1).max() < 1e-9
    for travel in (known.travel, path.travel[at]):  # otherwise a lateral stiffness would not refer to a unit vector
        assert np.abs(np.einsum("ij,ij->i", travel, toolpath.axis)).max() < 1e-12
        np.testing.assert_allclose(np.linalg.norm(travel, axis=1), 1.0, atol=1e-12)
    cross = np.linalg.norm(np.cross(known.travel, path.travel[at]), axis=1)
    plain = np.isnan(known.second[:, 0])
    assert cross[plain].max() < 0.02  # the travel of a plunge is that of the next cut, projected along another axis
    assert (cross[plain] < 1e-12).mean() > 0.9


def test_plunge_with_a_rotating_axis_agrees_with_the_planner() -> None:
    """The tool plunges while its axis tilts sideways.

    After the first degree of tilt, the move itself defines the direction of travel.
    """
    corners = np.array([[0, 0, 0.04], [0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.2, 0, 0.04]])
    lean = np.array([[0, 0, 1], [0, 0.1, 1], [0.02, 0.1, 1], [0, 0.1, 1], [0, 0, 1.0]])
    toolpath = replace(
        some_path("travel"),
        **{k: getattr(some_path("travel"), k)[:5] for k in ("operation", "reference", "tolerance", "line")},
        position=corners,
        axis=lean / np.linalg.norm(lean, axis=1, keepdims=True),
        move=np.array([MoveKind.RAPID] + 4 * [MoveKind.CUT], np.int8),
        feed=np.array([np.nan, 0.02, 0.02, 0.02, 0.02]),
    )
    path, known = build_planning_path(toolpath), reference_direction_module.compute_directions_at_points(toolpath)
    at = np.flatnonzero(path.is_point)
    across = np.abs(np.stack([np.einsum("ij,ij->i", v, path.travel[at]) for v in (known.travel, known.other)]))
    assert np.nanmax(across, axis=0).min() > 1 - 1e-12  # at every point one of the two equals that of the planner
    low = np.maximum(np.ceil(path.index - 1e-9).astype(int) - 1, 0)
    there = reference_direction_module.interpolate_directions(toolpath, known, path.index, leaving=False)
    tcp = np.zeros((len(path.index), 4, 4))
    tcp[:, :3, 0], tcp[:, :3, 2] = path.reference, -path.axis
    apart = np.abs((there.compute_rotation_angle(tcp) - path.offset[at][low][:, None] + np.pi) % (2 * np.pi) - np.pi)
    # the remaining difference is the sideways rotation of the axis
    assert np.degrees(np.nanmin(apart, axis=1)[path.index > 0].max()) < 1.0


def test_reference_between_points_is_that_of_the_previous_point() -> None:
    """A long move between two rows with different reference directions, as robot programs contain them."""
    base = some_path("travel")
    toolpath = replace(
        base,
        **{k: getattr(base, k)[:4] for k in ("operation", "tolerance", "line")},
        position=np.array([[0, 0, 0.05], [0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0.0]]),
        axis=np.tile([0.0, 0.0, 1.0], (4, 1)),
        move=np.array([MoveKind.RAPID] + 3 * [MoveKind.CUT], np.int8),
        feed=np.array([np.nan, 0.02, 0.02, 0.02]),
        reference=np.array([[1, 0, 0], [1, 0, 0], [0.8, 0.6, 0], [0, 1, 0.0]]),
    )
    path, known = build_planning_path(toolpath), reference_direction_module.compute_directions_at_points(toolpath)
    inside = ~path.is_point
    assert inside.sum() > 4
    there = reference_direction_module.interpolate_directions(toolpath, known, path.index, leaving=True)
    tcp = np.zeros((len(path.index), 4, 4))
    tcp[:, :3, 0], tcp[:, :3, 2] = path.reference, -path.axis
    apart = np.abs((there.compute_rotation_angle(tcp)[:, 0] - path.offset + np.pi) % (2 * np.pi) - np.pi)
    assert apart[inside].max() < 1e-9


def test_missing_body_or_mass_is_named(cell: Cell, tmp_path: Path) -> None:
    """The model is compared with the URDF file: an additional body, another size and another mass are detected."""

    def told(old: str, new: str) -> list[str]:
        text = cell.urdf.read_text()
        assert old in text
        arm = UrdfKinematics(cell)
        bodies = build_bodies(cell, arm)
        wanted = list_checked_pairs(cell, arm, bodies)
        urdf = tmp_path / "robot.urdf"
        urdf.write_text(text.replace(old, new, 1))
        return [c.where for c in check_inventory(replace(cell, urdf=urdf), arm, bodies, wanted) if c.passed is False]

    assert told("<robot", "<robot") == []
    (where,) = told(
        '<link name="flange"/>',
        '<link name="flange"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>',
    )
    assert "'flange'" in where
    (where,) = told('<sphere radius="0.09"/>', '<sphere radius="0.19"/>')
    assert "link 'link_5'" in where
    (where,) = told('mass value="140"', 'mass value="1400"')
    assert "link_1" in where
    (where,) = told('mass value="140"', 'mass value="140,0"')
    assert "link_1" in where
    (where,) = told('<box size="0.9 0.26 0.26"/>', '<capsule radius="0.1" length="0.2"/>')
    assert "link_3" in where
