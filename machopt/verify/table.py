"""trajectory.csv, points.csv and compensation.csv as the verification reads them: by name, nothing assumed.

Every column of the contract must be there once, every number be finite where the column has no right to be empty, and
no column may stand there that nothing here looks at.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.toolpath import Move
from machopt.errors import InputError

Array = NDArray[np.float64]

JOINTS = tuple(f"q{i}_deg" for i in range(1, 7))
SHIFT = ("comp_dx_mm", "comp_dy_mm", "comp_dz_mm")
MOTION = ("time_s", "point", "operation", "move", *JOINTS, "gamma_deg", "feed_mm_min")
POINTS = (
    "point", "operation", "move", "x_mm", "y_mm", "z_mm", "i", "j", "k", "gamma_deg", "branch", *JOINTS, "k_axial_N_mm",
    "k_normal_N_mm", "deflection_mm", "clearance_mm", "limit_margin_deg", "singularity", "status", "reason",
)  # fmt: skip
FURTHER = ("feed_mm_min", "k_jiao_x_N_mm", "nearest_pair", "stiffness_from", "deflection_std_mm", "k_axial_std_N_mm")
PLAIN = frozenset("0123456789+-.eE")  # float() takes digits of other scripts and underscores too
_NOTHING = dict.fromkeys(map(ord, PLAIN))  # what they are translated into
MOST = 2**31  # a point number beyond is none
WORDS = tuple(move.word for move in Move)


@dataclass(frozen=True)
class Motion:
    """What trajectory.csv says, in SI; S rows."""

    time: Array  # (S,) s
    point: Array  # (S,) NaN where empty
    move: NDArray[np.int64]  # (S,) Move codes
    q: Array  # (S, 6) rad
    external: Array  # (S, E) rad or m
    operation: tuple[str, ...]  # (S,) labels, empty for none
    gamma: Array  # (S,) rad, NaN where empty
    feed: Array  # (S,) m/s

    @property
    def cycle(self) -> float:
        """s between two samples."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    def at(self, n: int | np.int64) -> str:
        """Where row n is, for people."""
        point = f", point {self.point[n]:.3f}" if np.isfinite(self.point[n]) else ""
        return f"sample {n}, {self.time[n]:.3f} s{point}"


@dataclass(frozen=True)
class Points:
    """What points.csv says, N rows; numbers as the file has them but for point, joints and shift."""

    point: NDArray[np.int64]  # (N,)
    q: Array  # (N, 6) rad by encoder, NaN where the point has none
    status: tuple[str, ...]
    numbers: dict[str, Array]  # every further column of numbers, in the file's units, NaN where empty
    words: dict[str, tuple[str, ...]]  # operation, move, reason, nearest_pair, stiffness_from
    shift: Array | None = None  # (N, 3) m in workpiece, where the commanded path is shifted

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(N,) the planner says that the point has a configuration."""
        return np.array([s == "ok" for s in self.status])


@dataclass(frozen=True)
class Shift:
    """What compensation.csv says: how the path is shifted at its corners, and against which force."""

    index: Array  # (P,) fractional toolpath index, not falling
    offset: Array  # (P, 3) m in workpiece
    force: Array  # (P, 3) N in workpiece


def read_motion(file: Path, cell: Cell) -> Motion:
    """trajectory.csv.

    Raises:
        InputError: the file, a column or a number is missing, or a column is unknown.
    """
    columns = _columns(file)
    axes = [f"e{n}_mm" if prismatic else f"e{n}_deg" for n, prismatic in enumerate(cell.external_prismatic, start=1)]
    _check_names(columns, (*MOTION, *axes), ("tool",), file)
    external = [_numbers(columns, name, file) / (1e3 if name.endswith("mm") else 180.0 / np.pi) for name in axes]
    time = _numbers(columns, "time_s", file)
    if len(time) < 2:
        raise InputError(f"{len(time)} samples; a motion has two or more", file=file)
    return Motion(
        time=time, point=_numbers(columns, "point", file, empty=True), move=_moves(columns, file),
        q=_joints(columns, file, empty=False), external=np.array(external).T.reshape(len(time), -1),
        operation=tuple(columns["operation"]), gamma=np.deg2rad(_numbers(columns, "gamma_deg", file, empty=True)),
        feed=_numbers(columns, "feed_mm_min", file) / 6e4,
    )  # fmt: skip


def read_points(file: Path) -> Points:
    """points.csv.

    Raises:
        InputError: the file, a column or a number is missing, or a column is unknown.
    """
    columns = _columns(file)
    shifted = any(name in columns for name in SHIFT)
    _check_names(columns, (*POINTS, *(SHIFT if shifted else ())), FURTHER, file)
    number = _numbers(columns, "point", file)
    odd = np.flatnonzero((number != np.round(number)) | (np.abs(number) > MOST))
    if len(odd):
        row = int(odd[0])
        raise InputError(f"{number[row]:g} is no point number", file=file, where=f"data row {row + 1}, point")
    _moves(columns, file)
    text = ("operation", "move", "reason", "nearest_pair", "stiffness_from")
    skip = {"point", "status", *text, *JOINTS, *SHIFT}
    shift = np.column_stack([_numbers(columns, n, file) for n in SHIFT]) / 1e3 if shifted else None
    return Points(
        number.astype(int), _joints(columns, file, empty=True), tuple(columns["status"]),
        {name: _numbers(columns, name, file, empty=name not in POINTS[3:9]) for name in columns if name not in skip},
        {name: tuple(columns[name]) for name in text if name in columns}, shift,
    )  # fmt: skip


def read_shift(file: Path) -> Shift:
    """compensation.csv.

    Raises:
        InputError: the file, a column or a number is missing, or the index falls.
    """
    columns = _columns(file)
    for name in ("point", "dx_mm", "dy_mm", "dz_mm", "fx_N", "fy_N", "fz_N"):
        _column(columns, name, file)
    index = _numbers(columns, "point", file)
    if (np.diff(index) < 0).any():
        row = int(np.flatnonzero(np.diff(index) < 0)[0]) + 2
        raise InputError("the index falls; the corners stand in order", file=file, where=f"data row {row}, point")
    offset, force = (np.column_stack([_numbers(columns, n, file) for n in names])
                     for names in (("dx_mm", "dy_mm", "dz_mm"), ("fx_N", "fy_N", "fz_N")))  # fmt: skip
    return Shift(index, offset / 1e3, force)


def read_columns(file: Path) -> dict[str, list[str]]:
    """A table's columns by name, as words.

    Raises:
        InputError: the file cannot be read, holds no rows, or a row has more or fewer fields than the header.
    """
    return _columns(file)


def _check_names(columns: dict[str, list[str]], needed: Sequence[str], further: Sequence[str], file: Path) -> None:
    for name in needed:
        _column(columns, name, file)
    for name in columns:
        if name not in needed and name not in further:
            raise InputError(f"column {name!r} is not known; known are {', '.join((*needed, *further))}", file=file)


def _moves(columns: dict[str, list[str]], file: Path) -> NDArray[np.int64]:
    moves = _column(columns, "move", file)
    code = {word: n for n, word in enumerate(WORDS)}
    if not code.keys() >= {*moves}:
        line, word = next((n, word) for n, word in enumerate(moves, start=1) if word not in code)
        raise InputError(f"{word!r} is no move; {', '.join(WORDS)} are", file=file, where=f"data row {line}, move")
    return np.array([code[word] for word in moves])


def _joints(columns: dict[str, list[str]], file: Path, *, empty: bool) -> Array:
    return np.deg2rad(np.column_stack([_numbers(columns, name, file, empty=empty) for name in JOINTS]))


def _columns(file: Path) -> dict[str, list[str]]:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", file=file) from error
    lines = [line for line in text.splitlines() if not line.startswith("#") and line.strip()]
    if len(lines) < 2:
        raise InputError("holds no rows", file=file)
    rows: list[list[str]] | None = None
    if '"' in text:
        try:
            rows = list(csv.reader(lines))
        except csv.Error as error:
            raise InputError(f"is no CSV table: {error}", file=file) from error
        if len(rows) < 2:
            raise InputError("holds no rows", file=file)
    header = [name.strip() for name in (lines[0].split(",") if rows is None else rows[0])]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise InputError(f"column {twice[0]!r} stands there twice", file=file)
    width = len(header)
    fields = [line.count(",") + 1 for line in lines] if rows is None else [*map(len, rows)]
    if {*fields} != {width}:
        number, count = next((n, count) for n, count in enumerate(fields) if count != width)
        raise InputError(f"{count} fields, the header has {width}", file=file, where=f"data row {number}")
    if rows is None:  # no list of fields for every row: there are hundreds of thousands
        flat = ",".join(lines[1:]).split(",")
        columns = [flat[k::width] for k in range(width)]
    else:
        columns = [list(column) for column in zip(*rows[1:], strict=True)]
    quoted = "'" in text  # only then can a field need more than its blanks stripped
    return {
        name: [_shown(field.strip()) for field in column] if quoted else _stripped(column)
        for name, column in zip(header, columns, strict=True)
    }


def _stripped(column: list[str]) -> list[str]:
    """Fields without blanks around them; most columns have none anywhere, which one look at all of it tells."""
    whole = "".join(column)
    return column if whole.split(None, 1) == [whole] else [*map(str.strip, column)]


def _shown(field: str) -> str:
    """A field without the apostrophe that keeps a spreadsheet from running it."""
    formula = field.lstrip("'").lstrip(" ").startswith(("=", "+", "-", "@", "＝", "＋", "－", "＠"))
    return field[1:] if formula and field.startswith("'") else field


def _column(columns: dict[str, list[str]], name: str, file: Path) -> list[str]:
    if name not in columns:
        raise InputError(f"column {name!r} is missing; there are {', '.join(columns)}", file=file)
    return columns[name]


def _numbers(columns: dict[str, list[str]], name: str, file: Path, *, empty: bool = False) -> Array:
    texts = _column(columns, name, file)
    if "".join(texts).translate(_NOTHING):
        row = next(n for n, text in enumerate(texts) if not set(text) <= PLAIN)
        raise InputError(
            f"{texts[row]!r} is not a finite number in plain digits", file=file, where=f"data row {row + 1}, {name}"
        )
    try:
        out = np.fromiter(map(float, texts if all(texts) else [text or "nan" for text in texts]), float, len(texts))
    except ValueError:
        out = np.array([_float_or_inf(text) for text in texts])
    bad = ~np.isfinite(out)
    if empty and bad.any():
        bad &= np.array([text != "" for text in texts])
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InputError(f"{texts[row]!r} is not a finite number", file=file, where=f"data row {row + 1}, {name}")
    return out


def _float_or_inf(text: str) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.inf
