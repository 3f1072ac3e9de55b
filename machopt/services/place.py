"""``machopt place``: where to put the workpiece, or the robot, and the best places as whole verified plans."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.domain.results.place import PlaceResult
from machopt.effects.own import in_use, with_effects
from machopt.formats.cell import load_cell
from machopt.formats.movedcell import write_moved_cell
from machopt.formats.options import load_options
from machopt.formats.toolpath import read_toolpath
from machopt.output import output_folder, write_result
from machopt.placement.asked import Search
from machopt.placement.found import Planned, Siting
from machopt.placement.journal import Journal
from machopt.placement.moved import moved, refuse
from machopt.placement.search import Site, find
from machopt.plan.drive import refuse_wrong_unit
from machopt.report.gather.place import Confirmed, page_of, result_of, write_places
from machopt.report.place_page import write_place_page
from machopt.services import load as one_plan
from machopt.services.inputs import input_hashes, single
from machopt.services.knownrobot import known_robot
from machopt.services.manifest import write_command_manifest
from machopt.services.place_key import key_of, names_of, refuse_options
from machopt.services.run import optimize


@dataclass(frozen=True, kw_only=True)
class Request:
    """What the user asked for."""

    cell: Path
    toolpaths: tuple[Path, ...]
    out: Path
    search: Search = field(default_factory=Search)
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of formats.toolpath.read_toolpath
    posts: tuple[str, ...] = ()
    effects: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came out; ``exit_code`` is 0, 3 where nothing can be planned anywhere, 4 where a plan is not confirmed."""

    exit_code: int
    result: PlaceResult
    report: Path


def place(request: Request, progress: Callable[[str], None] = lambda _: None) -> Outcome:
    """Look for the best place.

    Writes ``place.json``, ``places.csv`` (every place that was looked at), ``report.html`` and a folder ``best-1`` …
    for each of the best, with the moved cell and a whole output of ``optimize`` for each toolpath. Until it is done,
    what was found stands in ``OUT.progress.jsonl``: the same command goes on with it.

    Raises:
        InputError: bad cell, toolpath, options, ranges or output folder.
    """
    with in_use(with_effects(request.effects)):
        return _placed(request, progress)


def _placed(request: Request, progress: Callable[[str], None]) -> Outcome:
    progress("load")
    cell = load_cell(request.cell)
    refuse(cell)
    options = load_options(cell.plan, request.plan_file, list(request.overrides))
    refuse_options(options)
    robot = known_robot(cell)
    toolpaths = tuple(read_toolpath(file, robot=robot, **request.reading) for file in request.toolpaths)
    for file, toolpath in zip(request.toolpaths, toolpaths, strict=True):
        refuse_wrong_unit(cell, toolpath, file, stated="unit" in request.reading)
    with output_folder(request.out) as folder:
        site = Site.of(cell, toolpaths, options, request.search)
        beside = request.out.with_name(request.out.name + ".progress.jsonl")
        journal = Journal(beside, key_of(cell, toolpaths, options, request.search))
        if journal.known:
            progress(f"going on with {journal.known} places that {beside.name} holds")
        siting = find(site, request.search, journal, progress)
        confirmed = tuple(
            _confirm(request, site, siting, p, folder / f"best-{k}", progress)
            for k, p in enumerate(siting.best[: request.search.best], 1)
        )
        hashes = {**input_hashes(cell), **{t.source: t.sha256 for t in toolpaths}}
        result = result_of(site, request.search, siting, confirmed, hashes)
        write_places(folder / "places.csv", site, siting)
        write_place_page(folder / "report.html", page_of(site, siting, result))
        write_result(folder / "place.json", result)
        roles = {"toolpath": request.toolpaths, "plan": (request.plan_file,), "effects": request.effects}
        read = [single(f, role) for role, files in roles.items() for f in files if f is not None]
        write_command_manifest(
            folder, "place", request, cell, verdict=result.verdict, exit_code=result.exit_code, inputs=read
        )
    journal.done()
    return Outcome(result.exit_code, result, request.out / "report.html")


def _confirm(
    request: Request, site: Site, siting: Siting, one: Planned, folder: Path, progress: Callable[[str], None]
) -> Confirmed:
    """A place as ``optimize`` plans, exports and verifies it."""
    head = f"made by machopt place from {site.cell.name}: {one.place.shift.words}"
    cell = write_moved_cell(folder / "cell", site.cell, moved(site.cell, siting.carried, one.place.shift), head)
    asked = {name: getattr(request, name) for name in ("plan_file", "overrides", "reading", "posts", "effects")}
    verdicts, code = [], 0
    for name, file in zip(names_of(request.toolpaths), request.toolpaths, strict=True):
        progress(f"write {folder.name}: {file.name}")
        done = optimize(one_plan.Request(cell=cell.parent, toolpath=file, out=folder / name, **asked))
        verdicts.append(f"{file.name}: {done.result.verdict}")
        code = max(code, done.exit_code)
    return Confirmed(one, folder.name, "; ".join(verdicts), code)
