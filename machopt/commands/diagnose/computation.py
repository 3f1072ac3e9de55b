"""Computation of ``machopt diagnose`` in memory, and its output files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from machopt.commands.diagnose.model_files import check_written_errors, write_assessed_files
from machopt.commands.diagnose.output_files import (
    write_kinematics_file,
    write_residual_table,
    write_stiffness_file,
)
from machopt.commands.input_hashes import build_manifest_file, list_recording_inputs
from machopt.commands.manifest import write_command_manifest
from machopt.data_types.cell import Cell
from machopt.data_types.documents.diagnosis_document import DiagnosisDocument
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness
from machopt.measurement.diagnosis.data_types.diagnosis_problem import DiagnosisProblem
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs.model_assessment import ModelAssessment
from machopt.measurement.diagnosis.request import DiagnoseRequest
from machopt.output import write_result
from machopt.report.page_data.cell_scene import build_cell_scene
from machopt.report.page_data.diagnosis import build_diagnosis_page_data
from machopt.report.page_types.diagnosis_page_data import DiagnosisPageData
from machopt.report.page_types.display_units import format_option_value
from machopt.report.pages.diagnosis.diagnosis_page import write_diagnosis_page

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class DiagnoseComputation:
    """Result of a diagnosis in memory, not written yet."""

    request: DiagnoseRequest
    cell: Cell
    recording: Recording
    problem: DiagnosisProblem | None
    assessed: ModelAssessment | None  # errors of the written files; None of a motion
    diagnosis: DiagnosisResult
    model: ArmStiffness | None  # the extended one, where it is one
    page: DiagnosisPageData
    result: DiagnosisDocument


def build_computation(
    request: DiagnoseRequest,
    cell: Cell,
    diagnosed_recording: DiagnosedRecording,
    assessed: ModelAssessment | None,
    model: ArmStiffness | None,
    result: DiagnosisDocument,
    facts: Mapping[str, object],
) -> DiagnoseComputation:
    """Return the computation of a finished diagnosis, with its page.

    Args:
        request: The validated request.
        cell: The robot cell.
        diagnosed_recording: The diagnosed recording.
        assessed: Errors of the written files; None of a motion.
        model: The extended model; None without one.
        result: The document.
        facts: Options and hashes of input files for the page.
    """
    d = diagnosed_recording.diagnosis
    scene = None if diagnosed_recording.recording.kind == "motion" else build_cell_scene(cell)[0]
    page = build_diagnosis_page_data(
        cell,
        diagnosed_recording.recording,
        d,
        tuple((k, format_option_value(v)) for k, v in facts.items()),
        result.effect_on_job,
        problem=diagnosed_recording.problem,
        scene=scene,
    )
    return DiagnoseComputation(
        request=request,
        cell=cell,
        recording=diagnosed_recording.recording,
        problem=diagnosed_recording.problem,
        assessed=assessed,
        diagnosis=d,
        model=model,
        page=page,
        result=result,
    )


def write_diagnosis_files(done: DiagnoseComputation, folder: Path, progress: Progress = lambda _: None) -> None:
    """Write the files into an empty folder.

    Args:
        done: Result of the computation.
        folder: The empty folder.
        progress: Called with the name of each stage when it begins.
    """
    request = done.request
    progress("writing the model and tables")
    write_stiffness_file(folder, done.model)
    write_kinematics_file(folder, done.cell, done.diagnosis)
    if done.assessed is not None:
        write_assessed_files(folder, done.assessed)
        check_written_errors(folder, done.cell, done.diagnosis, done.assessed)
    write_residual_table(folder / "residuals.csv", done.recording, done.diagnosis, done.problem)
    progress("report")
    write_diagnosis_page(folder / "report.html", done.page)
    write_result(folder / "diagnosis.json", done.result)
    read = [build_manifest_file(f, "terms") for f in request.terms]
    read += [] if request.toolpath is None else [build_manifest_file(request.toolpath, "toolpath")]
    write_command_manifest(
        folder,
        "diagnose",
        request,
        done.cell,
        verdict=done.result.verdict,
        inputs=(*list_recording_inputs(request.recordings), *read),
    )
