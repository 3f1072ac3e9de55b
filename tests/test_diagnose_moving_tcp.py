"""Tracked TCP in motion, against an arm with known compliance, lag and delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import simulated_long_motion

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.errors import InputError
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    DiagnosisProblem,
    EffectHypothesis,
    HypothesisCatalogue,
)
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.dynamic import motion_channels
from machopt.measurement.recording import load_recording

COMPLIANCE = np.array([0.3, 0.5, 0.7, 2.0, 2.5, 3.0]) * 1e-6  # rad/(N·m), of simulated_long_motion
LATE = 0.012  # s


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, Recording]:
    cell, recording = simulated_long_motion.write_long_motion(
        tmp_path_factory.mktemp("tip"), 3000, 100.0, 3, shows="tip"
    )
    return load_cell(cell), load_recording(recording)


def build_problem(
    cell: Cell, recording: Recording
) -> tuple[DiagnosisProblem, HypothesisCatalogue, tuple[Finding, ...]]:
    problem, catalogue, _, found = motion_channels.build_motion_problem(
        recording, cell, "tip", np.random.default_rng(0)
    )
    return problem, catalogue, found


def solve_least_squares(problem: DiagnosisProblem, *more: np.ndarray) -> np.ndarray:
    """Return the least-squares coefficients of the base and of further columns (M, 3, 1)."""
    A = np.concatenate([problem.base, *more], axis=2)
    A = A.reshape(-1, A.shape[2])
    size = np.linalg.norm(A, axis=0)
    return np.asarray(np.linalg.lstsq(A / size, problem.y.reshape(-1), rcond=None)[0] / size)


def lags(catalogue: HypothesisCatalogue) -> dict[str, EffectHypothesis]:
    return {h.law: h for h in catalogue.hypotheses if h.effect == "servo_lag"}


def test_base_model_contains_the_compliances_of_the_arm(driven: tuple[Cell, Recording]) -> None:
    """The tolerance of 5 % follows from 3,000 samples with 20 µm noise; tracker frame and target are fitted together.

    The target lies on axis 6, so that joint 6 is not observed.
    """
    problem, catalogue, found = build_problem(*driven)
    assert problem.channel == "position"
    names = [u.name for u in problem.unknowns]
    assert names[9:] == [f"compliance {j}" for j in range(1, 7)]
    np.testing.assert_allclose(solve_least_squares(problem)[9:14], COMPLIANCE[:5], rtol=0.05)
    assert np.abs(problem.base[:, :, 14]).max() < 1e-9
    assert np.abs(solve_least_squares(problem)[:3]).max() < 1e-4  # m: the simulated tracker frame equals the base frame
    assert found == ()
    assert lags(catalogue) == {}
    assert ("servo_lag", "the commanded joints are not recorded") in {
        (u.effect, u.reason) for u in catalogue.untestable
    }


def test_arm_behind_its_command_is_offered_as_in_the_encoders(driven: tuple[Cell, Recording]) -> None:
    cell, recording = driven
    assert recording.velocity is not None
    commanded = recording.q + LATE * recording.velocity  # the TCP follows the encoders
    problem, catalogue, found = build_problem(cell, replace(recording, q_command=commanded))
    shown = lags(catalogue)["as the encoders show it"]
    x = solve_least_squares(problem, shown.columns(()))[-1:]
    assert x[0] == pytest.approx(1.0, abs=0.02)
    assert shown.quantities(x, ())["delay"].value == pytest.approx(1e3 * LATE, rel=0.03)  # ms
    one = lags(catalogue)["one delay of all joints"]
    assert one.shapes[-1][0] == pytest.approx(LATE, abs=1e-3)
    assert [f for f in found if f.effect == "time_skew"] == []


def test_encoder_delay_and_arm_delay_are_separated(driven: tuple[Cell, Recording]) -> None:
    cell, recording = driven
    assert recording.velocity is not None
    changed = replace(recording, q=recording.q - LATE * recording.velocity, q_command=recording.q)
    _, _, found = build_problem(cell, changed)
    (late,) = (f for f in found if f.effect == "time_skew")
    assert late.location == "sensor:q"
    assert late.parameters["late"].value == pytest.approx(1e3 * LATE, rel=0.03)  # ms
    assert late.after < 0.2 * late.before


def test_channel_requires_a_tracked_position(driven: tuple[Cell, Recording]) -> None:
    cell, recording = driven
    with pytest.raises(InputError, match="the channel tip needs x_mm, y_mm, z_mm"):
        build_problem(cell, replace(recording, position=None))
