"""``machopt identify`` of frequency responses: stiffness.yaml, damping of the modes in process.yaml, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.cell.process_file.process_writer import write_process_modes
from machopt.cell.stiffness.stiffness_file import write_stiffness
from machopt.commands.input_hashes import compute_input_hashes, list_recording_inputs, list_request_paths
from machopt.commands.manifest import write_command_manifest
from machopt.data_types.cell import Cell
from machopt.data_types.documents.frequency_response_document import FrequencyResponseDocument
from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.kinematics.mimic_joints import check_no_mimic_joints
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.identification.frequency_response.frequency_response_document import (
    build_frequency_response_document,
    list_damping_percent,
)
from machopt.measurement.identification.frequency_response.frequency_response_result import FrequencyResponseResult
from machopt.measurement.identification.frequency_response.request import (
    FrequencyResponseRequest,
    check_frequency_response_request,
    convert_identify_request,
)
from machopt.measurement.identification.request import IdentifyRequest
from machopt.measurement.recording.frequency_response_reader import load_frequency_responses
from machopt.output import write_output_folder, write_result
from machopt.output.tables.frequency_responses_table import write_frequency_responses_csv
from machopt.report.page_types.frequency_response_page_data import FrequencyResponsePageData
from machopt.report.pages.frequency_response_page import write_frequency_response_page


@dataclass(frozen=True)
class FrequencyResponseComputation:
    """Result of an identification in memory, not written yet."""

    request: FrequencyResponseRequest
    cell: Cell
    recording: FrequencyResponseRecording
    found: FrequencyResponseResult
    result: FrequencyResponseDocument


@dataclass(frozen=True)
class FrequencyResponseRun:
    """Result of ``machopt identify`` with frequency responses."""

    result: FrequencyResponseDocument
    report: Path


def run_frequency_response_identification(
    identify_request: IdentifyRequest, progress: Callable[[str], None] = lambda _: None
) -> FrequencyResponseRun:
    """Identify joint stiffness and damping from frequency responses and write them out.

    Args:
        identify_request: Options as ``machopt identify`` has them.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, recording, options or output folder; responses that the model does not explain.
    """
    request = convert_identify_request(identify_request)
    with write_output_folder(request.out, force=request.overwrite, inputs=list_request_paths(request)) as folder:
        refuse_without_pyarrow(request.tables)
        done = compute_frequency_response_identification(request, progress)
        progress("report")
        write_frequency_response_files(done, folder)
    return FrequencyResponseRun(done.result, request.out / "report.html")


def compute_frequency_response_identification(
    request: FrequencyResponseRequest, progress: Callable[[str], None], cell: Cell | None = None
) -> FrequencyResponseComputation:
    """Identify joint stiffness and damping from frequency responses.

    Args:
        request: The request; its ``out`` is not used.
        progress: Called with the name of each stage when it begins.
        cell: The cell, if it is loaded already.

    Raises:
        InputError: bad cell, recording or options; responses that the model does not explain.
    """
    # CasADi is imported for this kind of recording only
    from machopt.measurement.identification.frequency_response.frequency_response_pipeline import (
        identify_from_responses,
    )

    check_frequency_response_request(request)
    progress("reading cell and recording")
    cell = load_cell(request.cell, allow_external=request.allow_external, bodies=False) if cell is None else cell
    recording = load_frequency_responses(request.recording)
    check_no_mimic_joints(cell, "identify")
    random, level = np.random.default_rng(request.seed), request.level_percent / 100.0
    found = identify_from_responses(recording, cell, load_robot(cell), level, random, progress)
    hashes = compute_input_hashes(cell, (request.recording,))
    result = build_frequency_response_document(request, cell, recording, found, hashes)
    return FrequencyResponseComputation(request, cell, recording, found, result)


def write_frequency_response_files(done: FrequencyResponseComputation, folder: Path) -> None:
    """Write what ``machopt identify`` writes for frequency responses.

    Args:
        done: Result of the identification.
        folder: An empty folder.
    """
    request, cell, recording, found = done.request, done.cell, done.recording, done.found
    write_stiffness(folder / "stiffness.yaml", found.stiffness)
    damping = list_damping_percent(found)
    if damping and cell.process is not None and cell.process.file is not None:
        source = f"frequency responses, recording {recording.source}"
        write_process_modes(folder / "process.yaml", cell.process.file, damping, source)
    write_frequency_responses_csv(folder / "frequency_responses.csv", recording, found.predicted)
    page = FrequencyResponsePageData(done.result, recording, found.predicted)
    write_frequency_response_page(folder / "report.html", page)
    write_result(folder / "frequency_response.json", done.result)
    inputs = list_recording_inputs((request.recording,))
    write_command_manifest(folder, "identify", request, cell, verdict="identified", inputs=inputs)
