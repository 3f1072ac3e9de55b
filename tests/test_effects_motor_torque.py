"""Contract of every motor torque effect, one added by one file and one line, and diagnoses with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording, diagnose_recording, shaken

from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.effects import registry
from machopt.effects.joint import drive_gain, joint_coupling
from machopt.effects.protocol import JOINTS, LawParameter, MotorLaw, MotorLoading, Quantity
from machopt.errors import InputError
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.dynamic import drive_gain_and_coupling, friction, motion_channels
from machopt.numerics.array_types import Array

LAWS = [pytest.param(e, law, id=law.name) for e in registry.select_motor_effects() for law in e.motor_laws]


def build_motor_loading(joints: int, count: int = 300) -> MotorLoading:
    t = np.arange(count)[:, None] / 100.0 + np.arange(joints)
    return MotorLoading(
        required_torque=90.0 + 40.0 * np.cos(2.0 * t),
        speed=np.sin(3.0 * t),
        acceleration=np.cos(3.0 * t),
        compute_friction_direction=np.sign,
    )


@pytest.mark.parametrize(("effect", "law"), LAWS)
def test_law_has_columns_of_its_joints_and_growing_sizes(effect: registry.Effect, law: MotorLaw) -> None:
    joints = 2 if effect.is_joint_pair else 1
    whole = build_motor_loading(joints)
    for shape in map(np.array, law.grid()):
        assert len(shape) == len(law.shape)
        columns = law.columns(shape, whole)
        assert columns.shape == (300, joints, len(law.coefficients))
        values = np.arange(1.0, len(law.coefficients) + 1.0)
        one, two = (next(iter(law.sizes(k * values, shape, whole).values())) for k in (1.0, 2.0))
        assert two.value == pytest.approx(2.0 * one.value, rel=1e-12)
        assert law.note
        assert law.equation


@pytest.mark.parametrize("forward", [True, False])
def test_joint_and_motor_torques_have_equal_power(forward: bool) -> None:
    """A motor with φ = q_j ± κ q_i and torque τ_j: the powers q̇ᵀτ (joint torques) and φ̇ᵀτ (motor torques) are
    equal."""
    whole, ratio = build_motor_loading(2), 0.4 if forward else -0.4
    F = np.array([5.0, 2.0, 0.7])
    turns = np.stack([whole.speed[:, 0], whole.speed[:, 1] + ratio * whole.speed[:, 0]], axis=1)
    joints = (
        whole.required_torque + joint_coupling.ThroughShaftCoupling(False, forward).columns(np.array([0.4]), whole) @ F
    )
    motors = whole.required_torque + joint_coupling.ThroughShaftCoupling(True, forward).columns(
        np.array([0.4]), whole
    ) @ np.append(F, 1.0)
    np.testing.assert_allclose(np.sum(joints * whole.speed, axis=1), np.sum(motors * turns, axis=1), rtol=1e-12)


@dataclass(frozen=True)
class Bent(drive_gain.DriveGainError):
    """A drive whose torque constant decreases with the current."""

    name = "saturates"
    equation = "τ recorded = τ (1 + g τ²)"
    coefficients = (LawParameter(key="cube", unit="1/(N·m)²"),)

    def columns(self, shape: Array, seen: MotorLoading) -> Array:
        return seen.required_torque[:, :, None] ** 3

    def sizes(self, values: Array, shape: Array, seen: MotorLoading) -> dict[str, Quantity]:
        return {"cube": Quantity(float(values[0]), "1/(N·m)²")}


def test_motor_torque_effect_is_added_by_one_file_and_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The effect is offered at every moving joint, in its own coordinate, with and without a common gain of the
    load."""
    toy = replace(
        registry.EFFECTS["units"], name="saturation", places=JOINTS, preferred_places=(), motor_laws=(Bent(),)
    )
    monkeypatch.setattr(registry, "EFFECTS", registry.build_registry((*registry.ALL_EFFECTS, toy)))
    cell = arm(tmp_path, 2, tool=5.0)
    t, q, v, a = build_fourier_motion(2, np.random.default_rng(1))
    tau = load_dynamics(cell).compute_torque(q, v, a)
    _, catalogue, *_ = motion_channels.build_motion_problem(
        build_motion_recording(t, q, v, tau), cell, "torque", np.random.default_rng(0)
    )
    found = [h for h in catalogue.hypotheses if h.effect == toy.name]
    assert [h.location for h in found] == ["joint:1", "joint:1", "joint:2", "joint:2"]
    assert [h.law.endswith("with the load besides") for h in found] == [False, True] * 2
    for one in found[2:]:
        column = one.columns(())[:, :, 0]
        assert not column[:, 0].any()
        assert np.abs(column[:, 1]).max() > 0.0


@pytest.mark.parametrize("share", [0.12, -0.12])
def test_wrong_drive_gain_is_named_at_its_joint(tmp_path: Path, share: float) -> None:
    """It is named neither payload, nor link mass, nor friction, because these also change the torques of other
    joints."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 11)
    tau[:, 1] *= 1.0 + share
    found = diagnose_recording(build_motion_recording(t, q, v, tau + 1.0 * rng.normal(size=q.shape)), cell, "torque")[0]
    assert [(f.effect, f.location) for f in found.findings] == [("units", "column:tau2_Nm")]
    low, high = found.findings[0].parameters["gain"].ci95
    assert low < 100.0 * share < high


def diagnose_coupled_motors(tmp_path: Path, *, by_motors: bool) -> DiagnosisResult:
    """Diagnose an arm whose motor 6 turns with half of joint 5; rigid-body and friction torques follow from power,
    not from catalogue columns."""
    rng = np.random.default_rng(13)
    cell = arm(tmp_path, 6, tool=5.0)
    t, q, v, a = build_fourier_motion(6, rng, periods=4)
    A = np.eye(6)
    A[5, 4] = 0.5
    motors = np.linalg.solve(A.T, load_dynamics(cell).compute_torque(q, v, a).T).T
    turns = v @ A.T
    motors += 6.0 * np.sign(turns) + 2.0 * turns + 0.3 * (a @ A.T)
    message = motors if by_motors else motors @ A
    return diagnose_recording(build_motion_recording(t, q, v, message + rng.normal(size=q.shape)), cell, "torque")[0]


@pytest.mark.parametrize("by_motors", [True, False])
def test_coupled_wrist_motors_are_named(tmp_path: Path, by_motors: bool) -> None:
    """Before, they were named friction and transmission error of the other joint, or were not named."""
    found = diagnose_coupled_motors(tmp_path, by_motors=by_motors)
    assert [(f.effect, f.location) for f in found.findings] == [("joint_coupling", "joint:5-6")]
    assert found.findings[0].law.endswith("torques of motors" if by_motors else "torques of joints")
    ratio = found.findings[0].parameters["ratio"]
    assert ratio.value == pytest.approx(0.5, rel=0.02)
    assert ratio.ci95[0] <= 0.5 <= ratio.ci95[1]
    assert found.verdict == "explained"


@pytest.mark.parametrize(("over", "leaps"), [(0.003, False), (None, True)])
def test_interval_of_a_gear_ratio_depends_on_the_friction_reversal(over: float | None, leaps: bool) -> None:
    """With abrupt reversals the interval is wider; it was as wide with smooth friction reversals."""
    rng, n, ratio = np.random.default_rng(2), 4000, 0.5
    t = np.arange(n) / 250.0
    speed = np.stack([np.sin(1.3 * t), np.sin(2.1 * t + 0.3)], axis=1) * (0.05, 0.04)
    v = speed[:, 1] + ratio * speed[:, 0]
    torque = (np.sign(v) if over is None else np.tanh(v / over)) + 0.01 * rng.normal(size=n)
    still = SimpleNamespace(
        rate=250.0, average_blocks=lambda x: x, subtract_period_mean=lambda x: x, q=speed, v=speed, a=0.0 * speed
    )
    scene = SimpleNamespace(motion=still, segment_start=(np.arange(n) == 0).astype(int))
    last = drive_gain_and_coupling._LastJointTorque(
        scene, (0, 1), friction.IMMEDIATE_REVERSAL, torque, np.zeros((n, 0))
    )  # type: ignore[arg-type]
    felt = MotorLoading(
        required_torque=0.0 * speed,
        speed=speed,
        acceleration=0.0 * speed,
        compute_friction_direction=last.compute_friction_direction,
    )
    law = joint_coupling.ThroughShaftCoupling(is_motor_side=False, forward=True)
    assert drive_gain_and_coupling._has_friction_jump(law, (ratio,), felt, last) == leaps


def in_amperes(recording: Recording, gains: Array) -> Recording:
    assert recording.torque is not None
    return replace(recording, torque=None, current=recording.torque / gains)


def test_currents_of_unknown_gain_are_fitted_with_all_other_parameters(tmp_path: Path) -> None:
    """Gains of 3.5 to 80 N·m/A are determined by the masses of the arm; smooth friction reversal at joint 2 is still
    found."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 12)
    gains = np.array([3.5, 80.0, 11.0])
    quiet = build_motion_recording(t, q, v, tau + rng.normal(size=q.shape))
    found, notes, _ = diagnose_recording(in_amperes(quiet, gains), cell, "torque")
    assert not found.findings
    assert found.verdict == "consistent"
    output = next(n for n in notes if "current times a gain" in n)
    values = [float(part.split(" (joint")[0].split(", ")[-1]) for part in output.split(")")[:3]]
    assert values == pytest.approx(gains, rel=0.1)
    tau[:, 1] += 6.0 * np.sign(v[:, 1]) / (1.0 + (v[:, 1] / 0.06) ** 2)
    found, *_ = diagnose_recording(
        in_amperes(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), gains), cell, "torque"
    )
    assert [(f.effect, f.location) for f in found.findings] == [("joint_friction", "joint:2")]


def test_currents_against_the_masses_are_refused(tmp_path: Path) -> None:
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 12)
    turned = in_amperes(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), np.array([3.0, 8.0, -4.0]))
    with pytest.raises(InputError, match=r"current3_A runs against.*motor_gain_Nm_per_A"):
        diagnose_recording(turned, cell, "torque")


@pytest.mark.parametrize("stuck", [0.0, 1.5])
def test_constant_current_is_refused(tmp_path: Path, stuck: float) -> None:
    """A constant current caused a division by zero, or a gain of 1e16."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 12)
    recording = in_amperes(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), np.array([3.0, 8.0, 4.0]))
    assert recording.current is not None
    recording.current[:, 2] = stuck
    with pytest.raises(InputError, match="current3_A never changes"):
        diagnose_recording(recording, cell, "torque")


def test_joint_without_gravity_torque_has_no_known_drive_gain(tmp_path: Path) -> None:
    """Its gain is unknown, so no effect of it is tested; the other joints are evaluated."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 3, 14)
    recording = in_amperes(build_motion_recording(t, q, v, tau + rng.normal(size=q.shape)), np.array([3.0, 8.0, 4.0]))
    assert recording.current is not None
    lone = recording.current.copy()
    lone[:, 2] = np.sign(v[:, 2]) + 0.1 * rng.normal(size=len(v))
    problem, catalogue, notes, _ = motion_channels.build_motion_problem(
        replace(recording, current=lone), cell, "torque", np.random.default_rng(0)
    )
    assert any("at joint 3 masses ask too little" in n for n in notes)
    assert not [h for h in catalogue.hypotheses if h.location == "joint:3"]
    assert ("joint_friction", "joint:3") in {u.name for u in catalogue.untestable}
    assert np.isfinite(problem.y).all()
