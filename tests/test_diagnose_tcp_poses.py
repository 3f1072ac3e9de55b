"""Measured TCP poses: base model, columns of every law, and selection of the true law.

The recordings come from an independent equilibrium (joint springs under weight, finite rotations). An effect is
simulated where it acts: in the angles, the masses or the lengths.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.effects.joint.joint_angle_errors import list_testable_orders
from machopt.errors import InputError
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.data_types.static_readings import StaticReadings
from machopt.measurement.diagnosis.effect_columns import structural_compliance
from machopt.measurement.diagnosis.effect_columns.joint_angle_errors import compute_joint_angle_range
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import measured_pose_channel
from machopt.measurement.diagnosis.static.measured_pose_hypothesis_catalogue import (
    compute_column_span,
    compute_remaining_share,
)
from machopt.numerics.rigid_transforms import convert_to_quaternion, convert_vector_to_rotation
from machopt.stiffness.terms import build_fitted_term

Array = NDArray[np.float64]
CELL = Path(__file__).resolve().parents[1] / "cells" / "irb6700_drilling"
ARCSEC = np.pi / 648000
POSES, VISITS = 60, 3
WAVE = "transmission_error"
SOFTER = np.array([1.0, 1.25, 0.85, 1.1, 0.9, 1.2])  # the true springs always differ from the cell


@cache
def arm() -> tuple[Cell, Robot, RobotMasses]:
    cell = load_cell(CELL)
    return cell, load_robot(cell), load_masses(cell)


@cache
def poses() -> Array:
    """Return joint angles (N, 6) in rad; each pose is visited VISITS times."""
    cell = arm()[0]
    rng = np.random.default_rng(5)
    low, high = cell.limits.lower[:6], cell.limits.upper[:6]
    middle, half = 0.5 * (low + high), np.minimum(0.35 * (high - low), 1.8)
    return np.asarray(np.tile(rng.uniform(middle - half, middle + half, (POSES, 6)), (VISITS, 1)))


def measure(
    *,
    delta: Callable[[Array], Array] = np.zeros_like,
    masses: RobotMasses | None = None,
    load: Array | None = None,
    grow: Array | None = None,
    noise: float = 0.0,
    six: bool = False,
    registration: str = "fit",
    frame: tuple[Array, Array, Array] | None = None,
) -> Recording:
    """Simulate tracker readings: springs under weight and load (N, 6), angles q + delta(q), links longer by grow (N,
    3)."""
    cell, robot, own = arm()
    assert cell.stiffness is not None
    carried = own if masses is None else masses
    q, c = poses(), SOFTER / cell.stiffness.joints
    shift, turn, target = frame if frame is not None else (np.zeros(3), np.zeros(3), np.zeros(3))
    T = cell.tool.T_flange_tcp.copy()
    T[:3, 3] += target
    theta = q + delta(q)
    for _ in range(12):
        state = robot.compute_state(theta, T, bodies=True)
        tau = compute_gravity_torque(robot, carried, state)[0]
        if load is not None:
            tau = tau + np.einsum("nci,nc->ni", state.J, load)
        theta = q + delta(q) + c * tau
    state = robot.compute_state(theta, T, bodies=True)
    p, R = state.T_base_tool[:, :3, 3].copy(), state.T_base_tool[:, :3, :3]
    if grow is not None:
        assert state.R_bodies is not None
        points = [*robot.point, robot.T_base_flange_zero[:3, 3]]
        for n, group in enumerate(((1,), (2,), (3, 4, 5, 6))):
            for i in group:
                p += grow[:, n : n + 1] * (state.R_bodies[:, i] @ (points[i] - points[i - 1]))
    Q = convert_vector_to_rotation(turn)
    p = p @ Q.T + shift
    rng = np.random.default_rng(11)
    p += noise * rng.normal(size=p.shape)
    turned = convert_vector_to_rotation(2 * noise * rng.normal(size=p.shape)) @ Q @ R
    N = len(q)
    return Recording(
        kind="absolute",
        source="made up",
        q=q,
        pose=np.tile(np.arange(POSES), VISITS),
        cycle=np.repeat(np.arange(VISITS), POSES),
        session=np.repeat(np.arange(VISITS), POSES),
        line=np.arange(2, N + 2),
        wrench=load,
        position=p,
        quaternion=convert_to_quaternion(turned) if six else None,
        time=np.concatenate([1e5 * v + 60.0 * np.arange(POSES) for v in range(VISITS)]),
        temperature=np.concatenate([21 + 4 * (1 - np.exp(-np.arange(POSES) / 25.0)) for _ in range(VISITS)]),
        registration="fit" if registration == "fit" else "fixed",
    )


def build(recording: Recording, **changes: object) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
    cell, robot, masses = arm()
    found = measured_pose_channel.build_measured_pose_problem(
        recording,
        replace(cell, **changes),
        robot,
        masses,
        np.random.default_rng(0),  # type: ignore[arg-type]
    )
    return found[0], found[1]


def solve_least_squares(problem: DiagnosisProblem, columns: Array | None = None) -> tuple[Array, Array]:
    """Return (coefficients, residual (N, D)) of unweighted least squares; rotations are converted to displacements
    at 0.5 m."""
    A = problem.base if columns is None else np.concatenate([problem.base, columns], axis=2)
    w = np.array([1.0] * 3 + [0.5] * 3)[: problem.dimensions]
    flat = (A * w[:, None]).reshape(-1, A.shape[2])
    size = np.linalg.norm(flat, axis=0)
    x = np.linalg.lstsq(flat / size, (problem.y * w).reshape(-1), rcond=1e-12)[0] / size
    return x, problem.y - A @ x


def only(catalogue: HypothesisCatalogue, effect: str, where: str, law: str = "") -> EffectHypothesis:
    return next(h for h in catalogue.hypotheses if h.name == (effect, where) and h.law.startswith(law))


def gains(problem: DiagnosisProblem, catalogue: HypothesisCatalogue) -> dict[tuple[str, str], float]:
    """Return the decrease of the residual sum of squares per coefficient, with the best law and shape of each name."""
    before = float(np.sum(solve_least_squares(problem)[1] ** 2))
    out: dict[tuple[str, str], float] = {}
    for h in catalogue.hypotheses:
        for shape in h.shapes:
            columns = h.columns(shape)
            after = float(np.sum(solve_least_squares(problem, columns)[1] ** 2))
            out[h.name] = max(out.get(h.name, 0.0), (before - after) / columns.shape[2])
    return out


# base model ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("six", [False, True])
def test_base_model_contains_springs_frame_and_target_exactly(six: bool) -> None:
    """Tracker 3 mm and 1 mrad off, target 2 mm off, springs a quarter softer: the first fit leaves 0.2 µm."""
    cell = arm()[0]
    assert cell.stiffness is not None
    frame = np.array([2e-3, -3e-3, 1e-3]), np.array([5e-4, -1e-3, 2e-4]), np.array([1e-3, 2e-3, -5e-4])
    problem, _ = build(measure(six=six, frame=frame))
    x, rest = solve_least_squares(problem)
    assert np.abs(rest).max() < 2e-7
    found = {u.name: v for u, v in zip(problem.unknowns, x, strict=True)}
    for j in (2, 3, 5):  # weight loads these joints; joint 1 not at all, joints 4 and 6 hardly
        assert found[f"joint {j}"] == pytest.approx(SOFTER[j - 1] / cell.stiffness.joints[j - 1], rel=2e-3)
    np.testing.assert_allclose([found[f"target {a}"] for a in "xyz"], frame[2], atol=2e-6)
    assert "joint 1" not in found
    assert [f.name for f in problem.families] == ["translation", "rotation"][: 1 + six]


def test_outliers_and_a_wrong_unit_do_not_break_the_first_fit() -> None:
    recording = measure(noise=1e-5)
    assert recording.position is not None
    bad = recording.position.copy()
    bad[::20, 0] += 0.05
    problem, _ = build(replace(recording, position=bad))
    good = np.ones(len(problem), bool)
    good[::20] = False
    clean, _ = build(recording)
    # the initial fit changed, the measured values did not
    np.testing.assert_allclose(problem.y[good], clean.y[good], atol=5e-6)
    metres, _ = build(replace(recording, position=1e-3 * recording.position))
    assert np.isfinite(metres.y).all()
    assert np.isfinite(metres.base).all()


def test_known_corrections_of_the_cell_are_applied() -> None:
    known = KinematicCorrections((KinematicCorrection("joint_zero_offset", "joint:3", {"offset_deg": 0.05}),))
    recording = measure(delta=lambda q: np.radians(0.05) * np.eye(6)[2] + 0 * q)
    assert np.abs(solve_least_squares(build(recording)[0])[1]).max() > 2e-5
    assert np.abs(solve_least_squares(build(recording, kinematics=known)[0])[1]).max() < 2e-7


def test_arrival_directions_and_replicates_are_labelled() -> None:
    N = POSES * VISITS
    load = np.zeros((N, 6))
    load[::2, 2] = -800.0  # a mass is attached at every other pose
    load[:, 0] = np.linspace(-5, 5, N)  # the sensor drifts slightly
    problem, _ = build(measure(load=load))
    assert len(np.unique(problem.visit)) == N  # one reading per visit
    np.testing.assert_array_equal(problem.replicate[:POSES], problem.replicate[POSES : 2 * POSES])
    assert len(np.unique(problem.replicate)) == POSES
    assert problem.scale is not None
    recording = measure(load=load)
    mixed = replace(recording, pose=np.repeat(np.arange(N // 2), 2))  # a pose with and without load is not a replicate
    assert (build(mixed)[0].replicate == -1).all()


def test_invalid_input_is_refused() -> None:
    cell, robot, masses = arm()
    for bad in (replace(measure(), kind="deflection"), replace(measure(), position=None)):
        with pytest.raises(InputError, match="absolute"):
            measured_pose_channel.build_measured_pose_problem(bad, cell, robot, masses, np.random.default_rng(0))


# testable effects ----------------------------------------------------------------------------------------------


def names(catalogue: HypothesisCatalogue, effect: str) -> set[str]:
    return {h.location for h in catalogue.hypotheses if h.effect == effect}


def test_directions_absorbed_by_frame_or_target_are_not_offered() -> None:
    three, six = build(measure())[1], build(measure(six=True))[1]
    fixed = build(measure(registration="fixed"))[1]
    assert names(three, "joint_zero_offset") == {f"joint:{j}" for j in (2, 3, 4, 5)}
    assert names(six, "joint_zero_offset") == {f"joint:{j}" for j in (2, 3, 4, 5, 6)}
    assert names(fixed, "joint_zero_offset") == {f"joint:{j}" for j in range(1, 7)}
    reasons = {(u.effect, u.location): u.reason for u in three.untestable}
    assert "tracker frame" in reasons["joint_zero_offset", "joint:1"]
    assert "orientations" in reasons["joint_zero_offset", "joint:6"]
    assert not names(three, "displacement_frame")
    assert names(fixed, "displacement_frame") == {"sensor:displacement"}
    for catalogue in (three, six, fixed):  # no effect is both offered and untestable
        assert not {h.name for h in catalogue.hypotheses} & {(u.effect, u.location) for u in catalogue.untestable}
    problem, _ = build(measure())
    base = compute_column_span(problem.base)
    assert all(
        compute_remaining_share(h.columns(h.shapes[0]), base) > 1e-3 for h in three.hypotheses if len(h.shapes) == 1
    )


def test_zero_offset_law_is_exact_and_a_wave_is_not() -> None:
    """An allowed model uncertainty of 6 % of the offset's gain, as for a wave, hid a payload (benchmark yard 21,
    case several05)."""
    exact = {h.effect: h.is_exact for h in build(measure())[1].hypotheses if h.family == "kinematic"}
    assert exact["joint_zero_offset"]
    assert exact["geometry"]
    assert not exact["transmission_error"]


def test_weight_is_unknown_without_masses() -> None:
    cell, robot, _ = arm()
    problem, catalogue, notes = measured_pose_channel.build_measured_pose_problem(
        measure(), cell, robot, None, np.random.default_rng(0)
    )
    missing = {u.effect for u in catalogue.untestable}
    assert {"payload", "gravity_compensator"} <= missing
    assert not names(catalogue, "link_compliance")
    # without torque no spring can be fitted
    assert [u.name for u in problem.unknowns if u.location.startswith("joint")] == []
    assert any("masses" in n for n in notes)


def test_poses_without_masses_in_a_known_frame_are_diagnosed() -> None:
    cell, robot, _ = arm()
    recording = measure(registration="fixed", noise=1e-5)
    problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(
        recording, cell, robot, None, np.random.default_rng(0)
    )
    assert problem.base.shape[2] == 0
    d = selection_pipeline.diagnose_problem(
        problem,
        replace(catalogue, hypotheses=catalogue.hypotheses[:2]),
        selection_pipeline.DiagnosisOptions(),
        np.random.default_rng(0),
    )
    assert d.verdict != "consistent"  # deflections by weight exist, but no column describes them


def test_thermal_effects_require_time_or_temperature() -> None:
    recording = replace(measure(), time=None, temperature=None)
    catalogue = build(recording)[1]
    assert not names(catalogue, "thermal_drift")
    assert "thermal_drift" in {u.effect for u in catalogue.untestable}
    assert {
        h.law.split()[-1]
        for h in build(replace(recording, time=measure().time))[1].hypotheses
        if h.effect == "thermal_drift"
    } == {"session"}


def test_wave_orders_follow_the_covered_angles() -> None:
    cell, robot, masses = arm()
    q = poses()

    def orders(angles: Array) -> tuple[float, ...]:
        state = robot.compute_state(angles, cell.tool.T_flange_tcp, bodies=True)
        none = np.zeros(len(angles), np.int64)
        r = StaticReadings(
            recording=measure(),
            robot=robot,
            T_flange_tcp=cell.tool.T_flange_tcp,
            masses=masses,
            state=state,
            wrench=np.zeros((len(angles), 6)),
            dimensions=3,
            is_difference=False,
            compliance=np.full(6, 1e-6),
            session=none,
            visit=none,
            cycle=none,
        )
        return list_testable_orders(compute_joint_angle_range(r, 3))

    many = orders(q)
    assert many[:12] == tuple(float(n) for n in range(1, 13))
    assert len(many) == POSES // 3  # one order for every three distinct angles
    few = q.copy()
    few[:, 3] = q[0, 3]
    assert orders(few) == ()
    few[:, 3] = np.linspace(0.0, np.radians(20), len(q))
    assert orders(few)[0] == 5.0  # 20° are a quarter of a wave of order 4.5


# laws ----------------------------------------------------------------------------------------------------------


def unit(joint: int) -> Array:
    return np.eye(6)[joint - 1]


def heavier(mass: float, at: Array) -> RobotMasses:
    _, robot, own = arm()
    flange = robot.T_base_flange_zero
    com = flange[:3, :3] @ at + flange[:3, 3]
    return RobotMasses(np.r_[own.body, 6], np.r_[own.mass, mass], np.vstack([own.com, com]), own.gravity)


def wave(joint: int, order: float, cos: float, sin: float) -> Callable[[Array], Array]:
    return lambda q: (
        ARCSEC * (cos * np.cos(order * q[:, joint - 1]) + sin * np.sin(order * q[:, joint - 1]))[:, None] * unit(joint)
    )


def compute_thermal_growth() -> Array:
    temperature = measure().temperature
    assert temperature is not None
    return np.asarray((temperature - 21.0)[:, None] * 1.2e-5 * np.array([1.0, 1.0, 1.0]))


Case = tuple[str, str, str, dict[str, object], tuple[float, ...], float]
CASES: list[Case] = [
    (
        "joint_zero_offset",
        "joint:3",
        "constant",
        {"delta": lambda q: np.radians(0.01) * unit(3) + 0 * q},
        (),
        np.radians(0.01),
    ),
    ("transmission_error", "joint:4", "one", {"delta": wave(4, 5.0, 12.0, 0.0)}, (5.0,), 12 * ARCSEC),
    (
        "transmission_error",
        "joint:3",
        "a wave",
        {"delta": lambda q: wave(3, 4.0, 8.0, 0.0)(q) + wave(3, 8.0, 3.0, 4.0)(q)},
        (4.0, 8.0),
        8 * ARCSEC,
    ),
    ("joint_coupling", "joint:4-5", "gears", {"delta": lambda q: 6e-5 * q[:, 3:4] * unit(5)}, (), 6e-5),
    ("joint_coupling", "joint:5-6", "gears", {"delta": lambda q: 2e-4 * q[:, 4:5] * unit(6), "six": True}, (), 2e-4),
    ("payload", "tool", "another mass at another", {"masses": "heavier"}, (), 8.0),
    ("thermal_drift", "environment", "the arm grows with", {"grow": "warmed"}, (), 1.2e-5),
]


@pytest.mark.parametrize("case", CASES, ids=[f"{c[0]}@{c[1]}" for c in CASES])
def test_true_law_is_found_with_its_size(case: Case) -> None:
    """The columns of the true law reduce the mismatch to a few percent and give the correct size; no other law gains
    as much."""
    effect, where, law, put, shape, size = case
    put = dict(put)
    if "masses" in put:
        put["masses"] = heavier(8.0, np.array([0.02, 0.0, 0.15]))
    if "grow" in put:
        put["grow"] = compute_thermal_growth()
    problem, catalogue = build(measure(**put))  # type: ignore[arg-type]
    base = solve_least_squares(problem)[1]
    h = only(catalogue, effect, where, law)
    x, rest = solve_least_squares(problem, h.columns(shape))
    own = x[problem.base.shape[2] :]
    # springs of the first fit absorb part of a payload: a few percent
    most, close = (0.1, 0.1) if effect == "payload" else (0.03, 0.02)
    assert np.sum(rest[:, :3] ** 2) < most**2 * np.sum(base[:, :3] ** 2)
    assert own[0] == pytest.approx(size, rel=close)
    ranking = gains(problem, catalogue)
    assert max(ranking, key=lambda name: ranking[name]) == (effect, where)
    quantities = h.quantities(own, shape)
    first = next(iter(quantities.values()))
    double = next(iter(h.quantities(2 * own, shape).values()))
    assert double.value == pytest.approx(2 * first.value)  # detection limits are given in this quantity


def test_fine_gear_order_is_found_where_nothing_else_explains_the_residual() -> None:
    """60 angles allow 20 orders to be tested in noise; the order of a gear tooth is higher and was left unexplained."""
    problem, catalogue = build(measure(delta=wave(3, 37.0, 30.0, 0.0), noise=2e-5))

    def diagnosed(offered: HypothesisCatalogue) -> DiagnosisResult:
        return selection_pipeline.diagnose_problem(
            problem, offered, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
        )

    assert all(max(s[-1] for s in h.shapes if s) < 37.0 for h in catalogue.hypotheses if h.name[0] == WAVE and h.shapes)
    assert diagnosed(replace(catalogue, extended_hypotheses=())).verdict == "unexplained"
    found = diagnosed(catalogue)
    assert [(f.effect, f.location) for f in found.findings] == [(WAVE, "joint:3")]
    assert found.verdict == "explained"
    assert found.findings[0].parameters["order"].value == pytest.approx(37.0, abs=0.2)
    assert found.findings[0].parameters["amplitude"].value == pytest.approx(30.0, rel=0.1)


def test_written_findings_compensate_the_planted_effect() -> None:
    """The correction of a finding, in the kinematics of the cell, removes the mismatch."""
    delta = wave(5, 3.0, 9.0, -4.0)
    problem, catalogue = build(measure(delta=delta))
    h = only(catalogue, "transmission_error", "joint:5", "one")
    x, _ = solve_least_squares(problem, h.columns((3.0,)))
    found = h.correction(x[problem.base.shape[2] :], (3.0,))
    assert isinstance(found, KinematicCorrection)
    assert found.parameters["per_turn"] == 3.0
    assert found.parameters["cos_arcsec"] == pytest.approx(9.0, rel=0.01)
    assert found.parameters["sin_arcsec"] == pytest.approx(-4.0, rel=0.02)
    known = KinematicCorrections((KinematicCorrection(found.effect, found.location, found.parameters),))
    before = np.abs(solve_least_squares(problem)[1]).max()
    assert np.abs(solve_least_squares(build(measure(delta=delta), kinematics=known)[0])[1]).max() < 0.02 * before


def test_compensator_deflects_joint_2_by_its_angle() -> None:
    """A spring between two pivots, simulated from its geometry: no other law with at most two coefficients has a
    smaller residual."""
    cell = arm()[0]
    assert cell.stiffness is not None
    c = SOFTER[1] / cell.stiffness.joints[1]
    a, L, alpha, rate, preload = 0.25, 0.9, 2.2, 4e4, 2e3

    def delta(q: Array) -> Array:
        s = np.sqrt(a**2 + L**2 + 2 * a * L * np.cos(alpha + q[:, 1]))
        torque = (preload + rate * (s - 0.6)) * a * L * np.sin(alpha + q[:, 1]) / s  # −F ds/dq
        return np.asarray((c * torque)[:, None] * unit(2))

    problem, catalogue = build(measure(delta=delta))
    rest = {
        (h.name, h.law): min(float(np.sum(solve_least_squares(problem, h.columns(s))[1] ** 2)) for s in h.shapes)
        for h in catalogue.hypotheses
        if h.columns(h.shapes[0]).shape[2] <= 2
    }
    best = min(rest, key=lambda name: rest[name])
    assert best == (("gravity_compensator", "joint:2"), "spring between two pivots")
    assert rest[best] < 0.02 * np.sum(solve_least_squares(problem)[1] ** 2)


# weight on bodies ----------------------------------------------------------------------------------------------


def test_plate_on_uneven_bolts_is_a_base_not_a_tracker_frame() -> None:
    """The plate sinks and tilts under a constant weight, like a rigid frame; a frame was named as a second effect."""
    problem, catalogue = build(measure(noise=2e-5, registration="fixed"))
    plate = only(catalogue, "base_compliance", "base", "tilts and sinks")
    C = 1e-9 * np.array([4.5, 4.0, -3.0, 20.0, -2.0, 28.0])  # m/N, 1/N, rad/(N·m)
    problem = replace(problem, y=problem.y + plate.columns(()) @ C)
    found = selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )
    assert [(f.effect, f.law) for f in found.findings] == [("base_compliance", "tilts and sinks")]
    assert found.verdict == "explained"
    size = found.findings[0].parameters["tilt_compliance"]
    assert size.ci95[0] < 28e-9 < size.ci95[1]


def test_sinking_plate_is_not_offered_with_a_fitted_tracker_frame() -> None:
    laws = {h.law for h in build(measure())[1].hypotheses if h.effect == "base_compliance"}
    assert "tilts" in laws
    assert "tilts and sinks" not in laws


def readings(masses: RobotMasses | None, load: Array, q: Array) -> StaticReadings:
    cell, robot, _ = arm()
    T = cell.tool.T_flange_tcp
    none = np.zeros(len(q), np.int64)
    return StaticReadings(
        recording=measure(),
        robot=robot,
        T_flange_tcp=T,
        masses=masses,
        state=robot.compute_state(q, T, bodies=True),
        wrench=load,
        dimensions=6,
        is_difference=False,
        compliance=np.full(6, 1e-6),
        session=none,
        visit=none,
        cycle=none,
    )


@pytest.mark.parametrize("link", [2, 4])
def test_beam_under_load_equals_the_term_of_stiffness_yaml(link: int) -> None:
    q = poses()[:8]
    load = np.random.default_rng(1).normal(size=(8, 6)) * np.array([500, 500, 500, 80, 80, 80.0])
    r = readings(None, load, q)
    h = next(
        h
        for h in structural_compliance.build_structure_hypotheses(r)
        if h.name == ("link_compliance", f"link:{link}") and h.law == "bends"
    )
    term = build_fitted_term("link_compliance", f"link:{link}", r.robot, r.T_flange_tcp)
    expected = term.compute_response(r.state, load)[:, :, 0]
    np.testing.assert_allclose(h.columns(())[:, :, 0], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    both = next(
        h
        for h in structural_compliance.build_structure_hypotheses(r)
        if h.location == f"link:{link}" and h.law.startswith("bends in two")
    )
    x = np.array([2e-7, 5e-8, 1e-7])  # the matrix in stiffness.yaml gives the same displacement as the columns
    written = both.correction(x, ())
    assert written is not None
    spring = build_fitted_term(written.effect, written.location, r.robot, r.T_flange_tcp, **dict(written.parameters))
    d = spring.compute_response(r.state, load) @ spring.values
    np.testing.assert_allclose(both.columns(()) @ x, d, rtol=1e-9, atol=1e-12 * np.abs(d).max())


def test_link_under_its_own_weight_deflects_as_a_beam() -> None:
    """w L⁴/8EI and w L³/6EI at the end of the horizontal forearm, transformed to the TCP."""
    _, robot, own = arm()
    start, end = robot.point[3], robot.point[4]
    L = float(np.linalg.norm(end - start))
    g = own.gravity
    alone = RobotMasses(np.array([4]), np.array([60.0]), (0.5 * (start + end))[None], g)
    r = readings(alone, np.zeros((1, 6)), np.zeros((1, 6)))  # with all joints at zero the forearm lies along x
    h = next(
        h
        for h in structural_compliance.build_structure_hypotheses(r)
        if h.name == ("link_compliance", "link:4") and h.law == "bends"
    )
    w = 60.0 * 9.80665 / L
    column = h.columns(())[0, :, 0]
    turn = w * L**3 / 6  # about y, nose down
    beyond = r.state.T_base_tool[0, :3, 3] - end
    sag = np.array([0.0, 0.0, -w * L**4 / 8]) + np.cross([0.0, turn, 0.0], beyond)
    np.testing.assert_allclose(column, [*sag, 0.0, turn, 0.0], rtol=1e-9, atol=1e-9)


def test_weight_wrenches_give_the_gravity_torque() -> None:
    """The wrench of all bodies after joint i, multiplied by J_i, equals the torque of gravity.py."""
    _, robot, masses = arm()
    r = readings(masses, np.zeros((8, 6)), poses()[:8])
    torque = compute_gravity_torque(robot, masses, r.state)[0]
    for i in range(6):
        w = structural_compliance.compute_weight_wrench(r, masses.body > i)
        np.testing.assert_allclose(np.einsum("nc,nc->n", r.state.J[:, :, i], w), torque[:, i], atol=1e-8)


def test_orientations_are_in_base_axes() -> None:
    """Six coordinates, fixed registration: a tracker rotated by 1 mrad about base z gives (0, 0, 1) mrad in addition
    to the springs."""
    recording = measure(six=True, registration="fixed", frame=(np.zeros(3), np.array([0, 0, 1e-3]), np.zeros(3)))
    problem, catalogue = build(recording)
    h = only(catalogue, "displacement_frame", "sensor:displacement")
    x, rest = solve_least_squares(problem, h.columns(()))
    np.testing.assert_allclose(x[problem.base.shape[2] + 3 :], [0.0, 0.0, 1e-3], atol=2e-6)  # remainder: 1 mrad squared
    assert np.abs(rest).max() < 3e-6  # m, 1 mrad² over 2 m
    assert dict(h.quantities(x[problem.base.shape[2] :], ()))["angle"].value == pytest.approx(
        np.degrees(1e-3), rel=5e-3
    )


def test_relinearised_equations_are_exact_to_the_micrometre() -> None:
    """Offsets of 1 mrad change the deflection by weight (1 in 50 at joint 2) and rotate the other axes; laws
    linearized at zero neglect this."""
    true = np.radians([0.0, 0.06, -0.05, 0.04, 0.06, 0.0])
    recording = measure(delta=lambda q: np.broadcast_to(true, q.shape), registration="fixed")
    found = tuple(
        KinematicCorrection("joint_zero_offset", f"joint:{j + 1}", {"offset_deg": float(np.degrees(true[j]))})
        for j in (1, 2, 3, 4)
    )

    def left_by_the_truth(about: tuple[KinematicCorrection, ...]) -> float:
        problem, catalogue, _ = measured_pose_channel.build_measured_pose_problem(
            recording, *arm(), np.random.default_rng(0), about=about
        )
        laws = {h.location: h for h in catalogue.hypotheses if h.effect == "joint_zero_offset"}
        y = problem.y - sum(laws[f"joint:{j + 1}"].columns(())[:, :, 0] * true[j] for j in (1, 2, 3, 4))
        A = problem.base.reshape(y.size, -1)
        x = np.linalg.lstsq(A / np.linalg.norm(A, axis=0), y.reshape(-1), rcond=None)[0]
        return float(np.abs(y.reshape(-1) - (A / np.linalg.norm(A, axis=0)) @ x).max())

    assert left_by_the_truth(()) > 5e-6
    assert left_by_the_truth(found) < 1e-6  # remaining curvature of the springs


def test_found_geometry_enters_as_its_columns_state() -> None:
    """Without noise or error: the model linearized about a frame error that does not exist differs by this frame
    error, to second order."""
    recording = measure(registration="fixed")
    twist = {"shift_mm": [0.3, -0.2, 0.4], "turn_mrad": [0.4, 0.3, -0.5]}
    build = [
        measured_pose_channel.build_measured_pose_problem(recording, *arm(), np.random.default_rng(0), about=about)[0]
        for about in ((), (KinematicCorrection("geometry", "joint:3", twist),))
    ]
    y = build[1].y - build[0].y
    A = np.concatenate([b.base.reshape(y.size, -1) for b in build], axis=1)
    A = A / np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A, y.reshape(-1), rcond=None)[0]
    assert float(np.abs(y.reshape(-1) - A @ x).max()) < 3e-5  # 0.7 mrad at 3 m would be 2 mm
