"""With which options a folder is verified: the user's where given, else its manifest's, else the cell's own."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.errors import InputError
from machopt.formats.options import load_options, options_as_user
from machopt.formats.programs.toolpath import KnownRobot
from machopt.formats.reading import reading_as_user, reading_from_user
from machopt.formats.setups import placed
from machopt.formats.unknownwords import read_for_plan
from machopt.output.jsonfile import plain
from machopt.verify import Check
from machopt.verify.check import Promise

NAN = float("nan")


@dataclass(frozen=True, kw_only=True)
class VerifyRequest:
    """What the user asked for; what was not given is taken from the folder's manifest."""

    cell: Path
    toolpath: Path
    out: Path
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of read_toolpath that were given
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own


@dataclass(frozen=True)
class InForce:
    """What a folder is held against."""

    options: PlanOptions
    toolpath: Toolpath
    notes: tuple[str, ...] = ()  # options that the user gave and the folder was not made with
    checks: tuple[Check, ...] = ()  # what the manifest records and nobody can use


def in_force(request: VerifyRequest, cell: Cell, robot: KnownRobot | None, manifest: Manifest | None) -> InForce:
    """Options and toolpath; what a manifest records wrongly is a failed check, and the defaults stand in for it.

    Raises:
        InputError: the toolpath or an option that the user gave is wrong.
    """
    recorded = {} if manifest is None else manifest.options
    given = {k: v for k, v in request.reading.items() if v not in (None, False)}
    checks: list[Check] = []
    below, reading = cell.plan, dict[str, Any]()
    if manifest is not None:
        try:
            load_options(dict(recorded))
            below = dict(recorded)
        except InputError as problem:
            checks.append(failed(Promise.OPTIONS, f"the manifest's cannot be used: {problem.reason}"))
        try:
            reading = reading_from_user(manifest.reading)
            toolpath = read_for_plan(
                request.toolpath, robot=robot, cell_offsets=tuple(cell.offsets), **{**reading, **given}
            )
        except InputError as problem:
            checks.append(failed(Promise.READING, f"the toolpath cannot be read with the manifest's: {problem}"))
            reading = {}
    if not reading:
        toolpath = read_for_plan(request.toolpath, robot=robot, cell_offsets=tuple(cell.offsets), **given)
    options = load_options(below, request.plan_file, list(request.overrides))
    notes = _contradictions(plain(options_as_user(options)), below) if manifest is not None and not checks else []
    notes += _contradictions(reading_as_user(given), reading_as_user(reading)) if manifest is not None else []
    return InForce(options, placed(toolpath, cell), tuple(notes), tuple(checks))


def failed(name: str, why: str, *, because: InputError | None = None) -> Check:
    """A check that failed without a number; ``because`` of a file that could not be read."""
    return Check(name=name, passed=False, value=NAN, limit=NAN, unit="", where=why, because=file_of(because))


def file_of(problem: InputError | None) -> str:
    """Name of the file that a problem is about; empty where it is about none."""
    return "" if problem is None or problem.file is None else Path(problem.file).name


def _contradictions(used: dict[str, Any], recorded: dict[str, Any]) -> list[str]:
    return [
        f"{key} = {used[key]} here, but the folder was made with {recorded.get(key, 'none')}"
        for key in used
        if used[key] != recorded.get(key)
    ]
