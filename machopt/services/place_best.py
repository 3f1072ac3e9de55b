"""The best places as ``optimize`` plans, exports and verifies them, each with its moved cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.formats.movedcell import write_moved_cell
from machopt.placement.found import Planned, Siting
from machopt.placement.hands import Hands, Own
from machopt.placement.moved import moved
from machopt.placement.search import Site
from machopt.report.gather.place import Confirmed
from machopt.services import load as one_plan
from machopt.services.place_asked import PlaceRequest
from machopt.services.run import optimize


@dataclass(frozen=True)
class _Wanted:
    """One of the best places, and where it is written."""

    request: PlaceRequest
    one: Planned
    folder: Path


def confirmed(
    request: PlaceRequest,
    site: Site,
    siting: Siting,
    folder: Path,
    progress: Callable[[str], None],
    crew: Hands | None = None,
) -> tuple[Confirmed, ...]:
    """Write ``best-1`` …: ``cell`` and, for each toolpath, a whole output of ``optimize``."""
    best = siting.best[: request.search.best]
    wanted = [_Wanted(request, one, folder / f"best-{k}") for k, one in enumerate(best, 1)]
    out: list[Confirmed] = []
    progress(f"write and verify the {len(best)} best")
    for done in (crew or Own(site)).each(_confirm, wanted):
        out.append(done)
        progress(f"{len(out)} of the {len(best)} best are written and verified")
    return tuple(out)


def _confirm(site: Site, wanted: _Wanted) -> Confirmed:
    request, one, folder = wanted.request, wanted.one, wanted.folder
    head = f"made by machopt place from {site.cell.name}: {one.place.shift.words}"
    cell = write_moved_cell(folder / "cell", site.cell, moved(site.cell, site.carried, one.place.shift), head)
    verdicts, code = [], 0
    for name, file, reading in zip(names_of(request.toolpaths), request.toolpaths, request.readings, strict=True):
        asked = one_plan.OptimizeRequest(
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
        done = optimize(asked)
        verdicts.append(f"{file.name}: {done.result.verdict}")
        code = max(code, done.exit_code)
    plans = tuple(f"{folder.name}/{name}/report.html" for name in names_of(request.toolpaths))
    return Confirmed(one, folder.name, "; ".join(verdicts), code, plans)


def names_of(files: tuple[Path, ...]) -> list[str]:
    """A folder's name for each toolpath: its own, numbered where two are alike."""
    stems = [f.stem for f in files]
    return stems if len({*stems, "cell"}) == len(files) + 1 else [f"{k}-{stem}" for k, stem in enumerate(stems, 1)]
