"""Effects outside the catalogue in motions: a hose is no transmission error, and a transmission error is named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import build_motion_recording, diagnose_recording, shaken

from machopt.dynamics.rigid_body import load_dynamics
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.dynamic import motion_channels, torque_delay
from machopt.measurement.diagnosis.motion_data.motion_signals import build_motion_signals
from machopt.numerics.array_types import Array


def left_open(tmp_path: Path, added: Callable[[Array], Array], seed: int, joint: int = 0) -> DiagnosisResult:
    """Diagnose a two-joint arm without other effects, with an additional motor torque ``added(q)`` at one joint."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, seed)
    tau[:, joint] += added(q[:, joint])
    return diagnose_recording(build_motion_recording(t, q, v, tau + 0.5 * rng.normal(size=q.shape)), cell, "torque")[0]


def test_tightening_hose_is_no_gear_ripple(tmp_path: Path) -> None:
    """Slack within a third of a radian, then increasingly tight: two long-period waves fitted well enough and were
    named."""
    found = left_open(tmp_path, lambda q: 60.0 * np.sign(q) * np.maximum(np.abs(q) - 0.15, 0.0) ** 1.7, 7)
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "joint:1" in n and "a hose or a cable" in n]


def test_ripple_of_two_orders_keeps_its_name(tmp_path: Path) -> None:
    found = left_open(tmp_path, lambda q: 3.0 * np.sin(24.0 * q) + 1.5 * np.cos(57.0 * q), 8)
    assert [(f.effect, f.location) for f in found.findings] == [("transmission_error", "joint:1")]
    assert found.verdict == "explained"


def test_hose_at_joint_2_is_no_gravity_compensator(tmp_path: Path) -> None:
    """Location and angle-dependent torque are those of a compensator, which was named; slack in the middle of the
    range excludes a spring."""

    def hose(q: Array) -> Array:
        return np.asarray(12.0 * (np.maximum(q - 0.1, 0.0) ** 1.5 - np.maximum(-q - 0.2, 0.0) ** 2))

    found = left_open(tmp_path, hose, 7, joint=1)
    assert not found.findings
    assert found.verdict == "unexplained"
    assert [n for n in found.notes if "joint:2" in n]


def test_gravity_compensator_keeps_its_name(tmp_path: Path) -> None:
    def balancer(q: Array) -> Array:
        """Return the torque of a spring between two pivots, 0.2 and 1.1 m from the joint, with 0.5 kN and 2.5 kN/m."""
        s = np.sqrt(0.2**2 + 1.1**2 + 2 * 0.2 * 1.1 * np.cos(q + 2.0))
        return np.asarray((500.0 + 2500.0 * (s - 0.9)) * 0.2 * 1.1 * np.sin(q + 2.0) / s)

    found = left_open(tmp_path, balancer, 9, joint=1)
    assert [(f.effect, f.location) for f in found.findings] == [("gravity_compensator", "joint:2")]
    assert found.verdict == "explained"


@pytest.mark.parametrize(("late", "shared"), [((0,), False), ((0, 1), True)])
def test_delay_of_a_single_joint_is_no_clock_error(tmp_path: Path, late: tuple[int, ...], shared: bool) -> None:
    """A delay was fitted to the friction or balancer of that joint; used for all joints, it smoothed every reversal
    and added more error than it removed."""
    rng, cell, t, q, v, tau = shaken(tmp_path, 2, 10)
    given = tau.copy()
    given[3:, late] = tau[:-3, late]  # 30 ms
    recording = build_motion_recording(t, q, v, given + 0.5 * rng.normal(size=q.shape))
    m, dynamics = build_motion_signals(recording, 2), load_dynamics(cell)
    scene = motion_channels._build_motion_model(recording, cell, m, dynamics, dynamics.compute_torque(m.q, m.v, m.a))
    assert recording.torque is not None
    best, of_most, _ = torque_delay.estimate_torque_delay(
        scene, recording.torque[m.index], m.average_blocks(np.zeros((len(m.q), 2, 1)))
    )
    assert best == pytest.approx(0.03, abs=1e-3)
    assert of_most == shared
