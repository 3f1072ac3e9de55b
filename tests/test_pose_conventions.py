"""Measured poses in other conventions: quaternions, tracker axes, measured point, positions of reflectors."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from simulated_hidden_effects import CELLS, HiddenEffects, arm, plan_load_tests, solve_equilibrium

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording, StandardUncertainty, TrackerTarget
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_quality.correction_candidates import select_rows
from machopt.measurement.diagnosis.data_quality.joint_conventions import correct_joint_convention
from machopt.measurement.diagnosis.data_quality.misplaced_reflectors import correct_misplaced_reflectors
from machopt.measurement.diagnosis.data_quality.quaternion_conventions import correct_quaternion_convention
from machopt.measurement.diagnosis.data_quality.separate_sessions import correct_separate_sessions
from machopt.measurement.diagnosis.data_quality.stated_frame_and_tcp import correct_stated_frame
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import transform_to_base

CELL = "irb6700_drilling"
TURN = Rotation.from_rotvec([0.4, -0.9, 1.1])
REFLECTORS = np.array([[0.05, 0.08, 0.02], [-0.09, 0.03, 0.05], [0.02, -0.1, 0.09]])  # m from the TCP, flange axes


@cache
def load_arm() -> tuple[Cell, Robot, np.ndarray]:
    cell = load_cell(CELLS / CELL)
    return cell, load_robot(cell), cell.tool.T_flange_tcp


@cache
def poses(registration: str = "fixed", reflectors: bool = False) -> Recording:
    """Return 36 poses of an arm with joint zero errors of some hundredths of a degree, with noise of 20 µm."""
    rng = np.random.default_rng(29)
    a = arm(CELL)
    plan = plan_load_tests(a, rng, poses=36, sessions=1, loads=1, directions=1, force=1e-6)
    rows = np.flatnonzero(~plan.loaded)
    zero = np.radians([0.0, -0.04, 0.03, 0.02, 0.03, 0.0])
    p, R, _, _ = solve_equilibrium(a, HiddenEffects(a.nominal * 0.9, zero=zero), plan)
    _, _, T = load_arm()
    p, R, N = p[rows], R[rows], len(rows)
    additional = REFLECTORS if reflectors else np.zeros((1, 3))
    count = len(additional)
    position = np.concatenate([p + R @ T[:3, :3].T @ at for at in additional])
    places = T[:3, 3] + additional
    return Recording(
        kind="absolute",
        source="simulated",
        q=np.tile(plan.q[rows], (count, 1)),
        pose=np.tile(plan.pose[rows], count),
        cycle=np.arange(N * count),
        session=np.zeros(N * count, np.int64),
        line=np.arange(2, N * count + 2),
        position=position + 2e-5 * rng.standard_normal(position.shape),
        quaternion=np.tile(Rotation.from_matrix(R).as_quat()[:, [3, 0, 1, 2]], (count, 1)),
        registration=registration,  # type: ignore[arg-type]
        targets=tuple(TrackerTarget(str(n), tuple(at)) for n, at in enumerate(places)) if reflectors else (),
        target=np.repeat(np.arange(count), N) if reflectors else None,
        stated_labels=frozenset({"pose"}),
        uncertainty=StandardUncertainty(displacement=2e-5),
    )


def angle_deg(one: np.ndarray, other: np.ndarray) -> float:
    order = [1, 2, 3, 0]
    return float(
        np.degrees((Rotation.from_quat(one[:, order]) * Rotation.from_quat(other[:, order]).inv()).magnitude().max())
    )


def turn_body(q: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(q[:, [1, 2, 3, 0]]) * TURN).as_quat()[:, [3, 0, 1, 2]]


@pytest.mark.parametrize("registration", ["fit", "fixed"])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda q: q[:, [1, 2, 3, 0]], "x, y, z, w"),
        (lambda q: q * [1, -1, -1, -1], "inverse"),
        (lambda q: q[:, [1, 2, 3, 0]] * [-1, -1, -1, 1], "x, y, z, w and the inverse"),
        (turn_body, "measured body"),
    ],
)
def test_quaternion_conventions_are_identified(registration: str, change, words: str) -> None:  # type: ignore[no-untyped-def]
    _, robot, T = load_arm()
    right = poses(registration)
    assert right.quaternion is not None
    read, (finding,) = correct_quaternion_convention(replace(right, quaternion=change(right.quaternion)), robot, T)
    assert finding.location == "column:qw"
    assert words in finding.note
    assert read.quaternion is not None
    assert angle_deg(read.quaternion, right.quaternion) < 0.2
    assert correct_quaternion_convention(right, robot, T) == (right, [])


def test_tracker_frame_differs_from_base_link() -> None:
    _, robot, T = load_arm()
    right = poses()
    assert right.position is not None
    wrong = replace(right, position=TURN.apply(right.position) + np.array([1.5, -0.7, 0.3]))
    read, (finding,) = correct_stated_frame(wrong, robot, T)
    assert (finding.effect, read.registration) == ("displacement_frame", "fit")
    assert finding.parameters["angle"].value == pytest.approx(
        np.degrees(TURN.magnitude()), abs=0.2
    )  # the joint zero errors change the angle
    assert correct_stated_frame(right, robot, T) == (right, [])
    assert correct_stated_frame(wrong, robot, T, ("displacement_frame", "geometry"))[0].registration == "fixed"


@pytest.mark.parametrize("offset_mm", [(12.0, -16.0, 0.0), (-20.0, 40.0, 40.0)])
def test_displaced_tcp_is_found(offset_mm: tuple[float, float, float]) -> None:
    _, robot, T = load_arm()
    right = poses()
    assert right.quaternion is not None
    R = Rotation.from_quat(right.quaternion[:, [1, 2, 3, 0]]).as_matrix() @ T[:3, :3].T
    wrong = replace(right, position=right.position + 1e-3 * R @ np.array(offset_mm))
    read, (finding,) = correct_stated_frame(wrong, robot, T)
    assert (finding.effect, finding.location) == ("geometry", "tool")
    assert 1e3 * (np.array(read.targets[0].place) - T[:3, 3]) == pytest.approx(offset_mm, abs=1.0)


@pytest.mark.parametrize("common", [True, False])
def test_places_of_all_reflectors_are_estimated(common: bool) -> None:
    cell, robot, _ = load_arm()
    right = poses("fit", reflectors=True)
    rng = np.random.default_rng(4)
    off = np.tile([0.03, -0.04, 0.02], (3, 1)) if common else 0.04 * rng.standard_normal((3, 3))
    places = [tuple(np.array(t.place) + at) for t, at in zip(right.targets, off, strict=True)]
    wrong = replace(right, targets=tuple(TrackerTarget(str(n), at) for n, at in enumerate(places)))
    read, findings = correct_misplaced_reflectors(wrong, cell, robot, load_masses(cell))
    assert [f.location for f in findings] == ([] if common else ["column:target"])
    assert [w for w in read.warnings if "targets_mm" in w] if common else not read.warnings
    shown = 1e3 * np.array([t.place for t in read.targets])
    assert np.abs(shown - 1e3 * np.array([t.place for t in right.targets])).max() < 2.0
    assert correct_misplaced_reflectors(right, cell, robot, load_masses(cell)) == (right, [])


def test_mirrored_tracker_is_no_mirrored_arm() -> None:
    _, robot, T = load_arm()
    right = replace(poses(), quaternion=None)
    assert right.position is not None
    mirrored = replace(right, position=right.position * [1.0, -1.0, 1.0])
    assert correct_joint_convention(mirrored, robot, T) == (mirrored, [])


@pytest.mark.parametrize("cause", ["target", "frame"])
def test_session_without_common_poses_is_aligned_to_the_others(cause: str) -> None:
    cell, robot, T = load_arm()
    right = replace(poses("fit"), quaternion=None)
    assert right.position is not None
    session = (np.arange(len(right)) % 2).astype(np.int64) + 3
    later = session == 4
    right = replace(right, session=session)
    R = robot.compute_fk(right.q, T)[:, :3, :3] @ T[:3, :3].T
    move = R @ np.array([-0.004, 0.001, 0.002]) if cause == "target" else np.array([0.002, 0.003, -0.001])
    wrong = replace(right, position=right.position + np.where(later[:, None], move, 0.0))
    read, (finding,) = correct_separate_sessions(wrong, robot, load_masses(cell), T)
    assert finding.location == ("column:target" if cause == "target" else "sensor:displacement")
    assert finding.parameters["session"].value == 4
    assert read.position is not None
    assert np.linalg.norm(read.position - right.position, axis=1).max() < 3e-4
    assert correct_separate_sessions(right, robot, load_masses(cell), T) == (right, [])


@pytest.mark.parametrize("count", [1, 3])
def test_unknown_places_of_reflectors_are_estimated(count: int) -> None:
    """The stated reflector positions are 0, 0, 0 in the flange (unknown); one reflector or three."""
    cell, robot, T = load_arm()
    right = poses("fit", reflectors=True)
    assert right.target is not None
    right = replace(select_rows(right, right.target < count), targets=right.targets[:count])
    unknown = tuple(TrackerTarget(t.name, (0.0, 0.0, 0.0)) for t in right.targets)
    recording, _ = transform_to_base(replace(right, targets=unknown), robot, T)
    read, _ = correct_misplaced_reflectors(recording, cell, robot, load_masses(cell))
    shown = np.array([t.place for t in read.targets]) - [t.place for t in right.targets]
    assert 1e3 * np.abs(shown).max() < 2.0
