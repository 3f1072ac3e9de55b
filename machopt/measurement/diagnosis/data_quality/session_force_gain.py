"""Sessions whose force gain deviates from the first session by more than the tolerance of load cells.

A force gain per session is fitted together with the springs, because load cells differ by one or two percent. A much
larger deviation indicates a wrong label, sensor or setting and would appear as force noise. Every pose that two
sessions share gives one ratio of displacement per force. A gain error changes all ratios equally.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.effects import prior_scales
from machopt.effects.recording.sensor_errors import GAIN
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.force_gain_estimate import estimate_force_gain, predict_displacements
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.statistics.replicate_noise import compute_robust_sigma
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.numerics.array_types import Array

Ints = NDArray[np.int64]


def correct_session_force_gains(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Correct the forces of sessions whose gain differs strongly from that of the first session.

    Args:
        recording: Load tests with corrected units and axes.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each session.
    """
    out: list[Finding] = []
    sessions = np.unique(recording.session)
    if recording.kind != "deflection" or recording.wrench is None or GAIN.name in accept or len(sessions) < 2:
        return recording, out
    share = _compute_force_ratio_by_pose(build_load_test_experiment(recording, robot, T_flange_tcp), recording.session)
    first = share[int(sessions[0])]
    wrench = recording.wrench.copy()
    for one in sessions[1:].tolist():
        each = np.array([v / first[p] for p, v in share[one].items() if p in first])
        if len(each) < thresholds.COUNTS.min_comparisons:
            continue
        middle = float(np.median(each))
        spread = compute_robust_sigma(each - middle)
        if abs(middle - 1.0) < thresholds.LEVELS.difference_sigma * max(prior_scales.FORCE_GAIN.scale, spread):
            continue
        wrench[recording.session == one] /= middle
        out.append(_build_gain_finding(*estimate_force_gain(each, middle, spread), one, int(sessions[0])))
    return (replace(recording, wrench=wrench), out) if out else (recording, out)


def _compute_force_ratio_by_pose(tests: LoadTestExperiment, session: Ints) -> dict[int, dict[int, float]]:
    """Return the ratio of recorded to implied force by session and pose; springs fitted to all readings predict it."""
    y, by_springs = tests.measured[:, :3], predict_displacements(tests)
    out: dict[int, dict[int, float]] = {}
    for one in np.unique(session).tolist():
        out[one] = {}
        for pose in np.unique(tests.pose[session == one]).tolist():
            rows = (session == one) & (tests.pose == pose)
            moved = float(np.sum(by_springs[rows] * y[rows]))
            if moved > 0.0:
                out[one][pose] = float(np.sum(by_springs[rows] ** 2)) / moved
    return out


def _build_gain_finding(estimated_value: EstimatedValue, p_value: float, session: int, first: int) -> Finding:
    over = estimated_value.value
    words = (
        f"session {session}: forces read {abs(over):.3g} % too {'much' if over > 0 else 'little'} for what the arm "
        f"does under those of session {first}, at every pose alike; they were read like those, though these data do "
        "not say which of the two is right"
    )
    return build_record_finding(
        GAIN.name,
        GAIN.places[0],
        words,
        float("nan"),
        float("nan"),
        p_value,
        {
            "gain": estimated_value,
            "session": build_exact_estimate(float(session)),
        },
        stated={"message": words, "session": session},
    )
