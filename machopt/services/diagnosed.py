"""A diagnosis in memory, and its files: everything that ``machopt diagnose`` computes before it writes the first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.diagnose.nouns.asked import DiagnoseRequest
from machopt.diagnose.nouns.problem import Problem
from machopt.diagnose.nouns.result import Diagnosis
from machopt.domain.cell import Cell
from machopt.domain.recording import Recording
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.domain.stiffness import Stiffness
from machopt.output import write_result
from machopt.report.diagnosis import DiagnosisPage
from machopt.report.diagnosis_page import write_diagnosis
from machopt.services.diagnose_files import write_corrections, write_model, write_residuals
from machopt.services.inputs import recording_inputs, single
from machopt.services.manifest import write_command_manifest

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Diagnosed:
    """A diagnosis in memory: nothing of it is written yet."""

    request: DiagnoseRequest
    cell: Cell
    recording: Recording
    problem: Problem | None
    diagnosis: Diagnosis
    model: Stiffness | None  # the extended one, where it is one
    page: DiagnosisPage
    result: DiagnosisResult


def write(done: Diagnosed, folder: Path, progress: Progress = lambda _: None) -> None:
    """Write its files into an empty folder."""
    request = done.request
    progress("writing the model and tables")
    write_model(folder, done.model)
    write_corrections(folder, done.cell, done.diagnosis)
    write_residuals(folder / "residuals.csv", done.recording, done.diagnosis, done.problem)
    progress("report")
    write_diagnosis(folder / "report.html", done.page)
    write_result(folder / "diagnosis.json", done.result)
    read = [single(f, "terms") for f in request.terms]
    read += [] if request.toolpath is None else [single(request.toolpath, "toolpath")]
    write_command_manifest(
        folder,
        "diagnose",
        request,
        done.cell,
        verdict=done.result.verdict,
        inputs=(*recording_inputs(request.recordings), *read),
    )
