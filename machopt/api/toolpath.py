"""Toolpath of the Python API."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from machopt.api.cell import Cell
from machopt.api.error_message_translation import use_argument_names
from machopt.api.option_types import ReadingOptions
from machopt.api.request_options import convert_to_path
from machopt.cell.work_offsets import place_toolpath
from machopt.commands.toolpath_reading_options import get_reading_options
from machopt.data_types import toolpath as domain
from machopt.numerics.array_types import Array
from machopt.toolpath.reading_options import parse_reading_options
from machopt.toolpath.toolpath_reader import read_toolpath


@dataclass(frozen=True)
class Toolpath:
    """Points of the tool tip with tool axis, N of them, in the order of the file. :meth:`read` makes one."""

    path: Path  # the file, as it was given
    description: domain.Toolpath  # everything that was read, in SI
    reading: Mapping[str, Any] = field(default_factory=dict)  # how it was read, for the manifest

    @classmethod
    @use_argument_names()
    def read(
        cls, path: str | os.PathLike[str], *, cell: Cell | None = None, **reading: Unpack[ReadingOptions]
    ) -> Toolpath:
        """Read a CAM export, a robot program or a point table.

        Args:
            path: the file; its content decides its format.
            cell: whose robot a program with joint positions was written for.
            reading: what the file does not say itself, by the names of ``manifest.json``: ``unit`` ("mm", "inch"),
                ``machine``, ``feed_mm_min``, ``tool_axis``, ``offsets``, ``decimals``, ``cycle_order``, ``kind``,
                ``accept_unknown``, ``strict`` …

        Raises:
            InputError: names file and line, what was found and what was expected; or a keyword that is none of these.
        """
        options, file = parse_reading_options(reading), convert_to_path(path, "toolpath")
        if cell is None:
            return cls(file, read_toolpath(file, **options), options)
        found = read_toolpath(file, **get_reading_options(cell.description), **options)
        return cls(file, place_toolpath(found, cell.description), options)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.description)

    @property
    def position(self) -> Array:
        """(N, 3) tool tip in ``workpiece``, mm."""
        out = 1e3 * self.description.position
        out.setflags(write=False)
        return out

    @property
    def axis(self) -> Array:
        """(N, 3) unit vectors from tip to shank in ``workpiece``."""
        return self.description.axis

    @property
    def feed(self) -> Array:
        """(N,) feed of the move that ends at each point, mm/min; NaN for rapid moves."""
        out = 60e3 * self.description.feed
        out.setflags(write=False)
        return out

    @property
    def move(self) -> tuple[str, ...]:
        """(N,) type of the move to each point: cut, rapid, approach, retract, link."""
        return tuple(domain.MoveKind(m).word for m in np.asarray(self.description.move).tolist())

    @property
    def operations(self) -> tuple[str, ...]:
        """Labels of the operations, in their order."""
        return tuple(o.label for o in self.description.operations)

    @property
    def not_understood(self) -> tuple[str, ...]:
        """Unknown words of the file, each with its first line; those that may move points prevent a plan."""
        words = self.description.ignored
        return tuple(f"{w.word} (line {w.first_line})" for w in words if not w.understood)

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.description.warnings

    def __repr__(self) -> str:
        return f"<Toolpath of {len(self)} points, {self.description.format}, {self.path}>"


def read_toolpath_argument(path: Toolpath | str | os.PathLike[str], cell: Cell) -> Toolpath:
    """Return a toolpath; a path is read.

    Args:
        path: A toolpath, or its path.
        cell: The robot cell.

    Raises:
        InputError: the file is no toolpath.
    """
    return path if isinstance(path, Toolpath) else Toolpath.read(path, cell=cell)
