"""``machopt process``: coefficients of a material with covariance from mean forces or waveforms, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.cell_reader import load_cell
from machopt.cell.process_file.process_writer import MeasuredCut, write_process
from machopt.commands.input_hashes import compute_input_hashes, list_recording_inputs, list_request_paths
from machopt.commands.manifest import write_command_manifest
from machopt.data_types.cell import Cell
from machopt.data_types.documents.coefficients_document import CoefficientsDocument
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.measurement.cutting.coefficient_fit import CoefficientFit
from machopt.measurement.cutting.coefficients_document import (
    build_coefficients_document,
    build_waveform_section,
    get_material_name,
)
from machopt.measurement.cutting.recording_fit import CuttingFit, fit_recording
from machopt.measurement.cutting.request import ProcessRequest, check_process_request
from machopt.measurement.recording import load_cutting_recording
from machopt.output import write_output_folder, write_result
from machopt.output.tables.cuts_table import write_cuts_csv
from machopt.report.page_types.coefficients_page_data import CoefficientsPageData
from machopt.report.pages.coefficients_page import write_coefficients_page


@dataclass(frozen=True, kw_only=True)
class ProcessComputation:
    """Result of a fit in memory, not written yet."""

    request: ProcessRequest
    cell: Cell
    found: CuttingFit
    result: CoefficientsDocument


@dataclass(frozen=True)
class ProcessResult:
    """Result of ``machopt process``."""

    fit: CoefficientFit
    result: CoefficientsDocument
    report: Path


def run_process(request: ProcessRequest, progress: Callable[[str], None] = lambda _: None) -> ProcessResult:
    """Fit the cutting coefficients of one material to measured cuts and write them out.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, recording, options or output folder; cuts that do not determine the coefficients.
    """
    with write_output_folder(request.out, force=request.overwrite, inputs=list_request_paths(request)) as folder:
        refuse_without_pyarrow(request.tables)
        done = compute_process(request, progress)
        progress("report")
        write_process_files(done, folder)
    return ProcessResult(done.found.fit, done.result, request.out / "report.html")


def compute_process(
    request: ProcessRequest, progress: Callable[[str], None], cell: Cell | None = None
) -> ProcessComputation:
    """Fit the cutting coefficients of one material to measured cuts.

    Args:
        request: The validated request; its ``out`` is not used.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.

    Raises:
        InputError: bad cell, recording or options; cuts that do not determine the coefficients.
    """
    check_process_request(request)
    progress("reading cell and recording")
    cell = load_cell(request.cell, allow_external=request.allow_external, bodies=False) if cell is None else cell
    given = load_cutting_recording(request.recording)
    progress("fitting")
    found = fit_recording(given, cell, level=request.level_percent / 100.0, keep_outliers=request.keep_outliers)
    result = build_coefficients_document(
        request, cell, found.recording, found.fit, compute_input_hashes(cell, (request.recording,))
    )
    if found.waveform is not None:
        result = result.model_copy(update={"waveform": build_waveform_section(found.recording, found.waveform)})
    return ProcessComputation(request=request, cell=cell, found=found, result=result)


def write_process_files(done: ProcessComputation, folder: Path) -> None:
    """Write process.yaml, cuts.csv, report.html, coefficients.json and manifest.json into an empty folder.

    Args:
        done: Result of the computation.
        folder: The empty folder.
    """
    found = done.found
    recording, fit, row = found.recording, found.fit, int(found.fit.used.argmax())
    side = recording.side[row]
    cut = MeasuredCut(
        spindle_speed=float(recording.spindle_speed[row]),
        spindle=recording.spindle,
        ae=found.cutter.diameter if side == "slot" else float(recording.ae[row]),
        ap=float(recording.ap[row]),
        side=side,
    )
    write_process(folder / "process.yaml", get_material_name(done.request, recording), found.coefficients, cut)
    write_cuts_csv(
        folder / "cuts.csv",
        places=[recording.format_place(row) for row in range(len(recording))],
        feed_per_tooth=fit.feed_per_tooth,
        measured=fit.measured,
        predicted=fit.predicted,
        reasons=fit.reasons,
    )
    page = CoefficientsPageData(
        document=done.result,
        feed_per_tooth=fit.feed_per_tooth,
        measured=fit.measured,
        predicted=fit.predicted,
        used=fit.used,
        waveform=found.waveform,
    )
    write_coefficients_page(folder / "report.html", page)
    write_result(folder / "coefficients.json", done.result)
    inputs = list_recording_inputs((done.request.recording,))
    write_command_manifest(folder, "process", done.request, done.cell, verdict="identified", inputs=inputs)
