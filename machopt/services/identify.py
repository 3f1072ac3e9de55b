"""``machopt identify``: from a cell and load tests to a stiffness file with its uncertainty, and a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.domain.recording import Recording
from machopt.domain.results.identification import IdentificationResult
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.readings import write_readings_csv
from machopt.formats.recording import load_recording, load_recordings
from machopt.formats.stiffness import write_stiffness
from machopt.formats.termtext import term_from_text
from machopt.identify.asked import Request, check, options_of
from machopt.identify.experiment import experiment
from machopt.identify.pipeline import identify
from machopt.identify.result import Identification
from machopt.identify.told import result_of
from machopt.model.linkage import refuse_linked
from machopt.model.robot import load_masses, load_robot
from machopt.model.terms import compile_terms
from machopt.output import output_folder, write_result
from machopt.report.gather.identify import page_of
from machopt.report.identification_page import write_identification
from machopt.services.inputs import input_hashes, recording_inputs, single
from machopt.services.manifest import write_command_manifest


@dataclass(frozen=True)
class Outcome:
    """What came out."""

    identification: Identification
    result: IdentificationResult
    report: Path


def run_identify(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Identify the stiffness of a cell's robot from one or several recordings.

    Raises:
        InputError: bad cell, recording, options or output folder; a record that cannot be right.
    """
    with in_use(with_effects(request.effects)):
        return _identify(request, progress)


def _identify(request: Request, progress: Callable[[str], None]) -> Outcome:
    check(request)
    options = options_of(request, tuple(term_from_text(t) for t in request.terms))
    progress("reading cell and recording")
    cell = load_cell(request.cell, allow_external=request.allow_external)
    recording = _recording(request.recordings)
    refuse_linked(cell, "identify")
    robot = load_robot(cell)
    tests = experiment(recording, robot, cell.tool.T_flange_tcp)
    for text, term in zip(request.terms, options.terms, strict=True):
        try:
            compile_terms((term,), robot, cell.tool.T_flange_tcp)
        except InputError as problem:
            raise InputError(problem.reason, where=f"--fit {text}") from None
    masses = load_masses(cell) if options.geometric else None
    with output_folder(request.out) as folder:
        progress("identifying")
        found = identify(
            tests, robot, cell.tool.T_flange_tcp, cell.stiffness, options, np.random.default_rng(options.seed), masses
        )
        progress("writing stiffness and tables")
        result = result_of(request, cell, recording, found, input_hashes(cell, request.recordings))
        write_stiffness(folder / "stiffness.yaml", found.stiffness)
        t = found.table
        write_readings_csv(
            folder / "readings.csv",
            pose=tests.pose,
            cycle=recording.cycle,
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
        write_identification(folder / "report.html", page_of(cell, recording, tests, found, _facts(result)))
        write_result(folder / "identification.json", result)
        read = (*recording_inputs(request.recordings), *(single(f, "effects") for f in request.effects))
        write_command_manifest(folder, "identify", request, cell, verdict="identified", inputs=read)
    return Outcome(found, result, request.out / "report.html")


def _recording(paths: tuple[Path, ...]) -> Recording:
    return load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)


def _facts(result: IdentificationResult) -> tuple[tuple[str, str], ...]:
    noise: dict[str, float | None] = result.noise_mm.plain()
    rows = [(name, str(value)) for name, value in result.options.plain().items()]
    rows += [
        (f"noise shared by a {name}" if name != "reading" else "noise of a reading", f"{value:.4f} mm")
        for name, value in noise.items()
        if value is not None
    ]
    rows += [("note", text) for text in result.notes]
    rows += list(result.inputs.items())
    return tuple(rows)
