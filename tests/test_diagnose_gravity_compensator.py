"""Gravity compensator and transmission error wave are distinguished over a limited joint range."""

from __future__ import annotations

import numpy as np
import pytest
import test_diagnose_tcp_poses as absolute
from numpy.typing import NDArray

from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.model_selection import selection_pipeline

Array = NDArray[np.float64]
PLACE, WAVE, BALANCER = "joint:2", "transmission_error", "gravity_compensator"
SMALL = np.radians(20.0)  # range to either side of the middle


@pytest.fixture(autouse=True)
def _turns_little(monkeypatch: pytest.MonkeyPatch) -> None:
    q = absolute.poses().copy()
    middle = 0.5 * (q[:, 1].min() + q[:, 1].max())
    q[:, 1] = middle + SMALL * (q[:, 1] - middle) / np.abs(q[:, 1] - middle).max()
    monkeypatch.setattr(absolute, "poses", lambda: q)


def spring(q: Array) -> Array:
    """Return the deflection of joint 2 by a spring between two pivots, with its dead centre within the poses, at the
    joint angle deflected by weight."""
    cell, robot, masses = absolute.arm()
    assert cell.stiffness is not None
    soft = absolute.SOFTER / cell.stiffness.joints
    q = q + soft * compute_gravity_torque(robot, masses, robot.compute_state(q, cell.tool.T_flange_tcp, bodies=True))[0]
    c = soft[1]
    a, L, rest, rate, preload = 0.25, 0.55, 0.45, 2.4e4, 1e3
    angle = q[:, 1] - float(np.median(absolute.poses()[:, 1])) + 0.15
    s = np.sqrt(a**2 + L**2 - 2 * a * L * np.cos(angle))
    torque = -(preload + rate * (s - rest)) * a * L * np.sin(angle) / s
    return np.asarray((c * torque)[:, None] * absolute.unit(2))


def diagnose_angles(delta: object) -> DiagnosisResult:
    problem, catalogue = absolute.build(absolute.measure(delta=delta, noise=2e-5))  # type: ignore[arg-type]
    return selection_pipeline.diagnose_problem(
        problem, catalogue, selection_pipeline.DiagnosisOptions(), np.random.default_rng(0)
    )


def test_partial_wave_is_a_compensator_unless_the_data_exclude_it() -> None:
    d = diagnose_angles(spring)
    assert [(f.effect, f.location) for f in d.findings] == [(BALANCER, PLACE)]
    assert (WAVE, PLACE) in d.findings[0].one_of
    low, high = d.findings[0].parameters["peak_torque"].ci95
    cell = absolute.arm()[0]
    assert cell.stiffness is not None
    true = np.abs(spring(absolute.poses())).max() * cell.stiffness.joints[1] / absolute.SOFTER[1]
    assert low < true < high


def test_wave_over_whole_periods_remains_a_wave() -> None:
    d = diagnose_angles(absolute.wave(2, 13.0, 40.0, 0.0))
    assert [(f.effect, f.location) for f in d.findings] == [(WAVE, PLACE)]
    assert d.findings[0].parameters["order"].value == pytest.approx(13.0, abs=1.0)
