"""``machopt map``: from a cell to stiffness and dexterity over a slice, a volume, a line or a joint plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.domain.results.maps import MapResult
from machopt.effects.own import in_use, with_effects
from machopt.formats.fields import write_map_csv
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.output import output_folder, write_result
from machopt.report.map_page import write_map_page
from machopt.report.map_svg import write_map_svg
from machopt.services.inputs import paths_read, single
from machopt.services.manifest import write_command_manifest
from machopt.services.map_columns import map_columns
from machopt.services.mapped import Mapped, mapped
from machopt.workspace.asked import MapRequest

__all__ = ["MapOutcome", "MapRequest", "run_map"]


@dataclass(frozen=True)
class MapOutcome:
    """What came out; ``exit_code`` is 0, or 3 where no sample has a posture."""

    exit_code: int
    result: MapResult
    report: Path
    message: str  # one sentence for the user


def run_map(request: MapRequest, progress: Callable[[str], None] = lambda _: None) -> MapOutcome:
    """Map a cell.

    Writes ``map.csv`` (and ``map_free.csv`` where the rotation about the tool axis is free), ``map.json``,
    ``map.svg`` and ``report.html``. The same input gives the same bytes.

    Raises:
        InputError: bad cell, options, measured table or output folder.
    """
    with (
        in_use(with_effects(request.effects)),
        output_folder(request.out, force=request.overwrite, inputs=paths_read(request)) as folder,
    ):
        refuse_without_pyarrow(request.tables)
        done = mapped(request, progress)
        write(done, folder, progress)
    return MapOutcome(done.exit_code, done.result, request.out / "report.html", done.message)


def write(done: Mapped, folder: Path, progress: Callable[[str], None] = lambda _: None) -> None:
    """Write its files into an empty folder."""
    progress("report")
    request, first = done.request, done.layers[0]
    for layer in done.layers:
        name = "map.csv" if layer is first else f"map_{layer.name}.csv"
        write_map_csv(folder / name, map_columns(done.samples, layer, done.options, first, done.comparison))
    write_map_page(folder / "report.html", done.page)
    write_map_svg(folder / "map.svg", done.page)
    write_result(folder / "map.json", done.result)
    read = [single(f, role) for f, role in ((request.measured, "measured"), (request.plan_file, "plan")) if f]
    read += [single(f, "effects") for f in request.effects]
    write_command_manifest(
        folder,
        "map",
        request,
        done.cell,
        verdict=done.verdict,
        exit_code=done.result.exit_code,
        inputs=read,
        unchecked=done.unchecked,
    )
