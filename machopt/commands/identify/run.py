"""``machopt identify``: a stiffness file with uncertainty from a cell and load tests, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.stiffness.stiffness_file import write_stiffness
from machopt.commands.identify.computation import IdentifyComputation, compute_identification
from machopt.commands.input_hashes import build_manifest_file, list_recording_inputs
from machopt.commands.manifest import write_command_manifest
from machopt.commands.request_output_folder import open_request_folder
from machopt.data_types.documents.identification_document import IdentificationDocument
from machopt.measurement.identification.identification_result import IdentificationResult
from machopt.measurement.identification.request import IdentifyRequest
from machopt.output import write_result
from machopt.output.tables.readings_table import ReadingsTable, write_readings_csv
from machopt.report.page_data.identification import build_identification_page_data
from machopt.report.page_types.display_units import format_option_value
from machopt.report.pages.identification_page import write_identification_page


@dataclass(frozen=True)
class IdentifyResult:
    """Result of ``machopt identify``."""

    identification: IdentificationResult
    result: IdentificationDocument
    report: Path


def run_identify(request: IdentifyRequest, progress: Callable[[str], None] = lambda _: None) -> IdentifyResult:
    """Identify the stiffness of a cell's robot from one or several recordings.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, recording, options or output folder; a record that cannot be right.
    """
    with open_request_folder(request) as folder:
        done = compute_identification(request, progress)
        write_identification_files(done, folder, progress)
    return IdentifyResult(done.identification, done.result, request.out / "report.html")


def write_identification_files(
    done: IdentifyComputation, folder: Path, progress: Callable[[str], None] = lambda _: None
) -> None:
    """Write the files into an empty folder.

    Args:
        done: Result of the computation.
        folder: The empty folder.
        progress: Called with the name of each stage when it begins.
    """
    progress("writing stiffness and tables")
    request, cell, tests, found = done.request, done.cell, done.tests, done.identification
    write_stiffness(folder / "stiffness.yaml", found.stiffness)
    t = found.table
    table = ReadingsTable(
        pose=tests.pose,
        cycle=done.recording.cycle,
        session=tests.session,
        line=tests.line,
        wrench=tests.wrench,
        measured=t.measured,
        predicted=t.predicted,
        heldout=t.measured - t.heldout,
        uncertainty=t.uncertainty,
        weight=t.weight,
        leverage=found.influence.leverage,
    )
    write_readings_csv(folder / "readings.csv", table)
    progress("report")
    write_identification_page(
        folder / "report.html",
        build_identification_page_data(cell, done.recording, tests, found, _list_page_facts(done.result)),
    )
    write_result(folder / "identification.json", done.result)
    read = (*list_recording_inputs(request.recordings), *(build_manifest_file(f, "effects") for f in request.effects))
    write_command_manifest(folder, "identify", request, cell, verdict="identified", inputs=read)


def _list_page_facts(result: IdentificationDocument) -> tuple[tuple[str, str], ...]:
    noise: dict[str, float | None] = result.noise_mm.to_json_types()
    rows = [(name, format_option_value(value)) for name, value in result.options.to_json_types().items()]
    rows += [
        (f"noise shared by a {name}" if name != "reading" else "noise of a reading", f"{value:.4f} mm")
        for name, value in noise.items()
        if value is not None
    ]
    rows += [("note", text) for text in result.notes]
    rows += list(result.inputs.items())
    return tuple(rows)
