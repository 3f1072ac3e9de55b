"""Complete diagnosis of a recording: correct the recording, set up the problem, select effects, add the record
findings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.cell import Cell, describe_fixed_external_joints
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import StiffnessTerm, describe_ignored_springs
from machopt.errors import InputError, OptionError, RecordingError
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.robot import Robot, RobotMasses
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.diagnosis.data_quality import (
    moved_tracker_or_target,
    outlier_rows,
    record_corrections,
    shifted_rows,
)
from machopt.measurement.diagnosis.data_quality.duplicated_rows import find_duplicated_rows
from machopt.measurement.diagnosis.data_quality.record_corrections import RecordContext
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EffectLocation, Finding
from machopt.measurement.diagnosis.dynamic import motion_channels, next_motion
from machopt.measurement.diagnosis.dynamic.motion_diagnosis import MotionDiagnosis
from machopt.measurement.diagnosis.effect_columns import existing_terms, user_hypotheses
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.static import tcp_offset
from machopt.measurement.diagnosis.static.load_test_diagnosis import LoadTestDiagnosis
from machopt.measurement.diagnosis.static.measured_pose_diagnosis import MeasuredPoseDiagnosis
from machopt.measurement.diagnosis.static.unknown_link_masses import has_link_mass
from machopt.measurement.diagnosis.verdict import cell_stiffness_comparison, data_sufficiency
from machopt.measurement.diagnosis.verdict.verdict_text import format_verdict
from machopt.stiffness.arm_stiffness import ArmElasticity

MIN_POSES = 3  # least number of poses: three points determine a frame


@dataclass(frozen=True)
class DiagnosedRecording:
    """Diagnosis with the data that the output files are written from."""

    diagnosis: DiagnosisResult
    problem: DiagnosisProblem
    recording: Recording

    @property
    def weight_alone(self) -> bool:
        """Whether these are measured poses without any load except gravity."""
        return self.recording.kind == "absolute" and self.problem.scale is None


def diagnose_static_recording(
    cell: Cell,
    recording: Recording,
    options: selection_pipeline.DiagnosisOptions,
    laws: list[tuple[str, user_hypotheses.HypothesisSource]],
    *,
    accept: tuple[str, ...],
    seed: int,
    barred: frozenset[EffectLocation] = frozenset(),
    unstated: frozenset[EffectLocation] = frozenset(),
) -> DiagnosedRecording:
    """Diagnose load tests or measured poses.

    Args:
        cell: Robot cell.
        recording: Recording of kind deflection or absolute.
        options: Options of the model selection.
        laws: User-defined laws with their source.
        accept: Recording faults that are not to be corrected.
        seed: Seed of all random choices.
        barred: Effects and places of measured poses that are not to be tried.
        unstated: Effects and places that stiffness.yaml cannot state; they may be named, and the written model is
            fitted without them.

    Returns:
        The diagnosis with its problem and the corrected recording.

    Raises:
        InputError: The recording is inconsistent or too small.
    """
    check_no_mimic_joints(cell, "diagnose")
    motion_channels.check_joint_names(recording, cell)
    robot, T = load_robot(cell), cell.tool.T_flange_tcp
    masses = read_stated_masses(cell)
    prior = None if cell.stiffness is None else cell.stiffness.joints
    if laws and recording.kind != "deflection":
        raise OptionError(
            "laws of your own are tried on load tests (kind deflection) only", where="--effects", file=recording.source
        )
    options = replace(options, unstated=unstated)
    options.progress("checking the record")
    if recording.kind == "absolute" and len(recording) < MIN_POSES:
        raise RecordingError(
            f"found {len(recording)} reading{'' if len(recording) == 1 else 's'}; ten poses or more would work "
            "(machopt plan-poses chooses them)",
            file=recording.source,
        )
    right = record_corrections.correct_recording(recording, RecordContext(cell, robot, masses, accept))
    recording = right.recording
    others = find_duplicated_rows(recording, robot, T)
    lost = shifted_rows.find_lost_rows(list(right.findings), len(recording))
    copies = outlier_rows.find_copied_rows(recording) | others | lost
    if recording.used is not None:
        copies = copies | ~recording.used
    terms = _list_known_terms(cell, robot, masses)
    tcp_findings: list[Finding] = []
    notes: tuple[str, ...] = ()
    if recording.kind == "deflection":
        tests = LoadTestDiagnosis(
            cell=cell,
            recording=recording,
            robot=robot,
            masses=read_load_test_masses(cell),
            user_laws=laws,
            excluded=copies,
            options=options,
            seed=seed,
        )
        d, problem = existing_terms.diagnose_with_known_terms(terms, tests.run)
        tcp_findings = tests.tcp_findings
    else:
        poses = MeasuredPoseDiagnosis(
            cell=cell,
            recording=recording,
            robot=robot,
            masses=masses,
            barred=barred,
            excluded=copies,
            options=options,
            seed=seed,
        )
        d, problem = existing_terms.diagnose_with_known_terms(terms, poses.run, existing_terms.is_known_in_poses)
        notes = poses.notes
    outlier_finding = outlier_rows.find_outlier_rows(recording, d, copies, problem, others)
    warnings = [*recording.warnings, *right.warnings, *describe_fixed_external_joints(cell)]
    warnings += cell_stiffness_comparison.describe_deviating_springs(d, prior)
    warnings += tcp_offset.describe_tcp_correction(T, tcp_findings)
    warnings += () if cell.stiffness is None else describe_ignored_springs(cell.stiffness.external)
    if recording.kind == "absolute" and cell.stiffness is not None and cell.stiffness.position is not None:
        warnings += cell.stiffness.position.beyond(recording.q)
    corrected, overnight = moved_tracker_or_target.merge_with_thermal_drift(list(right.findings), d.findings)
    notes = (*right.notes, *overnight, *notes)
    whole = _add_record_findings(d, [*corrected, *tcp_findings], outlier_finding, notes, tuple(warnings))
    return DiagnosedRecording(data_sufficiency.downgrade_if_insufficient(whole, problem), problem, recording)


def _list_known_terms(cell: Cell, robot: Robot, masses: RobotMasses | None) -> tuple[StiffnessTerm, ...]:
    """Return the terms of the cell's stiffness that count as known; reject terms that a plan could not use."""
    if cell.stiffness is None:
        return ()
    ArmElasticity(robot, cell.tool.T_flange_tcp, cell.stiffness, cell.arm_limits, masses)
    return existing_terms.select_known_terms(cell.stiffness.terms)


def diagnose_motion_recording(
    cell: Cell,
    recording: Recording,
    options: selection_pipeline.DiagnosisOptions,
    *,
    requested_channel: str,
    seed: int,
    toolpath: bool,
) -> DiagnosedRecording:
    """Diagnose a motion.

    Args:
        cell: Robot cell.
        recording: Recording of kind motion.
        options: Options of the model selection.
        requested_channel: Requested channel, or "auto".
        seed: Seed of all random choices.
        toolpath: Whether the effect on a toolpath is requested too.

    Returns:
        The diagnosis with its problem and the corrected recording.

    Raises:
        InputError: Joints, signals or the channel do not allow a diagnosis.
    """
    motion_channels.check_joint_names(recording, cell)
    if toolpath and (len(cell.arm_joints) != 6 or cell.arm_prismatic):
        raise OptionError(
            "a toolpath needs an arm of six revolute joints; without it the motion is diagnosed all the same",
            where="--toolpath",
        )
    possible = motion_channels.list_testable_channels(recording, cell)
    if not possible:
        raise RecordingError(
            "nothing that was recorded can be predicted: joint torque with inertias in the URDF, link-side encoders "
            "(qse1_deg …) or a tracked TCP (x_mm …) would work"
            + (
                "; the torque of current1_A … is unknown: motor_gain_Nm_per_A and gear_ratio in recording.yaml give it"
                if recording.current is not None
                else ""
            ),
            file=recording.source,
        )
    allowed = [name for name in possible if requested_channel in ("auto", name)]
    if not allowed:
        text = f"found {requested_channel}; this recording allows {', '.join(possible)}"
        raise OptionError(text, where="--channel")
    channel = allowed[0]
    options.progress(f"signals and equations, channel {channel}")
    motion = MotionDiagnosis(cell=cell, recording=recording, channel=channel, options=options, seed=seed)
    whole = len(cell.arm_joints) >= 6 and not cell.arm_prismatic
    terms = _list_known_terms(cell, load_robot(cell), read_stated_masses(cell)) if whole else ()
    d, problem = existing_terms.diagnose_with_known_terms(
        terms,
        motion.run,
        existing_terms.is_known_in_torques if channel == "torque" else existing_terms.is_known_in_motions,
    )
    options.progress("the next motion")
    d = replace(d, next_experiment=next_motion.suggest_next_motion(cell, channel, d))
    # a finding without correction, such as a lag behind the command, changes no error of this channel
    findings = [
        f if f.record else replace(f, before=d.heldout_before, after=d.heldout_before) for f in motion.record_findings
    ]
    return DiagnosedRecording(
        _add_record_findings(
            d, findings, None, motion.notes, (*recording.warnings, *describe_fixed_external_joints(cell))
        ),
        problem,
        recording,
    )


def _add_record_findings(
    d: DiagnosisResult,
    corrections: list[Finding],
    outlier_finding: Finding | None,
    notes: tuple[str, ...],
    warnings: tuple[str, ...],
) -> DiagnosisResult:
    """Return the diagnosis with the record findings: corrections first, outlier rows last."""
    findings = (*corrections, *d.findings, *(() if outlier_finding is None else (outlier_finding,)))
    before, explained, verdict = d.heldout_before, d.explained, d.verdict
    if corrections:  # the recording fault was part of the mismatch: count from the uncorrected error
        before = max([before, *(f.before for f in corrections if np.isfinite(f.before))])
        beyond, left = before**2 - d.noise_floor**2, max(d.heldout_after**2 - d.noise_floor**2, 0.0)
        explained = float(np.clip(1.0 - left / beyond, 0.0, 1.0)) if beyond > 0 else d.explained
    if corrections and d.verdict == "unexplained":  # the recording fault is corrected, and a mismatch remains
        verdict = "partly_explained"
    out = replace(
        d,
        findings=findings,
        verdict=verdict,
        heldout_before=before,
        explained=explained,
        notes=(*d.notes, *notes),
        warnings=warnings,
    )
    return replace(out, sentence=format_verdict(out)) if findings != d.findings else out


def read_stated_masses(cell: Cell) -> RobotMasses | None:
    """Read the masses of links and tool as far as they are stated.

    Args:
        cell: Robot cell.

    Returns:
        The masses; None if none is stated.
    """
    try:
        masses = load_masses(cell)
    except InputError:
        return None
    return masses if masses.mass.sum() > 0 else None


def read_load_test_masses(cell: Cell) -> RobotMasses | None:
    """Read the masses for load tests.

    Args:
        cell: Robot cell.

    Returns:
        The masses; None if the URDF has none for the long links, so that gravity is unknown.
    """
    masses = read_stated_masses(cell)
    return masses if has_link_mass(masses) else None
