"""``machopt map``: stiffness and dexterity of a cell over a slice, a volume, a line or a joint plane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from machopt.commands.input_hashes import build_manifest_file
from machopt.commands.manifest import write_command_manifest
from machopt.commands.map.computation import MapComputation, compute_map
from machopt.commands.map.table_columns import build_map_columns
from machopt.commands.request_output_folder import open_request_folder
from machopt.data_types.documents.map_document import MapDocument
from machopt.output import write_result
from machopt.output.tables.map_table import write_map_csv
from machopt.report.pages.map_page import write_map_page
from machopt.report.svg.map_picture import write_map_svg
from machopt.workspace_map.request import MapRequest

__all__ = ["MapRequest", "MapResult", "run_map"]


@dataclass(frozen=True)
class MapResult:
    """Result of ``machopt map``; ``exit_code`` is 0, or 3 where no sample has a posture."""

    exit_code: int
    result: MapDocument
    report: Path
    message: str  # one sentence for the user


def run_map(request: MapRequest, progress: Callable[[str], None] = lambda _: None) -> MapResult:
    """Map a cell.

    Writes ``map.csv`` (and ``map_free.csv`` where the rotation about the tool axis is free), ``map.json``,
    ``map.svg`` and ``report.html``. The same input gives the same bytes.

    Args:
        request: The validated request.
        progress: Called with the name of each stage when it begins.

    Raises:
        InputError: bad cell, options, measured table or output folder.
    """
    with open_request_folder(request) as folder:
        done = compute_map(request, progress)
        write_map_files(done, folder, progress)
    return MapResult(done.exit_code, done.result, request.out / "report.html", done.message)


def write_map_files(done: MapComputation, folder: Path, progress: Callable[[str], None] = lambda _: None) -> None:
    """Write the files into an empty folder.

    Args:
        done: Result of the computation.
        folder: The empty folder.
        progress: Called with the name of each stage when it begins.
    """
    progress("report")
    request, first = done.request, done.layers[0]
    for layer in done.layers:
        name = "map.csv" if layer is first else f"map_{layer.name}.csv"
        write_map_csv(folder / name, build_map_columns(done.samples, layer, done.options, first, done.comparison))
    write_map_page(folder / "report.html", done.page)
    write_map_svg(folder / "map.svg", done.page)
    write_result(folder / "map.json", done.result)
    read = [
        build_manifest_file(f, role)
        for f, role in ((request.measured, "measured"), (request.plan_file, "plan"), (request.toolpath, "toolpath"))
        if f
    ]
    read += [build_manifest_file(f, "effects") for f in request.effects]
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
