"""The manifest of a command: what it was asked and by what it works, before anything is made."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import machopt
from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest, ManifestFile
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.formats.options import options_as_user
from machopt.formats.posts.densify import Tolerance
from machopt.job.inputs import cell_inputs, distinct, single
from machopt.job.reading import reading_as_user
from machopt.job.scope import checked, unchecked

ROLES = {"points.csv": "points", "trajectory.csv": "trajectory", "compensation.csv": "compensation",
         "result.json": "result", "report.html": "report"}  # fmt: skip
_LIBRARIES = ("numpy", "scipy", "numba", "pin", "coal", "python-fcl", "trimesh")  # whose numbers are in the output


def optimize_manifest(
    cell: Cell, toolpath_file: Path, toolpath: Toolpath, options: PlanOptions, *, reading: Mapping[str, Any],
    plan_file: Path | None, post_files: Sequence[Path], tolerance: Tolerance,
) -> Manifest:  # fmt: skip
    """The manifest of one plan; files, programs and verdict follow when they are there."""
    read = single(toolpath_file, "toolpath")
    named = [ManifestFile(read.name, "toolpath", toolpath.sha256 or read.sha256, read.size)]
    named += [single(plan_file, "plan")] if plan_file is not None else []
    named += [single(f, "post") for f in post_files]
    return Manifest(
        command="optimize", verdict="", exit_code=0, versions=versions(),
        inputs=distinct((*cell_inputs(cell), *named)), options=options_as_user(options),
        reading=reading_as_user(reading), program_tolerance_mm=float(f"{1e3 * tolerance.position:.12g}"),
        checked=checked(options), unchecked=unchecked(cell, options),
    )  # fmt: skip


def versions() -> dict[str, str]:
    """machopt, Python and the libraries that the numbers come from."""
    out = {"machopt": machopt.__version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            out[name] = "not installed as a package"
    return out
