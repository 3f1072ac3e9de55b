"""``machopt identify``: from a cell and load tests to a stiffness file with its uncertainty, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.domain.results.identification import IdentificationResult
from machopt.effects.own import in_use, with_effects
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.formats.readings import write_readings_csv
from machopt.formats.stiffness import write_stiffness
from machopt.identify.asked import IdentifyRequest
from machopt.identify.result import Identification
from machopt.output import output_folder, write_result
from machopt.report.display import in_words
from machopt.report.gather.identify import page_of
from machopt.report.identification_page import write_identification
from machopt.services.identified import Identified, identified
from machopt.services.inputs import paths_read, recording_inputs, single
from machopt.services.manifest import write_command_manifest


@dataclass(frozen=True)
class IdentifyOutcome:
    """What came out."""

    identification: Identification
    result: IdentificationResult
    report: Path


def run_identify(request: IdentifyRequest, progress: Callable[[str], None] = lambda _: None) -> IdentifyOutcome:
    """Identify the stiffness of a cell's robot from one or several recordings.

    Raises:
        InputError: bad cell, recording, options or output folder; a record that cannot be right.
    """
    with (
        in_use(with_effects(request.effects)),
        output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder,
    ):
        refuse_without_pyarrow(request.tables)
        done = identified(request, progress)
        write(done, folder, progress)
    return IdentifyOutcome(done.identification, done.result, request.out / "report.html")


def write(done: Identified, folder: Path, progress: Callable[[str], None] = lambda _: None) -> None:
    """Write its files into an empty folder."""
    progress("writing stiffness and tables")
    request, cell, tests, found = done.request, done.cell, done.tests, done.identification
    write_stiffness(folder / "stiffness.yaml", found.stiffness)
    t = found.table
    write_readings_csv(
        folder / "readings.csv",
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
    progress("report")
    write_identification(folder / "report.html", page_of(cell, done.recording, tests, found, _facts(done.result)))
    write_result(folder / "identification.json", done.result)
    read = (*recording_inputs(request.recordings), *(single(f, "effects") for f in request.effects))
    write_command_manifest(folder, "identify", request, cell, verdict="identified", inputs=read)


def _facts(result: IdentificationResult) -> tuple[tuple[str, str], ...]:
    noise: dict[str, float | None] = result.noise_mm.plain()
    rows = [(name, in_words(value)) for name, value in result.options.plain().items()]
    rows += [
        (f"noise shared by a {name}" if name != "reading" else "noise of a reading", f"{value:.4f} mm")
        for name, value in noise.items()
        if value is not None
    ]
    rows += [("note", text) for text in result.notes]
    rows += list(result.inputs.items())
    return tuple(rows)
