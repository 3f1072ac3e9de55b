"""Computation of ``machopt identify`` in memory, before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.cell.stiffness.term_parser import parse_term
from machopt.commands.identify.record_conventions import refuse_other_conventions
from machopt.commands.input_hashes import compute_input_hashes
from machopt.commands.recording_cell import load_recording_cell
from machopt.data_types.cell import Cell, describe_fixed_external_joints
from machopt.data_types.documents.identification_document import MISFIT_WARNING, IdentificationDocument
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ModelDiscrepancy, describe_ignored_springs
from machopt.errors import InputError, OptionError
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_masses, load_robot
from machopt.measurement.estimation.load_test_equations import LoadTestExperiment, build_load_test_experiment
from machopt.measurement.identification.assessment.misfit_intervals import compute_gain_covariance
from machopt.measurement.identification.assessment.misfit_intervals import widen_stiffness_interval as widen_interval
from machopt.measurement.identification.assessment.model_discrepancy import estimate_identification_discrepancy
from machopt.measurement.identification.identification_document import build_identification_document
from machopt.measurement.identification.identification_pipeline import identify_stiffness
from machopt.measurement.identification.identification_result import IdentificationResult
from machopt.measurement.identification.request import IdentifyRequest, check_identify_request, convert_to_options
from machopt.measurement.recording import load_recording, load_recordings
from machopt.measurement.recording.recording_merge import drop_unused_readings
from machopt.stiffness.terms import compile_terms


@dataclass(frozen=True, kw_only=True)
class IdentifyComputation:
    """Result of an identification in memory, not written yet."""

    request: IdentifyRequest
    cell: Cell
    recording: Recording
    tests: LoadTestExperiment
    identification: IdentificationResult
    result: IdentificationDocument


def compute_identification(
    request: IdentifyRequest, progress: Callable[[str], None], cell: Cell | None = None
) -> IdentifyComputation:
    """Return the identified stiffness.

    Args:
        request: The validated request; its ``out`` is not used.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.
    """
    check_identify_request(request)
    options = convert_to_options(request, tuple(parse_term(t) for t in request.terms))
    progress("reading cell and recording")
    recording = drop_unused_readings(_read_recordings(request.recordings))
    cell = cell or load_recording_cell(request.cell, recording, allow_external=request.allow_external)
    check_no_mimic_joints(cell, "identify")
    robot = load_robot(cell)
    tests = build_load_test_experiment(recording, robot, cell.tool.T_flange_tcp)
    for text, term in zip(request.terms, options.terms, strict=True):
        try:
            compile_terms((term,), robot, cell.tool.T_flange_tcp)
        except InputError as problem:
            raise OptionError(problem.reason, where=f"--fit {text}") from None
    masses = load_masses(cell) if options.geometric else None
    progress("checking conventions")
    refuse_other_conventions(cell, recording, robot, tests, options.accept)
    progress("identifying")
    random = np.random.default_rng(options.seed)
    found = identify_stiffness(tests, robot, cell.tool.T_flange_tcp, cell.stiffness, options, random, masses)
    external_stiffness = () if cell.stiffness is None else cell.stiffness.external
    placed = None if cell.stiffness is None else cell.stiffness.position
    doubt = _test_misfit(cell, robot, tests, found)
    found = replace(found, sessions=len(np.unique(tests.session)))
    found = replace(found, lever=float(np.linalg.norm(cell.tool.T_flange_tcp[:3, 3])))
    found = _widen_intervals(
        replace(
            found,
            stiffness=replace(found.stiffness, discrepancy=doubt, external=external_stiffness, position=placed),
            warnings=(
                *_describe_misfit(request, doubt),
                *found.warnings,
                *describe_ignored_springs(external_stiffness),
                *describe_fixed_external_joints(cell),
            ),
        )
    )
    result = build_identification_document(
        request, cell, recording, found, compute_input_hashes(cell, request.recordings)
    )
    return IdentifyComputation(
        request=request, cell=cell, recording=recording, tests=tests, identification=found, result=result
    )


def _describe_misfit(request: IdentifyRequest, doubt: ModelDiscrepancy | None) -> tuple[str, ...]:
    """Return the first warning: springs alone do not explain the readings."""
    if doubt is None or not doubt.misfit:
        return ()
    paths = " ".join(str(p) for p in request.recordings)
    return (
        f"{MISFIT_WARNING}: they leave {1e3 * doubt.left:.3f} mm, the noise is "
        f"{1e3 * doubt.noise:.3f} mm; the intervals are widened by that. Next: machopt diagnose {request.cell} {paths} "
        "-o OUT finds what is missing",
    )


def _widen_intervals(result: IdentificationResult) -> IdentificationResult:
    """Return the result with joint intervals that hold for the arm as built."""
    doubt, level = result.stiffness.discrepancy, result.uncertainty.level
    if doubt is None:
        return result
    joints = tuple(
        replace(
            j,
            interval=widen_interval(j.joint, j.k, j.interval, doubt, result.sessions, result.lever, level),
        )
        if j.identified
        else j
        for j in result.joints
    )
    covariance = result.stiffness.covariance
    if covariance is not None:
        covariance = covariance + compute_gain_covariance(result.stiffness.joints, result.sessions)
    return replace(result, joints=joints, stiffness=replace(result.stiffness, covariance=covariance))


def _test_misfit(
    cell: Cell, robot: Robot, tests: LoadTestExperiment, result: IdentificationResult
) -> ModelDiscrepancy | None:
    try:
        masses = load_masses(cell)
    except InputError:  # without weight
        masses = None
    return estimate_identification_discrepancy(
        result.fit, tests, robot, cell.tool.T_flange_tcp, result.stiffness, masses, cell.arm_limits
    )


def _read_recordings(paths: tuple[Path, ...]) -> Recording:
    return load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)
