"""``machopt diagnose``: missing effects of the model from a cell and a recording, the extended model, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from machopt.commands.diagnose.computation import DiagnoseComputation, build_computation, write_diagnosis_files
from machopt.commands.diagnose.motion_diagnosis import diagnose_motion
from machopt.commands.diagnose.output_files import (
    KINEMATICS,
    STIFFNESS,
    compute_effect_on_job,
    list_kinematic_corrections,
    rank_findings_at_job,
)
from machopt.commands.input_hashes import compute_input_hashes, list_request_paths
from machopt.commands.recording_cell import load_recording_cell
from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import DiagnosisDocument
from machopt.data_types.measurements.recording import Recording
from machopt.effects.user_effects import UserModule, activate_user_effects, run_user_files
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.diagnosis_pipeline import (
    DiagnosedRecording,
    diagnose_static_recording,
)
from machopt.measurement.diagnosis.effect_columns import user_hypotheses
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.model_selection.search.search_cache import SearchCache
from machopt.measurement.diagnosis.outputs.diagnosis_document import build_diagnosis_document
from machopt.measurement.diagnosis.outputs.extended_stiffness import (
    ExtendedStiffness,
    add_withheld_notes,
)
from machopt.measurement.diagnosis.outputs.implausible_correction_removal import diagnose_with_useful_files
from machopt.measurement.diagnosis.outputs.model_assessment import ModelAssessment, state_written_errors
from machopt.measurement.diagnosis.outputs.model_uncertainty import add_model_uncertainty
from machopt.measurement.diagnosis.request import DiagnoseRequest, check_diagnose_request
from machopt.measurement.diagnosis.verdict.verdict_rules import apply_verdict_rules
from machopt.measurement.recording import load_recording, load_recordings
from machopt.options.plan_option_reader import load_options
from machopt.output import write_output_folder

Progress = Callable[[str], None]


@dataclass(frozen=True)
class DiagnoseResult:
    """Result of ``machopt diagnose``."""

    diagnosis: DiagnosisResult
    result: DiagnosisDocument
    report: Path


def run_diagnose(request: DiagnoseRequest, progress: Progress = lambda _: None) -> DiagnoseResult:
    """Diagnose a recording of a cell's robot.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, recording, laws or output folder.
    """
    own = run_user_files(request.terms)
    with (
        activate_user_effects(own),
        write_output_folder(request.out, force=request.overwrite, inputs=list_request_paths(request)) as folder,
    ):
        refuse_without_pyarrow(request.tables)
        done = compute_diagnosis(request, own, progress)
        write_diagnosis_files(done, folder, progress)
    return DiagnoseResult(done.diagnosis, done.result, request.out / "report.html")


def _diagnose_load_tests(
    request: DiagnoseRequest,
    cell: Cell,
    recording: Recording,
    options: selection_pipeline.DiagnosisOptions,
    laws: list[tuple[str, user_hypotheses.HypothesisSource]],
) -> tuple[DiagnosedRecording, ExtendedStiffness, ModelAssessment | None]:
    """Return the diagnosis of load tests, its model, and the assessment of the written files."""
    accept, seed = request.accept, request.seed
    searches = SearchCache()
    options = replace(options, searches=searches)
    useful = diagnose_with_useful_files(
        cell,
        lambda barred, unstated: diagnose_static_recording(
            cell, recording, options, laws, accept=accept, seed=seed, barred=barred, unstated=unstated
        ),
    )
    searches.clear()
    found = replace(useful.found, diagnosis=state_written_errors(useful.found.diagnosis, useful.assessed))
    options.progress("what the model may still lack")
    made = replace(useful.made, after=add_model_uncertainty(cell, found, useful.made.after))
    return found, made, useful.assessed


def compute_diagnosis(
    request: DiagnoseRequest, own: tuple[UserModule, ...], progress: Progress, cell: Cell | None = None
) -> DiagnoseComputation:
    """Return the effects that the model lacks.

    Args:
        request: The validated request; its ``out`` is not used.
        own: Loaded files of ``request.terms``, already registered.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.
    """
    progress("reading cell and recording")
    paths = request.recordings
    recording = load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)
    moving = recording.kind == "motion"
    if cell is None:
        cell = load_recording_cell(request.cell, recording, allow_external=request.allow_external)
    laws = user_hypotheses.load_hypothesis_sources(own)
    check_diagnose_request(request, recording.kind)
    load_options(cell.plan, overrides=request.overrides)  # what is wrong with them is stated before minutes of work
    options = selection_pipeline.DiagnosisOptions(
        max_effects=request.get_max_findings(recording.kind), progress=progress
    )
    if moving:
        found, made, assessed = diagnose_motion(request, cell, recording, options)
    else:
        found, made, assessed = _diagnose_load_tests(request, cell, recording, options, laws)
    found = replace(found, diagnosis=apply_verdict_rules(found.diagnosis))
    d = add_withheld_notes(replace(found.diagnosis, warnings=(*cell.warnings, *found.diagnosis.warnings)), made)
    if request.toolpath is not None and made.after is not None and made.before is not None:
        progress("what it changes for the toolpath")
    effect = compute_effect_on_job(cell, request.toolpath, made.before, made.after, request.overrides)
    d = rank_findings_at_job(d, effect)
    inputs, stated = compute_input_hashes(cell, request.recordings), request.list_options(recording.kind)
    result = build_diagnosis_document(
        cell,
        found.recording,
        d,
        model=None if made.after is None else STIFFNESS,
        kinematics=KINEMATICS if list_kinematic_corrections(d) else None,
        effect_on_job=effect,
        options=stated,
        inputs=inputs,
    )
    return build_computation(
        request, cell, replace(found, diagnosis=d), assessed, made.after, result, {**stated, **inputs}
    )
