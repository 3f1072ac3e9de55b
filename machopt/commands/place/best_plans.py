"""Plans, exports and verification of the best placements, each with its moved cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.cell.moved_cell_writer import write_moved_cell
from machopt.commands.optimize import request as one_plan
from machopt.commands.optimize.run import run_optimize
from machopt.commands.place.document import ConfirmedPlacement
from machopt.commands.place.request import PlaceRequest
from machopt.placement.moved_cell import move_cell
from machopt.placement.placement_site import PlacementSite
from machopt.placement.search_result import PlacementSearchResult, PlannedPlacement
from machopt.placement.task_executor import InProcessExecutor, PlacementExecutor


@dataclass(frozen=True)
class _BestPlanTask:
    """One of the best places, and where it is written."""

    request: PlaceRequest
    one: PlannedPlacement
    folder: Path


def write_best_plans(
    request: PlaceRequest,
    site: PlacementSite,
    siting: PlacementSearchResult,
    folder: Path,
    progress: Callable[[str], None],
    executor: PlacementExecutor | None = None,
) -> tuple[ConfirmedPlacement, ...]:
    """Write ``best-1`` …: ``cell`` and, for each toolpath, a complete output of ``run_optimize``.

    Args:
        request: The validated request.
        site: The cell, the jobs and the options of the search.
        siting: Result of the placement search.
        folder: The output folder.
        progress: Called with the name of each stage when it begins.
        executor: Worker processes; None computes in this process.
    """
    best = siting.best[: request.search.best]
    wanted = [_BestPlanTask(request, one, folder / f"best-{k}") for k, one in enumerate(best, 1)]
    out: list[ConfirmedPlacement] = []
    progress(f"write and verify the {len(best)} best")
    for done in (executor or InProcessExecutor(site)).map_items(_write_and_verify_plan, wanted):
        out.append(done)
        progress(f"{len(out)} of the {len(best)} best are written and verified")
    return tuple(out)


def _write_and_verify_plan(site: PlacementSite, best_plan_task: _BestPlanTask) -> ConfirmedPlacement:
    request, one, folder = best_plan_task.request, best_plan_task.one, best_plan_task.folder
    head = f"made by machopt place from {site.cell.name}: {one.place.shift.text}"
    cell = write_moved_cell(folder / "cell", site.cell, move_cell(site.cell, site.moved_bodies, one.place.shift), head)
    verdicts, code = [], 0
    for name, file, reading in zip(
        list_toolpath_folder_names(request.toolpaths), request.toolpaths, request.readings, strict=True
    ):
        optimize_request = one_plan.OptimizeRequest(
            cell=cell.parent,
            toolpath=file,
            out=folder / name,
            plan_file=request.plan_file,
            overrides=request.overrides,
            direct=request.direct,
            reading=dict(reading),
            posts=request.posts,
            effects=request.effects,
            tables=request.tables,
        )
        done = run_optimize(optimize_request)
        verdicts.append(f"{file.name}: {done.result.verdict}")
        code = max(code, done.exit_code)
    plans = tuple(f"{folder.name}/{name}/report.html" for name in list_toolpath_folder_names(request.toolpaths))
    return ConfirmedPlacement(one, folder.name, "; ".join(verdicts), code, plans)


def list_toolpath_folder_names(files: tuple[Path, ...]) -> list[str]:
    """Return a folder name for each toolpath: its file name, numbered where two are equal.

    Args:
        files: The toolpath files.
    """
    stems = [f.stem for f in files]
    return stems if len({*stems, "cell"}) == len(files) + 1 else [f"{k}-{stem}" for k, stem in enumerate(stems, 1)]
