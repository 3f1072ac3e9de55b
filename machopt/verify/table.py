"""trajectory.csv, points.csv and compensation.csv as the verification reads them: by name, nothing assumed.

Every column that machopt writes must be there once, every number be finite where the column may not be empty, and
no column may stand there that nothing here looks at.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.toolpath import Move
from machopt.errors import InputError
from machopt.verify.readonce import held

JOINTS = tuple(f"q{i}_deg" for i in range(1, 7))
SHIFT = ("comp_dx_mm", "comp_dy_mm", "comp_dz_mm")
MOTION = ("time_s", "point", "operation", "move", *JOINTS, "gamma_deg", "feed_mm_min")
POINTS = (
    "point",
    "operation",
    "move",
    "x_mm",
    "y_mm",
    "z_mm",
    "i",
    "j",
    "k",
    "gamma_deg",
    "branch",
    *JOINTS,
    "k_axial_N_mm",
    "k_normal_N_mm",
    "deflection_mm",
    "clearance_mm",
    "limit_margin_deg",
    "singularity",
    "status",
    "reason",
)
FURTHER = (
    "feed_mm_min",
    "k_jiao_x_N_mm",
    "nearest_pair",
    "stiffness_from",
    "deflection_std_mm",
    "k_axial_std_N_mm",
    "dwell_s",
)
TEXT = frozenset(
    {"operation", "move", "status", "reason", "nearest_pair", "stiffness_from", "tool"}
)  # columns of words
ROWS = 20_000  # turned into numbers at once: a million rows as words would be gigabytes
PLAIN = frozenset("0123456789+-.eE")  # float() takes digits of other scripts and underscores too
_NOTHING = dict.fromkeys(map(ord, PLAIN))  # what they are translated into
MOST = 2**31  # a point number beyond is none
WORDS = tuple(move.word for move in Move)


@dataclass(frozen=True)
class Table:
    """A table's columns by name; those of numbers are read as such and hold words only where they are none."""

    file: Path
    text: dict[str, list[str]]
    parts: dict[str, list[Array | list[str]]]  # block after block; words where one of them is no finite number

    def __contains__(self, name: str) -> bool:
        return name in self.text or name in self.parts

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.text, *self.parts)

    def words(self, name: str) -> list[str]:
        """A column of words."""
        self._there(name)
        return self.text[name]

    def numbers(self, name: str, *, empty: bool = False) -> Array:
        """A column of numbers, NaN where a field is empty.

        Raises:
            InputError: the column is missing, or a field is no finite number, or empty where it must not be.
        """
        self._there(name)
        done: list[Array] = []
        for part in self.parts[name]:
            before = sum(map(len, done))
            done.append(_numbers(part, name, self.file, before) if isinstance(part, list) else part)
            missing = np.isnan(done[-1])
            if not empty and missing.any():
                row = before + int(np.flatnonzero(missing)[0]) + 1
                raise InputError("'' is not a finite number", file=self.file, where=f"data row {row}, {name}")
        return np.concatenate(done)

    def _there(self, name: str) -> None:
        if name not in self:
            raise InputError(f"column {name!r} is missing; there are {', '.join(self.names)}", file=self.file)


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
    slides: tuple[bool, ...] = ()  # (E,) which external axes are in m
    tool: tuple[str, ...] = ()  # (S,) names, empty where the cell has no table

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
    external: Array  # (N, E) rad or m, likewise
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
    table = read_table(file)
    _check_names(table, (*MOTION, *_external_names(cell), *(["tool"] if cell.tools else [])), ("tool",))
    if cell.tools:
        _check_tools(table, cell)
    time = table.numbers("time_s")
    if len(time) < 2:
        raise InputError(f"{len(time)} samples; a motion has two or more", file=file)
    return Motion(
        time=time,
        point=table.numbers("point", empty=True),
        move=_moves(table),
        q=_joints(table, empty=False),
        external=_external(table, cell, empty=False),
        operation=tuple(table.words("operation")),
        gamma=np.deg2rad(table.numbers("gamma_deg", empty=True)),
        feed=table.numbers("feed_mm_min") / 6e4,
        slides=cell.external_prismatic,
        tool=tuple(table.words("tool")) if cell.tools else (),
    )


def read_points(file: Path, cell: Cell) -> Points:
    """points.csv.

    Raises:
        InputError: the file, a column or a number is missing, or a column is unknown.
    """
    table = read_table(file)
    shifted = any(name in table for name in SHIFT)
    axes = _external_names(cell)
    _check_names(table, (*POINTS, *axes, *(SHIFT if shifted else ())), FURTHER)
    number = table.numbers("point")
    odd = np.flatnonzero((number != np.round(number)) | (np.abs(number) > MOST))
    if len(odd):
        row = int(odd[0])
        raise InputError(f"{number[row]:g} is no point number", file=file, where=f"data row {row + 1}, point")
    _moves(table)
    skip = {"point", *JOINTS, *axes, *SHIFT}
    shift = np.column_stack([table.numbers(n) for n in SHIFT]) / 1e3 if shifted else None
    return Points(
        number.astype(int),
        _joints(table, empty=True),
        _external(table, cell, empty=True),
        tuple(table.words("status")),
        {name: table.numbers(name, empty=name not in POINTS[3:9]) for name in table.parts if name not in skip},
        {name: tuple(words) for name, words in table.text.items() if name != "status"},
        shift,
    )


def read_shift(file: Path) -> Shift:
    """compensation.csv.

    Raises:
        InputError: the file, a column or a number is missing, or the index falls.
    """
    table = read_table(file)
    index = table.numbers("point")
    if (np.diff(index) < 0).any():
        row = int(np.flatnonzero(np.diff(index) < 0)[0]) + 2
        raise InputError("the index falls; the corners stand in order", file=file, where=f"data row {row}, point")
    offset, force = (
        np.column_stack([table.numbers(n) for n in names])
        for names in (("dx_mm", "dy_mm", "dz_mm"), ("fx_N", "fy_N", "fz_N"))
    )
    return Shift(index, offset / 1e3, force)


def read_columns(file: Path) -> dict[str, list[str]]:
    """A short table's columns by name, as words.

    Raises:
        InputError: the file cannot be read, holds no rows, or a row has more or fewer fields than the header.
    """
    out: dict[str, list[str]] = {}
    for block in _blocks(file):
        for name, words in block.items():
            out.setdefault(name, []).extend(words)
    return out


def read_table(file: Path) -> Table:
    """A table of any length; within :func:`machopt.verify.readonce.read_once` it is read once.

    Raises:
        InputError: the file cannot be read, holds no rows, or a row has more or fewer fields than the header.
    """
    return held(file, _read_table)


def _read_table(file: Path) -> Table:
    text: dict[str, list[str]] = {}
    parts: dict[str, list[Array | list[str]]] = {}
    known: dict[str, str] = {}  # equal words are one
    for block in _blocks(file):
        for name, words in block.items():
            if name in TEXT:
                text.setdefault(name, []).extend([known.setdefault(word, word) for word in words])
            else:
                parts.setdefault(name, []).append(_plain_numbers(words))
    return Table(file, text, parts)


def _check_names(table: Table, needed: Sequence[str], further: Sequence[str]) -> None:
    for name in needed:
        if name not in table:
            raise InputError(f"column {name!r} is missing; there are {', '.join(table.names)}", file=table.file)
    for name in table.names:
        if name not in needed and name not in further:
            raise InputError(
                f"column {name!r} is not known; known are {', '.join((*needed, *further))}", file=table.file
            )


def _check_tools(table: Table, cell: Cell) -> None:
    """Every row has the tool that the toolpath wants, or one of the table where it wants several."""
    wanted = {*cell.tools} if cell.tool_name is None else {cell.tool_name}
    for row, word in enumerate(table.words("tool"), start=1):
        if word not in wanted:
            known = f"the cell has {', '.join(cell.tools)}" if word not in cell.tools else "the toolpath wants another"
            raise InputError(
                f"{word!r} is not the tool {cell.tool_name or ' or '.join(cell.tools)!r}; {known}",
                file=table.file,
                where=f"data row {row}, tool",
            )


def _moves(table: Table) -> NDArray[np.int64]:
    code = {word: n for n, word in enumerate(WORDS)}
    moves = table.words("move")
    if not code.keys() >= {*moves}:
        line, word = next((n, word) for n, word in enumerate(moves, start=1) if word not in code)
        raise InputError(
            f"{word!r} is no move; {', '.join(WORDS)} are", file=table.file, where=f"data row {line}, move"
        )
    return np.array([code[word] for word in moves])


def _joints(table: Table, *, empty: bool) -> Array:
    return np.deg2rad(np.column_stack([table.numbers(name, empty=empty) for name in JOINTS]))


def _external_names(cell: Cell) -> list[str]:
    return [f"e{n}_mm" if slides else f"e{n}_deg" for n, slides in enumerate(cell.external_prismatic, start=1)]


def _external(table: Table, cell: Cell, *, empty: bool) -> Array:
    """(rows, E) rad or m."""
    names = _external_names(cell)
    columns = [table.numbers(n, empty=empty) * (1e-3 if n.endswith("mm") else np.pi / 180.0) for n in names]
    return np.array(columns).T.reshape(len(table.words("move")), -1)


def _blocks(file: Path) -> Iterator[dict[str, list[str]]]:
    """The columns of some thousand rows after the other, as words."""
    try:
        with file.open(encoding="utf-8-sig") as lines:
            yield from _blocks_of((line for line in lines if not line.startswith("#") and line.strip()), file)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {getattr(error, 'strerror', None) or error}", file=file) from error
    except csv.Error as error:
        raise InputError(f"is no CSV table: {error}", file=file) from error


def _blocks_of(lines: Iterator[str], file: Path) -> Iterator[dict[str, list[str]]]:
    header = [name.strip() for name in next(csv.reader(islice(lines, 1)), [])]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise InputError(f"column {twice[0]!r} stands there twice", file=file)
    done, width = 0, len(header)
    while block := list(islice(lines, ROWS)):
        text = "".join(block)
        rows = list(csv.reader(block)) if '"' in text else None
        fields = [line.count(",") + 1 for line in block] if rows is None else [*map(len, rows)]
        if {*fields} != {width}:
            number, count = next((n, count) for n, count in enumerate(fields, done + 1) if count != width)
            raise InputError(f"{count} fields, the header has {width}", file=file, where=f"data row {number}")
        if rows is None:  # no list of fields for every row
            flat = ",".join(block).split(",")
            columns = [flat[k::width] for k in range(width)]
        else:
            columns = [list(column) for column in zip(*rows, strict=True)]
        done += len(fields)
        quoted = "'" in text  # only then can a field need more than its blanks stripped
        yield {
            name: [_shown(field.strip()) for field in column] if quoted else _stripped(column)
            for name, column in zip(header, columns, strict=True)
        }
    if not done:
        raise InputError("holds no rows", file=file)


def _stripped(column: list[str]) -> list[str]:
    """Fields without blanks around them; most columns have none anywhere, which one look at all of it tells."""
    whole = "".join(column)
    return column if whole.split(None, 1) == [whole] else [*map(str.strip, column)]


def _shown(field: str) -> str:
    """A field without the apostrophe that keeps a spreadsheet from running it."""
    formula = field.lstrip("'").lstrip(" ").startswith(("=", "+", "-", "@", "＝", "＋", "－", "＠"))
    return field[1:] if formula and field.startswith("'") else field


def _plain_numbers(words: list[str]) -> Array | list[str]:
    """Words as numbers, NaN where they are empty; as they are where one of them is no finite number in plain digits."""
    if not "".join(words).translate(_NOTHING):
        try:
            out = np.fromiter(map(float, words if all(words) else [word or "nan" for word in words]), float, len(words))
        except ValueError:
            return words
        if not np.isinf(out).any():
            return out
    return words


def _numbers(words: list[str], name: str, file: Path, before: int) -> Array:
    """Numbers of a block in which something is none; ``before``: rows of the table before it."""
    if not set("".join(words)) <= PLAIN:
        row = next(n for n, text in enumerate(words) if not set(text) <= PLAIN)
        raise InputError(
            f"{words[row]!r} is not a finite number in plain digits",
            file=file,
            where=f"data row {before + row + 1}, {name}",
        )
    out = np.array([_float_or_inf(text) for text in words])
    bad = np.isinf(out)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise InputError(
            f"{words[row]!r} is not a finite number", file=file, where=f"data row {before + row + 1}, {name}"
        )
    return out


def _float_or_inf(text: str) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.inf
