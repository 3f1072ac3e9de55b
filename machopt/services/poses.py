"""``machopt plan-poses``: which poses and loads to measure so that the stiffness is known as well as wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.design.asked import (
    PosesRequest,
    unchecked_poses,
)
from machopt.domain.manifest import ManifestFile
from machopt.domain.results.poses import PosesResult
from machopt.effects.own import in_use, with_effects
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.formats.poses import write_poses_csv, write_recording_template
from machopt.output import output_folder, write_result
from machopt.report.poses_page import write_poses_page
from machopt.services.inputs import paths_read, recording_inputs, single
from machopt.services.manifest import write_command_manifest
from machopt.services.poses_planned import Planned, planned

__all__ = ["PosesOutcome", "PosesRequest", "run_plan_poses"]


@dataclass(frozen=True)
class PosesOutcome:
    """What came out; ``exit_code`` is 0, or 3 where no pose can be measured."""

    exit_code: int
    result: PosesResult
    report: Path
    message: str  # one sentence for the user


def run_plan_poses(request: PosesRequest, progress: Callable[[str], None] = lambda _: None) -> PosesOutcome:
    """Plan load tests and write them out.

    Args:
        request: cell, output folder and options.
        progress: told what is being done, in words.

    Returns:
        The result; ``poses.csv``, ``recording_template/``, ``plan.json`` and ``report.html`` are in the folder. Without
        a single admissible load test only the last two are, and say why.

    Raises:
        InputError: bad cell, option or output folder.
    """
    with (
        in_use(with_effects(request.effects)),
        output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder,
    ):
        refuse_without_pyarrow(request.tables)
        done = planned(request, progress)
        write(done, folder, progress)
    return PosesOutcome(done.exit_code, done.result, request.out / "report.html", done.message)


def write(done: Planned, folder: Path, progress: Callable[[str], None] = lambda _: None) -> None:
    """Write their files into an empty folder."""
    request = done.request
    if done.table is not None:
        write_poses_csv(folder / "poses.csv", done.table)
    if done.template is not None:
        write_recording_template(folder / "recording_template", done.template)
    progress("report")
    write_poses_page(folder / "report.html", done.page)
    write_result(folder / "plan.json", done.result)
    write_command_manifest(
        folder,
        "plan-poses",
        request,
        done.cell,
        verdict=done.verdict,
        exit_code=done.exit_code,
        inputs=_read(request),
        unchecked=unchecked_poses(request),
    )


def _read(request: PosesRequest) -> tuple[ManifestFile, ...]:
    """What a plan was made from beside its cell."""
    found: tuple[ManifestFile, ...] = ()
    if request.discriminate is not None:
        found = recording_inputs([request.discriminate], "diagnosis")
    found += () if request.toolpath is None else (single(request.toolpath, "toolpath"),)
    return (*found, *(single(f, "effects") for f in request.effects))
