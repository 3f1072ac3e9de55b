"""trajectory.csv and points.csv as the verification reads them: header by name, ``#`` comments, nothing assumed."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.domain.cell import Cell
from machopt.domain.toolpath import Move
from machopt.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """What trajectory.csv says, in SI."""

    time: Array  # (S,) s
    point: Array  # (S,) NaN where empty
    move: NDArray[np.int64]  # (S,) Move codes
    q: Array  # (S, 6) rad
    external: Array  # (S, E) rad or m


@dataclass(frozen=True)
class Points:
    """What points.csv says."""

    point: NDArray[np.int64]  # (N,)
    q: Array  # (N, 6) rad, NaN where the point has none
    status: tuple[str, ...]
    shift: Array | None = None  # (N, 3) m in workpiece, where the commanded path is shifted


@dataclass(frozen=True)
class Shift:
    """What compensation.csv says: how the path is shifted at its corners, and against which force."""

    index: Array  # (P,) fractional toolpath index, not falling
    offset: Array  # (P, 3) m in workpiece
    force: Array  # (P, 3) N in workpiece


def read_motion(file: Path, cell: Cell) -> Motion:
    """trajectory.csv.

    Raises:
        InputError: the file, a column or a number is missing.
    """
    columns = _columns(file)
    words = [move.word for move in Move]
    moves = _column(columns, "move", file)
    for line, word in enumerate(moves, start=1):
        if word not in words:
            raise InputError(f"{word!r} is no move; {', '.join(words)} are", file=file, where=f"data row {line}, move")
    external = []
    for n, prismatic in enumerate(cell.external_prismatic, start=1):
        values = _numbers(columns, f"e{n}_mm" if prismatic else f"e{n}_deg", file)
        external.append(values / 1e3 if prismatic else np.deg2rad(values))
    time = _numbers(columns, "time_s", file)
    if len(time) < 2:
        raise InputError(f"{len(time)} samples; a motion has two or more", file=file)
    return Motion(
        time, _numbers(columns, "point", file, empty=True), np.array([words.index(w) for w in moves]),
        _joints(columns, file, empty=False), np.array(external).T.reshape(len(time), -1),
    )  # fmt: skip


def read_points(file: Path) -> Points:
    """points.csv.

    Raises:
        InputError: the file or a column is missing.
    """
    columns = _columns(file)
    number = _numbers(columns, "point", file).astype(int)
    names = [f"comp_d{c}_mm" for c in "xyz"]
    shift = np.column_stack([_numbers(columns, n, file) for n in names]) / 1e3 if names[0] in columns else None
    return Points(number, _joints(columns, file, empty=True), tuple(_column(columns, "status", file)), shift)


def read_shift(file: Path) -> Shift:
    """compensation.csv.

    Raises:
        InputError: the file, a column or a number is missing, or the index falls.
    """
    columns = _columns(file)
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


def _joints(columns: dict[str, list[str]], file: Path, *, empty: bool) -> Array:
    degrees = [_numbers(columns, f"q{i}_deg", file, empty=empty) for i in range(1, 7)]
    return np.deg2rad(np.column_stack(degrees))


def _columns(file: Path) -> dict[str, list[str]]:
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=file) from error
    rows = list(csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    if len(rows) < 2:
        raise InputError("holds no rows", file=file)
    header = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=1):
        if len(row) != len(header):
            raise InputError(f"{len(row)} fields, the header has {len(header)}", file=file, where=f"data row {number}")
    return {
        name: [field.strip() for field in column]
        for name, column in zip(header, zip(*rows[1:], strict=True), strict=True)
    }


def _column(columns: dict[str, list[str]], name: str, file: Path) -> list[str]:
    if name not in columns:
        raise InputError(f"column {name!r} is missing; there are {', '.join(columns)}", file=file)
    return columns[name]


def _numbers(columns: dict[str, list[str]], name: str, file: Path, *, empty: bool = False) -> Array:
    out = np.full(len(_column(columns, name, file)), np.nan)
    for n, field in enumerate(columns[name]):
        if empty and field.lower() in ("", "nan"):
            continue
        try:
            out[n] = float(field)
        except ValueError:
            out[n] = np.nan
        if not np.isfinite(out[n]):
            raise InputError(f"{field!r} is not a finite number", file=file, where=f"data row {n + 1}, {name}")
    return out
