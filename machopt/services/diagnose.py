"""``machopt diagnose``: from a cell and a recording to what the model leaves out, the extended model, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.diagnose.asked import Request
from machopt.diagnose.result import Diagnosis
from machopt.domain.results.diagnosis import DiagnosisResult
from machopt.effects.own import in_use, run
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.output import output_folder, write_result
from machopt.report.diagnosis_page import write_diagnosis
from machopt.services.diagnose_files import (
    write_corrections,
    write_model,
    write_residuals,
)
from machopt.services.diagnosed import Diagnosed, diagnosed
from machopt.services.inputs import recording_inputs, single
from machopt.services.manifest import write_command_manifest

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What came out."""

    diagnosis: Diagnosis
    result: DiagnosisResult
    report: Path


def run_diagnose(request: Request, progress: Progress = lambda _: None) -> Outcome:
    """Diagnose a recording of a cell's robot.

    Raises:
        InputError: bad cell, recording, laws or output folder.
    """
    own = run(request.terms)
    with in_use(own), output_folder(request.out) as folder:
        refuse_without_pyarrow(request.tables)
        done = diagnosed(request, own, progress)
        write(done, folder, progress)
    return Outcome(done.diagnosis, done.result, request.out / "report.html")


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
