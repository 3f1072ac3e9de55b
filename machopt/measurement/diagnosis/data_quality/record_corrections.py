"""Corrections of a static recording before any physics is tried.

:data:`RECORD_CORRECTIONS` is the table, in the order of execution: columns and units first, then reflectors and
sessions, then labels and gains. Each correction gets the recording that the ones before it have left, and returns it
corrected or as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.measurement.diagnosis.data_quality import (
    exchanged_inclinometer_columns,
    joint_conventions,
    misplaced_reflectors,
    moved_tracker_or_target,
    pose_units,
    quaternion_conventions,
    separate_sessions,
    session_force_gain,
    stated_frame_and_tcp,
    static_record_correction,
    wrong_weight_label,
)
from machopt.measurement.diagnosis.data_types import reflectors_and_tracker_frames
from machopt.measurement.diagnosis.data_types.diagnosis_result import Finding
from machopt.numerics.array_types import Array

LOAD_TESTS, POSES = "deflection", "absolute"


@dataclass(frozen=True)
class RecordContext:
    """What the corrections compare a recording with."""

    cell: Cell
    robot: Robot
    masses: RobotMasses | None  # of links and tool; None if unknown
    accept: tuple[str, ...]  # faults that the user declares to be intended; they are not corrected

    @property
    def T_flange_tcp(self) -> Array:
        """Pose (4, 4) of the TCP in the flange frame, m."""
        return self.cell.tool.T_flange_tcp


@dataclass(frozen=True, kw_only=True)
class CorrectedRecording:
    """Corrected recording with the findings of the corrections."""

    recording: Recording
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()  # on reflectors and tracker frames
    warnings: tuple[str, ...] = ()


Step = Callable[[Recording, RecordContext], CorrectedRecording]


@dataclass(frozen=True, kw_only=True)
class RecordCorrection:
    """One correction: (recording, context) to the corrected recording with the findings of this correction alone."""

    name: str
    kinds: tuple[str, ...]  # kinds of recordings that it is made for
    statistic: str  # what decides
    correct: Step


def correct_recording(recording: Recording, context: RecordContext) -> CorrectedRecording:
    """Correct a static recording by all corrections of the table.

    Args:
        recording: Load tests or measured poses, as read.
        context: Cell, robot and masses, and the faults that are not to be corrected.

    Returns:
        The recording with the findings, notes and warnings of all corrections.
    """
    whole = CorrectedRecording(recording=recording)
    for correction in RECORD_CORRECTIONS:
        if recording.kind in correction.kinds:
            one = correction.correct(whole.recording, context)
            whole = replace(
                one,
                findings=(*whole.findings, *one.findings),
                notes=(*whole.notes, *one.notes),
                warnings=(*whole.warnings, *one.warnings),
            )
    return whole


def _build(result: tuple[Recording, list[Finding]]) -> CorrectedRecording:
    return CorrectedRecording(recording=result[0], findings=tuple(result[1]))


def _compare_with_kinematics(
    correct: Callable[[Recording, Robot, Array, tuple[str, ...]], tuple[Recording, list[Finding]]],
) -> Step:
    """Return the step of a correction that needs the arm and the TCP alone."""
    return lambda recording, c: _build(correct(recording, c.robot, c.T_flange_tcp, c.accept))


def _correct_joint_convention(recording: Recording, c: RecordContext) -> CorrectedRecording:
    joint_map = c.cell.controller.joint_map
    return _build(joint_conventions.correct_joint_convention(recording, c.robot, c.T_flange_tcp, c.accept, joint_map))


def _transform_to_base(recording: Recording, c: RecordContext) -> CorrectedRecording:
    recording, notes = reflectors_and_tracker_frames.transform_to_base(recording, c.robot, c.T_flange_tcp)
    return CorrectedRecording(recording=recording, notes=tuple(notes))


def _correct_columns(recording: Recording, c: RecordContext) -> CorrectedRecording:
    stiffness = c.cell.stiffness
    recording, findings, warnings = static_record_correction.correct_static_record(
        recording,
        c.robot,
        c.T_flange_tcp,
        None if stiffness is None else stiffness.joints,
        c.accept,
        estimated=stiffness is not None and stiffness.estimated,
    )
    return CorrectedRecording(recording=recording, findings=tuple(findings), warnings=tuple(warnings))


def _correct_reflectors(recording: Recording, c: RecordContext) -> CorrectedRecording:
    if "columns" in c.accept:
        return CorrectedRecording(recording=recording)
    return _build(misplaced_reflectors.correct_misplaced_reflectors(recording, c.cell, c.robot, c.masses))


def _correct_inclinometer(recording: Recording, c: RecordContext) -> CorrectedRecording:
    return _build(
        exchanged_inclinometer_columns.correct_inclinometer_columns(recording, c.cell, c.robot, c.masses, c.accept)
    )


def _correct_separate_sessions(recording: Recording, c: RecordContext) -> CorrectedRecording:
    return _build(separate_sessions.correct_separate_sessions(recording, c.robot, c.masses, c.T_flange_tcp, c.accept))


RECORD_CORRECTIONS: tuple[RecordCorrection, ...] = (
    RecordCorrection(
        name="units of poses",
        kinds=(POSES,),
        statistic="misfit of each session to forward kinematics, in each usual unit",
        correct=_compare_with_kinematics(pose_units.correct_pose_units),
    ),
    RecordCorrection(
        name="joint convention",
        kinds=(LOAD_TESTS, POSES),
        statistic="evidence of q = M q_recorded + z, choices counted",
        correct=_correct_joint_convention,
    ),
    RecordCorrection(
        name="stated frame",
        kinds=(POSES,),
        statistic="evidence of a free frame or another point of the flange",
        correct=_compare_with_kinematics(stated_frame_and_tcp.correct_stated_frame),
    ),
    RecordCorrection(
        name="quaternions",
        kinds=(POSES,),
        statistic="evidence of another order, conjugate or constant rotation",
        correct=_compare_with_kinematics(quaternion_conventions.correct_quaternion_convention),
    ),
    RecordCorrection(
        name="tracker frame",
        kinds=(POSES,),
        statistic="least squares of points; no fault, the frame is free",
        correct=_transform_to_base,
    ),
    RecordCorrection(
        name="units, axes, signs, rows",
        kinds=(LOAD_TESTS, POSES),
        statistic="misfit by pose with and without each candidate, sign test",
        correct=_correct_columns,
    ),
    RecordCorrection(
        name="reflectors",
        kinds=(POSES,),
        statistic="evidence of other places, three numbers a reflector counted",
        correct=_correct_reflectors,
    ),
    RecordCorrection(
        name="changes between sessions",
        kinds=(POSES,),
        statistic="differences at equal poses, least absolute deviations",
        correct=_compare_with_kinematics(moved_tracker_or_target.correct_session_changes),
    ),
    RecordCorrection(
        name="inclinometer",
        kinds=(POSES,),
        statistic="eigenvalues of the compliance from tilt and moment",
        correct=_correct_inclinometer,
    ),
    RecordCorrection(
        name="separate sessions",
        kinds=(POSES,),
        statistic="evidence of a change, model of the arm fitted with it",
        correct=_correct_separate_sessions,
    ),
    RecordCorrection(
        name="weight labels",
        kinds=(LOAD_TESTS,),
        statistic="ratio of response per load size at equal poses",
        correct=_compare_with_kinematics(wrong_weight_label.correct_wrong_weight_labels),
    ),
    RecordCorrection(
        name="force gain of a session",
        kinds=(LOAD_TESTS,),
        statistic="ratio of displacement per force at poses that sessions share",
        correct=_compare_with_kinematics(session_force_gain.correct_session_force_gains),
    ),
)
