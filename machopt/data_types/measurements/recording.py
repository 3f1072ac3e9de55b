"""Recording of measurements on a real robot: joint positions, loads, displacements or poses.

All values are in SI and in the frames that the file states. The conversion to base axes at the TCP needs kinematics
and is done in :mod:`machopt.measurement.estimation.load_test_equations`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Ints

RecordingKind = Literal["deflection", "absolute", "motion"]
FrameName = Literal["base", "tool"]


@dataclass(frozen=True, kw_only=True)
class StandardUncertainty:
    """1 sigma as the recording states it; None where it does not."""

    displacement: float | None = None  # m
    rotation: float | None = None  # rad
    force: float | None = None  # N
    moment: float | None = None  # N·m
    joint: float | None = None  # rad
    target: float | None = None  # m, of a coordinate of a reflector's nominal place
    tilt: float | None = None  # rad, of an inclinometer


@dataclass(frozen=True)
class TrackerTarget:
    """A reflector that a tracker looks at."""

    name: str  # as the column ``target`` says
    place: tuple[float, float, float]  # m in flange, by the drawing


@dataclass(frozen=True, kw_only=True)
class Recording:
    """N readings. A channel that the file does not have is None."""

    kind: RecordingKind
    source: str  # folder name, for messages
    q: Array  # (N, n) rad (m of a joint that slides), joint positions by encoder; n = 6 of a planned arm
    pose: Ints  # (N,) same label: same robot pose; numbered by q where the file has no column
    cycle: Ints  # (N,) same label inside a pose: same load cycle; every reading its own where there is no column
    session: Ints  # (N,) same label: same day and set-up; all 0 where there is no column
    line: Ints  # (N,) 1-based line of each reading in the data file; 1-based row of a Parquet file
    wrench: Array | None = None  # (N, 6) N, N·m on the robot, axes of wrench_frame, about wrench_point
    wrench_frame: FrameName = "base"
    wrench_point: Array | None = None  # (3,) m in flange; None: the TCP
    displacement: Array | None = None  # (N, 3) m, or (N, 6) m and rad; TCP against the unloaded state of its cycle
    displacement_frame: FrameName = "base"
    position: Array | None = None  # (N, 3) m, measured TCP (or reflector, see targets) in base_link
    quaternion: Array | None = None  # (N, 4) w x y z, measured TCP orientation in base_link, unit length
    time: Array | None = None  # (N,) s
    temperature: Array | None = None  # (N,) °C
    branch: NDArray[np.int8] | None = None  # (N,) +1 loading, −1 unloading, 0 not stated
    q_command: Array | None = None  # (N, n) rad (m)
    q_secondary: Array | None = None  # (N, n) rad (m), link-side encoder; NaN where an axis has none
    velocity: Array | None = None  # (N, n) rad/s (m/s)
    torque: Array | None = None  # (N, n) N·m (N) at the joint
    current: Array | None = None  # (N, n) A
    prismatic: tuple[bool, ...] = ()  # which joints slide; empty: all turn
    registration: Literal["fixed", "fit"] = "fixed"  # "fit": tracker-to-base pose and target position are nominal
    targets: tuple[TrackerTarget, ...] = ()  # reflectors that were measured; empty: the TCP itself
    target: Ints | None = None  # (N,) index into targets; None: all readings are of the first, or of the TCP
    frame: Ints | None = None  # (N,) same label: same stand of the tracker; None: it never moved
    tilt: Array | None = (
        None  # (N, 2) rad, rotation of tilt_link about base x and y beyond the encoders' word; NaN: not read
    )
    tilt_link: str = ""  # a link of the URDF, or its number of moved joints ("3", "link:3"); empty: no tilts
    used: NDArray[np.bool_] | None = None  # (N,) False: the reading is not used; None: all are
    uncertainty: StandardUncertainty = field(default_factory=StandardUncertainty)
    notes: str = ""
    stated_labels: frozenset[str] = frozenset()  # which of "pose", "cycle", "session" the file itself states
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()  # names of the data files; empty where nothing was read
    file: Ints | None = None  # (N,) index into files; None: all readings stand in the first

    @property
    def needs_any_chain(self) -> bool:
        """Whether the arm may be another chain than six revolute joints."""
        return self.kind == "motion" or any(self.prismatic) or self.q.shape[1] != 6

    def __len__(self) -> int:
        return len(self.q)

    def place(self, reading: int) -> str:
        """Return file and line of a reading for messages: ``line 12``, or ``run_b.csv line 12`` of several files.

        Args:
            reading: Number of the reading, from 0.
        """
        name = "" if self.file is None or len(self.files) < 2 else f"{self.files[self.file[reading]]} "
        return f"{name}line {self.line[reading]}"
