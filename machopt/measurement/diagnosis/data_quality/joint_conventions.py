"""Joint angles of measured poses in another convention than that of the URDF.

A pendant may count joint 3 against the horizontal, so that q3 = J3 ± J2; a zero position may be a quarter or half turn
away; a joint may turn the other way. Each convention is compared with forward kinematics, with the tracker frame and
the reflectors fitted. It is accepted if it removes nearly all of the misfit and no other convention does. The mean
error counts, because series that move one joint at a time show a convention in few poses.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.locations import format_column_location
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import COLUMNS
from machopt.kinematics.robot import Robot
from machopt.measurement.diagnosis import thresholds
from machopt.measurement.diagnosis.data_quality.correction_candidates import select_rows
from machopt.measurement.diagnosis.data_quality.session_corrections import build_record_equations, compute_sign_test
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.measurement.diagnosis.data_types.record_findings import build_record_finding
from machopt.measurement.diagnosis.data_types.reflectors_and_tracker_frames import register_positions
from machopt.numerics.array_types import Array

MOST = 400  # most readings used: a convention shows in a few
ZERO_TURNS = (90.0, -90.0, 180.0)  # degrees by which zero positions of conventions differ
COUPLED, COUPLING = 2, 1  # joints (0-based) of which a pendant may count the first against the horizontal


@dataclass(frozen=True)
class JointConvention:
    """One way to understand the joint columns."""

    joint: int  # 0-based, whose column is understood differently
    words: str
    apply: Callable[[Array], Array]  # (N, n) rad as recorded → as the URDF counts them


def correct_joint_convention(
    recording: Recording, robot: Robot, T_flange_tcp: Array, accept: Collection[str] = ()
) -> tuple[Recording, list[Finding]]:
    """Convert joint angles that are recorded in another convention.

    Args:
        recording: Recording of any kind; only measured poses of six revolute joints are checked.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.
        accept: Names of faults that the user declares to be intended; they are not corrected.

    Returns:
        The recording in the convention of the URDF, and a finding if it was converted.
    """
    if recording.kind != "absolute" or COLUMNS.name in accept or any(recording.prismatic):
        return recording, []
    part = _select_few_used_readings(recording)
    if part.position is None or len(np.unique(part.pose)) < thresholds.RECORD.part_readings:
        return recording, []
    spread = float(np.median(np.linalg.norm(part.position - np.median(part.position, axis=0), axis=1)))
    stated = _compute_errors(part, robot, T_flange_tcp)
    if not float(np.mean(stated)) > thresholds.RECORD.whole_pose_off * spread:
        return recording, []
    tried = [
        (c, _compute_errors(replace(part, q=c.apply(part.q)), robot, T_flange_tcp))
        for c in list_joint_conventions(part.q.shape[1])
    ]
    tried.sort(key=lambda one: float(np.mean(one[1])))
    (best, errors), (_, second) = tried[:2]
    least = float(np.mean(errors))
    if least > thresholds.RECORD.clearly * float(np.mean(stated)):
        return recording, []
    if least > thresholds.RECORD.session_falls * float(np.mean(second)):
        return recording, []  # another convention does nearly as well
    column = f"q{best.joint + 1}_deg"
    words = f"{column} {best.words}; so read the poses fit the arm, and they were read that way"
    finding = build_record_finding(
        COLUMNS.name,
        format_column_location(column),
        words,
        1e3 * float(np.mean(stated)),
        1e3 * least,
        compute_sign_test(np.arange(len(stated)), stated, errors),
    )
    return replace(recording, q=best.apply(recording.q)), [finding]


def list_joint_conventions(joints: int) -> Iterator[JointConvention]:
    """List the conventions that differ from the URDF in one joint.

    Args:
        joints: Number of joints.

    Returns:
        Iterator over the conventions.
    """
    if joints > COUPLED:
        for sign, text in ((1.0, "+"), (-1.0, "−")):
            for own in (1.0, -1.0):
                yield JointConvention(
                    COUPLED,
                    f"counts joint 3 against the horizontal: q3 = {'−' if own < 0 else ''}J3 {text} J2",
                    lambda q, s=sign, o=own: _couple(q, s, o),  # type: ignore[misc]
                )
    for j in range(joints):
        yield JointConvention(j, "has the other sign", lambda q, j=j: _turn(q, j, -1.0, 0.0))  # type: ignore[misc]
        for sign in (1.0, -1.0):
            for zero in ZERO_TURNS:
                yield JointConvention(
                    j,
                    f"{'has the other sign and ' if sign < 0 else ''}counts from a zero {zero:g}° away",
                    lambda q, j=j, s=sign, z=zero: _turn(q, j, s, np.radians(z)),  # type: ignore[misc]
                )


def _couple(q: Array, sign: float, own: float) -> Array:
    out = q.copy()
    out[:, COUPLED] = own * q[:, COUPLED] + sign * q[:, COUPLING]
    return out


def _turn(q: Array, joint: int, sign: float, zero: float) -> Array:
    out = q.copy()
    out[:, joint] = sign * q[:, joint] + zero
    return out


def _select_few_used_readings(recording: Recording) -> Recording:
    rows = np.ones(len(recording), bool) if recording.used is None else recording.used.copy()
    there = np.flatnonzero(rows)
    if len(there) > MOST:
        rows[:] = False
        rows[there[np.linspace(0, len(there) - 1, MOST).astype(int)]] = True
    return select_rows(recording, rows)


def _compute_errors(part: Recording, robot: Robot, T: Array) -> Array:
    """Return the residuals (n,) m after fitting frame and reflectors."""
    e = build_record_equations(register_positions(part, robot, T), robot, T)
    return np.asarray(np.linalg.norm(e.error(e.fit()), axis=1))
