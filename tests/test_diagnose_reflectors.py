"""Measured poses of several reflectors with a tracker at any station.

Each reflector is simulated by :func:`test_diagnose_tcp_poses.measure` as a TCP at its position.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from test_diagnose_tcp_poses import arm, measure, poses

from machopt.data_types.measurements.recording import Recording, TrackerTarget
from machopt.errors import InputError
from machopt.measurement.diagnosis import diagnosis_pipeline
from machopt.measurement.diagnosis.data_quality import misplaced_reflectors
from machopt.measurement.diagnosis.data_types import reflectors_and_tracker_frames
from machopt.measurement.diagnosis.effect_columns import as_built_joint_frames
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import measured_pose_channel
from machopt.measurement.diagnosis.static.measured_pose_model import NominalPoseModel
from machopt.numerics.rigid_transforms import convert_vector_to_rotation

Array = NDArray[np.float64]
PLACES = np.array([[0.15, 0.01, 0.02], [-0.06, 0.13, 0.05], [-0.08, -0.12, 0.03]])  # m in flange
BESIDE = 1e-4 * np.array([[2.0, -3.0, 1.0], [-1.0, 2.0, 4.0], [3.0, 1.0, -2.0]])
STANDS = (
    (np.array([0.4, 2.0, -1.1]), np.array([2.5, -1.0, 0.7])),
    (np.array([-0.2, 0.3, 2.9]), np.array([-2.0, 3.0, 0.2])),
)


def simulate_three_reflectors(*, wrong: Array | None = None, noise: float = 0.0, stands: int = 2) -> Recording:
    """Simulate three reflectors at each visit, offset by BESIDE from their nominal positions; the tracker moves
    before the last session."""
    cell = arm()[0]
    tip = cell.tool.T_flange_tcp[:3, 3]
    none = np.zeros(3)
    parts = [measure(frame=(none, none, at - tip)) for at in PLACES + BESIDE]
    one = parts[0]
    N = len(one)
    order = np.arange(3 * N).reshape(3, N).T.reshape(-1)  # all reflectors of a visit in consecutive rows

    def all_of(values: Array) -> Array:
        return np.asarray(np.concatenate([values] * 3)[order])

    position = np.concatenate([r.position for r in parts if r.position is not None])[order]
    position += noise * np.random.default_rng(3).normal(size=position.shape)
    session = all_of(one.session)
    frame = np.minimum(session, stands - 1)
    for n, (turn, shift) in enumerate(STANDS[:stands]):
        rows = frame == n
        position[rows] = position[rows] @ convert_vector_to_rotation(turn).T + shift
    output = PLACES if wrong is None else PLACES + wrong
    return replace(
        one,
        q=all_of(one.q),
        pose=all_of(one.pose),
        cycle=all_of(one.cycle),
        session=session,
        line=np.arange(2, 3 * N + 2),
        time=None,
        temperature=None,
        position=position,
        targets=tuple(TrackerTarget(str(n + 1), (float(x), float(y), float(z))) for n, (x, y, z) in enumerate(output)),
        target=np.tile(np.arange(3), N),
        frame=frame,
        stated_labels=frozenset({"cycle", "pose", "session"}),
    )


def fit_first_frame(recording: Recording) -> tuple[NominalPoseModel, Array]:
    cell, robot, masses = arm()
    brought, _ = reflectors_and_tracker_frames.transform_to_base(recording, robot, cell.tool.T_flange_tcp)
    model = NominalPoseModel(brought, cell, robot, masses, frozenset())
    frame = model.fit_base()
    _, p, R = model.predict(frame)
    return model, np.concatenate([frame.target, [model.residual(frame, p, R).std(axis=0)]])


def test_tracker_stations_and_reflector_places_are_recovered() -> None:
    _, found = fit_first_frame(simulate_three_reflectors())
    np.testing.assert_allclose(found[:3], BESIDE, atol=2e-6)  # the prior of the nominal positions has almost no weight
    assert found[3].max() < 1e-6  # m: no residual remains


def test_base_and_notes_contain_every_frame_and_place() -> None:
    cell, robot, masses = arm()
    recording, output = reflectors_and_tracker_frames.transform_to_base(
        simulate_three_reflectors(), robot, cell.tool.T_flange_tcp
    )
    problem, catalogue, notes = measured_pose_channel.build_measured_pose_problem(
        recording, cell, robot, masses, np.random.default_rng(0)
    )
    names = [u.name for u in problem.unknowns if u.location in ("registration", "tool")]
    assert len(names) == len(set(names)) == 2 * 6 + 3 * 3
    assert all(u.prior is not None for u in problem.unknowns if u.location == "tool")
    assert len(output) == 2  # tracker stations
    assert any("1 by (" in n for n in notes)
    assert np.bincount(problem.visit).tolist() == [3] * 180  # the three reflectors of one visit
    assert np.bincount(problem.replicate).tolist() == [3] * 180  # each reflector at each pose, from both stations
    assert ("tool_compliance", "tool") in {(u.effect, u.location) for u in catalogue.untestable}
    assert np.abs(problem.y - problem.base @ _fit(problem)).max() < 1e-6


def _fit(problem: measured_pose_channel.DiagnosisProblem) -> Array:
    A = problem.base.reshape(-1, problem.base.shape[2])
    size = np.linalg.norm(A, axis=0)
    return np.asarray(np.linalg.lstsq(A / size, problem.y.reshape(-1), rcond=1e-12)[0] / size)


def test_three_reflectors_observe_axis_rotations_better_than_one() -> None:
    """Standard error of the rotation of each joint frame, with all joint frames fitted in addition to the base and
    with priors from maker's tolerances."""
    cell, robot, masses = arm()
    whole, _ = reflectors_and_tracker_frames.transform_to_base(
        simulate_three_reflectors(stands=1), robot, cell.tool.T_flange_tcp
    )
    assert whole.target is not None
    few = (whole.pose < 12) & (whole.session == 0)
    three, one = (
        _select_rows(whole, few),
        replace(_select_rows(whole, few & (whole.target == 0)), targets=whole.targets[:1]),
    )
    sigma = []
    for recording in (one, three):
        model = NominalPoseModel(recording, cell, robot, masses, frozenset())
        frame = model.fit_base()
        state, p, _ = model.predict(frame)
        base, unknowns = model.columns(state, p)
        readings = model.build_readings(state, frame, model.nominal)
        twists = [
            as_built_joint_frames.compute_frame_columns(readings, f"joint:{j}")
            * as_built_joint_frames.list_manufacturing_tolerances()
            for j in range(1, 7)
        ]
        A = np.concatenate([base, *twists], axis=2).reshape(3 * len(recording), -1)
        scale = np.r_[1.0 / np.linalg.norm(A[:, : len(unknowns)], axis=0), np.ones(36)]
        known = np.r_[np.full(len(unknowns), 1e-12), np.ones(36)]
        A = A * scale / 2.5e-5
        covariance = np.linalg.inv(A.T @ A + np.diag(known))[-36:, -36:]
        sigma.append(np.sqrt(np.diag(covariance)).reshape(6, 6)[:, 3:])
    observed = sigma[1] < 0.3  # better than the maker's prior
    assert np.median(sigma[0][observed] / sigma[1][observed]) > 2.5  # three times as many readings alone give 1.7
    assert (sigma[1] < 1.001 * sigma[0]).all()


def _select_rows(recording: Recording, rows: NDArray[np.bool_]) -> Recording:
    names = ("q", "pose", "cycle", "session", "line", "position", "target", "frame")
    return replace(recording, **{name: getattr(recording, name)[rows] for name in names})


def test_wrong_reflector_place_is_a_record_fault() -> None:
    cell, robot, masses = arm()
    wrong = np.zeros((3, 3))
    wrong[1] = [0.02, -0.01, 0.015]
    recording, _ = reflectors_and_tracker_frames.transform_to_base(
        simulate_three_reflectors(wrong=wrong), robot, cell.tool.T_flange_tcp
    )
    corrected, (finding,) = misplaced_reflectors.correct_misplaced_reflectors(recording, cell, robot, masses)
    assert (finding.effect, finding.location, finding.record) == ("columns", "column:target", True)
    assert "target 2" in finding.note
    np.testing.assert_allclose([finding.parameters[f"shift {a}"].value for a in "xyz"], -1e3 * wrong[1], atol=0.6)
    np.testing.assert_allclose(corrected.targets[1].place, PLACES[1], atol=6e-4)
    assert finding.after < 0.1 * finding.before


def test_exchanged_reflector_names_are_corrected() -> None:
    cell, robot, masses = arm()
    wrong = PLACES[[1, 0, 2]] - PLACES
    recording, _ = reflectors_and_tracker_frames.transform_to_base(
        simulate_three_reflectors(wrong=wrong), robot, cell.tool.T_flange_tcp
    )
    corrected, (finding,) = misplaced_reflectors.correct_misplaced_reflectors(recording, cell, robot, masses)
    assert "exchanged" in finding.note
    np.testing.assert_allclose([t.place for t in corrected.targets], PLACES)


def test_reflector_plate_rotated_as_a_whole_is_no_fault() -> None:
    cell, robot, masses = arm()
    turned = PLACES @ convert_vector_to_rotation(np.array([0.0, 0.0, 0.3])).T
    recording, _ = reflectors_and_tracker_frames.transform_to_base(
        simulate_three_reflectors(wrong=turned - PLACES), robot, cell.tool.T_flange_tcp
    )
    assert misplaced_reflectors.correct_misplaced_reflectors(recording, cell, robot, masses)[1] == []


def test_station_without_enough_points_is_refused() -> None:
    cell, robot, _ = arm()
    recording = simulate_three_reflectors()
    assert recording.frame is not None
    frame = recording.frame.copy()
    frame[:2] = 7
    with pytest.raises(InputError, match="frame 7 has 2 readings"):
        reflectors_and_tracker_frames.transform_to_base(replace(recording, frame=frame), robot, cell.tool.T_flange_tcp)


def test_single_frame_near_the_base_is_left_to_the_fit() -> None:
    cell, robot, _ = arm()
    recording = measure()
    assert reflectors_and_tracker_frames.transform_to_base(recording, robot, cell.tool.T_flange_tcp) == (recording, ())
    assert len(poses())


def test_three_poses_of_three_reflectors_are_too_few() -> None:
    """The reflector positions are refitted, too: nine readings of three poses determine them and the frame, and
    nothing else."""
    cell, _, _ = arm()
    few = simulate_three_reflectors(stands=1)
    rows = few.session == few.session[0]
    rows[np.flatnonzero(rows)[9:]] = False
    parts = {k: v[rows] for k, v in vars(few).items() if isinstance(v, np.ndarray) and len(v) == len(few)}
    with pytest.raises(InputError, match=r"9 readings of 3 coordinates in 3 poses .* refits 15 numbers"):
        diagnosis_pipeline.diagnose_static_recording(
            cell, replace(few, **parts), selection_pipeline.DiagnosisOptions(), [], accept=(), seed=0
        )
