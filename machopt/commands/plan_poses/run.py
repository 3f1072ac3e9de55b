"""``machopt plan-poses``: poses and loads to measure for a wanted accuracy of the stiffness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.commands.input_hashes import build_manifest_file, list_recording_inputs
from machopt.commands.manifest import write_command_manifest
from machopt.commands.plan_poses.computation import PlanPosesComputation, compute_pose_plan
from machopt.commands.request_output_folder import open_request_folder
from machopt.data_types.documents.pose_plan_document import PosesDocument
from machopt.data_types.manifest import ManifestFile
from machopt.measurement.design.request import PosesRequest, list_unchecked_conditions
from machopt.output import write_result
from machopt.output.tables.measurement_poses_table import write_poses_csv, write_recording_template
from machopt.report.pages.pose_plan_page import write_pose_plan_page

__all__ = ["PlanPosesResult", "PosesRequest", "run_plan_poses"]


@dataclass(frozen=True)
class PlanPosesResult:
    """Result of ``machopt plan-poses``; ``exit_code`` is 0, or 3 where no pose can be measured."""

    exit_code: int
    result: PosesDocument
    report: Path
    message: str  # one sentence for the user


def run_plan_poses(request: PosesRequest, progress: Callable[[str], None] = lambda _: None) -> PlanPosesResult:
    """Plan load tests and write them out.

    Args:
        request: cell, output folder and options.
        progress: called with each stage, in words.

    Returns:
        The result; ``poses.csv``, ``recording_template/``, ``plan.json`` and ``report.html`` are in the folder. Without
        a single admissible load test only the last two are, and say why.

    Raises:
        InputError: bad cell, option or output folder.
    """
    with open_request_folder(request) as folder:
        done = compute_pose_plan(request, progress)
        write_pose_plan_files(done, folder, progress)
    return PlanPosesResult(done.exit_code, done.result, request.out / "report.html", done.message)


def write_pose_plan_files(
    done: PlanPosesComputation, folder: Path, progress: Callable[[str], None] = lambda _: None
) -> None:
    """Write the files into an empty folder.

    Args:
        done: Result of the computation.
        folder: The empty folder.
        progress: Called with the name of each stage when it begins.
    """
    request = done.request
    if done.table is not None:
        write_poses_csv(folder / "poses.csv", done.table)
    if done.template is not None:
        write_recording_template(folder / "recording_template", done.template)
    progress("report")
    write_pose_plan_page(folder / "report.html", done.page)
    write_result(folder / "plan.json", done.result)
    write_command_manifest(
        folder,
        "plan-poses",
        request,
        done.cell,
        verdict=done.verdict,
        exit_code=done.exit_code,
        inputs=_list_input_files(request),
        unchecked=list_unchecked_conditions(request),
    )


def _list_input_files(request: PosesRequest) -> tuple[ManifestFile, ...]:
    """Return the input files of a plan other than its cell."""
    found: tuple[ManifestFile, ...] = ()
    if request.discriminate is not None:
        found = list_recording_inputs([request.discriminate], "diagnosis")
    found += () if request.toolpath is None else (build_manifest_file(request.toolpath, "toolpath"),)
    return (*found, *(build_manifest_file(f, "effects") for f in request.effects))
