"""Quaternions in another order, of the inverse rotation, or of axes that are turned by a constant rotation.

Orders (w first or last) and the conjugate are compared. With each, the axes of the measured body or of the tracker may
be turned by any constant rotation, which is fitted (Wahba 1965, by singular values). A convention is accepted where its
evidence is very strong with its numbers counted, and where it removes most of the misfit.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.convention_fits import fit_frames_and_points
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    compute_nominal_points,
    index_tracker_frames,
)
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import (
    convert_quaternion_to_matrix,
    convert_to_quaternion,
    convert_to_rotation_vector,
)

Side = Literal["", "body", "tracker"]
XYZW_TO_WXYZ = [3, 0, 1, 2]
STEPS = 8  # of the robust mean of rotations
ORDERS = ("as named", "in the order x, y, z, w")


@dataclass(frozen=True, kw_only=True)
class _QuaternionReading:
    """One way to understand the quaternions."""

    rotation: Array  # (N, 3, 3) so read, in the axes of the recorded positions
    words: tuple[str, ...]
    turned_deg: float  # fitted constant rotation, deg; 0 if none
    error: Array  # (N,) rad
    cost: float  # −2 log evidence


def correct_quaternion_convention(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Convert quaternions that are recorded in another convention.

    Args:
        recording: Recording of any kind with corrected joint angles; measured poses with quaternions are checked.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording with quaternions (w, x, y, z) of the TCP in the axes of the positions, and a finding if they
        were converted.
    """
    if recording.kind != "absolute" or recording.quaternion is None or COLUMNS.name in accept:
        return recording, []
    if len(np.unique(recording.pose)) < thresholds.COUNTS.min_comparisons:
        return recording, []
    p, R = compute_nominal_points(recording, robot, T_flange_tcp)
    free = recording.registration == "fit"
    rigid = fit_frames_and_points(p, R, recording, frames=free, points=free or bool(recording.targets))
    expected = np.swapaxes(rigid.turn[index_tracker_frames(recording)], 1, 2) @ R @ T_flange_tcp[:3, :3]
    read = list(_list_readings(recording, expected))
    stated = next(r for r in read if not r.words)
    best = _select_reading(stated, read)
    if best is None:
        return recording, []
    words = f"the quaternions hold {' and '.join(best.words)}; they were read that way"
    parameters = {"turned": build_exact_estimate(best.turned_deg, "deg")} if best.turned_deg else {}
    finding = build_record_finding(
        COLUMNS.name,
        format_column_location("qw"),
        words,
        1e3 * float(np.mean(stated.error)),
        1e3 * float(np.mean(best.error)),
        compute_sign_test(recording.pose, stated.error, best.error),
        parameters,
    )
    # errors of quaternions are angles; the channel's error is a length, and is not known yet
    finding = replace(finding, before=float("nan"), after=float("nan"))
    return replace(recording, quaternion=convert_to_quaternion(best.rotation)), [finding]


def _select_reading(stated: _QuaternionReading, read: list[_QuaternionReading]) -> _QuaternionReading | None:
    """Return the convention with the fewest changes that fits; None if the stated one fits, or if several do."""
    if float(np.mean(stated.error)) < thresholds.LIMITS.large_rotation:
        return None
    fits = [
        r
        for r in read
        if stated.cost - r.cost > thresholds.LEVELS.min_evidence
        and float(np.mean(r.error)) < thresholds.SHARES.relevant * float(np.mean(stated.error))
    ]
    if not fits:
        return None
    least = min(len(r.words) for r in fits)
    simple = sorted((r for r in fits if len(r.words) == least), key=lambda r: r.cost)
    undecided = len(simple) > 1 and simple[1].cost - simple[0].cost < thresholds.LEVELS.min_evidence
    return None if undecided else simple[0]


def fit_constant_rotation(moved: Array, to: Array) -> Array:
    """Fit the rotation Q with Q moved ≈ to, by least absolute deviations.

    Args:
        moved: (N, 3, 3) rotations.
        to: (N, 3, 3) rotations.

    Returns:
        (3, 3) rotation.

    Source:
        Wahba, SIAM Review 7 (1965) 409; solved by singular values.
    """
    each = to @ np.swapaxes(moved, 1, 2)
    weight, Q = np.ones(len(each)), np.eye(3)
    for _ in range(STEPS):
        U, _, Vt = np.linalg.svd(np.einsum("n,nij->ij", weight, each))
        Q = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        size = _compute_angles(each, np.broadcast_to(Q, each.shape))
        weight = 1.0 / np.maximum(size, max(0.1 * float(np.median(size)), 1e-9))
    return np.asarray(Q)


def _list_readings(recording: Recording, expected: Array) -> Iterator[_QuaternionReading]:
    """Yield every convention: order, conjugate, and where axes may be turned."""
    assert recording.quaternion is not None  # checked by the caller
    sides: tuple[Side, ...] = ("", "body", "tracker")
    for order in ORDERS:
        values = recording.quaternion if order == ORDERS[0] else recording.quaternion[:, XYZW_TO_WXYZ]
        for conjugate in (False, True):
            R = convert_quaternion_to_matrix(values)
            R = np.swapaxes(R, 1, 2) if conjugate else R
            words = [order] if order != ORDERS[0] else []
            words += ["the inverse rotations"] if conjugate else []
            for side in sides:
                yield _build_reading(recording, expected, R, tuple(words), side)


def _build_reading(
    recording: Recording, expected: Array, R: Array, words: tuple[str, ...], side: Side
) -> _QuaternionReading:
    turned, angle = R, 0.0
    if side == "tracker":
        Q = fit_constant_rotation(R, expected)
        turned = Q @ R
    elif side == "body":
        Q = fit_constant_rotation(np.swapaxes(R, 1, 2), np.swapaxes(expected, 1, 2)).T
        turned = R @ Q
    if side:
        angle = float(np.degrees(np.linalg.norm(convert_to_rotation_vector(Q))))
        where = "the measured body" if side == "body" else "the tracker, other than those of the positions"
        words = (*words, f"axes of {where} that are turned by {angle:.1f}°")
    error = _compute_angles(turned, expected)
    changes = len(words)
    cost = compute_description_cost(
        compute_pose_errors(recording.pose, error), parameters=3 if side else 0, choices=2.0**changes
    )
    return _QuaternionReading(rotation=turned, words=words, turned_deg=angle, error=error, cost=cost)


def _compute_angles(one: Array, other: Array) -> Array:
    return np.asarray(np.linalg.norm(convert_to_rotation_vector(one @ np.swapaxes(other, 1, 2)), axis=1))
