"""Options for the verification of a folder: the user's, else those of the manifest, else those of the cell."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.cell.work_offsets import place_toolpath
from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options, load_options
from machopt.output.json_files import convert_to_json_types
from machopt.programs.program_to_toolpath import ProgramRobot
from machopt.toolpath.reading_options import format_reading_options, parse_reading_options
from machopt.toolpath.unknown_words import read_for_plan
from machopt.verification import VerificationCheck
from machopt.verification.check_results import CheckName

MISSING_VALUE = float("nan")


@dataclass(frozen=True, kw_only=True)
class VerifyRequest:
    """Request of ``machopt verify``; missing values come from the folder's manifest."""

    cell: Path
    toolpath: Path
    out: Path
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of read_toolpath that were given
    allow_external: bool = False
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own
    process: Path | None = None  # a process.yaml in place of the cell's own


@dataclass(frozen=True)
class OptionsInForce:
    """Options and toolpath that a folder is compared with."""

    options: PlanOptions
    toolpath: Toolpath
    notes: tuple[str, ...] = ()  # options that the user gave and the folder was not made with
    checks: tuple[VerificationCheck, ...] = ()  # wrong records of the manifest


def resolve_options_in_force(
    request: VerifyRequest, cell: Cell, robot: ProgramRobot | None, manifest: FolderManifest | None
) -> OptionsInForce:
    """Return the options and the toolpath. A wrong entry of the manifest is a failed check, and the default is used
    instead.

    Args:
        request: The request of ``machopt verify``.
        cell: The robot cell.
        robot: Robot for joint targets; None where the cell has none.
        manifest: The manifest of the folder; None where it cannot be read.

    Raises:
        InputError: the toolpath or an option that the user gave is wrong.
    """
    recorded = {} if manifest is None else manifest.options
    given = {k: v for k, v in request.reading.items() if v not in (None, False)}
    from_cell: dict[str, Any] = {"robot": robot, "cell_offsets": tuple(cell.offsets)}
    checks: list[VerificationCheck] = []
    below, reading = cell.plan, dict[str, Any]()
    if manifest is not None:
        try:
            load_options(dict(recorded))
            below = dict(recorded)
        except InputError as problem:
            checks.append(build_failed_check(CheckName.OPTIONS, f"the manifest's cannot be used: {problem.reason}"))
        try:
            reading = parse_reading_options(manifest.reading)
            toolpath = read_for_plan(request.toolpath, {**from_cell, **reading, **given})
        except InputError as problem:
            checks.append(
                build_failed_check(CheckName.READING, f"the toolpath cannot be read with the manifest's: {problem}")
            )
            reading = {}
    if not reading:
        toolpath = read_for_plan(request.toolpath, {**from_cell, **given})
    options = load_options(below, request.plan_file, list(request.overrides))
    notes = (
        _list_contradictions(convert_to_json_types(format_user_options(options)), below)
        if manifest is not None and not checks
        else []
    )
    notes += (
        _list_contradictions(format_reading_options(given), format_reading_options(reading))
        if manifest is not None
        else []
    )
    return OptionsInForce(options, place_toolpath(toolpath, cell), tuple(notes), tuple(checks))


def build_failed_check(name: str, why: str, *, because: InputError | None = None) -> VerificationCheck:
    """Return a check that failed without a number.

    Args:
        name: Name of the check.
        why: Reason of the failure.
        because: Error of the file that could not be read.
    """
    return VerificationCheck(
        name=name,
        passed=False,
        value=MISSING_VALUE,
        limit=MISSING_VALUE,
        unit="",
        where=why,
        because=get_error_file(because),
    )


def get_error_file(problem: InputError | None) -> str:
    """Return the name of the file that an error names; empty where it names none.

    Args:
        problem: The error.
    """
    return "" if problem is None or problem.file is None else Path(problem.file).name


def _list_contradictions(used: dict[str, Any], recorded: dict[str, Any]) -> list[str]:
    return [
        f"{key} = {used[key]} here, but the folder was made with {recorded.get(key, 'none')}"
        for key in used
        if used[key] != recorded.get(key)
    ]
