"""Torque columns of exchanged joints, and motor-side torque of a single joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_diagnose_motion import arm, build_fourier_motion, build_motion_recording

from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.rigid_body import load_dynamics
from machopt.errors import InputError
from machopt.measurement.diagnosis.dynamic import exchanged_torque_columns, motion_channels
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals, build_motion_signals
from machopt.numerics.array_types import Array


def simulate_motion(folder: Path, seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return time, q, q̇, the ideal torque, and the torque of three joints with friction and noise."""
    rng = np.random.default_rng(seed)
    cell = arm(folder, 3, tool=8.0)
    t, q, v, a = build_fourier_motion(3, rng)
    need = load_dynamics(cell).compute_torque(q, v, a)
    return t, q, v, need, need + 5.0 * np.sign(v) + 2.0 * v + 0.5 * rng.normal(size=q.shape)


def prepare_signals(
    t: Array, q: Array, v: Array, tau: Array, cell_folder: Path
) -> tuple[Recording, MotionSignals, Array]:
    recording = build_motion_recording(t, q, v, tau)
    m = build_motion_signals(recording, 3)
    return recording, m, load_dynamics(arm(cell_folder, 3, tool=8.0)).compute_torque(m.q, m.v, m.a)


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_exchanged_torque_columns_are_corrected_and_reported(tmp_path: Path, pair: tuple[int, int]) -> None:
    t, q, v, _, tau = simulate_motion(tmp_path, 3)
    swapped = tau.copy()
    swapped[:, pair] = tau[:, pair[::-1]]
    corrected, found = exchanged_torque_columns.correct_exchanged_torques(*prepare_signals(t, q, v, swapped, tmp_path))
    assert corrected.torque is not None
    np.testing.assert_array_equal(corrected.torque, tau)
    assert [(f.effect, f.location) for f in found] == [("columns", f"column:tau{pair[0] + 1}_Nm")]
    assert found[0].record
    assert found[0].before > 5.0 * found[0].after
    assert found[0].p_value < 1e-3


def test_correct_torque_columns_remain(tmp_path: Path) -> None:
    """The columns also remain where a balancer supplies most of a joint's torque, or where the torques of two joints
    are 30 % off."""
    t, q, v, need, tau = simulate_motion(tmp_path, 4)
    for given in (tau, tau + [0.0, -0.8, 0.0] * need, tau + [0.3, 0.0, -0.3] * need):
        corrected, found = exchanged_torque_columns.correct_exchanged_torques(
            *prepare_signals(t, q, v, given, tmp_path)
        )
        assert not found
        assert corrected.torque is given


def test_motor_side_torque_of_one_joint_is_refused(tmp_path: Path) -> None:
    t, q, v, _, tau = simulate_motion(tmp_path, 5)
    tau = tau / [1.0, 120.0, 1.0]
    with pytest.raises(InputError, match=r"tau2_Nm.*1:1[12]\d\?"):
        motion_channels.build_motion_problem(
            build_motion_recording(t, q, v, tau), arm(tmp_path, 3, tool=8.0), "torque", np.random.default_rng(0)
        )
