"""Checks of a motion recording: units, motor-side torques, constant or saturated channels, clock of the encoders.

Correctable faults are corrected and reported as findings; others raise an error. The certainty of a finding follows
from time blocks: in how many the corrected recording agrees better than the stated one. Its effect on the error of
the channel is added by :mod:`machopt.measurement.diagnosis.dynamic.motion_channels`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import bdtrc

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import UNITS
from machopt.errors import RecordingError
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.dynamic.friction import fit_least_squares
from machopt.measurement.diagnosis.motion_data.motion_signals import MotionSignals
from machopt.numerics.array_types import Array

COLUMNS = {
    "q": "q{}_deg q{}_mm",
    "velocity": "qd{}_deg_s qd{}_mm_s",
    "torque": "tau{}_Nm tau{}_N",
    "q_secondary": "qse{}_deg qse{}_mm",
    "q_command": "qcmd{}_deg qcmd{}_mm",
}
THOUSANDS = {1e-3: "a thousandth of the unit", 1e3: "a thousand times the unit"}
FACTORS = {np.pi / 180.0: "radians for degrees", 180.0 / np.pi: "degrees twice", **THOUSANDS}
STRETCHES = 24


def fit_slope(x: Array, y: Array) -> tuple[float, float]:
    """Fit the slope of y over x through their means.

    Args:
        x: (N,) abscissa.
        y: (N,) ordinate.

    Returns:
        Slope and correlation coefficient; 0, 0 if either is constant.
    """
    a, b = x - x.mean(), y - y.mean()
    xx, yy, xy = float(a @ a), float(b @ b), float(a @ b)
    if xx <= 0 or yy <= 0:
        return 0.0, 0.0
    return xy / xx, xy / float(np.sqrt(xx * yy))


def format_column_name(recording: Recording, field: str, joint: int) -> str:
    """Return the column name of a joint's channel.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        field: Field of the recording.
        joint: Joint index, 0-based.

    Returns:
        Column name.
    """
    turns, slides = COLUMNS[field].split()
    return (slides if recording.prismatic and recording.prismatic[joint] else turns).format(joint + 1)


def compute_sign_test(before: Array, after: Array) -> float:
    """Compute the p-value of a sign test over time blocks.

    Args:
        before: (S,) errors before the correction.
        after: (S,) errors after the correction.

    Returns:
        One-sided p-value.
    """
    wins = int(np.sum(after < before))
    return float(bdtrc(wins - 1, len(before), 0.5))


def compute_interval_medians(x: Array) -> Array:
    """Compute medians of |x| over equal parts of the recording.

    Args:
        x: (N,) signal.

    Returns:
        (S,) medians.
    """
    parts = np.array_split(np.abs(x), min(STRETCHES, len(x)))
    return np.array([np.median(p) for p in parts])


def correct_motion_units(recording: Recording, joints: int) -> tuple[Recording, list[Finding]]:
    """Correct angles, lengths and speeds that are in another unit than the other channels.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        joints: Number of joints.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    found: list[Finding] = []
    slides = np.array((recording.prismatic or (False,) * joints)[:joints])
    for name in ("velocity", "q_secondary", "q_command"):
        for of in (False, True):
            those = np.flatnonzero(slides == of).tolist()
            if those and getattr(recording, name) is not None and recording.time is not None:
                recording, more = _correct_channel_units(recording, name, those)
                found += more
    return recording, found


def _correct_channel_units(recording: Recording, name: str, joints: list[int]) -> tuple[Recording, list[Finding]]:
    """Correct the units of one channel for the revolute or for the prismatic joints."""
    x, q = _compare_with_encoders(recording, name)
    pairs = {j: fit_slope(q[:, j], x[:, j]) for j in joints if np.isfinite(x[:, j]).all() and np.ptp(x[:, j]) > 0}
    sure = {j: s for j, (s, r) in pairs.items() if abs(r) > thresholds.SHARES.agreement}
    if not sure:
        return recording, []
    against = [j for j, s in sure.items() if s < 0]
    if against:
        raise RecordingError(
            f"{recording.source}: {format_column_name(recording, name, against[0])} runs against "
            f"{format_column_name(recording, 'q', against[0])}; the same sign as the encoder would work"
        )
    factor = float(np.median(list(sure.values())))
    slides = bool(recording.prismatic) and recording.prismatic[joints[0]]
    known = [f for f in (THOUSANDS if slides else FACTORS) if abs(factor / f - 1.0) < thresholds.SHARES.load_tolerance]
    assert recording.time is not None  # checked by the caller
    if (
        known
        and name == "velocity"
        and known[0] > 1.0
        and np.median(np.diff(np.sort(recording.time))) > thresholds.LIMITS.segment_time
    ):
        return _correct_milliseconds(recording, joints)
    if not known or max(abs(s / factor - 1.0) for s in sure.values()) > thresholds.SHARES.load_tolerance:
        return recording, []
    # all joints within a few degrees and all other channels 57 times larger: the encoders are in another unit
    own = recording.q[:, joints]
    few = (
        np.abs(1e3 * own).max() < thresholds.LIMITS.millimetre_range
        if slides
        else np.abs(np.degrees(own)).max() < 2.0 * np.pi
    )
    odd, scale = ("q", known[0]) if known[0] > 1.0 and few else (name, 1.0 / known[0])
    values = getattr(recording, odd).copy()
    values[:, joints] *= scale
    words = FACTORS[known[0]] if odd != "q" else "metres for millimetres" if slides else "radians for degrees"
    corrected = replace(recording, **{odd: values})
    misfit = [
        np.sum([compute_interval_medians(_subtract_median(a[:, j]) - _subtract_median(b[:, j])) for j in sure], axis=0)
        for a, b in (_compare_with_encoders(r, name) for r in (recording, corrected))
    ]
    where = format_column_name(recording, odd, joints[0])
    return corrected, [_build_unit_finding(where, 1.0 / scale, words, compute_sign_test(misfit[0], misfit[1]))]


def _correct_milliseconds(recording: Recording, joints: list[int]) -> tuple[Recording, list[Finding]]:
    """Correct a clock in milliseconds: encoder speeds are 1000 times smaller than the recorded velocities."""
    assert recording.time is not None
    corrected = replace(recording, time=recording.time / 1e3)
    before, after = (
        np.sum([compute_interval_medians(x[:, j] - q[:, j]) for j in joints], axis=0)
        for x, q in (_compare_with_encoders(r, "velocity") for r in (recording, corrected))
    )
    return corrected, [_build_unit_finding("time_s", 1e3, "milliseconds for seconds", compute_sign_test(before, after))]


def _compare_with_encoders(recording: Recording, name: str) -> tuple[Array, Array]:
    """Return a channel and its counterpart from the encoders, in time order."""
    assert recording.time is not None
    order = np.lexsort((recording.time, recording.session))
    q, x = recording.q[order], getattr(recording, name)[order]
    if name != "velocity":
        return x, q
    steps = np.diff(recording.time[order])
    good = (np.diff(recording.session[order]) == 0) & (steps > 0)
    return (0.5 * (x[1:] + x[:-1]))[good], np.diff(q, axis=0)[good] / steps[good, None]


def _subtract_median(x: Array) -> Array:
    return x - float(np.median(x))


def correct_torque_side(
    recording: Recording, motion: MotionSignals, predicted: Array
) -> tuple[Recording, list[Finding]]:
    """Correct torques in another unit, or reject torques measured before the gears.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        motion: Filtered joint signals of the recording, M samples.
        predicted: (M, n) joint torque required by the rigid-body model, N·m.

    Returns:
        The recording (unchanged if nothing was corrected) and the finding.

    Raises:
        InputError: A torque has the wrong sign, or torques are measured before the gears.
    """
    if recording.torque is None:
        return recording, []
    tau = recording.torque[motion.index, : predicted.shape[1]]
    needed = np.ptp(predicted, axis=0)
    for j in np.flatnonzero(needed > thresholds.SHARES.negligible * needed.max()).tolist():
        v = motion.v[:, j]
        friction = np.stack([np.ones(len(v)), np.sign(v), v], axis=1)  # it can hide which way the rest points
        against = fit_slope(fit_least_squares(predicted[:, j], friction)[0], fit_least_squares(tau[:, j], friction)[0])[
            1
        ]
        if against < -thresholds.SHARES.agreement and not _is_dissipative(
            tau[:, j], predicted[:, j], motion.q[:, j], friction
        ):
            raise RecordingError(
                f"{recording.source}: {format_column_name(recording, 'torque', j)} runs against what the arm "
                f"needs there by its "
                "masses; the sign of torques that drive the joint forward would work"
            )
    pairs = [fit_slope(predicted[:, j], tau[:, j]) for j in range(predicted.shape[1])]
    sure = [
        j
        for j, (s, r) in enumerate(pairs)
        if abs(r) > thresholds.SHARES.agreement and needed[j] > thresholds.SHARES.negligible * needed.max()
    ]
    if len(sure) < min(2, predicted.shape[1]):
        return recording, []
    slopes = np.array([pairs[j][0] for j in sure])
    median_slope = float(np.median(slopes))
    known = [f for f in (1e-3, 1e3) if abs(median_slope / f - 1.0) < thresholds.SHARES.majority]
    if known and np.ptp(slopes) < thresholds.SHARES.majority * abs(median_slope):
        factor = known[0]
        # against the nominal arm: refitted masses of links would make up for any factor
        before, after = (
            np.sqrt(
                np.mean(
                    [compute_interval_medians(_subtract_median(t[:, j] - predicted[:, j])) ** 2 for j in sure], axis=0
                )
            )
            for t in (tau, tau / factor)
        )
        finding = _build_unit_finding(
            format_column_name(recording, "torque", 0), factor, FACTORS[factor], compute_sign_test(before, after)
        )
        finding = replace(finding, before=float(np.median(before)), after=float(np.median(after)))
        return replace(recording, torque=recording.torque / factor), [finding]
    if np.all(np.abs(slopes) < thresholds.SHARES.minority):
        shares = ", ".join(f"{100 * pairs[j][0]:.2g} %" for j in sure)
        raise RecordingError(
            f"{recording.source}: {format_column_name(recording, 'torque', sure[0])} is {shares} of what the "
            f"arm needs at joints "
            f"{', '.join(str(j + 1) for j in sure)}: torque of the motors before their gears? Torque at the joint "
            "(times the gear ratio) would work"
        )
    return recording, []


def _is_dissipative(tau: Array, predicted: Array, q: Array, friction: Array) -> bool:
    """Return whether a torque brakes its joint in addition to the part opposite to the masses.

    A gravity compensator may exceed the weight torque at some angles while friction still has the right sign. A
    channel with the wrong sign has both reversed.
    """
    balancer = [f(k * q) for k in (1, 2) for f in (np.cos, np.sin)]
    beside = np.stack([predicted, *balancer], axis=1)
    left, x = fit_least_squares(tau, np.concatenate([friction, beside], axis=1))
    rubs = friction[:, 1:] @ x[1:3]
    power = rubs * friction[:, 2]
    return bool(power.mean() > 0.0 and np.std(rubs) > thresholds.SHARES.minority * np.std(left))


def check_channel_quality(recording: Recording, joints: int) -> tuple[Recording, list[str]]:
    """Check for channels that never change and torques that saturate; drop missing velocities.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        joints: Number of joints.

    Returns:
        The recording and notes.

    Raises:
        InputError: No joint moves, or a torque is constant although its joint moves.
    """
    out = []
    moves = np.ptp(recording.q[:, :joints], axis=0) > thresholds.LIMITS.joint_motion
    if not moves.any():
        raise RecordingError(
            f"{recording.source}: no joint moves by more than {np.degrees(thresholds.LIMITS.joint_motion):.2g}° (or "
            f"{1e3 * thresholds.LIMITS.joint_motion:g} mm); there is no motion to diagnose"
        )
    for name in ("velocity", "torque"):
        values = getattr(recording, name)
        if values is None:
            continue
        for j in range(joints):
            x, label = values[:, j], format_column_name(recording, name, j)
            if np.ptp(x) == 0 and moves[j]:
                if name == "torque":
                    raise RecordingError(
                        f"{recording.source}: {label} never changes though joint {j + 1} moves; a "
                        "recording without it, or with what it was, would work"
                    )
                out.append(
                    f"{label} never changes though joint {j + 1} moves: velocities are differentiated from the "
                    "encoders instead"
                )
                recording = replace(recording, velocity=None)
                break
            if name == "torque":
                top = np.abs(x).max()
                share = float(np.mean(np.abs(x) >= top * (1.0 - 1e-9)))
                if top > 0 and share > thresholds.SHARES.negligible:
                    out.append(f"{label} is at ±{top:.4g} in {100 * share:.1f} % of the samples: cut off at a limit")
    return recording, out


def _build_unit_finding(name: str, factor: float, words: str, p_value: float) -> Finding:
    return build_record_finding(
        UNITS.name,
        format_column_location(name),
        "in the record, not in the robot",
        float("nan"),
        float("nan"),
        p_value,
        {"factor": build_exact_estimate(factor)},
        law=words,
        equation="column = factor × what its name says",
        stated={"factor": factor},
    )
