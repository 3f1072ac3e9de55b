"""``machopt place``: where to put the workpiece, or the robot, and the best places as whole verified plans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.domain.cell import Cell
from machopt.domain.results.place import PlaceResult
from machopt.domain.toolpath import Toolpath
from machopt.effects.own import in_use, with_effects
from machopt.errors import InputError
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.output import output_folder, write_result
from machopt.placement.found import Siting
from machopt.placement.hands import Hands
from machopt.placement.journal import Journal, refuse_foreign_journal
from machopt.placement.search import Site, find
from machopt.plan.job.drive import refuse_wrong_unit
from machopt.report.gather.place import page_of, result_of, write_places
from machopt.report.place_page import write_place_page
from machopt.services.inputs import input_hashes, paths_read, single
from machopt.services.manifest import write_command_manifest
from machopt.services.place_asked import PlaceRequest, key_of
from machopt.services.place_best import confirmed
from machopt.services.place_site import read, site_of

__all__ = ["PlaceOutcome", "PlaceRequest", "Sited", "place", "sited", "write"]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class PlaceOutcome:
    """What came out; ``exit_code`` is 0, 3 where nothing can be planned anywhere, 4 where a plan is not confirmed."""

    exit_code: int
    result: PlaceResult
    report: Path


@dataclass(frozen=True)
class Sited:
    """What was found, in memory."""

    request: PlaceRequest
    site: Site
    siting: Siting


def place(request: PlaceRequest, progress: Progress = lambda _: None, crew: Hands | None = None) -> PlaceOutcome:
    """Look for the best place, alone or with a crew of other processes: the answer is the same.

    Writes ``place.json``, ``places.csv``, ``report.html`` and ``best-1`` …: the moved cell and a whole output of
    ``optimize`` for each toolpath. Until then ``OUT.progress.jsonl`` has what was found: the same command goes on.

    Raises:
        InputError: bad cell, toolpath, options, ranges or output folder.
    """
    refuse_without_pyarrow(request.tables)
    with in_use(with_effects(request.effects)):
        journal = request.out.with_name(request.out.name + ".progress.jsonl")
        refuse_foreign_journal(journal, force=request.overwrite)
        progress("load")
        cell, toolpaths = read(request)
        with output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder:
            try:
                found = sited(request, cell, toolpaths, progress, journal, crew)
            except InputError:  # nothing can go on from what was asked wrongly
                journal.unlink(missing_ok=True)
                raise
            result = write(found, folder, progress, crew)
        journal.unlink(missing_ok=True)
    return PlaceOutcome(result.exit_code, result, request.out / "report.html")


def sited(
    request: PlaceRequest,
    cell: Cell,
    toolpaths: tuple[Toolpath, ...],
    progress: Progress = lambda _: None,
    journal: Path | None = None,
    crew: Hands | None = None,
) -> Sited:
    """Look for the best place and write nothing but the journal.

    Args:
        cell, toolpaths: as the request names them.
        journal: what an earlier run found, and where this one notes what it finds.
        crew: who looks and plans; None: this process.

    Raises:
        InputError: the cell, an option or a range is wrong.
    """
    site, options = site_of(request, cell, toolpaths)
    notes = Journal(journal, key_of(site.cell, toolpaths, options, request.search))
    progress(f"going on with {notes.known} places that are known" if notes.known else "places")
    siting = find(site, request.search, notes, progress, crew)
    if not siting.best:  # a part out of reach as it stands is what placement may help; one out of reach anywhere is not
        for file, reading, toolpath in zip(request.toolpaths, request.readings, site.toolpaths, strict=True):
            refuse_wrong_unit(cell, toolpath, file, stated="unit" in reading)
    return Sited(request, site, siting)


def write(found: Sited, folder: Path, progress: Progress = lambda _: None, crew: Hands | None = None) -> PlaceResult:
    """Write the best places as whole plans, and everything that is told."""
    request, site, siting = found.request, found.site, found.siting
    best = confirmed(request, site, siting, folder, progress, crew)
    hashes = {**input_hashes(site.cell), **{t.source: t.sha256 for t in site.toolpaths}}
    result = result_of(site, request.search, siting, best, hashes)
    write_places(folder / "places.csv", site, siting)
    write_place_page(folder / "report.html", page_of(site, siting, result))
    write_result(folder / "place.json", result)
    roles = {"toolpath": request.toolpaths, "plan": (request.plan_file,), "effects": request.effects}
    read = [single(f, role) for role, files in roles.items() for f in files if f is not None]
    verdict, code = result.verdict, result.exit_code
    write_command_manifest(folder, "place", request, site.cell, verdict=verdict, exit_code=code, inputs=read)
    return result
