"""Complete diagnosis of a recording: correct the recording, set up the problem, select effects, add the record
findings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell, describe_fixed_external_joints
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness, StiffnessTerm, describe_ignored_springs
from machopt.errors import InputError, OptionError, RecordingError
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.robot import GRAVITY, Robot, RobotMasses, load_masses, load_robot
from machopt.measurement.diagnosis.data_quality import (
    inclinometer_columns,
    misplaced_reflectors,
    moved_tracker_or_target,
    outlier_rows,
    pose_units,
    session_force_gain,
    shifted_rows,
    static_record_correction,
    wrong_weight_label,
)
from machopt.measurement.diagnosis.data_quality.duplicated_rows import find_duplicated_rows
from machopt.measurement.diagnosis.data_types import reflectors_and_tracker_frames
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem, HypothesisCatalogue
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, EffectLocation, Finding
from machopt.measurement.diagnosis.data_types.static_readings import GearLoadHistory
from machopt.measurement.diagnosis.dynamic import motion_channels, next_motion
from machopt.measurement.diagnosis.effect_columns import existing_terms, joint_torque, user_hypotheses
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.search.search_iterations import LinearisationPoint, Rebuild
from machopt.measurement.diagnosis.static import (
    load_test_channel,
    loaded_equilibrium_terms,
    measured_pose_channel,
    tcp_offset,
)
from machopt.measurement.diagnosis.static.unknown_link_masses import has_link_mass
from machopt.measurement.diagnosis.verdict import cell_stiffness_comparison, data_sufficiency
from machopt.measurement.diagnosis.verdict.verdict_text import format_verdict
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.numerics.array_types import Array
from machopt.stiffness.arm_stiffness import ArmElasticity

NO_LINEARISATION = LinearisationPoint()
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
    options.progress("checking the record")
    if recording.kind == "absolute" and len(recording) < MIN_POSES:
        raise RecordingError(
            f"found {len(recording)} reading{'' if len(recording) == 1 else 's'}; ten poses or more would work "
            "(machopt plan-poses chooses them)",
            file=recording.source,
        )
    right = _correct_recording(recording, cell, robot, masses, accept)
    recording = right.recording
    others = find_duplicated_rows(recording, robot, T)
    copies = (
        outlier_rows.find_copied_rows(recording) | others | shifted_rows.find_lost_rows(right.findings, len(recording))
    )
    said = [*recording.warnings, *right.warnings, *describe_fixed_external_joints(cell)]
    notes: tuple[str, ...] = ()

    beside: list[Finding] = []

    def load_tests(terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        known = None if cell.stiffness is None else ArmStiffness(joints=cell.stiffness.joints, terms=terms)

        def about(tcp: Array) -> tuple[DiagnosisResult, DiagnosisProblem]:
            return _diagnose_load_tests(
                seed,
                recording,
                robot,
                tcp,
                read_load_test_masses(cell),
                laws,
                known,
                copies,
                options,
                limits=cell.arm_limits,
                stated=existing_terms.has_geometric_stiffness(cell.stiffness),
                down=cell.T_world_base[:3, :3].T @ np.array([0.0, 0.0, -GRAVITY]),
            )

        done, tool = tcp_offset.diagnose_about_found_tcp(T, about)
        beside[:] = [] if tool is None else [tool]
        return done

    def poses(terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        rng, kept = np.random.default_rng(seed), frozenset[int]()

        def build(
            found: Mapping[int, float] | None, about: LinearisationPoint = NO_LINEARISATION
        ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
            nonlocal notes
            problem, catalogue, notes = measured_pose_channel.build_measured_pose_problem(
                recording, cell, robot, masses, rng, terms, found, kept, about.corrections
            )
            laws = tuple(h for h in catalogue.hypotheses if h.name not in barred)
            problem = replace(problem, time=recording.time, excluded=copies if copies.any() else None)
            return problem, replace(catalogue, hypotheses=laws)

        problem, catalogue = build(None)
        _refuse_too_few(problem, recording)

        def again(
            x: Array, doubted: frozenset[int], about: LinearisationPoint
        ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
            nonlocal problem, kept
            springs = {
                u.spring_joint: float(v) for u, v in zip(problem.unknowns, x, strict=True) if u.spring_joint is not None
            }
            kept |= {problem.unknowns[n].spring_joint or 0 for n in doubted}
            problem, catalogue = build(springs, about)
            return problem, catalogue

        return selection_pipeline.diagnose_problem(
            problem, catalogue, replace(options, predicted="poses"), rng, again
        ), problem

    terms = _list_known_terms(cell, robot, masses)
    if recording.kind == "deflection":
        d, problem = existing_terms.diagnose_with_known_terms(terms, load_tests)
    else:
        d, problem = existing_terms.diagnose_with_known_terms(terms, poses, existing_terms.is_known_in_poses)
    outlier_finding = outlier_rows.find_outlier_rows(recording, d, copies, problem, others)
    said += cell_stiffness_comparison.describe_deviating_springs(d, prior)
    said += tcp_offset.describe_tcp_correction(T, beside)
    said += () if cell.stiffness is None else describe_ignored_springs(cell.stiffness.external)
    if recording.kind == "absolute" and cell.stiffness is not None and cell.stiffness.position is not None:
        said += cell.stiffness.position.beyond(recording.q)
    corrected, overnight = moved_tracker_or_target.merge_with_thermal_drift(right.findings, d.findings)
    whole = _add_record_findings(
        d, [*corrected, *beside], outlier_finding, (*right.reflector_notes, *overnight, *notes), tuple(said)
    )
    return DiagnosedRecording(data_sufficiency.downgrade_if_insufficient(whole, problem), problem, recording)


@dataclass(frozen=True)
class _CorrectedRecording:
    """Corrected recording with the findings of the corrections."""

    recording: Recording
    findings: list[Finding]
    reflector_notes: tuple[str, ...]  # notes on reflectors and tracker frames
    warnings: tuple[str, ...]


def _correct_recording(
    recording: Recording, cell: Cell, robot: Robot, masses: RobotMasses | None, accept: tuple[str, ...]
) -> _CorrectedRecording:
    """Correct columns and units first, then reflectors and sessions, then labels and gains."""
    T, prior = cell.tool.T_flange_tcp, None if cell.stiffness is None else cell.stiffness.joints
    recording, found = pose_units.correct_pose_units(recording, robot, T, accept)
    recording, reflector_notes = reflectors_and_tracker_frames.transform_to_base(recording, robot, T)
    guessed = cell.stiffness is not None and cell.stiffness.estimated
    recording, findings, warnings = static_record_correction.correct_static_record(
        recording, robot, T, prior, accept, estimated=guessed
    )
    found = [*found, *findings]
    if recording.kind == "absolute" and "columns" not in accept:
        recording, sitting = misplaced_reflectors.correct_misplaced_reflectors(recording, cell, robot, masses)
        found += sitting
    if recording.kind == "absolute":
        recording, put_down = moved_tracker_or_target.correct_session_changes(recording, robot, T, accept)
        recording, assigned = inclinometer_columns.correct_inclinometer_columns(recording, cell, robot, masses, accept)
        found += [*put_down, *assigned]
    recording, relabelled = wrong_weight_label.correct_wrong_weight_labels(recording, robot, T, accept)
    recording, louder = session_force_gain.correct_session_force_gains(recording, robot, T, accept)
    return _CorrectedRecording(recording, [*found, *relabelled, *louder], tuple(reflector_notes), tuple(warnings))


def _list_known_terms(cell: Cell, robot: Robot, masses: RobotMasses | None) -> tuple[StiffnessTerm, ...]:
    """Return the terms of the cell's stiffness that count as known; reject terms that a plan could not use."""
    if cell.stiffness is None:
        return ()
    ArmElasticity(robot, cell.tool.T_flange_tcp, cell.stiffness, cell.arm_limits, masses)
    return existing_terms.select_known_terms(cell.stiffness.terms)


def _diagnose_load_tests(
    seed: int,
    recording: Recording,
    robot: Robot,
    T: Array,
    masses: RobotMasses | None,
    laws: list[tuple[str, user_hypotheses.HypothesisSource]],
    known: ArmStiffness | None,
    copies: NDArray[np.bool_],
    options: selection_pipeline.DiagnosisOptions,
    *,
    limits: tuple[Array, Array],
    stated: bool,
    down: Array,
) -> tuple[DiagnosisResult, DiagnosisProblem]:
    """Diagnose load tests. K_C becomes a finding unless the cell has it (``stated``).

    Args:
        limits: Lower and upper joint limits, each (6,) rad.
        down: (3,) gravity in base_link, m/s².
    """
    tests = loaded_equilibrium_terms.convert_wrench_at_loaded_pose(
        build_load_test_experiment(recording, robot, T), recording, robot, T, masses
    )
    memo: dict[str, GearLoadHistory] = {}
    terms = None
    if known is not None and known.terms:  # terms in addition to the joint springs
        r = load_test_channel.build_load_test_readings(recording, tests, robot, T, masses, 1.0 / known.joints, memo)
        lived, settled = joint_torque.compute_memory_term_displacement(r, known.terms)
        whole = ArmElasticity(robot, T, replace(known, terms=settled), limits, masses).evaluate(recording.q)
        springs = ArmElasticity(robot, T, ArmStiffness(joints=known.joints)).evaluate(recording.q)
        terms = lived + whole.compute_twist(tests.wrench) - springs.compute_twist(tests.wrench)

    alone: Array | None = None

    def build(
        compliance: Array | None, found: tuple[StiffnessTerm, ...] = ()
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        nonlocal alone
        bodies = load_test_channel.compute_body_compliance(robot, T, recording.q, found)
        problem, catalogue, readings = load_test_channel.build_load_test_problem(
            recording, tests, robot, T, masses, compliance, memo, terms, alone, bodies, down
        )
        alone = readings.compliance if alone is None else alone
        if stated:
            problem = replace(problem, subtracted_displacement=None)
        own = user_hypotheses.build_user_hypotheses(laws, readings)
        return problem, replace(catalogue, hypotheses=(*catalogue.hypotheses, *own))

    problem, catalogue = build(None)
    if copies.any():
        problem = replace(problem, excluded=copies)
    _refuse_too_few(problem, recording)
    rebuild = _exclude_rows(lambda x, _, about: build(np.maximum(x[:6], 0.0), about.bodies), copies)
    rng = np.random.default_rng(seed)
    d = selection_pipeline.diagnose_problem(problem, catalogue, replace(options, predicted="load tests"), rng, rebuild)
    return d, problem


def _refuse_too_few(problem: DiagnosisProblem, recording: Recording) -> None:
    """Raise an error if the base unknowns alone could fit every reading."""
    unknowns = sum(u.prior is None or u.location == "tool" for u in problem.unknowns)  # reflector positions included
    distinct = min(len(problem), 2 * len(np.unique(problem.group)))  # further replicates of one pose add no information
    if distinct * problem.dimensions > unknowns and problem.y.size >= 2 * unknowns:
        return
    poses = len(np.unique(problem.group))
    raise RecordingError(
        f"{len(problem)} reading{'' if len(problem) == 1 else 's'} of {problem.dimensions} coordinates in {poses} "
        f"pose{'' if poses == 1 else 's'} cannot be held against a model that refits {unknowns} numbers to them; ten "
        "poses or more would work (machopt plan-poses chooses them)",
        file=recording.source,
    )


def _exclude_rows(rebuild: Rebuild, rows: NDArray[np.bool_]) -> Rebuild:
    if not rows.any():
        return rebuild

    def again(
        x: Array, doubted: frozenset[int], about: LinearisationPoint
    ) -> tuple[DiagnosisProblem, HypothesisCatalogue]:
        problem, catalogue = rebuild(x, doubted, about)
        return replace(problem, excluded=rows), catalogue

    return again


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
                "; of current1_A … nothing says the torque: motor_gain_Nm_per_A and gear_ratio in recording.yaml do"
                if recording.current is not None
                else ""
            ),
            file=recording.source,
        )
    channel = possible[0] if requested_channel == "auto" else requested_channel
    if channel not in possible:
        raise OptionError(f"found {channel}; this recording allows {', '.join(possible)}", where="--channel")
    options.progress(f"signals and equations, channel {channel}")
    words = {
        "torque": "stretches of joint torque",
        "link": "stretches of link-side position",
        "tip": "stretches of tip",
    }
    notes: tuple[str, ...] = ()
    found: tuple[Finding, ...] = ()

    def stretches(terms: tuple[StiffnessTerm, ...]) -> tuple[DiagnosisResult, DiagnosisProblem]:
        nonlocal notes, found
        rng = np.random.default_rng(seed)
        problem, catalogue, notes, found = motion_channels.build_motion_problem(
            recording, cell, channel, rng, terms=terms
        )
        return selection_pipeline.diagnose_problem(
            problem, catalogue, replace(options, predicted=words[channel]), rng
        ), problem

    six = len(cell.arm_joints) == 6 and not cell.arm_prismatic
    terms = _list_known_terms(cell, load_robot(cell), read_stated_masses(cell)) if six else ()
    d, problem = existing_terms.diagnose_with_known_terms(
        terms,
        stretches,
        existing_terms.is_known_in_torques if channel == "torque" else existing_terms.is_known_in_motions,
    )
    options.progress("the next motion")
    d = replace(d, next_experiment=next_motion.suggest_next_motion(cell, channel, d))
    # a finding without correction, such as a lag behind the command, changes no error of this channel
    beside = [f if f.record else replace(f, before=d.heldout_before, after=d.heldout_before) for f in found]
    return DiagnosedRecording(
        _add_record_findings(d, beside, None, notes, (*recording.warnings, *describe_fixed_external_joints(cell))),
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
