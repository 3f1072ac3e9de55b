"""Motion program as every post takes it, and the controller it is written for.

The cell states the map from joint positions of the URDF to the controller's axis angles:

  a = C (sign · deg(q) + offset_deg),   C = 1 + coupling.

``coupling`` holds what one axis adds to another. FANUC counts J3 from the horizontal. Robots with a parallel
linkage count the motor of axis 3, which does not turn with the lower arm. Both are one entry (axis 3 from axis 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, ToolpathEvent
from machopt.numerics.array_types import Array

PTP, LIN = 0, 1
LEAST_FEED = 1e-6  # m/s, the last digit of KUKA's $VEL.CP

EVENT_LINES = ("spindle_on", "spindle_off", "coolant_on", "coolant_off", "tool", "dwell", "stop", "comment")
"""What a CAM event becomes in a program: names of template items, and keys of the cell's ``controller.lines``."""


@dataclass(frozen=True)
class JointMap:
    """Map from joint positions of the URDF to the controller's axis angles: see the module docstring."""

    sign: Array = field(default_factory=lambda: np.ones(6))  # (6,) ±1
    offset_deg: Array = field(default_factory=lambda: np.zeros(6))  # (6,)
    coupling: Array = field(default_factory=lambda: np.zeros((6, 6)))  # (6, 6), row: axis that gains, strictly lower

    def compute_axes_deg(self, q: Array) -> Array:
        """Return the (..., 6) axis angles as the controller counts them, deg.

        Args:
            q: (..., 6) joint positions of the URDF, rad.
        """
        plain = self.sign * np.degrees(q) + self.offset_deg
        return np.asarray(plain + plain @ self.coupling.T)


@dataclass(frozen=True)
class ExternalProgramAxis:
    """External joint of a cell as programs need it."""

    joint: str  # its name in the URDF
    slides: bool  # mm, else degrees
    carries_part: bool  # a positioner; else it carries the robot's base (rail, gantry)


@dataclass(frozen=True, kw_only=True)
class ExternalAxisMap:
    """Controller value of one external joint: sign · value + offset, mm or degrees."""

    number: int | None = None  # of KUKA's E1 … E6, ABB's eax_a … f; None: by its place among the cell's external joints
    sign: float = 1.0  # ±1
    offset: float = 0.0  # mm or deg, the controller's value where the URDF's joint is zero
    unit: str | None = None  # ABB: name of the mechanical unit
    machine: int | None = None  # KUKA: which MACHINE_DEF the positioner is
    pulses: float | None = None  # per mm or deg, Yaskawa


@dataclass(frozen=True, kw_only=True)
class RobotController:
    """Data of the robot's controller that posts need; everything is optional, and missing values are reported."""

    post: str | None = None  # a post's name, or a template file; None: no maker is known and none is assumed
    joint_map: JointMap | None = None  # None: the URDF's joints are taken as they are
    T_base_root: Array | None = None  # (4, 4) the controller's own robot coordinate system in base_link
    T_world_root: Array | None = None  # (4, 4) the controller's WORLD in the cell's, where a rail carries the robot
    external: Mapping[str, ExternalAxisMap] = field(default_factory=dict)  # by the joint's name in the URDF
    T_flange_mount: Array | None = None  # (4, 4) the controller's flange (tool 0) in the URDF's flange link
    tool_number: int | None = None
    base_number: int | None = None
    pulses_per_deg: Array | None = None  # (6,) Yaskawa
    position_levels: Array | None = None  # (8,) m, Yaskawa's PL=1 … 8, rising
    moves_per_part: int | None = None  # instead of the template's
    nonflip_j5: Literal["negative", "positive"] | None = None  # FANUC: the sign of J5 for its N
    lines: Mapping[str, str] = field(default_factory=dict)  # program lines by event, keys EVENT_LINES
    absolute_accuracy: Literal["on", "off", "unknown"] = "unknown"  # on: it corrects geometry and gravity sag itself


@dataclass(frozen=True, kw_only=True)
class RobotProgram:
    """M moves in order, SI, joints as the URDF counts them.

    The first move must be a PTP. ``T_base_workpiece`` holds with the external axes where they stand at that move.
    """

    kind: NDArray[np.int8]  # (M,) PTP or LIN
    q: Array  # (M, 6) rad, at the end of the move
    T_workpiece_tcp: Array  # (M, 4, 4), at the end of the move
    feed: Array  # (M,) m/s of the TCP on LIN moves; NaN on PTP
    cutting: NDArray[np.bool_]  # (M,)
    operation: NDArray[np.int32]  # (M,) index into ``operations``, −1 for none
    operations: tuple[str, ...]
    T_flange_tcp: Array  # (4, 4)
    T_base_workpiece: Array  # (4, 4), workpiece in the robot's base_link
    external: Array = field(default_factory=lambda: np.empty((0, 0)))  # (M, E) rad or m
    external_axes: tuple[ExternalProgramAxis, ...] = ()  # (E,)
    T_carrier_workpiece: Array | None = None  # (4, 4) in the positioner's link, else, on a rail alone, in world
    events: tuple[ToolpathEvent, ...] = ()  # ``index`` is the move that the event comes before
    ptp_speed: float = 0.8  # share of the axis velocity limits on PTP moves
    rapid_share: Array | None = None  # (M,) of the joint moves to and from a target over which it may be rounded
    rapid_zone: Array | None = None  # (M,) m, the same as a distance of the tool from the target; 0: a stop
    blend: float = 0.0  # m by which rounded corners may pass a point between cutting moves; 0 stops exactly at each
    source: str = ""  # what it was made from, for the head comment
    move: NDArray[np.int8] | None = None  # (M,) Move codes; by default rapid, cut or link from kind and cutting
    wrist_behind: NDArray[np.bool_] | None = None  # (M,) the wrist root lies behind axis 1
    elbow_up: NDArray[np.bool_] | None = None  # (M,) it lies on the front side of the line from axis 2 to axis 3
    time: Array | None = None  # (M,) s from the start, rising; for posts that give times
    joint_names: tuple[str, ...] = tuple(f"joint_{i}" for i in range(1, 7))
    axis_velocity: Array | None = None  # (6,) rad/s, limits that ``ptp_speed`` is a share of
    axis_acceleration: Array | None = None  # (6,) rad/s², limits that say how fast corners can be driven
    tool_mass: float = float("nan")  # kg
    tool_com: Array = field(default_factory=lambda: np.zeros(3))  # (3,) m, in flange

    def __post_init__(self) -> None:
        if len(self.kind) == 0 or self.kind[0] != PTP:
            raise ValueError("a robot program begins with a PTP move")
        if not (self.feed[self.kind == LIN] >= LEAST_FEED).all():
            raise ValueError("every LIN move needs a feed of at least 1e-6 m/s, the last digit of $VEL.CP")
        if len(self.external_axes) != (self.external.shape[1] if self.external.size else 0):
            raise ValueError("external_axes needs one entry for each column of external")
        if self.time is not None and not (np.diff(self.time) > 0).all():
            raise ValueError("the times of a program must rise")

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def part_rides(self) -> bool:
        """Whether a positioner carries the workpiece."""
        return any(axis.carries_part for axis in self.external_axes)

    @property
    def moves(self) -> NDArray[np.int8]:
        """(M,) Move codes."""
        if self.move is not None:
            return self.move
        drawn = np.where(self.cutting, np.int8(MoveKind.CUT), np.int8(MoveKind.LINK))
        return np.where(self.kind == PTP, np.int8(MoveKind.RAPID), drawn).astype(np.int8)
