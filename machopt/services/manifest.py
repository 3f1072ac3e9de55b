"""The manifest of a command: what it was asked and by what it works, before anything is made."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from machopt.domain.cell import Cell
from machopt.domain.manifest import Covered, Manifest, ManifestFile, with_scope
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.formats.options import options_as_user
from machopt.formats.parquet import write_beside
from machopt.formats.posts.densify import Tolerance
from machopt.formats.reading import reading_as_user
from machopt.output import write_manifest
from machopt.output.jsonfile import plain
from machopt.output.roles import ROLES
from machopt.recheck import scope
from machopt.services.inputs import cell_inputs, distinct, single
from machopt.version import __version__

_PLACES = (
    "cell",
    *("out", "overwrite"),
    "recordings",
    "toolpath",
    "toolpaths",
    "measured",
    "plan_file",
    "discriminate",
    "effects",
    "tables",
)  # inputs, by hash; and how files are written, which they show
_LIBRARIES = ("numpy", "scipy", "numba", "pin", "coal", "python-fcl", "trimesh")  # whose numbers are in the output


def optimize_manifest(
    cell: Cell,
    toolpath_file: Path,
    toolpath: Toolpath,
    options: PlanOptions,
    *,
    reading: Mapping[str, Any],
    plan_file: Path | None,
    post_files: Sequence[Path],
    effects: Sequence[Path] = (),
    tolerance: Tolerance,
) -> Manifest:
    """The manifest of one plan; files, programs and verdict follow when they are there."""
    read = single(toolpath_file, "toolpath")
    named = [ManifestFile(read.name, "toolpath", toolpath.sha256 or read.sha256, read.size)]
    named += [single(plan_file, "plan")] if plan_file is not None else []
    named += [single(f, "post") for f in post_files]
    named += [single(f, "effects") for f in effects]
    return Manifest(
        command="optimize",
        verdict="",
        exit_code=0,
        versions=versions(),
        inputs=distinct((*cell_inputs(cell), *named)),
        reading=reading_as_user(reading),
        program_tolerance_mm=float(f"{1e3 * tolerance.position:.12g}"),
        **under(cell, options, toolpath),
    )


def under(cell: Cell, options: PlanOptions, toolpath: Toolpath) -> dict[str, Any]:
    """What a manifest says of the options in force, by its fields: they change where a plan is steered."""
    said = {"checked": scope.checked(options), "unchecked": scope.unchecked(cell, options, toolpath)}
    return {"options": options_as_user(options), "not_recomputed": scope.NOT_RECOMPUTED, **said}


def write_command_manifest(
    folder: Path,
    command: str,
    request: object,
    cell: Cell,
    *,
    verdict: str,
    exit_code: int = 0,
    inputs: Iterable[ManifestFile] = (),
    checked: Iterable[Covered] = (),
    unchecked: Iterable[str] = (),
) -> None:
    """manifest.json of a command that plans no toolpath, beside everything else it wrote.

    Args:
        request: the command's own dataclass; its fields but the paths named here are the options.
        inputs: what it read beside the cell.
    """
    if getattr(request, "tables", "csv") == "parquet":
        write_beside(folder.glob("*.csv"))
    asked = {f.name: getattr(request, f.name) for f in fields(request) if f.name not in _PLACES}  # type: ignore[arg-type]
    manifest = Manifest(
        command=command,
        verdict=with_scope(verdict, unchecked),
        exit_code=exit_code,
        versions=versions(),
        inputs=distinct((*cell_inputs(cell), *inputs)),
        options=plain(asked),
        checked=tuple(checked),
        unchecked=tuple(unchecked),
    )
    write_manifest(folder, manifest, ROLES)


def versions() -> dict[str, str]:
    """machopt, Python and the libraries that the numbers come from."""
    out = {"machopt": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed as a package"
    return out
