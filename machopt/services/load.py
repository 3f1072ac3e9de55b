"""What ``machopt optimize`` was asked, loaded and refused where no plan could answer it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from machopt.domain.cell import Cell
from machopt.domain.manifest import Manifest
from machopt.domain.options import PlanOptions
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.formats.absolute_accuracy import apply_absolute_accuracy
from machopt.formats.cell import load_cell
from machopt.formats.options import load_options
from machopt.formats.parquet import refuse_without_pyarrow
from machopt.formats.posts.densify import Tolerance
from machopt.formats.setups import placed
from machopt.formats.toolchoice import stints_of, with_tools
from machopt.formats.unknownwords import read_for_plan, refuse_unknown_words
from machopt.plan.job.drive import refuse_unplannable, refuse_wrong_unit, with_reach_warning
from machopt.plan.job.pareto import refuse
from machopt.postprocess.wanted import Wanted, is_post_file, wanted_posts
from machopt.recheck.posts import tolerance_of
from machopt.services.knownrobot import reading_of
from machopt.services.manifest import optimize_manifest


@dataclass(frozen=True, kw_only=True)
class OptimizeRequest:
    """What the user asked for."""

    cell: Path
    toolpath: Path
    out: Path
    plan_file: Path | None = None
    overrides: tuple[str, ...] = ()
    direct: dict[str, object] | None = None  # options by their user key, e.g. {"method": "jiao2022"}
    reading: dict[str, Any] = field(default_factory=dict)  # keywords of formats.toolpath.read_toolpath
    allow_external: bool = False
    posts: tuple[str, ...] = ()  # names or template files; none: the cell's own
    front: bool = False  # further plans with other weights, for the trade-off
    program_tolerance_mm: float | None = None  # 0.05, or twice path_tolerance_mm where that is more
    effects: tuple[Path, ...] = ()  # Python files with effects of the user's own, which stiffness.yaml may hold
    tables: str = "csv"  # parquet: every table as Parquet, too
    overwrite: bool = False  # replace an earlier output though files in it were edited or added
    map_all: bool = False  # look for the collisions of every configuration, for the report's map


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """Everything a plan is made from."""

    cell: Cell
    options: PlanOptions
    toolpath: Toolpath
    stints: tuple[Stint, ...]  # one, or one a tool that is on where the job changes it
    posts: tuple[Wanted, ...]
    tolerance: Tolerance  # of the programs
    manifest: Manifest  # without files
    front: bool
    map_all: bool
    tables: str = "csv"


def load(request: OptimizeRequest) -> Loaded:
    """Read every file that was named; an InputError names a bad cell, toolpath, option or post."""
    cell = load_cell(request.cell, allow_external=request.allow_external)
    return prepared(cell, lambda: read_for_plan(request.toolpath, **reading_of(cell), **request.reading), request)


def prepared(cell: Cell, read: Callable[[], Toolpath], request: OptimizeRequest) -> Loaded:
    """What was asked of a cell and a toolpath, refused where no plan could answer it.

    Args:
        cell: as it was read, or changed since.
        read: gives the toolpath; asked for when the options are known to be good.
        request: files it names beside these two are read.

    Raises:
        InputError: bad options, toolpath or post.
    """
    refuse_without_pyarrow(request.tables)
    options = load_options(cell.plan, request.plan_file, list(request.overrides), **(request.direct or {}))
    posts, tolerance = wanted_posts(cell, request.posts), tolerance_of(request.program_tolerance_mm, options)
    toolpath = with_reach_warning(cell, placed(refuse_unknown_words(read(), request.toolpath), cell))
    cell = with_tools(apply_absolute_accuracy(cell, options), toolpath)
    stints = stints_of(cell, toolpath)
    if request.front:
        refuse(options)
    refuse_unplannable(toolpath, options)
    if not options.allow_gaps:
        refuse_wrong_unit(cell, toolpath, request.toolpath, stated="unit" in request.reading)
    manifest = optimize_manifest(
        cell,
        request.toolpath,
        toolpath,
        options,
        reading=request.reading,
        plan_file=request.plan_file,
        post_files=[Path(text) for text in request.posts if is_post_file(text)],
        effects=request.effects,
        tolerance=tolerance,
    )
    return Loaded(
        cell=cell,
        options=options,
        toolpath=toolpath,
        stints=stints,
        posts=posts,
        tolerance=tolerance,
        manifest=manifest,
        front=request.front,
        map_all=request.map_all,
        tables=request.tables,
    )
