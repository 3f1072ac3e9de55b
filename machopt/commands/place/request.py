"""Request of ``machopt place``: its checks, and the key by which a stopped run is continued."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from machopt.commands.input_hashes import compute_input_hashes
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.options.plan_option_reader import format_user_options
from machopt.placement.search_options import PlacementOptions
from machopt.version import __version__


@dataclass(frozen=True, kw_only=True)
class PlaceRequest:
    """Request of ``machopt place``."""

    cell: Path
    toolpaths: tuple[Path, ...]
    readings: tuple[Mapping[str, Any], ...]  # one a toolpath: keywords of toolpath.toolpath_reader.read_toolpath
    out: Path
    search: PlacementOptions = field(default_factory=PlacementOptions)
    plan_file: Path | None = None
    process: Path | None = None  # a process.yaml in place of the cell's own
    overrides: tuple[str, ...] = ()
    direct: dict[str, object] | None = None  # options by their user key
    posts: tuple[str, ...] = ()
    effects: tuple[Path, ...] = ()
    tables: str = "csv"  # parquet: every table, those of the best plans too, also as Parquet
    overwrite: bool = False  # replace an earlier output though files in it were edited or added


def check_comparable_options(options: PlanOptions) -> None:
    """Refuse options under which placements cannot be compared.

    Args:
        options: The planning options in force.

    Raises:
        InputError: an option prevents the comparison; the message says what would be accepted.
    """
    wrong = None
    if options.method != "global":
        wrong = ("method", f"method {options.method} does not look for the best plan; global would work")
    elif options.advised_feed_share is not None:
        wrong = ("advised_feed_share", "places are compared at the feeds of the file; leaving it out would work")
    elif options.allow_gaps:
        wrong = ("allow_gaps", "a place could win by leaving the soft points out; false would work")
    elif options.fixed or options.steer:
        wrong = (
            "fixed" if options.fixed else "steer",
            "fixed rotations belong to one place; a plan at the place that was found takes them",
        )
    if wrong:
        raise InputError(wrong[1], file="options", where=wrong[0])


def compute_request_key(
    cell: Cell, toolpaths: tuple[Toolpath, ...], options: PlanOptions, search: PlacementOptions
) -> str:
    """Return a hash of everything that decides the result; limits of time and number do not.

    Args:
        cell: The robot cell.
        toolpaths: The toolpaths of the jobs.
        options: The planning options in force.
        search: Options of the placement search.
    """
    ranges = {k: v for k, v in asdict(search).items() if k not in ("seconds", "plans", "best")}
    inputs = [
        __version__,
        compute_input_hashes(cell),
        [t.sha256 for t in toolpaths],
        format_user_options(options),
        ranges,
    ]
    points = b"".join(np.ascontiguousarray(t.position).tobytes() for t in toolpaths)  # as read: units and words count
    text = json.dumps(inputs, sort_keys=True, default=str).encode()
    return hashlib.sha256(text + points).hexdigest()
