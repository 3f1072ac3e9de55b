"""Maps compared with pinocchio and finite differences; symmetry, structure of published figures, refusals."""

from __future__ import annotations

import csv
import json
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from external_axis_cells import external_folder

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model import CollisionModel
from machopt.commands.map.run import MapRequest, MapResult, run_map
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.stiffness import StiffnessTerm
from machopt.errors import InputError
from machopt.kinematics.inverse.solver import SingularityMargins, build_solver, list_whole_turns
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.numerics.rigid_transforms import invert_transform
from machopt.stiffness.arm_stiffness import ArmElasticity
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics as PinocchioArm
from machopt.workspace_map.branch_tracking import MAX_JOINT_STEP, track_branches
from machopt.workspace_map.inverse_distance_weighting import interpolate_idw, is_inside_hull, predict_leave_one_out
from machopt.workspace_map.postures import (
    ReachingArm,
    add_whole_turns,
    build_tool_poses,
    choose_postures,
    compute_candidates,
)
from machopt.workspace_map.quantities import QUANTITIES, MapLoad, MapSettings, list_quantities
from machopt.workspace_map.quantity_evaluation import evaluate_quantities
from machopt.workspace_map.sample_grid import build_even_values, build_straight_line, compute_farthest_reach, trim_axis
from machopt.workspace_map.sample_posture_computation import build_map_settings

CELLS = Path(__file__).resolve().parents[1] / "cells"
KR240 = CELLS / "kr240_drilling"
DOWN = np.array([0.0, 0.0, 1.0])
FIELD = {f.key: f for f in QUANTITIES}
SMALL = {"ranges": ("x=900:2100", "z=300:1500"), "steps": ("300",), "length": 600.0, "collision": "none"}


def make_map(out: Path, cell: Path = KR240, **asked: object) -> MapResult:
    return run_map(MapRequest(cell=cell, out=out, **asked))  # type: ignore[arg-type]


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.fixture(scope="module")
def cell():  # type: ignore[no-untyped-def]
    return load_cell(KR240)


@pytest.fixture(scope="module")
def arm(cell) -> ReachingArm:  # type: ignore[no-untyped-def]
    robot = load_robot(cell)
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    return ReachingArm(
        robot=robot,
        solver=build_solver(robot),
        T_flange_tcp=cell.tool.T_flange_tcp,
        lower=lower + 0.01,
        upper=upper - 0.01,
        home=cell.home,
        margins=SingularityMargins(0.087, 0.052, 0.05, 0.01),
    )


@pytest.fixture(scope="module")
def setting(cell, arm: ReachingArm) -> MapSettings:  # type: ignore[no-untyped-def]
    elasticity = ArmElasticity(arm.robot, arm.T_flange_tcp, cell.stiffness)
    load = MapLoad(np.array([100.0, 200.0, -1500.0, 50.0, -40.0, 30.0]), "frame")
    return MapSettings(
        robot=arm.robot,
        T_flange_tcp=arm.T_flange_tcp,
        elasticity=elasticity,
        length=0.6,
        lower=cell.limits.lower[:6],
        upper=cell.limits.upper[:6],
        R_base_frame=np.eye(3),
        load=load,
    )


def postures(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (n, 6)) + np.radians([0, -70, 100, 20, -60, 30.0])


def numeric_jacobian(cell, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[no-untyped-def]
    """Return the pose in base_link and the Jacobian of the TCP, by central differences
    of pinocchio's forward kinematics."""
    arm, step = PinocchioArm(cell), 1e-5
    T_base_world = invert_transform(cell.T_world_base)

    def tcp(at: np.ndarray) -> np.ndarray:
        return T_base_world @ arm.compute_placements(at[None], np.zeros((1, 0)))[0, -2] @ cell.tool.T_flange_tcp

    T, J = tcp(q), np.empty((6, 6))
    for i in range(6):
        e = step * np.eye(6)[i]
        plus, minus = tcp(q + e), tcp(q - e)
        turn = (plus[:3, :3] - minus[:3, :3]) / (2 * step) @ T[:3, :3].T
        J[:, i] = [*(plus[:3, 3] - minus[:3, 3]) / (2 * step), turn[2, 1], turn[0, 2], turn[1, 0]]
    return T, J


# --- the table compared with an independent computation ------------------------------------------------------


def test_slice_agrees_with_pinocchio(tmp_path: Path, cell) -> None:  # type: ignore[no-untyped-def]
    outcome = make_map(tmp_path / "m", tool_axis="0.2,0,1", gamma=30.0, wrench="0,200,-1500,40,0,0", **SMALL)
    assert outcome.exit_code == 0
    found = [r for name in ("map.csv", "map_free.csv") for r in rows(tmp_path / "m" / name) if r["reason"] == "ok"]
    assert len(found) > 20
    k = cell.stiffness.joints
    wrench = np.array([0, 200.0, -1500.0, 40.0, 0, 0])
    for row in found[::7]:
        value = {name: float(text) for name, text in row.items() if re.fullmatch(r"-?\d+(\.\d+)?(e-?\d+)?", text)}
        T, J = numeric_jacobian(cell, np.radians([value[f"q{i}_deg"] for i in range(1, 7)]))
        # joints have six decimals of a degree: 2e-8 rad over 3 m
        np.testing.assert_allclose(T[:3, 3] * 1e3, [value[f"{c}_mm"] for c in "xyz"], atol=2e-4)
        np.testing.assert_allclose(-T[:3, 2], np.array([0.2, 0, 1]) / np.hypot(0.2, 1), atol=1e-6)
        np.testing.assert_allclose(-T[:3, 2], [value[c] for c in "ijk"], atol=2e-6)
        C = J @ np.diag(1 / k) @ J.T
        tt, z = C[:3, :3], T[:3, 2]
        expected = {
            "k_x_N_mm": 1e-3 / tt[0, 0],
            "k_y_N_mm": 1e-3 / tt[1, 1],
            "k_z_N_mm": 1e-3 / tt[2, 2],
            "k_axial_N_mm": 1e-3 / (z @ tt @ z),
            "k_min_N_mm": 1e-3 / np.linalg.eigvalsh(tt)[2],
            "k_max_N_mm": 1e-3 / np.linalg.eigvalsh(tt)[0],
            "k_across_N_mm": 1e-3 / np.linalg.eigvalsh(T[:3, :2].T @ tt @ T[:3, :2])[1],
            "deflection_mm": 1e3 * np.linalg.norm((C @ wrench)[:3]),
            "held_x_N_mm": 1e-3 * np.linalg.inv(C)[0, 0],
            "held_z_N_mm": 1e-3 * np.linalg.inv(C)[2, 2],
        }
        N = np.diag([1 / 0.6] * 3 + [1.0] * 3) @ J
        expected["dexterity"] = 6 / np.sqrt(np.trace(N.T @ N) * np.trace(np.linalg.inv(N.T @ N)))
        # differences with 1e-5 rad have an error of about 1e-9 of J, times its condition number
        for name, number in expected.items():
            assert value[name] == pytest.approx(number, rel=2e-5), name
        soft = np.array([value[f"soft_{c}"] for c in "ijk"])
        assert soft @ tt @ soft == pytest.approx(np.linalg.eigvalsh(tt)[2], rel=1e-5)


def test_rotating_joint_1_changes_no_base_independent_field(setting: MapSettings) -> None:
    q = postures(30)
    turned = q + np.array([0.9, 0, 0, 0, 0, 0])
    unloaded = replace(setting, load=None)
    one, two = evaluate_quantities(unloaded, q), evaluate_quantities(unloaded, turned)
    for key in ("dexterity", "k_min", "k_max", "k_axial", "k_across", "k_z", "held_z"):
        np.testing.assert_allclose(two.value[key], one.value[key], rtol=1e-9)  # rounding
    assert np.abs(two.value["k_x"] / one.value["k_x"] - 1).max() > 0.05
    tool = replace(setting, load=MapLoad(np.array([0, 300.0, -900.0, 0, 0, 0]), "tool"))
    for key in ("deflection", "nu_p"):
        np.testing.assert_allclose(
            evaluate_quantities(tool, turned).value[key], evaluate_quantities(tool, q).value[key], rtol=1e-6
        )


def test_inequalities_between_the_fields(setting: MapSettings) -> None:
    v = evaluate_quantities(setting, postures(200, 1)).value
    tolerance = 1 + 1e-9
    for key in ("k_axial", "k_across", "k_x", "k_y", "k_z"):
        assert (v[key] * tolerance >= v["k_min"]).all()
        assert (v[key] <= v["k_max"] * tolerance).all()
    for c in "xyz":
        assert (v[f"held_{c}"] * tolerance >= v[f"k_{c}"]).all()
    assert ((v["dexterity"] > 0) & (v["dexterity"] <= 1)).all()


def test_additional_terms_are_included(cell, setting: MapSettings) -> None:  # type: ignore[no-untyped-def]
    beam = StiffnessTerm("link_compliance", "link:4", {"EI_Nm2": 2.0e6})
    stiffness = replace(cell.stiffness, terms=(beam,))
    soft = replace(setting, elasticity=ArmElasticity(setting.robot, setting.T_flange_tcp, stiffness))
    q = postures(20, 2)
    C = soft.elasticity.evaluate(q).compute_compliance()  # type: ignore[union-attr]
    v, bare = evaluate_quantities(soft, q).value, evaluate_quantities(setting, q).value
    np.testing.assert_allclose(v["k_y"], 1 / C[:, 1, 1], rtol=1e-9)
    np.testing.assert_allclose(v["k_min"], 1 / np.linalg.eigvalsh(C[:, :3, :3])[:, 2], rtol=1e-6)
    np.testing.assert_allclose(v["held_y"], np.linalg.inv(C)[:, 1, 1], rtol=1e-5)  # condition number of C: 1e8
    assert (v["k_min"] < bare["k_min"]).all()


def test_workpiece_frame_gives_equivalent_fields(tmp_path: Path) -> None:
    """The workpiece frame of the KR500 is rotated by 90° about z: its x axis is the y axis of the base."""
    kr500 = CELLS / "kr500_milling"
    cell = load_cell(kr500)
    common = {"length": 600.0, "collision": "none", "fixed_rotation": True, "steps": ("100",)}
    make_map(tmp_path / "w", kr500, slice="xy", at=50.0, frame="workpiece", ranges=("x=0:200", "y=0:200"), **common)
    T = invert_transform(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    elasticity = ArmElasticity(load_robot(cell), cell.tool.T_flange_tcp, cell.stiffness)
    found = [r for r in rows(tmp_path / "w" / "map.csv") if r["reason"] == "ok"]
    assert found
    for row in found:
        q = np.radians([float(row[f"q{i}_deg"]) for i in range(1, 7)])
        at = elasticity.evaluate(q[None])
        place = T @ np.array([*(float(row[f"{c}_mm"]) * 1e-3 for c in "xyz"), 1.0])
        np.testing.assert_allclose(at.state.T_base_tool[0, :3, 3], place[:3], atol=2e-7)
        k_y_base = 1e-3 / at.compute_compliance_along(np.array([[0.0, 1.0, 0.0]]))[0]
        assert float(row["k_x_N_mm"]) == pytest.approx(k_y_base, rel=1e-6)


# --- structure of the papers' figures ------------------------------------------------------------------------


def test_dexterity_has_the_two_dark_lines_of_dumas2011_figure_3b(tmp_path: Path, arm: ReachingArm) -> None:
    """Dexterity is zero on two lines: horizontal for the stretched or folded arm, oblique for the wrist centre on axis
    1.

    It is larger on either side of them.
    """
    make_map(tmp_path / "j", joints="a2,a3", q="a1=0,a4=45,a5=45,a6=45", steps=("2",), length=600.0, collision="none")
    table = rows(tmp_path / "j" / "map.csv")
    a2, a3 = np.unique([float(r["q2_deg"]) for r in table]), np.unique([float(r["q3_deg"]) for r in table])
    dexterity = np.array([float(r["dexterity"]) for r in table]).reshape(len(a2), len(a3))
    r = arm.robot
    wrist = arm.solver.centre  # type: ignore[attr-defined]
    q = np.radians(np.array([(0, x, y, 45, 45, 45) for x, y in product(a2, a3)]))
    poses = r.compute_link_poses(q)
    centre = np.einsum("mij,j->mi", poses[:, 3, :3, :3], wrist) + poses[:, 3, :3, 3]
    shoulder, elbow = (np.einsum("mij,j->mi", poses[:, i, :3, :3], r.point[i]) + poses[:, i, :3, 3] for i in (1, 2))
    upper, fore = elbow - shoulder, centre - elbow
    fold = np.cross(upper, fore)[:, 1].reshape(dexterity.shape)  # zero: arm stretched or folded
    off = centre[:, 0].reshape(dexterity.shape)  # zero: wrist centre on axis 1 (q1 = 0, all points in the xz plane)
    for signed in (fold, off):
        change = np.argwhere(np.sign(signed[:, 1:]) != np.sign(signed[:, :-1]))
        assert len(change) > 20
        near = np.minimum(dexterity[change[:, 0], change[:, 1]], dexterity[change[:, 0], change[:, 1] + 1])
        # at most one step of 2° from the line; the index increases linearly with a slope of about 1 per rad
        assert near.max() < 0.035
    assert np.ptp(a3[np.argwhere(np.sign(fold[:, 1:]) != np.sign(fold[:, :-1]))[:, 1]]) == 0.0  # horizontal
    assert np.median(dexterity) > 0.15


def test_load_influence_is_as_small_as_in_dumas2011_section_3_2(setting: MapSettings) -> None:
    """ν_p ≤ 0.016 and ν_r ≤ 0.025° for the paper's wrench, wrist at 45°;
    our cell has another tool, hence the factor 2."""
    load = MapLoad(np.array([0, 0, -2000.0, 200.0, 200.0, 0]), "frame")
    a2, a3 = np.meshgrid(np.radians(np.arange(-140, 1, 10.0)), np.radians(np.arange(-120, 156, 10.0)))
    wrist = np.broadcast_to(np.radians([45.0] * 3), (a2.size, 3))
    q = np.column_stack([np.zeros(a2.size), a2.ravel(), a3.ravel(), wrist])
    v = evaluate_quantities(replace(setting, load=load), q).value
    assert v["nu_p"].max() < 2 * 0.016
    assert np.degrees(v["nu_r"]).max() < 2 * 0.025


# --- choice of configurations -------------------------------------------------------------------------------


def test_turns_joint_by_joint_equal_all_combinations(arm: ReachingArm) -> None:
    rng = np.random.default_rng(5)
    q = rng.uniform(-np.pi, np.pi, (500, 6))
    every = q[:, None] + list_whole_turns(arm.lower, arm.upper)
    inside = ((every >= arm.lower) & (every <= arm.upper)).all(axis=2)
    placed = add_whole_turns(q, arm.lower, arm.upper, arm.home)
    np.testing.assert_array_equal(np.isfinite(placed).all(axis=1), inside.any(axis=1))
    far = np.where(inside, np.abs(every - arm.home).sum(axis=2), np.inf).min(axis=1)
    ok = inside.any(axis=1)
    np.testing.assert_allclose(np.abs(placed - arm.home).sum(axis=1)[ok], far[ok], rtol=1e-12)


def test_every_pick_equals_brute_force_over_all_configurations(arm: ReachingArm, setting: MapSettings) -> None:
    place = np.stack(np.meshgrid([0.9, 1.4, 1.9], [-0.4, 0.3], [0.4, 0.9, 1.4]), axis=-1).reshape(-1, 3)
    gamma = np.radians([10.0, 100.0, 190.0, 280.0])
    good = FIELD["k_min"]

    def goodness(q: np.ndarray) -> np.ndarray:
        return good.compute_goodness(setting.evaluate_states(q))

    poses = build_tool_poses(place, DOWN, gamma)
    found = compute_candidates(arm, poses)
    q = found.q.reshape(len(place), 4, 8, 6)
    value = np.full(q.shape[:3], np.nan)
    value[found.reason.reshape(value.shape) == 0] = goodness(q[found.reason.reshape(value.shape) == 0])
    far = np.abs(q - arm.home).max(axis=-1)
    for pick in ("best", "worst", "home", 3):
        p = choose_postures(arm, lambda s: poses[s], (len(place), 4), gamma, goodness, pick)  # type: ignore[arg-type]
        for m in range(len(place)):
            per_rotation = []
            for r in range(4):
                known = np.flatnonzero(np.isfinite(value[m, r]))
                if pick == 3:
                    known = known[known == 3]
                if len(known):
                    v = value[m, r, known]
                    per_rotation.append(
                        {"best": v.max(), "worst": v.min(), "home": v[np.argmin(far[m, r, known])]}.get(str(pick), v[0])
                    )
            assert p.ok[m] == bool(per_rotation)
            if per_rotation:  # values within 1e-6 count as equal, so the choice may be worse by that
                assert goodness(p.q[m : m + 1])[0] == pytest.approx(max(per_rotation), rel=2e-6)
        if pick == 3:
            assert set(p.branch[p.ok].tolist()) == {3}
            assert (p.reason[~p.ok] != InfeasibilityReason.OK).all()
    T = arm.robot.compute_fk(p.q[p.ok], arm.T_flange_tcp)
    np.testing.assert_allclose(T[:, :3, 3], place[p.ok], atol=1e-9)


def test_shown_configurations_are_free_and_collides_means_none_is(cell, arm: ReachingArm, setting: MapSettings) -> None:  # type: ignore[no-untyped-def]
    robot, shapes = load_chain(cell)
    alone = replace(cell, obstacles=(), workpiece=replace(cell.workpiece, geometry=()))
    model = CollisionModel(alone, robot, shapes, 0.002)

    def collides(q: np.ndarray) -> np.ndarray:
        return model.check_configurations(q, np.ones(len(q), bool)).hit

    x, z = np.meshgrid(np.arange(-1.2, 1.3, 0.2), np.arange(-0.6, 1.9, 0.25))
    place = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    gamma = np.radians([0.0, 90.0])
    poses = build_tool_poses(place, DOWN, gamma)
    size = (len(place), 2)

    def goodness(q: np.ndarray) -> np.ndarray:
        return FIELD["k_min"].compute_goodness(setting.evaluate_states(q))

    free = choose_postures(arm, lambda s: poses[s], size, gamma, goodness, "best", collides)
    blind = choose_postures(arm, lambda s: poses[s], size, gamma, goodness, "best")
    assert not collides(free.q[free.ok]).any()
    blocked = np.flatnonzero(free.reason == InfeasibilityReason.COLLIDING)
    assert len(blocked) > 3
    found = compute_candidates(arm, poses)
    q, ok = found.q.reshape(len(place), 16, 6), found.reason.reshape(len(place), 16) == 0
    for m in blocked:
        assert ok[m].any()
        assert collides(q[m, ok[m]]).all()
    both = free.ok & blind.ok
    assert (goodness(free.q[both]) <= goodness(blind.q[both]) * (1 + 2e-6)).all()
    moved = np.flatnonzero(both & (np.abs(free.q - blind.q).max(axis=1) > 1e-9))
    assert len(moved)  # some positions use their second-best configuration
    assert collides(blind.q[moved]).all()


def test_free_rotation_is_never_worse_and_its_gain_is_stated(tmp_path: Path) -> None:
    make_map(tmp_path / "m", force="0,0,-1000", rotation_step=40.0, **SMALL)
    given, free = (rows(tmp_path / "m" / name) for name in ("map.csv", "map_free.csv"))
    reached = [(a, b) for a, b in zip(given, free, strict=True) if a["reason"] == "ok"]
    assert len(reached) > 10
    for a, b in reached:
        assert float(b["deflection_mm"]) <= float(a["deflection_mm"]) * (1 + 2e-6)
        assert float(b["rotations_percent"]) >= 100 / 9 - 0.1


# --- along a line --------------------------------------------------------------------------------------------


def test_line_is_driven_without_a_jump_at_constant_rotation(arm: ReachingArm, setting: MapSettings) -> None:
    samples = build_straight_line(np.array([1.0, -0.5, 0.8]), np.array([1.9, 0.5, 0.6]), 121)
    assert samples.position is not None
    gamma = np.radians([160.0, 70.0])
    poses = build_tool_poses(samples.position, DOWN, gamma)

    def goodness(q: np.ndarray) -> np.ndarray:
        return FIELD["k_min"].compute_goodness(setting.evaluate_states(q))

    p = track_branches(arm, poses, gamma, goodness, "best")
    assert p.ok.all()
    assert np.abs(np.diff(p.q, axis=0)).max() < np.radians(3.0)
    assert len(set(p.branch.tolist())) == 1
    assert np.ptp(p.gamma) == 0.0
    T = arm.robot.compute_fk(p.q, arm.T_flange_tcp)
    rotation = int(np.argmin(np.abs(gamma - p.gamma[0])))
    np.testing.assert_allclose(T, poses[:, rotation], atol=1e-9)
    worst = track_branches(arm, poses, gamma, goodness, "worst")
    assert goodness(worst.q[worst.ok]).min() <= goodness(p.q).min()


def test_line_has_gaps_outside_the_reach_and_marks_jumps(arm: ReachingArm, setting: MapSettings) -> None:
    def goodness(q: np.ndarray) -> np.ndarray:
        return FIELD["k_min"].compute_goodness(setting.evaluate_states(q))

    samples = build_straight_line(np.array([1.8, 0.0, 0.5]), np.array([3.6, 0.0, 0.5]), 91)
    assert samples.position is not None
    p = track_branches(arm, build_tool_poses(samples.position, DOWN, np.zeros(1)), np.zeros(1), goodness, "best")
    assert p.ok[0]
    assert p.reason[-1] == InfeasibilityReason.UNREACHABLE
    assert p.shortfall[-1] > 0.3
    # joint 1 rotates by 90°
    coarse = build_tool_poses(np.array([[1.4, -1.4, 0.8], [1.4, 1.4, 0.8]]), DOWN, np.zeros(1))
    jumped = track_branches(arm, coarse, np.zeros(1), goodness, "best")
    assert jumped.reason.tolist() == [InfeasibilityReason.OK, InfeasibilityReason.NO_PATH]
    assert np.nanmin(np.abs(np.diff(compute_candidates(arm, coarse).q[:, :, 0], axis=0))) > MAX_JOINT_STEP


# --- measured stiffness --------------------------------------------------------------------------------------


def test_idw_is_exact_at_its_data_and_bounded_by_them() -> None:
    rng = np.random.default_rng(3)
    points, values, query = rng.random((15, 3)), rng.uniform(1, 5, (15, 2)), rng.uniform(-0.5, 1.5, (300, 3))
    for power, neighbours in ((2.0, None), (4.0, 5), (1.0, 1)):
        at = interpolate_idw(points, values, points, power, neighbours)
        np.testing.assert_allclose(at.value, values, rtol=1e-12)
        assert at.inside.all()
        np.testing.assert_array_equal(at.nearest, 0.0)
        away = interpolate_idw(points, values, query, power, neighbours)
        assert (away.value >= values.min(axis=0) - 1e-12).all()
        assert (away.value <= values.max(axis=0) + 1e-12).all()
    nearest = np.argmin(np.linalg.norm(query[:, None] - points, axis=2), axis=1)
    np.testing.assert_allclose(interpolate_idw(points, values, query, 2.0, 1).value, values[nearest])
    # by hand: the weights for the distances 1 and 3 with power 2 are 9 : 1
    two = interpolate_idw(np.array([[0.0, 0, 0], [4.0, 0, 0]]), np.array([[10.0], [20.0]]), np.array([[1.0, 0, 0]]))
    assert two.value[0, 0] == pytest.approx(11.0, rel=1e-14)
    twice = interpolate_idw(np.zeros((2, 3)), np.array([[1.0], [3.0]]), np.zeros((1, 3)))
    assert twice.value[0, 0] == 2.0


def test_outside_the_convex_hull_is_flagged() -> None:
    cube = np.array(list(product([0.0, 1.0], repeat=3)))
    query = np.array([[0.5, 0.5, 0.5], [1.0, 0.5, 0.5], [1.01, 0.5, 0.5], [0.9, 0.9, 2.0]])
    assert is_inside_hull(cube, query).tolist() == [True, True, False, False]
    square = cube[cube[:, 2] == 0.0]
    assert is_inside_hull(square, np.array([[0.5, 0.5, 0], [0.5, 0.5, 0.01], [1.5, 0.5, 0]])).tolist() == [
        True,
        False,
        False,
    ]
    line = np.array([[0.0, 0, 0], [1.0, 1, 0], [2.0, 2, 0]])
    assert is_inside_hull(line, np.array([[1.5, 1.5, 0], [2.5, 2.5, 0], [1.0, 1.1, 0]])).tolist() == [
        True,
        False,
        False,
    ]
    assert is_inside_hull(np.zeros((3, 3)), np.array([[0.0, 0, 0], [0.1, 0, 0]])).tolist() == [True, False]


def test_leave_one_out_predicts_each_reading_from_the_others() -> None:
    points, values = np.array([[0.0, 0, 0], [1.0, 0, 0], [3.0, 0, 0]]), np.array([[1.0], [2.0], [4.0]])
    weights = [(2 / 1 + 4 / 9) / (1 + 1 / 9), (1 / 1 + 4 / 4) / (1 + 1 / 4), (1 / 9 + 2 / 4) / (1 / 9 + 1 / 4)]
    np.testing.assert_allclose(predict_leave_one_out(points, values)[:, 0], weights, rtol=1e-12)


def joint_from_tip_stiffness(J: np.ndarray, K_e: np.ndarray) -> np.ndarray:
    """K_θ = Jᵀ K_e J, the stiffness of the tip in joint coordinates.

    For the full 6×6 stiffness of an arm with joint springs, the diagonal contains these springs. For measured
    directional stiffness only, K_e = diag(k_x, k_y, k_z, 0, 0, 0), it does not: force over displacement along an axis
    is 1/C_xx and not an entry of K, the rank is at most three, and the result is a full matrix that changes with the
    configuration. Use it for comparison only, never as joint stiffness for planning (``machopt identify`` determines
    that).

    Args:
        J: (..., 6, 6), linear part first.
        K_e: (..., 6, 6) N/m, N, N·m/rad; or (..., 3, 3) N/m for the translation alone.

    Returns:
        (..., 6, 6) N·m/rad.

    Source: tian2025 eq. 28.
    """
    rows = J[..., : np.shape(K_e)[-1], :]
    return np.asarray(np.swapaxes(rows, -1, -2) @ K_e @ rows)


def test_joint_stiffness_from_the_tcp_requires_the_whole_matrix(setting: MapSettings) -> None:
    q = postures(5, 7)
    at = setting.evaluate_states(q)
    J, k = at.state.J, at.elasticity.k
    whole = np.linalg.inv(at.compliance)
    # of 1e6 N·m/rad
    np.testing.assert_allclose(joint_from_tip_stiffness(J, whole), k[..., None] * np.eye(6), atol=1e-3)
    measured = np.stack([1.0 / at.elasticity.compute_compliance_along(at.compute_axis(c)) for c in range(3)], axis=-1)[
        ..., None
    ] * np.eye(3)
    guess = joint_from_tip_stiffness(J, measured)
    assert (np.linalg.matrix_rank(guess, tol=1e-3) <= 3).all()
    assert np.abs(np.diagonal(guess, axis1=1, axis2=2) / k - 1).max() > 0.5


def test_measured_table_is_shown_beside_the_model(tmp_path: Path, arm: ReachingArm, setting: MapSettings) -> None:
    q = postures(12, 4)
    T = arm.robot.compute_fk(q, arm.T_flange_tcp)
    v = evaluate_quantities(setting, q).value
    lines = ["label,x_mm,y_mm,z_mm," + ",".join(f"q{i}_deg" for i in range(1, 7)) + ",kx_N_mm,kz_N_mm"]
    for n in range(12):
        numbers = [*T[n, :3, 3] * 1e3, *np.degrees(q[n]), v["k_x"][n] * 1e-3, v["k_z"][n] * 1e-3]
        lines.append(f"p{n}," + ",".join(f"{x:.6f}" for x in numbers))
    table = tmp_path / "measured.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    low, high = T[:, :3, 3].min(axis=0) * 1e3, T[:, :3, 3].max(axis=0) * 1e3
    box = tuple(f"{c}={a:.0f}:{b:.0f}" for c, a, b in zip("xyz", low, high, strict=True))
    outcome = make_map(
        tmp_path / "m",
        volume=True,
        ranges=box,
        steps=("150",),
        measured=table,
        length=600.0,
        fixed_rotation=True,
        collision="none",
    )
    message = json.loads((tmp_path / "m" / "map.json").read_text(encoding="utf-8"))["measured"]
    assert message["readings"] == 12
    assert message["relative_error"]["kx"]["model_rms"] < 1e-6  # the readings are those of the model, to printed digits
    # the configurations differ: interpolation by position alone cannot predict the readings
    assert message["relative_error"]["kx"]["left_out_rms"] > 0.01
    found = rows(tmp_path / "m" / "map.csv")
    assert {r["measured_hull"] for r in found} == {"inside", "outside"}
    least, most = v["k_x"].min() * 1e-3, v["k_x"].max() * 1e-3
    assert all(least * 0.999999 <= float(r["measured_kx_N_mm"]) <= most * 1.000001 for r in found)
    assert message["samples_inside_hull"] == sum(r["measured_hull"] == "inside" for r in found)
    assert not outcome.result.to_json_types()["warnings"]
    table.write_text("\n".join([lines[0], lines[1].replace("p0,", "p0,9"), *lines[2:]]) + "\n", encoding="utf-8")
    shifted = make_map(tmp_path / "s", measured=table, fixed_rotation=True, **SMALL)
    assert any("line 2: the joints put the TCP" in w for w in shifted.result.to_json_types()["warnings"])


# --- samples -------------------------------------------------------------------------------------------------


def test_no_configuration_exceeds_the_maximum_reach(arm: ReachingArm) -> None:
    centre, radius = compute_farthest_reach(arm.robot, arm.T_flange_tcp)
    q = np.random.default_rng(1).uniform(-np.pi, np.pi, (5000, 6))
    away = np.linalg.norm(arm.robot.compute_fk(q, arm.T_flange_tcp)[:, :3, 3] - centre, axis=1)
    assert away.max() <= radius
    assert away.max() > 0.7 * radius


def test_even_steps_and_trimmed_ranges() -> None:
    np.testing.assert_allclose(build_even_values(0.0, 0.3, 0.1), [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(build_even_values(0.0, 0.35, 0.1), [0, 0.1, 0.2, 0.3])
    values = np.arange(6.0)
    assert trim_axis(values, np.array([0, 0, 1, 1, 0, 0], bool)) == (1.0, 4.0)
    assert trim_axis(values, np.zeros(6, bool)) == (0.0, 5.0)
    assert trim_axis(values, np.ones(6, bool)) == (0.0, 5.0)


@pytest.mark.proof
def test_default_range_contains_everything_reachable(tmp_path: Path) -> None:
    """A much larger slice with the same spacing contains no reachable point outside the default range."""
    common = {"steps": ("100",), "length": 600.0, "collision": "none", "rotation_step": 60.0}
    usual = make_map(tmp_path / "d", **common)
    x, z = usual.result.to_json_types()["axes"]
    make_map(tmp_path / "w", ranges=("x=-4000:4000", "z=-4000:4000"), **common)
    for r in rows(tmp_path / "w" / "map_free.csv"):
        if r["reason"] == "ok":
            assert x["from"] <= float(r["x_mm"]) <= x["to"]  # type: ignore[index]
            assert z["from"] <= float(r["z_mm"]) <= z["to"]  # type: ignore[index]


# --- the command ---------------------------------------------------------------------------------------------


def test_same_input_same_bytes(tmp_path: Path) -> None:
    requested = {
        "ranges": ("x=700:1900", "z=100:1700"),
        "steps": ("200",),
        "force": "0,0,-500",
        "rotation_step": 60.0,
        "length": 600.0,
    }
    make_map(tmp_path / "a", **requested)
    make_map(tmp_path / "b", **requested)
    names = {"map.csv", "map_free.csv", "map.json", "map.svg", "report.html", "manifest.json"}
    assert {p.name for p in (tmp_path / "a").iterdir()} == names
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_json_states_the_extremes_of_the_table(tmp_path: Path) -> None:
    make_map(tmp_path / "m", fixed_rotation=True, **SMALL)
    message = json.loads((tmp_path / "m" / "map.json").read_text(encoding="utf-8"))
    assert message["machopt_map"] == 1
    assert [a["name"] for a in message["axes"]] == ["x", "z"]
    assert message["samples"] == 25
    table = rows(tmp_path / "m" / "map.csv")
    assert len(table) == 25
    layer = message["layers"]["given"]
    assert layer["reached"] == sum(r["reason"] == "ok" for r in table)
    assert sum(layer["reasons"].values()) == 25
    for name, field in layer["fields"].items():
        known = [float(r[name]) for r in table if r[name]]
        assert field["min"] == pytest.approx(min(known), rel=1e-6)
        assert field["max"] == pytest.approx(max(known), rel=1e-6)
        row = table[field["at_max"]["sample"]]
        assert float(row[name]) == pytest.approx(field["max"], rel=1e-6)
        np.testing.assert_allclose([float(row[f"{c}_mm"]) for c in "xyz"], field["at_max"]["xyz_mm"], atol=1e-3)


def test_nothing_reached_is_exit_code_3_with_the_reach(tmp_path: Path) -> None:
    outcome = make_map(tmp_path / "far", at=9000.0, steps=("800",), length=600.0)
    assert outcome.exit_code == 3
    assert "none of" in outcome.message
    assert re.search(
        r"most are out of reach, the nearest by \d+ mm; the tool tip never gets further than \d+ mm", outcome.message
    )
    assert (tmp_path / "far" / "report.html").exists()
    beyond = make_map(tmp_path / "deg", joints="a2", ranges=("a2=20:60",), length=600.0)
    assert beyond.exit_code == 3
    assert "a2 -140 to 0" in beyond.message
    assert {r["reason"] for r in rows(tmp_path / "deg" / "map.csv")} == {"limit"}


def test_cell_without_stiffness_has_dexterity(tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(KR240, bare)
    text = (bare / "cell.yaml").read_text(encoding="utf-8")
    (bare / "cell.yaml").write_text(re.sub(r"(?m)^stiffness:.*\n", "", text), encoding="utf-8")
    outcome = make_map(tmp_path / "m", bare, fixed_rotation=True, **SMALL)
    assert "dexterity" in outcome.message
    assert any("no stiffness" in w for w in outcome.result.to_json_types()["warnings"])
    header = set(rows(tmp_path / "m" / "map.csv")[0])
    assert "dexterity" in header
    assert not any(name.startswith(("k_", "held_", "soft_")) for name in header)
    with pytest.raises(InputError, match="k_min needs a cell with stiffness; dexterity, limit_margin would work"):
        make_map(tmp_path / "n", bare, by="k_min", **SMALL)


def test_stiffness_grid_is_used_and_its_boundary_reported(tmp_path: Path) -> None:
    gridded = tmp_path / "cell"
    shutil.copytree(CELLS / "kr500_milling", gridded)
    text = (gridded / "cell.yaml").read_text(encoding="utf-8")
    text = text.replace("stiffness: stiffness.yaml", "stiffness: stiffness_two_grid.yaml")
    (gridded / "cell.yaml").write_text(text, encoding="utf-8")
    requested = {"ranges": ("x=1000:3000", "z=0:2000"), "steps": ("250",), "length": 600.0, "collision": "none"}
    outcome = make_map(tmp_path / "m", gridded, fixed_rotation=True, **requested)
    cell = load_cell(gridded)
    elasticity = ArmElasticity(load_robot(cell), cell.tool.T_flange_tcp, cell.stiffness)
    table = rows(tmp_path / "m" / "map.csv")
    assert {r["stiffness_from"] for r in table if r["reason"] == "ok"} == {"grid", "constant"}
    for row in [r for r in table if r["reason"] == "ok"][::3]:
        q = np.radians([[float(row[f"q{i}_deg"]) for i in range(1, 7)]])
        J, k, inside = elasticity.compute_jacobian(q)
        assert row["stiffness_from"] == ("grid" if inside[0] else "constant")
        assert float(row["k_x_N_mm"]) == pytest.approx(1e-3 / np.sum(J[0, 0] ** 2 / k[0]), rel=1e-6)
    assert any("lies outside the stiffness grid" in w for w in outcome.result.to_json_types()["warnings"])


def test_every_field_is_offered_where_its_inputs_exist(setting: MapSettings) -> None:
    assert list_quantities(setting) == QUANTITIES
    without = {f.key for f in QUANTITIES} - {f.key for f in list_quantities(replace(setting, load=None))}
    assert without == {"deflection", "nu_p", "nu_r"}


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"slice": "xw"}, r"--slice: found 'xw', expected xy, xz, yz"),
        ({"slice": "xz", "volume": True}, r"--slice and --volume cannot be mapped at once"),
        ({"joints": "a2,b3"}, r"--joints: no arm joint 'b3'; valid: a1, "),
        ({"joints": "a2,a2"}, r"one joint or two different ones"),
        ({"joints": "a2", "q": "1,2,3"}, r"--q: found '1,2,3', expected 6 numbers"),
        ({"q": "0,0,0,0,0,0"}, r"--q: goes with --joints"),
        ({"ranges": ("x=500:500",)}, r"--range: x from 500 to 500 is an empty range; the lower end comes first"),
        ({"ranges": ("x=900:500",)}, r"empty range"),
        ({"ranges": ("y=0:500",)}, r"the map runs over x and z"),
        ({"ranges": ("x=0",)}, r"--range: found '0', expected 2 numbers such as x=500:2500"),
        ({"ranges": ("x=0:nan",)}, r"expected 2 numbers"),
        ({"steps": ("0",)}, r"--step: a step of 0 mm; more than 0 would work"),
        ({"joints": "a2", "steps": ("-1",)}, r"a step of -1 deg"),
        ({"ranges": ("x=0:100", "z=0:900"), "steps": ("300",)}, r"leaves one sample of x, from 0 mm to 100 mm; 50 mm"),
        ({"line": "0,0,0"}, r"--line: found '0,0,0', expected start and end"),
        ({"line": "1,2,3:1,2,3"}, r"a line has a length"),
        ({"line": "0,0,0:1,0,0", "ranges": ("x=0:1",)}, r"a line has its own ends"),
        ({"at": 5.0, "volume": True}, r"--at: goes with --slice"),
        ({"tool_axis": "0,0,0"}, r"--tool-axis: the tool axis has no length"),
        ({"tool_axis": "up"}, r"--tool-axis: found 'up', expected 3 numbers"),
        ({"frame": "tool"}, r"--frame: found 'tool', expected base, world or workpiece"),
        ({"rotation_step": 0.0}, r"--rotation-step: .*1 to 180 deg would work"),
        ({"pick": "second"}, r"--pick: found 'second', expected best, worst, home or the number"),
        ({"pick": "9"}, r"--pick: found branch 9; the arm has 0 to 7"),
        ({"by": "stiffness"}, r"--by: found 'stiffness', expected one of k_min"),
        ({"by": "nu_p"}, r"--by: nu_p needs --load-N or --wrench"),
        ({"force": "0,0,0"}, r"--load-N: a load of zero bends nothing"),
        ({"force": "1,0,0", "wrench": "1,0,0,0,0,0"}, r"--load-N and --wrench are both given"),
        ({"wrench": "1,0,0"}, r"--wrench: found '1,0,0', expected 6 numbers"),
        ({"load_axes": "base"}, r"--load-axes: found 'base', expected frame or tool"),
        ({"length": -3.0}, r"--length: found -3 mm"),
        ({"collision": "all"}, r"--collision: found 'all', expected none, self or cell"),
        ({"measured": Path("nowhere.csv")}, r"nowhere.csv: no such file"),
    ],
)
def test_invalid_options_name_the_option_and_what_is_accepted(
    tmp_path: Path, asked: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        make_map(tmp_path / "m", **{"length": 600.0, **asked})
    assert not (tmp_path / "m").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x_mm,y_mm,kx_N_mm\n1,2,3\n1,2,3\n", r"column z_mm is missing; it is required with x_mm, y_mm"),
        ("kx_N_mm\n3\n4\n", r"no place: x_mm, y_mm, z_mm or q1_deg"),
        ("x_mm,y_mm,z_mm\n1,2,3\n1,2,4\n", r"no stiffness: at least one of kx_N_mm"),
        ("x_mm,y_mm,z_mm,kx_N_mm\n1,2,3,900\n", r"found one reading; two or more would work"),
        ("x_mm,y_mm,z_mm,kx_N_mm\n1,2,3,900\n1,2,3,-4\n", r"line 3, column kx_N_mm: found -4 N/mm"),
        ("x_mm,y_mm,z_mm,kx_N_mm\n1,2,3,900\n1,2,3,\n", r"line 3"),
    ],
)
def test_invalid_tables_of_measured_stiffness_are_named(tmp_path: Path, text: str, message: str) -> None:
    table = tmp_path / "measured.csv"
    table.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        make_map(tmp_path / "m", measured=table, **SMALL)


def test_power_and_neighbours_are_validated(tmp_path: Path) -> None:
    table = tmp_path / "measured.csv"
    table.write_text("x_mm,y_mm,z_mm,kx_N_mm\n1500,0,800,900\n1600,0,900,800\n", encoding="utf-8")
    with pytest.raises(InputError, match="--power: found 0, expected a power above 0"):
        make_map(tmp_path / "m", measured=table, power=0.0, **SMALL)
    with pytest.raises(InputError, match="--neighbours: found 0, expected one neighbour or more"):
        make_map(tmp_path / "m", measured=table, neighbours=0, **SMALL)


def test_too_many_samples_are_refused_with_a_valid_step(tmp_path: Path) -> None:
    requested = {"ranges": ("x=500:2500", "z=0:2000"), "length": 600.0, "collision": "none"}
    with pytest.raises(InputError, match=r"\d+ samples × 19 rotations are too many; --step ") as caught:
        make_map(tmp_path / "m", steps=("0.5",), **requested)
    step = re.search(r"--step ([\d.]+) would work \(([\d,]+) samples\)", str(caught.value))
    assert step is not None
    count = int(step[2].replace(",", ""))
    assert count == (int(2000 / float(step[1]) + 1e-9) + 1) ** 2
    assert 20_000 < count <= 100_000
    with pytest.raises(InputError, match=r"too many; --step a2=0\.\d+ --step a3=|too many; --step 0?\.\d+"):
        make_map(tmp_path / "m", joints="a2,a3", steps=("0.01",))
    with pytest.raises(InputError, match=r"samples of 1000 mm; [\d.]+ mm would work"):
        make_map(tmp_path / "m", line="1000,0,800:2000,0,800", steps=("0.0001",), length=600.0)


def test_output_folder_of_another_kind_is_not_replaced(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "notes.txt").write_text("keep", encoding="utf-8")
    with pytest.raises(InputError, match="not an earlier machopt output"):
        make_map(mine, **SMALL)
    assert (mine / "notes.txt").read_text(encoding="utf-8") == "keep"


def test_earlier_map_is_replaced_completely(tmp_path: Path) -> None:
    make_map(tmp_path / "m", **SMALL)
    assert (tmp_path / "m" / "map_free.csv").exists()
    make_map(tmp_path / "m", fixed_rotation=True, **SMALL)
    assert not (tmp_path / "m" / "map_free.csv").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["m"]


def test_discrepancies_of_the_stiffness_file_are_reported(tmp_path: Path) -> None:
    """A misfit and compliant axes in addition to the arm are reported in map.json and on the page."""
    folder = external_folder(tmp_path, rail=True)
    file = folder / "stiffness.yaml"
    file.write_text(
        file.read_text() + "external_joints: {rail: {stiffness_N_mm: 2.0e+3}}\n"
        "discrepancy: {left_mm: 0.3, noise_mm: 0.03, misfit: true, torques_Nm: [500, 500, 500, 500, 500, 500], "
        "parts: [base ry], shift: [2.0e-8], modes: [[5.0e-9]]}\n"
    )
    out = tmp_path / "out"
    requested = {"ranges": ("x=900:1200", "z=500:900"), "steps": ("300",), "collision": "none"}
    done = run_map(MapRequest(cell=folder, out=out, **requested))
    output = " ".join(done.result.warnings)
    assert "leaves 0.3 mm of the readings it comes from, 10.0 times their noise" in output
    assert "Stiffness and deflection count in, in the mean, what the readings show" in output
    assert "what rail give there counts in" in output
    assert "leaves 0.3 mm of the readings" in (out / "report.html").read_text()
    asked_for = SimpleNamespace(length=0.5, T_base_frame=np.eye(4), load=None)
    setting = build_map_settings(load_cell(folder), load_robot(load_cell(folder)), asked_for)
    assert setting.external_compliance is not None
    rigid = replace(setting, external_compliance=None)
    q = np.array([[0.2, -1.0, 1.1, 0.1, 0.8, 0.0]])
    more = setting.evaluate_states(q).translational_compliance[0] - rigid.evaluate_states(q).translational_compliance[0]
    assert np.allclose(more, np.diag([0.0, 1.0 / 2e6, 0.0]), rtol=1e-9, atol=1e-15)  # the rail moves along y
