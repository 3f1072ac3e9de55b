"""Torque channels recorded under another joint's name, or measured at one motor before its gear.

Both give a torque that no arm has. It follows the rigid-body torque of another joint, or is a small fraction of its
own. A gravity compensator, payload or friction does not remove the joint's own inertia, and no second joint fits as
well.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_record_finding
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.measurement.diagnosis.dynamic.motion_record_checks import (
    compute_interval_medians,
    compute_sign_test,
    fit_slope,
    format_column_name,
)
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array


def correct_exchanged_torques(
    recording: Recording, motion: MotionSignals, predicted: Array
) -> tuple[Recording, list[Finding]]:
    """Exchange torque channels that were recorded under each other's names.

    Args:
        recording: Recording of kind motion.
        motion: Filtered joint signals of the recording, M samples.
        predicted: (M, n) joint torque required by the rigid-body model, N·m.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each exchange.

    Raises:
        InputError: One torque is measured before the gear, and the gear ratio is unknown.
    """
    if recording.torque is None:
        return recording, []
    out: list[Finding] = []
    for i, j in combinations(range(predicted.shape[1]), 2):
        tau = recording.torque[motion.index, : predicted.shape[1]]
        stated = [_compute_unexplained_share(motion, tau, predicted, a, a) for a in (i, j)]
        other = [_compute_unexplained_share(motion, tau, predicted, a, b) for a, b in ((i, j), (j, i))]
        # each channel fits the other joint much better than its own, with about the required magnitude
        falls = all(
            o is not None and s is not None and o[0] < thresholds.SHARES.corrected_misfit * s[0]
            for s, o in zip(stated, other, strict=True)
        )
        if not falls or not all(_is_near_one(o[1]) for o in other if o is not None):
            continue
        torque = recording.torque.copy()
        torque[:, [i, j]] = torque[:, [j, i]]
        recording = replace(recording, torque=torque)
        out.append(_build_exchange_finding(recording, motion, tau, predicted, (i, j)))
    _refuse_motor_side(recording, motion, predicted)
    return recording, out


def _compute_unexplained_share(
    motion: MotionSignals, tau: Array, predicted: Array, i: int, j: int
) -> tuple[float, float, float] | None:
    """Return the share of channel i's variance that the torque of joint j leaves (friction refitted), slope and
    correlation.

    None if the joint requires too little torque.
    """
    if np.ptp(predicted[:, j]) < thresholds.SHARES.negligible * np.ptp(predicted, axis=0).max():
        return None
    v = motion.v[:, j]
    rubbing = np.stack([np.ones(len(v)), np.sign(v), v], axis=1)
    need, seen = (fit_least_squares(x, rubbing)[0] for x in (predicted[:, j], tau[:, i]))
    s, r = fit_slope(need, seen)
    return float(np.sum((seen - s * need) ** 2) / max(np.sum((tau[:, i] - tau[:, i].mean()) ** 2), 1e-300)), s, r


def _is_near_one(s: float) -> bool:
    return 1.0 / thresholds.RATIOS.double < s < thresholds.RATIOS.double


def _build_exchange_finding(
    recording: Recording, motion: MotionSignals, tau: Array, predicted: Array, of: tuple[int, int]
) -> Finding:
    i, j = of
    now = tau.copy()
    now[:, [i, j]] = tau[:, [j, i]]
    before, after = (
        np.sqrt(
            np.mean([compute_interval_medians(_subtract_median(x[:, k] - predicted[:, k])) ** 2 for k in of], axis=0)
        )
        for x in (tau, now)
    )
    one, two = (format_column_name(recording, "torque", k) for k in of)
    return build_record_finding(
        COLUMNS.name,
        format_column_location(one),
        f"{one} and {two} stand under each other's names: each is what the other joint needs",
        float(np.median(before)),
        float(np.median(after)),
        compute_sign_test(before, after),
        further_places=(format_column_location(two),),
    )


def _refuse_motor_side(recording: Recording, motion: MotionSignals, predicted: Array) -> None:
    """Raise an error if one joint's torque is a small fraction of the required one and those of the others are not."""
    assert recording.torque is not None  # checked by the caller
    tau = recording.torque[motion.index, : predicted.shape[1]]
    each = {j: _compute_unexplained_share(motion, tau, predicted, j, j) for j in range(predicted.shape[1])}
    slopes = {j: x[1] for j, x in each.items() if x is not None and x[2] > thresholds.SHARES.agreement}
    whole = [j for j, s in slopes.items() if _is_near_one(s)]
    small = [
        j
        for j, s in slopes.items()
        if 0.0 < s < thresholds.SHARES.small
        and np.ptp(tau[:, j]) < thresholds.SHARES.minority * np.ptp(predicted[:, j])
    ]
    if small and len(whole) >= len(small):
        j = small[0]
        raise RecordingError(
            f"{recording.source}: {format_column_name(recording, 'torque', j)} is {100 * slopes[j]:.2g} % of "
            f"what the arm needs "
            f"there, and the torque of joints {', '.join(str(k + 1) for k in whole)} is whole: torque of the motor "
            f"before its gear, of about 1:{1 / slopes[j]:.0f}? Torque at the joint (times the gear ratio) would work"
        )


def _subtract_median(x: Array) -> Array:
    return np.asarray(x - np.median(x))
