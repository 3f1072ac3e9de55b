"""``machopt optimize``: from a cell and a CAM file to a folder with motion, program, tables, verdict and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from machopt.effects.own import in_use, with_effects
from machopt.output import output_folder
from machopt.plan.kernels import taken_beside
from machopt.plan.pipeline.setup import Timings
from machopt.services.inputs import paths_read
from machopt.services.load import OptimizeRequest, load
from machopt.services.planned import planned

if TYPE_CHECKING:
    from machopt.domain.results.optimize import OptimizeResult

WRITING = "machopt.services.written"  # what a plan does not need is loaded beside it


@dataclass(frozen=True)
class OptimizeOutcome:
    """What came out; ``exit_code`` is 0, 3 or 4."""

    exit_code: int
    result: OptimizeResult
    report: Path
    conflict: str = ""  # wishes that no plan keeps, in words


def optimize(request: OptimizeRequest, progress: Callable[[str], None] = lambda _: None) -> OptimizeOutcome:
    """Run the main job.

    Raises:
        InputError: bad cell, toolpath, options or output folder.
    """
    with in_use(with_effects(request.effects)):
        timings = Timings(progress=progress)
        with taken_beside(WRITING):
            with timings.stage("load"):
                given = load(request)
            with output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder:
                the_plan = planned(given, timings)
                from machopt.services.written import write

                result = write(the_plan, folder).result
    return OptimizeOutcome(result.exit_code, result, request.out / "report.html", the_plan.made.plan.conflict)
