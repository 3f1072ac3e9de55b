"""Robot program as an independent reader parsed it, in the cell's frames and units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import ToolpathEvent
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class ProgramInCell:
    """M moves in the order the controller carries them out, SI, joints as the URDF counts them.

    Poses follow from encoder angles by the nominal kinematics, because that is what a controller computes with.
    """

    file: str  # inside the output folder
    kind: NDArray[np.int8]  # (M,) PTP or LIN of machopt.data_types.robot_program
    q: Array  # (M, 6) rad; NaN where the target is a pose only
    external: Array  # (M, E) rad or m as the cell lists them; NaN where the program does not say
    T_workpiece_tcp: Array  # (M, 4, 4), of joint targets by forward kinematics
    feed: Array  # (M,) m/s on LIN moves, NaN where the program does not say
    move: NDArray[np.int8]  # (M,) Move codes as its comments say
    operation: tuple[str, ...]  # (M,) labels, empty for none
    events: tuple[ToolpathEvent, ...]  # index: the move that they come before
    line: NDArray[np.int32]  # (M,) in the file that holds the move
    time: Array  # (M,) s, NaN where the format gives none
    is_streamed: bool = False  # one move a control sample
    feed_step: float = 1e-6  # m/s, how coarsely the format prints feeds
    place_step: float = 0.0  # m, how coarsely it prints places (encoder pulses at arm's length)
    joint_step: float = 0.0  # rad, the same of joints
    target_step: float = 0.0  # m, what the last decimals of its joint targets are worth at arm's length

    @property
    def print_resolution(self) -> float:
        """The largest distance (m) between two targets that mean the same place, due to the printed decimals."""
        return 2.0 * max(self.place_step, self.target_step)

    def __len__(self) -> int:
        return len(self.kind)
