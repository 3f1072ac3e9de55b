"""``machopt optimize``: motion, program, tables, verdict and report from a cell and a CAM file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.commands.input_hashes import list_request_paths
from machopt.commands.optimize.computation import compute_optimize_plan
from machopt.commands.optimize.request import OptimizeRequest, load_optimize_inputs
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.output import write_output_folder
from machopt.planning.compiled_kernels import preload_kernels_in_thread
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
    return OptimizeResult(result.exit_code, result, request.out / "report.html", the_plan.job_result.plan.conflict)
