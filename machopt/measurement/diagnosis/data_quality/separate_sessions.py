"""Sessions of measured poses that share no pose with the others: a moved tracker or a reflector that was seated anew.

The model of the arm connects such sessions: tracker frame, reflectors, zeros of the joints and deflection by weight are
fitted to all readings together, with and without a change of one session. A change is accepted where its evidence is
very strong with its numbers counted, and where it removes most of the misfit. Otherwise errors of the arm between two
regions of poses would count as a change.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from machopt.data_types.effect_locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.dynamics.gravity_torque import compute_gravity_torque
from machopt.effects.recording.record_faults import COLUMNS
from machopt.effects.recording.sensor_errors import DISPLACEMENT
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_quality.session_corrections import compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_exact_estimate, build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import (
    build_frame_and_reflector_columns,
    compute_nominal_points,
)
from machopt.measurement.estimation.convention_score import compute_description_cost, compute_pose_errors
from machopt.measurement.estimation.robust_weights import fit_least_absolute_deviations
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import convert_vector_to_rotation, skew_matrix

MOST_CHANGES = 4  # most sessions that are corrected
Cause = Literal["target", "frame"]


@dataclass(frozen=True, kw_only=True)
class _Change:
    """Fitted change of one session."""

    session: int
    cause: Cause
    x: Array  # (3,) m in flange, or (6,) m, rad about the middle of the points
    middle: Array  # (3,) m
    before: Array  # (N,) m, error without the change
    after: Array  # (N,) m
    gain: float  # −2 log evidence


def correct_separate_sessions(
    recording: Recording,
    robot: Robot,
    masses: RobotMasses | None,
    T_flange_tcp: Array,
    accept: Collection[str] = (),
) -> tuple[Recording, list[Finding]]:
    """Remove changes of sessions that share no pose with the others.

    Args:
        recording: Recording of any kind; measured poses in base_link, with corrected columns, are checked.
        robot: Kinematic model of the arm.
        masses: Link and tool masses; None if unknown: without deflection by weight.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording (unchanged if nothing was corrected) and a finding for each correction.
    """
    out: list[Finding] = []
    if recording.kind != "absolute" or recording.position is None or recording.frame is not None:
        return recording, out
    if any(recording.prismatic):
        return recording, out
    for _ in range(MOST_CHANGES):
        changes = _list_changes(recording, robot, masses, T_flange_tcp)
        found = [c for c in changes if _name_effect(c)[0] not in accept]
        if not found:
            break
        best = max(found, key=lambda c: c.gain)
        recording = _apply_change(recording, robot, T_flange_tcp, best)
        out.append(_build_finding(recording, best))
    return recording, out


def _list_changes(recording: Recording, robot: Robot, masses: RobotMasses | None, T: Array) -> list[_Change]:
    """Return the decisive changes of single sessions, the cause with the better evidence each."""
    p, R = compute_nominal_points(recording, robot, T)
    assert recording.position is not None  # checked by the caller
    y, base = recording.position - p, _build_arm_columns(recording, robot, masses, T, p, R)
    before = _fit_errors(y, base)
    by_pose = compute_pose_errors(recording.pose, before)
    stated = compute_description_cost(by_pose)
    sessions = np.unique(recording.session)
    out = []
    for name in sessions[1:] if len(sessions) == 2 else sessions:  # of two the later one is corrected
        rows = recording.session == name
        if not rows.any() or rows.all() or np.intersect1d(recording.pose[rows], recording.pose[~rows]).size:
            continue
        if len(np.unique(recording.pose[rows])) < thresholds.COUNTS.min_comparisons:
            continue
        middle = p[rows].mean(axis=0)
        frame = np.concatenate([np.broadcast_to(np.eye(3), R.shape), -skew_matrix(p - middle)], axis=2)
        columns: dict[Cause, Array] = {"target": R, "frame": frame}
        tried = []
        for cause, own in columns.items():
            A = np.concatenate([base, own * rows[:, None, None]], axis=2)
            x = fit_least_absolute_deviations(A, y, np.ones(len(y)))
            after = np.linalg.norm(y - A @ x, axis=1)
            count = own.shape[2]
            cost = compute_description_cost(
                compute_pose_errors(recording.pose, after), parameters=count, choices=2.0 * len(sessions)
            )
            tried.append(
                _Change(
                    session=int(name),
                    cause=cause,
                    x=x[-count:],
                    middle=middle,
                    before=before,
                    after=after,
                    gain=stated - cost,
                )
            )
        best = max(tried, key=lambda c: c.gain)
        falls = float(np.mean(best.after)) < thresholds.SHARES.majority * float(np.mean(before))
        if falls and best.gain > thresholds.LEVELS.min_evidence:
            out.append(best)
    return out


def _build_arm_columns(
    recording: Recording, robot: Robot, masses: RobotMasses | None, T: Array, p: Array, R: Array
) -> Array:
    """Return the columns (N, 3, P) of tracker frame, reflectors, zeros and compliances of the joints."""
    state = robot.compute_state(recording.q, T, bodies=True)
    beside = p - state.T_base_tool[:, :3, 3]
    J = state.J[:, :3] + np.swapaxes(np.cross(np.swapaxes(state.J[:, 3:], 1, 2), beside[:, None]), 1, 2)
    out = [build_frame_and_reflector_columns(recording, p, R), J]
    if masses is not None:
        torque, *_ = compute_gravity_torque(robot, masses, state)
        out.append(J * torque[:, None, :])
    return np.concatenate(out, axis=2)


def _fit_errors(y: Array, A: Array) -> Array:
    x = fit_least_absolute_deviations(A, y, np.ones(len(y)))
    return np.asarray(np.linalg.norm(y - A @ x, axis=1))


def _apply_change(recording: Recording, robot: Robot, T: Array, change: _Change) -> Recording:
    assert recording.position is not None  # checked by the caller
    rows = recording.session == change.session
    position = recording.position.copy()
    if change.cause == "target":
        _, R = compute_nominal_points(recording, robot, T)
        position[rows] -= R[rows] @ change.x
    else:
        turn = convert_vector_to_rotation(change.x[3:])
        position[rows] = (position[rows] - change.middle - change.x[:3]) @ turn + change.middle
    return replace(recording, position=position)


def _name_effect(change: _Change) -> tuple[str, str]:
    if change.cause == "target":
        return COLUMNS.name, format_column_location("target")
    return DISPLACEMENT.name, DISPLACEMENT.places[0]


def _build_finding(recording: Recording, change: _Change) -> Finding:
    effect, where = _name_effect(change)
    shift = 1e3 * change.x[:3]
    at = ", ".join(f"{v:.2f}" for v in shift)
    what = (
        f"the reflector sat ({at}) mm in the flange from where it sat in the other sessions"
        if change.cause == "target"
        else f"the tracker's frame lies ({at}) mm about the middle of the points, turned by "
        f"{1e3 * float(np.linalg.norm(change.x[3:])):.2f} mrad, from where it lay in the other sessions"
    )
    words = (
        f"session {change.session}: {what}, by the model of the arm, as it shares no pose with the others; "
        "it was read that way"
    )
    return build_record_finding(
        effect,
        where,
        words,
        1e3 * float(np.mean(change.before)),
        1e3 * float(np.mean(change.after)),
        compute_sign_test(recording.pose, change.before, change.after),
        {
            **{f"shift {a}": build_exact_estimate(float(v), "mm") for a, v in zip("xyz", shift, strict=True)},
            "session": build_exact_estimate(float(change.session)),
        },
        stated={"message": words, "session": change.session},
    )
