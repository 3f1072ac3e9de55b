"""Load tests of a simulated arm with known effects, independent of the catalogue."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from diagnosis_in_memory import diagnose_in_memory
from simulated_hidden_effects import (
    ARCMIN,
    CELLS,
    HiddenEffects,
    NoiseLevels,
    arm,
    build_iwan_law,
    build_rough_backlash,
    compute_displacements,
    compute_unmodelled_rms,
    load_tests,
    plan_load_tests,
    sine_knee,
    solve_equilibrium,
)

from machopt.cell.cell_reader import load_cell
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.static import load_test_channel
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.stiffness.arm_stiffness import ArmElasticity

FORCES = {"kr240_drilling": 1500.0, "kr500_milling": 2500.0, "irb6700_drilling": 300.0, "cutting_cobot": 60.0}
FEW = {"poses": 14, "sessions": 2, "loads": 3, "directions": 2}
DEFAULT_NOISE = NoiseLevels()


def simulate_load_test(
    cell: str, seed: int, truth=None, *, rotations=False, frame="base", dirt=DEFAULT_NOISE, **design
):
    """Simulate a recording with joint stiffnesses 0.75 to 1.3 times those of the cell."""
    rng = np.random.default_rng([11, seed])
    a = arm(cell)
    k = a.nominal * rng.uniform(0.75, 1.3, 6)
    plan = plan_load_tests(a, rng, **(FEW | {"force": FORCES[cell]} | design))
    made_up = HiddenEffects(k) if truth is None else truth(a, k, plan)
    return load_tests(a, made_up, plan, rng, dirt, rotations=rotations, frame=frame), made_up, plan


def diagnose_recording(tmp_path: Path, cell: str, recording: Recording):
    return diagnose_in_memory(CELLS / cell, recording, tmp_path / "recording").diagnosis


def names(d) -> list[tuple[str, str]]:
    """Return the findings except K_C, which these arms really have."""
    return [(f.effect, f.location) for f in d.findings if f.effect != "geometric_stiffness"]


@cache
def model(cell: str):
    found = load_cell(CELLS / cell)
    return load_robot(found), found.tool.T_flange_tcp, load_masses(found)


@pytest.mark.parametrize("cell", sorted(FORCES))
def test_simulator_agrees_with_forward_kinematics(cell: str) -> None:
    a, rng = arm(cell), np.random.default_rng(1)
    plan = plan_load_tests(a, rng, poses=5, force=FORCES[cell], moment=10.0)
    p, R, J, tau = solve_equilibrium(a, HiddenEffects(np.full(6, 1e15)), plan)  # rigid
    robot, T, masses = model(cell)
    state = robot.compute_state(plan.q, T, bodies=True)
    assert np.abs(state.T_base_tool[:, :3, 3] - p).max() < 1e-9
    assert np.abs(state.T_base_tool[:, :3, :3] - R).max() < 1e-9
    assert np.abs(state.J - J).max() < 1e-9
    load = np.einsum("nci,nc->ni", state.J, plan.wrench)
    # N·m, of torques of thousands
    assert np.abs(compute_gravity_torque(robot, masses, state)[0] + load - tau).max() < 1e-6


# no effect --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "seed", "rotations", "frame"),
    [
        ("kr240_drilling", 1, False, "tool"),
        ("kr500_milling", 2, True, "base"),
        ("cutting_cobot", 4, True, "tool"),  # fourth cell: see test_nothing_is_named_without_labels
    ],
)
def test_nothing_is_named_in_an_intact_arm(tmp_path: Path, cell: str, seed: int, rotations: bool, frame: str) -> None:
    recording, _, _ = simulate_load_test(cell, seed, rotations=rotations, frame=frame)
    d = diagnose_recording(tmp_path, cell, recording)
    assert names(d) == []
    assert d.verdict == ("explained" if d.findings else "consistent")
    # seven unknowns from fourteen poses increase the error by a few per cent
    assert d.heldout_after < 1.15 * d.noise_floor


@pytest.mark.parametrize("left_out", [("session",), ("pose", "cycle", "session")])
def test_nothing_is_named_without_labels(tmp_path: Path, left_out: tuple[str, ...]) -> None:
    recording, _, _ = simulate_load_test("irb6700_drilling", 5)
    N = len(recording)
    plain = {"session": np.zeros(N, np.int64), "cycle": np.arange(N), "pose": recording.pose}
    changed = {k: plain[k] for k in left_out}
    recording = replace(
        recording, **changed, stated_labels=recording.stated_labels - set(left_out), time=None, branch=None
    )
    d = diagnose_recording(tmp_path, "irb6700_drilling", recording)
    assert (names(d), d.verdict) == ([], "consistent")


def test_sagging_arm_is_no_rotated_sensor(tmp_path: Path) -> None:
    """Weight rotates the tool by milliradians relative to the encoder pose; a wrench in tool axes rotates with it."""
    cell = "kr240_drilling"
    recording, truth, plan = simulate_load_test(
        cell, 6, frame="tool", poses=24, dirt=NoiseLevels(4e-6, 2e-6, 3e-6, 1e-3, 1e-3, 0.0)
    )
    _, sagged, _, _ = solve_equilibrium(arm(cell), HiddenEffects(truth.stiffness), plan)
    _, straight, _, _ = solve_equilibrium(arm(cell), HiddenEffects(np.full(6, 1e15)), plan)
    turn = np.linalg.norm(sagged - straight, axis=(1, 2)) / np.sqrt(2)
    assert np.median(turn) > 3e-3  # rad; otherwise the test has no effect to detect
    d = diagnose_recording(tmp_path, cell, recording)
    assert [n for n in names(d) if n[1].startswith("sensor")] == []


# one effect ----------------------------------------------------------------------------------------------------


def _largest(a, k, plan, joint: int) -> float:
    return float(np.abs(solve_equilibrium(a, HiddenEffects(k), plan)[3][:, joint]).max())


SINGLE = [
    (
        "kr240_drilling",
        "joint_nonlinear_stiffness",
        "joint:4",
        lambda a, k, p: HiddenEffects(k, {3: sine_knee(1.2 / k[3], 0.45 * _largest(a, k, p, 3))}),
        False,
    ),
    (
        "kr500_milling",
        "joint_backlash",
        "joint:1",
        lambda a, k, p: HiddenEffects(k, {0: build_rough_backlash(0.35 * ARCMIN, 0.02 * _largest(a, k, p, 0))}),
        False,
    ),
    (
        "irb6700_drilling",
        "link_compliance",
        "link:2",
        lambda a, k, p: HiddenEffects(k, hinges={2: np.diag([1.0, 0.8, 1.2]) * 0.9 / k[1]}),
        True,
    ),
    (
        "kr240_drilling",
        "base_compliance",
        "base",
        lambda a, k, p: HiddenEffects(k, hinges={0: np.diag([1.0, 1.3, 0.3]) * 0.04 / k[1]}),
        False,
    ),
    (
        "kr500_milling",
        "joint_coupling",
        "joint:4-5",
        lambda a, k, p: HiddenEffects(k, coupled=_pair(0.07 / k[4])),
        False,
    ),
    (
        "irb6700_drilling",
        "load_geometry",
        "sensor:force",
        lambda a, k, p: HiddenEffects(k, hook=np.array([0.03, -0.02, 0.0])),
        False,
    ),
]


def _pair(c: float) -> np.ndarray:
    out = np.zeros((6, 6))
    out[3, 4] = out[4, 3] = c
    return out


@pytest.mark.parametrize(
    ("cell", "effect", "where", "truth", "rotations"), SINGLE, ids=lambda v: v if isinstance(v, str) else ""
)
def test_single_effect_is_named_at_its_place(
    tmp_path: Path, cell: str, effect: str, where: str, truth, rotations: bool
) -> None:
    recording, made_up, plan = simulate_load_test(cell, 20, truth, rotations=rotations, poses=18, loads=4)
    assert (
        compute_unmodelled_rms(arm(cell), made_up, plan) > 12e-6
    )  # m, residual of an ideal refit: the effect is detectable
    d = diagnose_recording(tmp_path, cell, recording)
    assert names(d)[0] == (effect, where)
    f = next(x for x in d.findings if x.effect == effect)
    assert f.one_of[0] == (effect, where)
    assert f.after < 0.9 * f.before
    assert d.verdict == "explained"
    assert d.heldout_after < 1.15 * d.noise_floor


@pytest.mark.slow
def test_backlash_width_lies_in_its_interval(tmp_path: Path) -> None:
    width = 0.4
    recording, _, _ = simulate_load_test(
        "kr500_milling",
        31,
        lambda a, k, p: HiddenEffects(k, {0: build_rough_backlash(width * ARCMIN, 0.01 * _largest(a, k, p, 0))}),
        poses=20,
    )
    d = diagnose_recording(tmp_path, "kr500_milling", recording)
    found = next(f for f in d.findings if f.effect == "joint_backlash").parameters["width"]
    assert found.unit == "arcmin"
    assert found.ci95[0] <= width <= found.ci95[1]
    assert found.value == pytest.approx(width, rel=0.2)


@pytest.mark.slow
def test_hysteresis_is_found(tmp_path: Path) -> None:
    """Iwan elements under the torque of the load only: joint 1 carries no weight."""
    cell = "irb6700_drilling"
    recording, _, _ = simulate_load_test(
        cell,
        33,
        lambda a, k, p: HiddenEffects(k, {0: build_iwan_law(0.6 / k[0], 0.7 * _largest(a, k, p, 0))}),
        poses=18,
        loads=5,
    )
    d = diagnose_recording(tmp_path, cell, recording)
    assert names(d)[0] == ("joint_hysteresis", "joint:1")


def test_effect_outside_the_catalogue_is_a_mismatch(tmp_path: Path) -> None:
    """A gear whose stiffness depends on the angle of another joint: no law of the catalogue describes it."""

    def truth(a, k, plan):
        side = np.tanh(4.0 * plan.q[:, 3])
        return HiddenEffects(k, {0: lambda tau, q, time: 0.5 / k[0] * tau * side})

    recording, _, _ = simulate_load_test("kr240_drilling", 35, truth, poses=20)
    d = diagnose_recording(tmp_path, "kr240_drilling", recording)
    assert d.verdict in ("unexplained", "partly_explained")
    assert d.repeatable > d.noise_floor
    assert d.next_experiment


@pytest.mark.slow
def test_two_effects_are_both_named(tmp_path: Path) -> None:
    def truth(a, k, plan):
        knee = sine_knee(1.4 / k[3], 0.4 * _largest(a, k, plan, 3))
        return HiddenEffects(k, {3: knee}, hinges={0: np.diag([1.0, 1.3, 0.3]) * 0.06 / k[1]})

    recording, _, _ = simulate_load_test("kr240_drilling", 36, truth, poses=20, loads=4)
    d = diagnose_recording(tmp_path, "kr240_drilling", recording)
    assert set(names(d)) == {("joint_nonlinear_stiffness", "joint:4"), ("base_compliance", "base")}


def test_refitted_springs_equal_the_true_ones(tmp_path: Path) -> None:
    cell = "kr240_drilling"
    recording, truth, _ = simulate_load_test(cell, 37, dirt=NoiseLevels(gain_session=0.0, gain_cycle=0.0))
    d = diagnose_recording(tmp_path, cell, recording)
    for c, k in zip([c for c in d.coefficients if c.unknown.name.startswith("joint ")], truth.stiffness, strict=True):
        # sigma does not include the common gain error of all forces
        assert abs(c.value - 1.0 / k) < 4.0 * c.sigma + 0.02 / k


def test_displacements_equal_springs_in_series() -> None:
    """A hinge with compliance C between base and arm moves the TCP by G C Gᵀ w, to first order."""
    a = arm("kr240_drilling")
    plan = plan_load_tests(a, np.random.default_rng(2), poses=3, sessions=1, force=10.0)
    k = np.full(6, 1e16)
    C = np.diag([1e-9, 2e-9, 3e-9])
    d = compute_displacements(a, HiddenEffects(k, hinges={0: C}), plan)
    p, _, _, _ = solve_equilibrium(a, HiddenEffects(k), plan)
    p, f = p[plan.loaded], plan.wrench[plan.loaded, :3]
    want = np.cross(np.cross(p, f) @ C, p)
    assert np.abs(d - want).max() < 1e-4 * np.abs(want).max()  # weight rotates with the hinge: a relative error of 1e-5


def test_sensor_errors_act_through_springs_and_bodies() -> None:
    recording, truth, _ = simulate_load_test("irb6700_drilling", 31, rotations=True)
    robot, T, masses = model("irb6700_drilling")
    tests = build_load_test_experiment(recording, robot, T)
    soft = StiffnessTerm(
        "base_compliance", "base", {"compliance": np.diag([1e-9, 1e-9, 1e-9, 2e-8, 3e-8, 1e-8]).tolist()}
    )
    bodies = load_test_channel.compute_body_compliance(robot, T, recording.q, [soft])
    r = replace(
        load_test_channel.build_load_test_readings(recording, tests, robot, T, masses, 1.0 / truth.stiffness),
        bodies=bodies,
    )
    w = np.random.default_rng(2).normal(size=(len(recording), 6))
    whole = (
        ArmElasticity(robot, T, ArmStiffness(joints=truth.stiffness, terms=(soft,)))
        .evaluate(recording.q)
        .compute_twist(w)
    )
    assert r.compute_displacement(w) == pytest.approx(whole, rel=1e-9, abs=1e-15)
    assert load_test_channel.compute_body_compliance(robot, T, recording.q, []) is None
