"""Toolpath as every reader returns it and every planning step takes it."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.stock import StockEngagement
from machopt.numerics.array_types import Array


class MoveKind(enum.IntEnum):
    """What the robot does on the way **to** a point. The names are the tables' words, in lower case."""

    CUT = 0
    RAPID = 1
    APPROACH = 2
    RETRACT = 3
    LINK = 4

    @property
    def word(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class ToolpathOperation:
    """A run of consecutive points that belong together."""

    label: str
    kind: Literal["point", "trajectory"]  # point: drilling and the like, cuts run along the tool axis
    tool: str = ""
    comment: str = ""
    tool_named: str = ""  # another word of the file for the same tool, such as its name in addition to its number

    @property
    def tools(self) -> tuple[str, ...]:
        """Every word of the file for its tool."""
        return tuple(word for word in (self.tool, self.tool_named) if word)


@dataclass(frozen=True)
class ToolpathEvent:
    """Event just before the move to point ``index`` starts (spindle, coolant, tool, dwell)."""

    index: int
    kind: Literal["spindle", "coolant", "tool", "dwell", "stop", "comment"]
    text: str  # the source words
    value: float = float("nan")  # rpm, tool number, s


@dataclass(frozen=True)
class IgnoredWord:
    """Word of the source that was read but has no effect, with its first place."""

    word: str
    count: int
    first_line: int
    understood: bool  # True: known and without effect on motion; False: not understood
    stops: bool = False  # True: it may move points or frames, so no plan is made unless the user accepts it


@dataclass(frozen=True, kw_only=True)
class Toolpath:
    """Points of the tool tip with tool axis, in ``workpiece``; N rows in source order, none merged or dropped.

    Row k describes the straight move that **ends** at point k.
    """

    position: Array  # (N, 3) m
    axis: Array  # (N, 3) unit, from tip to shank (−z of the TCP)
    move: NDArray[np.int8]  # (N,) Move codes
    feed: Array  # (N,) m/s along the move that ends here; NaN for rapid moves
    operation: NDArray[np.int32]  # (N,) index into ``operations``
    operations: tuple[ToolpathOperation, ...]
    reference: Array  # (N, 3) direction of TCP x at gamma = 0 where the source gives one, else NaN
    tolerance: Array  # (N,) m, NaN where the source gives none
    line: NDArray[np.int32]  # (N,) 1-based line of the source
    source: str  # file name, for messages and reports
    format: str  # e.g. "csv", "apt/nx", "gcode"
    sha256: str  # of the source file
    events: tuple[ToolpathEvent, ...] = ()
    ignored: tuple[IgnoredWord, ...] = ()
    warnings: tuple[str, ...] = ()
    meta: dict[str, str] = field(default_factory=dict)
    offsets: tuple[
        tuple[int, str], ...
    ] = ()  # points from which another work offset of the cell counts, not placed yet
    surface_normal: Array | None = None  # (N, 3) unit, away from the material, where the source gives it, else NaN
    hole_depth: Array | None = None  # (N,) m, surface to the bottom of a hole where the file states it, else NaN
    process_operation: NDArray[np.int32] | None = None  # (N,) operation of process.yaml, −1 for none; None: no process
    force: Array | None = None  # (N, 3) N along travel, normal, axis on the way to the point; NaN: planning option
    engagement: StockEngagement | None = None  # contact with the stock, where operations take it from there

    def __post_init__(self) -> None:
        for name in ("position", "axis", "move", "feed", "operation", "reference", "tolerance", "line"):
            getattr(self, name).setflags(write=False)
        for array in (self.surface_normal, self.hole_depth, self.process_operation, self.force):
            if array is not None:
                array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.position)

    @property
    def dwells(self) -> Array:
        """(N + 1,) dwell times of the file, s: entry 0 before the first point, k + 1 at point k; 0 without a stated
        time.
        """
        out = np.zeros(len(self) + 1)
        for event in self.events:
            if event.kind == "dwell" and event.value > 0.0:
                out[min(event.index, len(self))] += event.value
        return out

    @property
    def cutting(self) -> NDArray[np.bool_]:
        """(N,) True where the move to the point cuts."""
        return np.asarray(self.move == MoveKind.CUT)


def format_incomplete_warning(reason: str) -> str:
    """Return the warning of a toolpath whose file seems to end too early.

    Args:
        reason: The reason, from ``meta["incomplete"]``.
    """
    return f"INCOMPLETE FILE? {reason}"
