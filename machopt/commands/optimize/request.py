"""Request of ``machopt optimize``: loading of its files, and refusal where no plan is possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from machopt.cell.absolute_accuracy import apply_absolute_accuracy
from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import select_job_tools, split_into_tool_segments
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.manifest import JobFiles, build_optimize_manifest
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types.cell import Cell
from machopt.data_types.manifest import FolderManifest
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.stock import join_stock_engagements
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.file_formats.parquet_tables import refuse_without_pyarrow
from machopt.options.plan_option_reader import load_options
from machopt.planning.job.pareto_front import check_front_options
from machopt.planning.job.request_checks import (
    add_reach_warning,
    check_length_unit,
    check_plannable,
    check_stability_ratio,
    check_tilt,
)
from machopt.process.binding.job_binding import attach_forces, mark_forces
from machopt.process.binding.operation_matching import attach_process
from machopt.program_export.selected_posts import SelectedPost, is_post_file, select_posts
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.toolpath.unknown_words import refuse_unknown_words
from machopt.verification.folder.programs.post_lookup import build_tolerance


@dataclass(frozen=True, kw_only=True)
class OptimizeRequest:
    """Request of ``machopt optimize``."""

    cell: Path
    toolpath: Path
    out: Path
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    direct: dict[str, object] | None = None  # options by their user key, e.g. {"method": "jiao2022"}
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of toolpath.toolpath_reader.read_toolpath
    allow_external: bool = False
    posts: tuple[str, ...] = ()  # names or template files; none: the cell's own
    front: bool = False  # further plans with other weights, for the trade-off
    program_tolerance_mm: float | None = None  # 0.05, or twice path_tolerance_mm where that is more
    process: Path | None = None  # a process.yaml in place of the cell's own
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added
    map_all: bool = False  # look for the collisions of every configuration, for the report's map


@dataclass(frozen=True, kw_only=True)
class OptimizeInputs:
    """Loaded inputs of a plan."""

    cell: Cell
    options: PlanOptions
    toolpath: Toolpath
    segments: tuple[ToolSegment, ...]  # one, or one a tool that is on where the job changes it
    posts: tuple[SelectedPost, ...]
    tolerance: ProgramTolerance  # of the programs
    manifest: FolderManifest  # without files
    front: bool
    map_all: bool
    tables: str = "csv"


def load_optimize_inputs(request: OptimizeRequest) -> OptimizeInputs:
    """Read every file that the request names.

    Args:
        request: The validated request.

    Raises:
        InputError: bad cell, toolpath, option or post.
    """
    cell = load_cell(request.cell, allow_external=request.allow_external, process=request.process)
    return prepare_optimize_inputs(
        cell, lambda: read_toolpath(request.toolpath, **{**get_reading_options(cell), **request.reading}), request
    )


def prepare_optimize_inputs(cell: Cell, read: Callable[[], Toolpath], request: OptimizeRequest) -> OptimizeInputs:
    """Return the inputs of a plan; refuse a request for which no plan is possible.

    Args:
        cell: as it was read, or changed since.
        read: reads the toolpath; called once the options are valid.
        request: files it names beside these two are read.

    Raises:
        InputError: bad options, toolpath or post.
    """
    refuse_without_pyarrow(request.tables)
    options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
    posts, tolerance = select_posts(cell, request.posts), build_tolerance(request.program_tolerance_mm, options)
    toolpath = read()
    refuse_unknown_words(toolpath, request.toolpath)
    toolpath = add_reach_warning(cell, place_toolpath(toolpath, cell))
    toolpath = attach_process(cell.process, toolpath)
    cell = select_job_tools(apply_absolute_accuracy(cell, options), toolpath)
    segments = attach_forces(split_into_tool_segments(cell, toolpath))
    toolpath = replace(toolpath, engagement=join_stock_engagements([s.toolpath.engagement for s in segments]))
    options = mark_forces(options, segments)
    if request.front:
        check_front_options(options)
    check_plannable(toolpath, options, cell.process)
    check_tilt(segments, options)
    check_stability_ratio(segments, options)
    if not options.allow_gaps:
        check_length_unit(cell, toolpath, request.toolpath, stated="unit" in request.reading)
    files = JobFiles(
        toolpath=request.toolpath,
        plan=request.plan_file,
        posts=[Path(text) for text in request.posts if is_post_file(text)],
        effects=request.effects,
    )
    manifest = build_optimize_manifest(cell, toolpath, options, files, reading=request.reading, tolerance=tolerance)
    return OptimizeInputs(
        cell=cell,
        options=options,
        toolpath=toolpath,
        segments=segments,
        posts=posts,
        tolerance=tolerance,
        manifest=manifest,
        front=request.front,
        map_all=request.map_all,
        tables=request.tables,
    )
