"""``machopt.map``: stiffness and dexterity over workspace or joint space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from machopt.api.cell import Cell, load_cell_argument
from machopt.api.error_message_translation import use_argument_names
from machopt.api.figure import Figure
from machopt.api.option_types import MapOptions
from machopt.api.request_options import NOWHERE, build_request
from machopt.api.result_saving import Named, Progress, ignore_progress, save_result, use_cell_effects
from machopt.api.table import Table
from machopt.commands.map.computation import MapComputation, compute_map
from machopt.commands.map.run import write_map_files
from machopt.commands.map.table_columns import build_map_columns
from machopt.data_types.documents.map_document import MapDocument
from machopt.numerics.array_types import Array
from machopt.report.svg.map_picture import build_map_svg
from machopt.workspace_map.request import MapRequest


@dataclass(frozen=True)
class MapFigures:
    """Pictures of a map."""

    _made: MapComputation

    def map(self) -> Figure:
        """Return the picture of ``map.svg``: the quantity that postures are chosen by, one panel for each layer."""
        return Figure(build_map_svg(self._made.page))


@dataclass(frozen=True)
class Map:
    """Stiffness and dexterity at a set of samples. :func:`map` makes one."""

    cell: Cell
    _made: MapComputation

    @property
    def result(self) -> MapDocument:
        """map.json, typed."""
        return self._made.result

    @property
    def verdict(self) -> str:
        """One sentence, with what was not checked."""
        return self._made.message

    @cached_property
    def layers(self) -> dict[str, Table]:
        """One table for each layer, with the columns of its CSV file: ``given``, and ``free`` where the rotation is
        free.
        """
        made, first = self._made, self._made.layers[0]
        out = {}
        for layer in made.layers:
            columns = build_map_columns(made.samples, layer, made.options, first, made.comparison)
            out[layer.name] = Table({c.name: _convert_column(c.values) for c in columns})
        return out

    @property
    def samples(self) -> Table:
        """Columns of ``map.csv``, one row for each sample."""
        return next(iter(self.layers.values()))

    @property
    def figures(self) -> MapFigures:
        return MapFigures(self._made)

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(self.result.warnings)

    @use_argument_names()
    def save(self, out: Named, *, force: bool = False) -> MapDocument:
        """Write what ``machopt map`` writes; returns map.json, typed.

        Args:
            out: a folder that is new, empty or an earlier output, which is replaced as a whole.
            force: replace an earlier output though files in it were edited or added.

        Raises:
            InputError: OUT holds something else or cannot be written; or the cell has changed since.
        """
        save_result(self.cell, out, lambda folder: write_map_files(self._made, folder), force=force)
        return self.result

    def __repr__(self) -> str:
        return f"<Map of {self.cell.name!r}: {self.verdict}>"


@use_argument_names()
def map(cell: Cell | Named, *, progress: Progress = ignore_progress, **options: Unpack[MapOptions]) -> Map:
    """Stiffness and dexterity over workspace or joint space: ``machopt map``.

    Args:
        cell: a cell, or the path of its folder.
        progress: called with each stage, in words.
        options: as :class:`machopt.workspace_map.request.MapRequest` has them, e.g. ``slice="xy"``, ``at=800``,
            ``steps=["100"]``, ``force="0,0,500"``; numbers in mm, degrees, N.

    Raises:
        InputError: bad cell, option or measured table.
    """
    a_cell = load_cell_argument(cell)
    request = build_request(
        MapRequest,
        options,
        cell=a_cell.path,
        out=NOWHERE,
        allow_external=a_cell.allow_external,
        effects=tuple(own.file for own in a_cell.effects),
    )
    with use_cell_effects(a_cell):
        return Map(a_cell, compute_map(request, progress, a_cell.description))


def _convert_column(values: Array | Sequence[str]) -> NDArray[Any]:
    """Numbers, also those that the table writes as words because some are missing; else words."""
    if isinstance(values, np.ndarray):
        return values.copy()
    numbers = all(v.lstrip("-").isdigit() or not v for v in values)
    return np.array([float(v or "nan") for v in values]) if numbers else np.array(values)
