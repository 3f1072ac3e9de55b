"""Columns of a recording: groups, units, and the kinds of recording that require them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.effect_locations import MOST_JOINTS
from machopt.data_types.measurements.recording import RecordingKind
from machopt.measurement.recording.recording_table import COORDINATES, THREE, AllowedColumns, RecordingTable
from machopt.numerics.array_types import Array

LABELS = ("pose", "cycle", "session")
USED = "used"  # 1, or 0 of a reading that is not used
TILTS = ("tilt_x_mrad", "tilt_y_mrad")  # of measured poses: an inclinometer on a link
SEEN = ("target", "frame")  # of measured poses: which reflector, and from which stand of the tracker
BRANCHES = {"load": 1, "unload": -1, "": 0}  # empty cell: not stated

Prismatic = tuple[bool, ...]  # one entry per joint: True if prismatic

_MOST_LABEL = 2.0**53  # larger integers are not exact as doubles
_UNIT_LENGTH = 2e-3  # tolerance of a quaternion's norm: numbers with three decimals are within it
_EXACT_LENGTH = 1e-9  # within this tolerance a quaternion is not normalised


@dataclass(frozen=True, kw_only=True)
class RecordingChannel:
    """Group of columns that forms one array of a recording."""

    field: str  # field of Recording
    columns: tuple[str, ...]
    si: float  # SI units per unit of the file
    decimals: int  # printed decimals
    needed: int  # this number of first columns must be present together
    rest: Literal["all", "zero", "nan"] = "all"  # treatment of missing further columns
    turns: str = ""  # column name of revolute joint {}; empty: not one column per joint
    slides: str = ""  # column name of prismatic joint {}; empty: the same
    sparse: bool = False  # cells may be empty (NaN)

    def names(self, prismatic: Prismatic) -> tuple[str, ...]:
        """Return the column names for a chain of joints.

        Args:
            prismatic: For each joint, whether it is prismatic.

        Returns:
            Column names.
        """
        if not self.turns:
            return self.columns
        return tuple((self.slides or self.turns if p else self.turns).format(i) for i, p in enumerate(prismatic, 1))

    def units(self, prismatic: Prismatic) -> tuple[float, ...]:
        """Return the SI units per unit of each column.

        Args:
            prismatic: For each joint, whether it is prismatic.

        Returns:
            One factor per column.
        """
        slide = 1e-3 if self.slides.endswith(("_mm", "_mm_s")) else self.si
        return tuple(slide if p and self.turns else self.si for p in prismatic or (False,) * len(self.columns))


def _list_six_names(name: str) -> tuple[str, ...]:
    return tuple(name.format(i) for i in range(1, 7))


def _define_joint_channel(
    field: str, turns: str, slides: str, si: float, decimals: int, needed: int = 6
) -> RecordingChannel:
    return RecordingChannel(
        field=field,
        columns=_list_six_names(turns),
        si=si,
        decimals=decimals,
        needed=needed,
        rest="all" if needed else "nan",
        turns=turns,
        slides=slides,
    )


_DEG = np.pi / 180.0
CHANNELS = (
    _define_joint_channel("q", "q{}_deg", "q{}_mm", _DEG, 9),
    RecordingChannel(
        field="wrench",
        columns=("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"),
        si=1.0,
        decimals=6,
        needed=3,
        rest="zero",
    ),
    RecordingChannel(
        field="displacement",
        columns=("dx_mm", "dy_mm", "dz_mm", "rx_mrad", "ry_mrad", "rz_mrad"),
        si=1e-3,
        decimals=7,
        needed=3,
    ),
    RecordingChannel(field="position", columns=("x_mm", "y_mm", "z_mm"), si=1e-3, decimals=7, needed=3),
    RecordingChannel(field="quaternion", columns=("qw", "qx", "qy", "qz"), si=1.0, decimals=12, needed=4),
    RecordingChannel(field="time", columns=("time_s",), si=1.0, decimals=9, needed=1),
    RecordingChannel(field="temperature", columns=("temperature_C",), si=1.0, decimals=5, needed=1),
    RecordingChannel(field="tilt", columns=TILTS, si=1e-3, decimals=7, needed=2, sparse=True),
    _define_joint_channel("q_command", "qcmd{}_deg", "qcmd{}_mm", _DEG, 9),
    _define_joint_channel("q_secondary", "qse{}_deg", "qse{}_mm", _DEG, 9, 0),
    _define_joint_channel("velocity", "qd{}_deg_s", "qd{}_mm_s", _DEG, 8),
    _define_joint_channel("torque", "tau{}_Nm", "tau{}_N", 1.0, 6),
    _define_joint_channel("current", "current{}_A", "", 1.0, 7),
)
ONE_COLUMN = ("time", "temperature")  # (N,) and not (N, 1)

NEEDED: dict[RecordingKind, tuple[str, ...]] = {
    "deflection": ("q", "wrench", "displacement"),
    "absolute": ("q", "position"),
    "motion": ("q", "time"),
}
MOTION_SHOWS = ("q_command", "q_secondary", "torque", "current", "position", "wrench")  # q and one of them
_USELESS: dict[RecordingKind, tuple[str, ...]] = {
    "deflection": ("position", "quaternion"),
    "absolute": ("displacement",),
    "motion": ("displacement",),
}

_AT_REST = AllowedColumns(
    numbers=(
        *LABELS,
        USED,
        *(name for channel in CHANNELS for name in channel.columns),
        *(f"q{i}_deg" for i in range(7, MOST_JOINTS + 1)),
        *(f"q{i}_mm" for i in range(1, MOST_JOINTS + 1)),
    ),
    words=("branch",),
    listed_names="pose, cycle, session, used, branch, "
    + ", ".join(
        f"{c.columns[0]} … {c.columns[-1]}" if len(c.columns) > 4 else ", ".join(c.columns)
        for c in CHANNELS
        if not c.sparse
    )
    + "; q1_mm of a joint that slides",
)
_POSES_ONLY = {
    name: f"column {name} belongs to recordings of kind absolute, where a tracker measures reflectors" for name in SEEN
}
_TILTS = {
    name: f"column {name} belongs to recordings of kind absolute, where an inclinometer sits on a link"
    for name in TILTS
}
_AT_POSES = AllowedColumns(
    numbers=(*_AT_REST.numbers, "frame"),
    words=(*_AT_REST.words, "target"),
    listed_names=f"{_AT_REST.listed_names}, target, frame, {', '.join(TILTS)}",
    names=("target",),
    sparse=TILTS,
)
_SLIDES = {
    f"q{i}_mm": "joints that slide are read in recordings of kind absolute and motion; a load test is of "
    "revolute joints, q1_deg …, and on a rail at rest during the measurement they are enough"
    for i in range(1, MOST_JOINTS + 1)
}
_AT_LOADS = replace(_AT_REST, refused_names={**_POSES_ONLY, **_TILTS, **_SLIDES})
_ANY_JOINT = [
    pattern.format(i)
    for channel in CHANNELS
    for i in range(1, MOST_JOINTS + 1)
    for pattern in dict.fromkeys((channel.turns, channel.slides))
    if pattern
]
_MOTORS = tuple(f"motor{i}_deg" for i in range(1, MOST_JOINTS + 1))
_IN_MOTION = AllowedColumns(
    numbers=tuple(dict.fromkeys((*_AT_REST.numbers, *_ANY_JOINT, *_MOTORS))),
    words=_AT_REST.words,
    listed_names=f"{_AT_REST.listed_names}, motor1_deg …; of a joint that slides q1_mm, qcmd1_mm, qse1_mm, "
    f"qd1_mm_s, tau1_N",
    refused_names={**_POSES_ONLY, **_TILTS},
)


def list_allowed_columns(kind: RecordingKind) -> AllowedColumns:
    """Return the columns that a recording may have: any chain of joints for a motion, else six joints or more.

    Args:
        kind: Kind of the recording.

    Returns:
        The allowed columns.
    """
    if kind == "motion":
        return _IN_MOTION
    return _AT_POSES if kind == "absolute" else _AT_LOADS


def find_sliding_joints(table: RecordingTable, kind: RecordingKind) -> Prismatic:
    """Find the prismatic joints of a table.

    Args:
        table: Table of one data file.
        kind: Kind of the recording.

    Returns:
        For each joint of the table, whether it is prismatic.

    Raises:
        InputError: A joint is missing, or stated both as angle and as length.
    """
    turns, slides = (
        {i for i in range(1, MOST_JOINTS + 1) if name.format(i) in table.numbers} for name in ("q{}_deg", "q{}_mm")
    )
    both = sorted(turns & slides)
    if both:
        raise table.build_error(f"q{both[0]}_deg and q{both[0]}_mm both stand; a joint turns or slides, keep one")
    there = sorted(turns | slides)
    if kind != "motion" and max(there, default=0) <= 6:  # read_channels lists what is missing of six
        return tuple(i in slides for i in range(1, 7))
    left_out = [i for i in range(1, max(there, default=0)) if i not in there]
    if left_out:
        have = ", ".join(f"q{i}_mm" if i in slides else f"q{i}_deg" for i in there)
        raise table.build_error(f"column q{left_out[0]}_deg is missing; it is required with {have}")
    return tuple(i in slides for i in there) or (False,) * 6


def read_channels(
    table: RecordingTable, kind: RecordingKind, prismatic: Prismatic, given: dict[str, Array] | None = None
) -> tuple[dict[str, Array], list[str]]:
    """Read the arrays of a table in SI, by field of :class:`~machopt.data_types.measurements.recording.Recording`.

    Args:
        table: Table read with :func:`list_allowed_columns`.
        kind: Kind of the recording.
        prismatic: For each joint, whether it is prismatic; see :func:`find_sliding_joints`.
        given: Arrays for columns that are missing.

    Returns:
        The arrays, and warnings.

    Raises:
        InputError: Required columns are missing, a group is incomplete, a column does not match a joint, or a
            quaternion is not unit.
    """
    out = {c.field: array for c in CHANNELS if (array := _read_channel(table, c, prismatic)) is not None}
    out |= {name: array for name, array in (given or {}).items() if name not in out}
    columns = {c.field: c.columns[: c.needed or 6] for c in CHANNELS}
    missing = [name for field in NEEDED[kind] if field not in out for name in columns[field]]
    if missing:
        other = next((k for k, fields in NEEDED.items() if all(f in out for f in fields)), None)
        hint = f"; the columns are those of kind {other}" if other else ""
        raise table.build_error(f"kind {kind} needs the columns {', '.join(missing)}; they are missing{hint}")
    if kind == "motion" and not any(field in out for field in MOTION_SHOWS):
        shows = ", ".join(columns[field][0] for field in MOTION_SHOWS)
        raise table.build_error(f"kind motion needs something to compare q1_deg … q6_deg with; one of {shows} …")
    warnings = [
        f"{table.path.name}: {', '.join(columns[field])} are not used in a recording of kind {kind}"
        for field in _USELESS[kind]
        if field in out
    ]
    if "quaternion" in out:
        out["quaternion"] = _normalise_quaternions(table, out["quaternion"])
    return out, warnings


def read_labels(table: RecordingTable, name: str) -> NDArray[np.int64]:
    """Read a column of integers.

    Args:
        table: Table of one data file.
        name: Column name.

    Returns:
        (N,) labels.

    Raises:
        InputError: A label is not an integer, or too large.
    """
    values = table.numbers[name]
    bad = np.flatnonzero((values != np.round(values)) | (np.abs(values) >= _MOST_LABEL))
    if bad.size:
        raise table.build_error(f"found {values[bad[0]]:.17g}; expected a whole number below 2^53", int(bad[0]), name)
    return values.astype(np.int64)


def read_used_rows(table: RecordingTable) -> NDArray[np.bool_] | None:
    """Read the column ``used``.

    Args:
        table: Table of one data file.

    Returns:
        (N,) True for readings that take part; None without the column.

    Raises:
        InputError: A cell is neither 0 nor 1, or no reading is used.
    """
    values = table.numbers.get(USED)
    if values is None:
        return None
    bad = np.flatnonzero((values != 0.0) & (values != 1.0))
    if bad.size:
        raise table.build_error(
            f"found {values[bad[0]]:g}; expected 1, or 0 of a reading to leave out", int(bad[0]), USED
        )
    if not values.any():
        raise table.build_error("is 0 in every row; expected 1 where a reading is to be used", column=USED)
    return np.asarray(values == 1.0)


def read_branches(table: RecordingTable) -> NDArray[np.int8]:
    """Read the column ``branch``.

    Args:
        table: Table of one data file.

    Returns:
        (N,) +1 loading, −1 unloading, 0 not stated.

    Raises:
        InputError: An unknown word.
    """
    words = table.words["branch"]
    unknown = next((k for k, word in enumerate(words) if word not in BRANCHES), None)
    if unknown is not None:
        raise table.build_error(f"found {words[unknown]!r}; expected load or unload", unknown, "branch")
    return np.array([BRANCHES[word] for word in words], dtype=np.int8)


def _read_channel(table: RecordingTable, channel: RecordingChannel, prismatic: Prismatic) -> Array | None:
    names = _list_channel_columns(table, channel, prismatic)
    have = [name for name in names if name in table.numbers]
    if not have:
        return None
    units = channel.units(prismatic if channel.turns else ())
    wanted = names if channel.turns and channel.needed else names[: channel.needed]
    if channel.rest == "all" and len(have) > channel.needed:
        wanted = names
    missing = [name for name in wanted if name not in have]
    if missing:
        why = f"; {THREE}" if set(missing) <= set(COORDINATES) else ""
        raise table.build_error(f"column {', '.join(missing)} is missing; it is required with {', '.join(have)}{why}")
    every = bool(channel.turns) or len(have) > channel.needed or channel.rest != "all"
    last = len(names) if every else channel.needed
    out = np.full((len(table), last), np.nan if channel.rest == "nan" else 0.0)
    for k, name in enumerate(names[:last]):
        if name in table.numbers:
            out[:, k] = table.numbers[name] * units[k]
    return out[:, 0] if channel.field in ONE_COLUMN else out


def _list_channel_columns(table: RecordingTable, channel: RecordingChannel, prismatic: Prismatic) -> tuple[str, ...]:
    """Return the columns of a channel for this chain; the force of a prismatic joint may have a torque name."""
    names = list(channel.names(prismatic))
    if not channel.turns:
        return tuple(names)
    for i in range(1, MOST_JOINTS + 1):
        for pattern in dict.fromkeys((channel.turns, channel.slides or channel.turns)):
            name = pattern.format(i)
            if name not in table.numbers or name in names:
                continue
            if i > len(prismatic):
                raise table.build_error(f"column {name} is of joint {i}, which has no column q{i}_deg or q{i}_mm")
            right = names[i - 1]
            if channel.field == "torque" and prismatic[i - 1] and right not in table.numbers:
                names[i - 1] = name
                continue
            way, q = ("slides", f"q{i}_mm") if prismatic[i - 1] else ("turns", f"q{i}_deg")
            if right in table.numbers:
                raise table.build_error(f"{right} and {name} both stand; keep one")
            raise table.build_error(f"found column {name}; joint {i} {way} ({q}), so {right} is expected")
    return tuple(names)


def _normalise_quaternions(table: RecordingTable, quaternion: Array) -> Array:
    length = np.linalg.norm(quaternion, axis=1)
    bad = np.flatnonzero(np.abs(length - 1.0) > _UNIT_LENGTH)
    if bad.size:
        raise table.build_error(
            f"found a quaternion of length {length[bad[0]]:.6g}; expected 1", int(bad[0]), "qw, qx, qy, qz"
        )
    return np.where(np.abs(length - 1.0)[:, None] > _EXACT_LENGTH, quaternion / length[:, None], quaternion)
