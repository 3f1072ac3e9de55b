"""A stiffness in memory: everything that ``machopt identify`` computes before it writes its first file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.domain.cell import Cell, held_still
from machopt.domain.recording import Recording
from machopt.domain.results.identification import IdentificationResult
from machopt.domain.stiffness import Discrepancy, held_over
from machopt.errors import InputError
from machopt.estimate.experiment import Experiment, experiment
from machopt.formats.cell import load_cell
from machopt.formats.recording import load_recording, load_recordings
from machopt.formats.termtext import term_from_text
from machopt.identify.asked import IdentifyRequest, check, options_of
from machopt.identify.discrepancy import of_identified
from machopt.identify.pipeline import identify
from machopt.identify.result import Identification
from machopt.identify.told import result_of
from machopt.model.linkage import refuse_linked
from machopt.model.robot import Robot, load_masses, load_robot
from machopt.model.terms import compile_terms
from machopt.services.inputs import input_hashes


@dataclass(frozen=True, kw_only=True)
class Identified:
    """A stiffness in memory: nothing of it is written yet."""

    request: IdentifyRequest
    cell: Cell
    recording: Recording
    tests: Experiment
    identification: Identification
    result: IdentificationResult


def identified(request: IdentifyRequest, progress: Callable[[str], None], cell: Cell | None = None) -> Identified:
    """The stiffness.

    Args:
        request: what was asked; its ``out`` is not looked at.
        cell: where it has been read already.
    """
    check(request)
    options = options_of(request, tuple(term_from_text(t) for t in request.terms))
    progress("reading cell and recording")
    cell = load_cell(request.cell, allow_external=request.allow_external, bodies=False) if cell is None else cell
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
    progress("identifying")
    random = np.random.default_rng(options.seed)
    found = identify(tests, robot, cell.tool.T_flange_tcp, cell.stiffness, options, random, masses)
    kept = () if cell.stiffness is None else cell.stiffness.external
    placed = None if cell.stiffness is None else cell.stiffness.position
    doubt = _misfit(cell, robot, tests, found)
    found = replace(
        found,
        stiffness=replace(found.stiffness, discrepancy=doubt, external=kept, position=placed),
        warnings=(*found.warnings, *held_over(kept), *held_still(cell)),
    )
    result = result_of(request, cell, recording, found, input_hashes(cell, request.recordings))
    return Identified(request=request, cell=cell, recording=recording, tests=tests, identification=found, result=result)


def _misfit(cell: Cell, robot: Robot, tests: Experiment, found: Identification) -> Discrepancy | None:
    try:
        masses = load_masses(cell)
    except InputError:  # without weight
        masses = None
    return of_identified(found.fit, tests, robot, cell.tool.T_flange_tcp, found.stiffness, masses, cell.arm_limits)


def _recording(paths: tuple[Path, ...]) -> Recording:
    return load_recording(paths[0]) if len(paths) == 1 else load_recordings(paths)
