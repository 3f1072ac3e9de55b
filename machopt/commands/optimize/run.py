"""``machopt optimize``: motion, program, tables, verdict and report from a cell and a CAM file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.commands.input_hashes import list_request_paths
from machopt.commands.optimize.computation import compute_optimize_plan
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import VerificationError
from machopt.output import write_output_folder
from machopt.planning.kernel_precompilation import preload_kernels_in_thread
from machopt.planning.pipeline.planning_setup import StageTimings

if TYPE_CHECKING:
    from machopt.data_types.documents.optimize_document import OptimizeDocument

OUTPUT_MODULE = "machopt.commands.optimize.verified_files"  # loaded in parallel to the plan, which does not need it


@dataclass(frozen=True)
class OptimizeResult:
    """Result of ``machopt optimize``; ``exit_code`` is 0, 3 or 4."""

    exit_code: int
    result: OptimizeDocument
    report: Path
    conflict: str = ""  # conflicting steering rules, in words


def find_failed_joint_result(result: OptimizeDocument) -> str:
    """Return why a joint result of method joint must not be driven; empty where it may, or where there is none.

    Args:
        result: The content of result.json.
    """
    if result.exit_code != VerificationError.exit_code or not any(entry.accepted for entry in result.joint or ()):
        return ""
    checks = () if result.verification is None else result.verification.checks
    failed = [check.name for check in checks if check.passed is False]
    return f"its verification failed: {failed[0]}" if failed else "its verification failed"


def remove_written_files(folder: Path) -> None:
    """Empty the temporary output folder.

    Args:
        folder: The folder.
    """
    for entry in folder.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def run_optimize(request: OptimizeRequest, progress: Callable[[str], None] = lambda _: None) -> OptimizeResult:
    """Plan, verify and write the result of one job.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, toolpath, options or output folder.
    """
    with activate_user_effects(load_effect_files(request.effects)):
        timings = StageTimings(progress=progress)
        with preload_kernels_in_thread(OUTPUT_MODULE):
            with timings.stage("load"):
                given = load_optimize_inputs(request)
            with write_output_folder(
                request.out, force=request.overwrite, inputs=list_request_paths(request)
            ) as folder:
                the_plan = compute_optimize_plan(given, timings)
                from machopt.commands.optimize.verified_files import write_verified_files

                result = write_verified_files(the_plan, folder).result
                failed = find_failed_joint_result(result)
                if failed:  # the fixed path in its place
                    remove_written_files(folder)
                    the_plan = compute_optimize_plan(given, timings, refused=failed)
                    result = write_verified_files(the_plan, folder).result
    return OptimizeResult(result.exit_code, result, request.out / "report.html", the_plan.job_result.plan.conflict)
