"""Measured cuts: conditions and mean forces, SI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from machopt.data_types.cell import CutterGeometry
from machopt.numerics.array_types import Array, Ints, make_arrays_read_only

ForceFrame = Literal["feed", "base", "tool"]
CUT_SIDES = ("up", "down", "slot")


@dataclass(frozen=True, kw_only=True)
class CuttingRecording:
    """N measured cuts; each row is the mean over whole revolutions of one steady cut."""

    source: str  # name of the folder
    files: tuple[Path, ...]
    file: Ints  # (N,) index into ``files``
    line: Ints  # (N,) 1-based
    spindle_speed: Array  # (N,) rev/s
    feed: Array  # (N,) m/s
    ae: Array  # (N,) m; NaN: not stated, for slots
    ap: Array  # (N,) m
    side: tuple[str, ...]  # (N,) of CUT_SIDES
    spindle: Literal["cw", "ccw"]
    force: Array  # (N, 3) N, on the tool, axes of ``frame``
    frame: ForceFrame  # feed: travel, normal, axis from tip to shank
    travel: Array | None  # (N, 3) direction of travel in axes of ``frame``
    q: Array | None  # (N, 6) rad, for ``base``
    cutter: CutterGeometry | None  # None: that of the cell
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    def __len__(self) -> int:
        return len(self.line)

    def format_place(self, row: int) -> str:
        """Return file and line of a row: ``data.csv line 12``.

        Args:
            row: row, from 0.
        """
        return f"{self.files[self.file[row]].name} line {self.line[row]}"
