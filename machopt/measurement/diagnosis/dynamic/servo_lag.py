"""Lag of the encoders behind their command."""

from __future__ import annotations

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import RecordCorrection
from machopt.measurement.diagnosis.data_types.diagnosis_result import EstimatedValue, Finding
from machopt.measurement.diagnosis.dynamic.motion_record_checks import STRETCHES, compute_sign_test
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array


def find_servo_lag(recording: Recording, motion: MotionSignals) -> list[Finding]:
    """Find encoders that lag behind the command in proportion to speed, if the channel itself does not show it.

    Args:
        recording: Recording with or without a command.
        motion: Filtered joint signals of the recording, M samples.

    Returns:
        The findings.
    """
    if recording.q_command is None:
        return []
    n = motion.q.shape[1]
    commanded = recording.q_command[motion.index, :n]
    speed = motion.differentiate(commanded)
    parts = np.array_split(np.arange(len(commanded)), STRETCHES)
    delay, sure, before, after = np.zeros(n), np.zeros(n), np.zeros(STRETCHES), np.zeros(STRETCHES)
    for j in range(n):
        behind, x = _subtract_mean(commanded[:, j] - motion.q[:, j]), _subtract_mean(speed[:, j])
        if np.ptp(commanded[:, j]) < thresholds.LIMITS.joint_motion or not float(x @ x) > 0:
            continue
        delay[j] = float(x @ behind) / float(x @ x)
        local = [float(x[p] @ behind[p]) / float(x[p] @ x[p]) for p in parts if float(x[p] @ x[p]) > 0]
        sure[j] = 1.4826 * float(np.median(np.abs(np.array(local) - delay[j]))) / np.sqrt(len(local))
        left = behind - delay[j] * x
        before += [float(behind[p] @ behind[p]) for p in parts]
        after += [float(left[p] @ left[p]) for p in parts]
    moving = delay[np.abs(delay) > 0]
    share = 1.0 - after.sum() / before.sum() if before.sum() > 0 else 0.0
    if not len(moving) or share < thresholds.SHARES.majority or abs(float(np.mean(moving))) < thresholds.LIMITS.delay:
        return []
    mean, unit = float(np.mean(moving)), "mm" if recording.prismatic and all(recording.prismatic) else "mrad"
    error = 1e3 * np.sqrt(np.array([before.sum(), after.sum()]) / commanded.size)
    parameters = {"delay": _build_estimate(1e3 * mean, "ms", 1e3 * float(np.sqrt(np.sum(sure**2))) / len(moving))}
    parameters |= {
        f"delay_{j + 1}": _build_estimate(1e3 * float(d), "ms", 1e3 * float(sure[j])) for j, d in enumerate(delay)
    }
    parameters |= {
        "following_error": _build_estimate(float(error[0]), unit, 0.0),
        "following_error_left": _build_estimate(float(error[1]), unit, 0.0),
    }
    return [
        Finding(
            effect="servo_lag",
            location="controller",
            law="encoders behind the command",
            equation="q(t) = q_command(t − T), joint by joint",
            note="in proportion to speed",
            one_of=(("servo_lag", "controller"), ("time_skew", "sensor:qcmd")),
            parameters=parameters,
            before=float("nan"),
            after=float("nan"),
            p_value=compute_sign_test(before, after),
            correction=RecordCorrection("servo_lag", "controller", {"delay_ms": (1e3 * delay).tolist()}),
        )
    ]


def _subtract_mean(x: Array) -> Array:
    return x - float(x.mean())


def _build_estimate(value: float, unit: str, sigma: float) -> EstimatedValue:
    return EstimatedValue(
        value, unit, (value - 1.645 * sigma, value + 1.645 * sigma), (value - 1.96 * sigma, value + 1.96 * sigma)
    )
