"""Motor currents without known torque constants: a gain of each joint is refitted with the other unknowns.

The known masses of the arm determine the gain of a joint, together with friction. A first value converts currents to
torques here. The deviation from it is an unknown of the base model
(:func:`machopt.measurement.diagnosis.dynamic.joint_torque_channel.build_joint_torque_problem`), so that payload and
compensator are never more certain than the gains. The overall scale is that of the masses of URDF and tool.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.measurements.recording import Recording
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array

MIN_JOINTS = 2  # least number of joints with determinable gains: one alone cannot be cross-checked


def has_currents_only(recording: Recording) -> bool:
    """Return whether the recording has currents but no torques.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        True for currents only.
    """
    return recording.torque is None and recording.current is not None


@dataclass(frozen=True)
class ConvertedTorques:
    """Torques converted from currents."""

    recording: Recording
    notes: str  # note on the gains
    joints_without_gain: frozenset[int]  # joints (0-based) with an undetermined torque constant


def convert_currents_to_torques(recording: Recording, motion: MotionSignals, predicted: Array) -> ConvertedTorques:
    """Convert currents to torques with fitted torque constants.

    Args:
        recording: Recording of kind motion with currents.
        motion: Filtered joint signals of the recording, M samples.
        predicted: (M, n) joint torque required by the rigid-body model, N·m.

    Returns:
        The recording with torques, a note, and the joints without a gain.

    Raises:
        InputError: A current has the wrong sign, or too few joints determine a gain.
    """
    assert recording.current is not None  # checked by has_currents_only
    n = predicted.shape[1]
    current = recording.current[motion.index, :n]
    dead = np.flatnonzero(np.ptp(current, axis=0) == 0.0)
    if len(dead):
        columns = ", ".join(f"current{j + 1}_A" for j in dead)
        raise RecordingError(
            f"{recording.source}: {columns} never change{'s'[: len(dead) == 1]}: not read, or of a braked joint, and "
            "no torque is evaluated there; a recording with the currents of all joints would work"
        )
    each = [_fit_current_per_torque(motion, current[:, j], predicted[:, j], j) for j in range(n)]
    sure = thresholds.SHARES.minority
    against = [j for j, (slope, sigma) in enumerate(each) if -slope * sure > sigma]
    unsized = frozenset(j for j, (slope, sigma) in enumerate(each) if sigma > sure * slope)
    if against or n - len(unsized) < min(n, MIN_JOINTS):
        why = (
            f"current{against[0] + 1}_A runs against what the arm needs there by its masses"
            if against
            else f"currents of {n - len(unsized)} of {n} joints show enough of what the arm needs by its masses to say "
            "what torque an ampere makes"
        )
        raise RecordingError(
            f"{recording.source}: {why}; motor_gain_Nm_per_A and gear_ratio in recording.yaml, or a motion with a load "
            "that the cell states, would work"
        )
    gains = np.array([1.0 / max(slope, sigma) for slope, sigma in each])
    made = np.zeros_like(recording.current)
    made[:, :n] = recording.current[:, :n] * gains
    observable = ", ".join(f"{g:.4g} (joint {j + 1})" for j, g in enumerate(gains) if j not in unsized)
    words = (
        "torque is current times a gain of each joint, which is refitted in any case: N·m per unit of current1_A …, by "
        f"the masses of URDF and tool, {observable}; a gain that all share passes for heavier masses"
    )
    if unsized:
        which = ", ".join(str(j + 1) for j in sorted(unsized))
        words += (
            f"; at {'joint' if len(unsized) == 1 else 'joints'} {which} masses ask too little to say it: nothing is "
            "named there"
        )
    return ConvertedTorques(replace(recording, torque=made), words, unsized)


def _fit_current_per_torque(motion: MotionSignals, current: Array, needed: Array, joint: int) -> tuple[float, float]:
    """Return amperes per N·m of a joint, and its standard deviation."""
    v, a = motion.v[:, joint], motion.a[:, joint]
    other_columns = np.stack([np.ones(len(v)), np.sign(v), v, a], axis=1)
    seen, needed_part = (
        motion.subtract_period_mean(motion.average_blocks(fit_least_squares(x, other_columns)[0][:, None]))[:, 0]
        for x in (current, needed)
    )
    power = max(float(needed_part @ needed_part), 1e-300)
    slope = float(needed_part @ seen) / power
    left = seen - slope * needed_part
    # errors of a cycle are correlated: that many readings count as one
    return slope, float(np.std(left)) * float(
        np.sqrt(thresholds.LIMITS.reading_rate * thresholds.LIMITS.segment_time / power)
    )
