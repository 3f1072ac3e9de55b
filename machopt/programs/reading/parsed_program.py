"""Data of a parsed robot program, independent of the writers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import IgnoredWord, ToolpathEvent
from machopt.numerics.array_types import Array

JOINT, LINEAR = 0, 1


@dataclass(frozen=True)
class ProgramFrame:
    """A base (user, work object) frame in the robot's own system, or a tool in its flange."""

    name: str
    T: Array | None  # (4, 4) m; None where the program names it but the controller holds the numbers
    rides_on: str = ""  # the mechanical unit that moves it, in the maker's word; T is then in that unit's own flange


@dataclass(frozen=True, kw_only=True)
class ParsedProgram:
    """M moves in the order the controller carries them out; calls followed, arcs as chords."""

    dialect: str
    name: str
    files: tuple[Path, ...]  # the requested file first
    kind: NDArray[np.int8]  # (M,) JOINT or LINEAR
    axes_deg: Array  # (M, 6) as the program counts them; NaN where the target is a pose
    T_base_tcp: Array  # (M, 4, 4) m; NaN where the target is given in axes
    feed: Array  # (M,) m/s of the TCP on linear moves; NaN where the program gives none
    blend: Array  # (M,) m, how far from the target the robot may leave it; 0 exact stop, NaN not given in mm
    time: Array  # (M,) s from the start, NaN where the format gives none
    external: Array  # (M, E) as written: mm, deg or pulses, of messages of ROS m or rad; NaN where absent
    configuration: tuple[Mapping[str, object], ...]  # (M,) status, turns, confdata … in the maker's own names
    base: NDArray[np.int32]  # (M,) index into ``bases``
    tool: NDArray[np.int32]  # (M,) index into ``tools``
    bases: tuple[ProgramFrame, ...]
    tools: tuple[ProgramFrame, ...]
    move: NDArray[np.int8]  # (M,) Move codes: joint moves rapid, linear ones as in a comment, else cut
    operation: NDArray[np.int32]  # (M,) index into ``operations``, −1 before the first
    operations: tuple[str, ...]
    events: tuple[ToolpathEvent, ...]  # index of the move they come before
    line: NDArray[np.int32]  # (M,) 1-based, in the file that holds the move
    ignored: tuple[IgnoredWord, ...] = ()
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(M,) True where the target is a pose."""
        return np.asarray(np.isfinite(self.T_base_tcp[:, 0, 3]))
