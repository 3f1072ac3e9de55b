"""Manifest of a command: its inputs, options and program version, before output files are made."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from machopt.commands.input_hashes import build_manifest_file, list_cell_inputs, rename_duplicate_names
from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest, ManifestFile, add_scope_to_verdict
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.parquet_tables import write_parquet_copies
from machopt.options.plan_option_reader import format_user_options
from machopt.output import write_manifest
from machopt.output.file_roles import ROLES
from machopt.output.json_files import convert_to_json_types
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.toolpath.reading_options import format_reading_options
from machopt.verification.folder import verification_scope
from machopt.version import __version__

_REQUEST_PATH_FIELDS = (
    "cell",
    *("out", "overwrite"),
    "recordings",
    "recording",
    "toolpath",
    "toolpaths",
    "measured",
    "plan_file",
    "process",
    "discriminate",
    "effects",
    "tables",
)  # inputs, by hash; and how files are written, which they show
_LIBRARIES = ("numpy", "scipy", "numba", "pin", "coal", "python-fcl", "trimesh")  # whose numbers are in the output


@dataclass(frozen=True, kw_only=True)
class JobFiles:
    """Input files of one plan, other than those of the cell."""

    toolpath: Path
    plan: Path | None  # plan file with options; None without one
    posts: Sequence[Path]  # template files of posts
    effects: Sequence[Path] = ()  # files with user-defined effects


def build_optimize_manifest(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    files: JobFiles,
    *,
    reading: Mapping[str, Any],
    tolerance: ProgramTolerance,
) -> FolderManifest:
    """Return the manifest of one plan; files, programs and verdict are added later.

    Args:
        cell: The robot cell.
        toolpath: The toolpath, points in the workpiece frame, SI.
        options: The planning options in force.
        files: The input files other than those of the cell.
        reading: Reading options of the toolpath that differ from the default.
        tolerance: The tolerance between program and motion.
    """
    read = build_manifest_file(files.toolpath, "toolpath")
    named = [ManifestFile(read.name, "toolpath", toolpath.sha256 or read.sha256, read.size)]
    named += [build_manifest_file(files.plan, "plan")] if files.plan is not None else []
    named += [build_manifest_file(f, "post") for f in files.posts]
    named += [build_manifest_file(f, "effects") for f in files.effects]
    return FolderManifest(
        command="optimize",
        verdict="",
        exit_code=0,
        versions=read_library_versions(),
        inputs=rename_duplicate_names((*list_cell_inputs(cell), *named)),
        reading=format_reading_options(reading),
        program_tolerance_mm=float(f"{1e3 * tolerance.position:.12g}"),
        **list_option_fields(cell, options, toolpath),
    )


def list_option_fields(cell: Cell, options: PlanOptions, toolpath: Toolpath) -> dict[str, Any]:
    """Return the manifest fields that depend on the options; they change where a plan is steered.

    Args:
        cell: The robot cell.
        options: The planning options in force.
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    given_options = {
        "checked": verification_scope.list_checked(options),
        "unchecked": verification_scope.list_unchecked(cell, options, toolpath),
    }
    return {
        "options": format_user_options(options),
        "not_recomputed": verification_scope.NOT_RECOMPUTED,
        **given_options,
    }


def write_command_manifest(
    folder: Path,
    command: str,
    request: object,
    cell: Cell,
    *,
    verdict: str,
    exit_code: int = 0,
    inputs: Iterable[ManifestFile] = (),
    unchecked: Iterable[str] = (),
) -> None:
    """Write manifest.json of a command that plans no toolpath, after all its other files.

    Args:
        folder: The output folder.
        command: Name of the command.
        request: Dataclass of the command; its fields except paths are the options.
        cell: The robot cell.
        verdict: Verdict in words.
        exit_code: Exit code of the command.
        inputs: Input files other than those of the cell.
        unchecked: What was not checked.
    """
    if getattr(request, "tables", "csv") == "parquet":
        write_parquet_copies(folder.glob("*.csv"))
    options = {f.name: getattr(request, f.name) for f in fields(request) if f.name not in _REQUEST_PATH_FIELDS}  # type: ignore[arg-type]
    manifest = FolderManifest(
        command=command,
        verdict=add_scope_to_verdict(verdict, unchecked),
        exit_code=exit_code,
        versions=read_library_versions(),
        inputs=rename_duplicate_names((*list_cell_inputs(cell), *inputs)),
        options=convert_to_json_types(options),
        unchecked=tuple(unchecked),
    )
    write_manifest(folder, manifest, ROLES)


def read_library_versions() -> dict[str, str]:
    """Return the versions of machopt, Python and the numerical libraries."""
    out = {"machopt": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed as a package"
    return out
