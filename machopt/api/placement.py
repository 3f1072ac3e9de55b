"""``machopt.place``: where to put the workpiece, or the robot."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from typing import Any, Literal, Unpack

from machopt.api.cell import Cell, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import PlanOptionValues
from machopt.api.request_options import NOWHERE, check_value_type, convert_to_path, convert_to_texts
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result, use_cell_effects
from machopt.api.table import Table
from machopt.api.toolpath import Toolpath, read_toolpath_argument
from machopt.commands.input_hashes import compute_input_hashes
from machopt.commands.place.document import build_place_columns, build_place_document
from machopt.commands.place.run import PlaceComputation, PlaceRequest, compute_placements, write_placement_files
from machopt.data_types.documents.place_document import PlaceDocument
from machopt.errors import InputError, suggest_nearest_word
from machopt.options.option_schema import OptionKeys
from machopt.placement.search_options import PlacementOptions

Range = tuple[float, float]


@dataclass(frozen=True)
class Placement:
    """Evaluated placements and the best of them. :func:`place` makes one."""

    cell: Cell
    _found: PlaceComputation

    @property
    def proven(self) -> bool:
        """Whether no other evaluated placement can be better."""
        return self._found.siting.is_optimal

    @property
    def result(self) -> PlaceDocument:
        """place.json, typed; without the verdicts on plans, which :meth:`save` makes."""
        site = self._found.site
        hashes = {**compute_input_hashes(site.cell), **{t.source: t.sha256 for t in site.toolpaths}}
        return build_place_document(site, self._found.request.search, self._found.siting, None, hashes)

    @property
    def verdict(self) -> str:
        """One sentence."""
        return self.result.verdict

    @property
    def places(self) -> Table:
        """Columns of ``places.csv``, one row for each placement, the cell's own first."""
        return Table(build_place_columns(self._found.site, self._found.siting))

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> PlaceDocument:
        """Write what ``machopt place`` writes: the best as moved cells with whole verified plans.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        return save_result(self.cell, out, lambda folder: write_placement_files(self._found, folder), force=force)

    def __repr__(self) -> str:
        return f"<Placement in {self.cell.name!r}: {self.verdict}>"


def _list_toolpaths(toolpaths: object) -> list[Any]:
    """Return the given toolpaths, of which there is at least one."""
    if isinstance(toolpaths, Toolpath | str | os.PathLike):
        return [toolpaths]
    if not isinstance(toolpaths, Iterable):
        raise InputError(
            f"found {toolpaths!r}; a toolpath, the path of its file, or a list of these would work", where="toolpaths"
        )
    several = list(toolpaths)
    if not several:
        raise InputError("no toolpath was given; one or more would work", where="toolpaths")
    return several


def _check_option_names(options: Mapping[str, object]) -> None:
    """Raise InputError where a planning option is unknown; arguments of :func:`place` may be meant."""
    unknown = next((name for name in options if name not in OptionKeys.model_fields), None)
    if unknown is not None:
        own = [n for n, p in inspect.signature(place).parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY]
        words = suggest_nearest_word(unknown, [*own, *OptionKeys.model_fields])
        raise InputError(f"unknown option {unknown!r}; {words}", where="place")


def _check_moved_object(move: str) -> None:
    if move not in ("workpiece", "base"):
        raise InputError(f"found {move!r}; valid: workpiece, base", where="move")


def _read_toolpaths(toolpaths: object, cell: Cell) -> list[Toolpath]:
    """Read the given toolpaths for a cell that can be copied."""
    read = [read_toolpath_argument(t, cell) for t in _list_toolpaths(toolpaths)]
    if cell.allow_external:
        raise InputError("files outside the cell folder are in no copy of it; a cell without them would work")
    return read


def _build_search_options(
    ranges: tuple[Range, Range, Range, Range],
    counts: tuple[int, int, int],
    minutes: float,
    move: str,
    carry: Iterable[str] | None,
    stay: Iterable[str],
) -> PlacementOptions:
    """Check the arguments of :func:`place` that concern the search, and convert them to SI units."""
    for name, numbers in zip(("x_mm", "y_mm", "z_mm", "turn_deg"), ranges, strict=True):
        check_value_type(tuple(numbers) if isinstance(numbers, list) else numbers, Range, name)
    for name, count in zip(("places", "best", "plans"), counts, strict=True):
        check_value_type(count, int, name)
    check_value_type(minutes, float, "minutes")
    x, y, z = ((a / 1e3, b / 1e3) for a, b in ranges[:3])
    turn_deg = ranges[3]
    places, best, plans = counts
    return PlacementOptions(
        x=x,
        y=y,
        z=z,
        turn=(radians(turn_deg[0]), radians(turn_deg[1])),
        places=places,
        base=move == "base",
        carry=None if carry is None else tuple(carry),
        stay=tuple(stay),
        best=best,
        plans=plans,
        seconds=60 * minutes,
    )


def _compute_placement(
    cell: Cell, request: PlaceRequest, toolpaths: Sequence[Toolpath], progress: Progress
) -> Placement:
    """Compute the placements with the effects of the cell."""
    descriptions = tuple(t.description for t in toolpaths)
    with use_cell_effects(cell):
        return Placement(cell, compute_placements(request, cell.description, descriptions, progress))


@use_argument_names()
def place(
    cell: Cell | Named,
    toolpaths: Toolpath | Named | Iterable[Toolpath | Named],
    *,
    x_mm: Range = (-300.0, 300.0),
    y_mm: Range = (-300.0, 300.0),
    z_mm: Range = (0.0, 0.0),
    turn_deg: Range = (0.0, 0.0),
    places: int = 200,
    best: int = 3,
    plans: int = 40,
    minutes: float = 10.0,
    move: Literal["workpiece", "base"] = "workpiece",
    carry: Iterable[str] | None = None,
    stay: Iterable[str] = (),
    plan_file: Named | None = None,
    posts: Iterable[Named] = (),
    progress: Progress = ignore_progress,
    **options: Unpack[PlanOptionValues],
) -> Placement:
    """Find the placement of workpiece or robot with the best worst index over all toolpaths: ``machopt place``.

    Args:
        cell: A cell, or the path of its folder.
        toolpaths: One or several, as toolpaths or paths of files.
        x_mm: Least and greatest shift along x of world, mm.
        y_mm: Least and greatest shift along y of world, mm.
        z_mm: Least and greatest shift along z of world, mm.
        turn_deg: Least and greatest rotation about the vertical through the toolpaths' centre (or base_link), deg.
        places: Maximum number of placements to evaluate.
        best: Number of placements that :meth:`Placement.save` writes as complete plans.
        plans: Maximum number of complete plans.
        minutes: Time after which no further placement is begun, min.
        move: What moves.
        carry: Obstacles that move along; None: what holds the moved object.
        stay: Obstacles that do not move, although they hold the moved object.
        plan_file: Planning options as YAML (``--plan``).
        posts: Robot programs of the best placements (``--post``).
        progress: Called with the name of each stage.
        options: Planning options as for :func:`machopt.optimize`.

    Raises:
        InputError: cell, toolpath, range or an option is wrong; the message says which, and what is accepted.
    """
    _check_option_names(options)
    _check_moved_object(move)
    a_cell = load_cell_argument(cell)
    read = _read_toolpaths(toolpaths, a_cell)
    request = PlaceRequest(
        cell=a_cell.path,
        toolpaths=tuple(t.path for t in read),
        readings=tuple(t.reading for t in read),
        out=NOWHERE,
        search=_build_search_options((x_mm, y_mm, z_mm, turn_deg), (places, best, plans), minutes, move, carry, stay),
        plan_file=None if plan_file is None else convert_to_path(plan_file, "plan_file"),
        direct={**options},
        posts=convert_to_texts(posts, "posts"),
        effects=tuple(own.file for own in a_cell.effects),
    )
    return _compute_placement(a_cell, request, read, progress)
