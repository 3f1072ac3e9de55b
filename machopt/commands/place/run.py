"""``machopt place``: the best placements of workpiece or robot, as complete verified plans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.commands.input_hashes import build_manifest_file, compute_input_hashes, list_request_paths
from machopt.commands.manifest import write_command_manifest
from machopt.commands.place.best_plans import write_best_plans
from machopt.commands.place.document import build_place_document, build_placement_page_data, write_place_table
from machopt.commands.place.request import PlaceRequest, compute_request_key
from machopt.commands.place.site_loading import build_placement_site, read_request_files
from machopt.data_types.cell import Cell
from machopt.data_types.documents.place_document import PlaceDocument
from machopt.data_types.toolpath import Toolpath
from machopt.effects.user_effects import activate_user_effects, load_effect_files
from machopt.errors import InputError
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.output import write_output_folder, write_result
from machopt.placement.journal import SearchJournal, refuse_foreign_journal
from machopt.placement.placement_site import PlacementSite
from machopt.placement.search import find_best_placement
from machopt.placement.search_result import PlacementSearchResult
from machopt.placement.task_executor import PlacementExecutor
from machopt.planning.job.request_checks import check_length_unit
from machopt.report.pages.placement_page import write_placement_page

__all__ = [
    "PlaceComputation",
    "PlaceRequest",
    "PlaceResult",
    "compute_placements",
    "run_place",
    "write_placement_files",
]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class PlaceResult:
    """Result of ``machopt place``; ``exit_code`` is 0, 3 where no placement can be planned, 4 where a plan is not
    confirmed.
    """

    exit_code: int
    result: PlaceDocument
    report: Path


@dataclass(frozen=True)
class PlaceComputation:
    """Result of the search in memory."""

    request: PlaceRequest
    site: PlacementSite
    siting: PlacementSearchResult


def run_place(
    request: PlaceRequest, progress: Progress = lambda _: None, executor: PlacementExecutor | None = None
) -> PlaceResult:
    """Search for the best placement, alone or with worker processes; the result is the same.

    Writes ``place.json``, ``places.csv``, ``report.html`` and ``best-1`` …: the moved cell and a complete output of
    ``optimize`` for each toolpath. Until then ``OUT.progress.jsonl`` holds the evaluated placements: the same command
    continues from there.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.
        executor: Worker processes; None computes in this process.

    Raises:
        InputError: bad cell, toolpath, options, ranges or output folder.
    """
    refuse_without_pyarrow(request.tables)
    with activate_user_effects(load_effect_files(request.effects)):
        journal = request.out.with_name(request.out.name + ".progress.jsonl")
        refuse_foreign_journal(journal, force=request.overwrite)
        progress("load")
        cell, toolpaths = read_request_files(request)
        with write_output_folder(request.out, force=request.overwrite, inputs=list_request_paths(request)) as folder:
            try:
                found = compute_placements(request, cell, toolpaths, progress, journal, executor)
            except InputError:  # a wrong request has no journal to continue
                journal.unlink(missing_ok=True)
                raise
            result = write_placement_files(found, folder, progress, executor)
        journal.unlink(missing_ok=True)
    return PlaceResult(result.exit_code, result, request.out / "report.html")


def compute_placements(
    request: PlaceRequest,
    cell: Cell,
    toolpaths: tuple[Toolpath, ...],
    progress: Progress = lambda _: None,
    journal: Path | None = None,
    executor: PlacementExecutor | None = None,
) -> PlaceComputation:
    """Search for the best placement; write only the journal.

    Args:
        request: The validated request.
        cell: The robot cell.
        toolpaths: The toolpaths of the jobs.
        progress: Called with the name of each stage when it begins.
        journal: File with the placements that an earlier run evaluated; new ones are appended.
        executor: Worker processes; None computes in this process.

    Raises:
        InputError: the cell, an option or a range is wrong.
    """
    site, options = build_placement_site(request, cell, toolpaths)
    notes = SearchJournal(journal, compute_request_key(site.cell, toolpaths, options, request.search))
    progress(f"going on with {notes.known_count} places that are known" if notes.known_count else "places")
    siting = find_best_placement(site, request.search, notes, progress, executor)
    if not siting.best:  # placement may help a part that is out of reach now, not one that is out of reach everywhere
        for file, reading, toolpath in zip(request.toolpaths, request.readings, site.toolpaths, strict=True):
            check_length_unit(cell, toolpath, file, stated="unit" in reading)
    return PlaceComputation(request, site, siting)


def write_placement_files(
    place_computation: PlaceComputation,
    folder: Path,
    progress: Progress = lambda _: None,
    executor: PlacementExecutor | None = None,
) -> PlaceDocument:
    """Write the best placements as complete plans, and all documents.

    Args:
        place_computation: Result of the search.
        folder: The empty folder.
        progress: Called with the name of each stage when it begins.
        executor: Worker processes; None computes in this process.

    Returns:
        The content of place.json.
    """
    request, site, siting = place_computation.request, place_computation.site, place_computation.siting
    best = write_best_plans(request, site, siting, folder, progress, executor)
    hashes = {**compute_input_hashes(site.cell), **{t.source: t.sha256 for t in site.toolpaths}}
    result = build_place_document(site, request.search, siting, best, hashes)
    write_place_table(folder / "places.csv", site, siting)
    write_placement_page(folder / "report.html", build_placement_page_data(site, siting, result))
    write_result(folder / "place.json", result)
    roles = {"toolpath": request.toolpaths, "plan": (request.plan_file,), "effects": request.effects}
    read = [build_manifest_file(f, role) for role, files in roles.items() for f in files if f is not None]
    verdict, code = result.verdict, result.exit_code
    write_command_manifest(folder, "place", request, site.cell, verdict=verdict, exit_code=code, inputs=read)
    return result
