"""Independent strict reader of ``trajectory.csv`` for round-trip tests."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np

from machopt.data_types.toolpath import MoveKind
from machopt.data_types.trajectory import Trajectory
from machopt.errors import InputError
from machopt.file_formats.csv_text_escaping import unescape_formula_text
from machopt.file_formats.file_reading import TABLE, read_text
from machopt.numerics.array_types import Array
from machopt.output.tables.plan_tables import DEG_PER_RAD, MM_MIN_PER_M_S, MM_PER_M

_MOVE_WORDS = {move.word: int(move) for move in MoveKind}


@dataclass(frozen=True)
class TrajectoryTable:
    """A trajectory that was read: samples, labels of ``operation``, types of the external axes."""

    trajectory: Trajectory
    operations: tuple[str, ...]
    external_prismatic: tuple[bool, ...] = ()


@dataclass(frozen=True)
class _Rows:
    """The raw fields of a CSV file by column, with the line number of each row."""

    file: Path
    columns: dict[str, tuple[str, ...]] = field(default_factory=dict)
    lines: tuple[int, ...] = ()

    def numbers(self, name: str, *, empty: bool = False) -> Array:
        """Return the column as floats; empty fields become NaN if ``empty`` allows them."""
        texts = self.columns[name]
        if empty:
            texts = tuple(t or "nan" for t in texts)
        try:
            values = np.array(texts, dtype=float)
        except ValueError:
            values = np.array([_float_or_nan(t) for t in texts])
            empty = False
        bad = ~np.isfinite(values) & (np.array([t != "nan" for t in texts]) if empty else True)
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            raise InputError(
                f"found {self.columns[name][row]!r}, expected a finite number",
                file=self.file,
                where=f"line {self.lines[row]}, column {name}",
            )
        return values


def read_trajectory_csv(path: Path) -> TrajectoryTable:
    """Read ``trajectory.csv`` in SI units; equal labels are one operation, in the order of their first occurrence.

    Raises:
        InputError: a column is missing or unknown, a field is not a number or move, or time does not increase.
    """
    header, rows = _read(path)
    external = [name for name in header if name.startswith("e") and name.split("_")[0][1:].isdigit()]
    expected = [
        "time_s",
        "point",
        "operation",
        "move",
        *(f"q{i}_deg" for i in range(1, 7)),
        *external,
        "gamma_deg",
        "feed_mm_min",
        *(["tool"] if "tool" in header else []),
    ]
    for i, name in enumerate(external, start=1):
        if name not in (f"e{i}_mm", f"e{i}_deg"):
            raise InputError(f"found {name!r}, expected e{i}_mm or e{i}_deg", file=path, where="header")
    _check_header(path, header, expected)
    prismatic = tuple(name.endswith("_mm") for name in external)
    scale = [1 / MM_PER_M if p else 1 / DEG_PER_RAD for p in prismatic]
    time = rows.numbers("time_s")
    if len(time) > 1 and not np.all(np.diff(time) > 0):
        row = int(np.flatnonzero(np.diff(time) <= 0)[0]) + 1
        raise InputError(
            f"time does not rise: {time[row]:g} s after {time[row - 1]:g} s",
            file=path,
            where=f"line {rows.lines[row]}, column time_s",
        )
    labels = tuple(unescape_formula_text(cell) for cell in rows.columns["operation"])
    operations = tuple(dict.fromkeys(label for label in labels if label))
    number = {"": -1, **{label: i for i, label in enumerate(operations)}}
    return TrajectoryTable(
        Trajectory(
            time=time,
            q=np.column_stack([rows.numbers(f"q{i}_deg") for i in range(1, 7)]) / DEG_PER_RAD,
            external=np.column_stack([rows.numbers(n) * s for n, s in zip(external, scale, strict=True)])
            if external
            else np.empty((len(time), 0)),
            point=rows.numbers("point", empty=True),
            move=np.array(_move_codes(rows), dtype=np.int8),
            operation=np.array([number[label] for label in labels], dtype=np.int32),
            gamma=rows.numbers("gamma_deg", empty=True) / DEG_PER_RAD,
            feed=rows.numbers("feed_mm_min", empty=True) / MM_MIN_PER_M_S,
        ),
        operations,
        prismatic,
    )


def _read(path: Path) -> tuple[list[str], _Rows]:
    text = read_text(path, expected="a table", most=TABLE)
    try:
        return _read_text(path, io.StringIO(text, newline=""))
    except csv.Error as error:
        raise InputError(f"not a CSV table: {error}", file=path) from None


def _read_text(path: Path, text: TextIO) -> tuple[list[str], _Rows]:
    reader = csv.reader(text)
    header: list[str] | None = None
    rows: list[list[str]] = []
    lines: list[int] = []
    for row in reader:
        if not row or (row[0].startswith("#")):
            continue
        if header is None:
            header = [name.strip() for name in row]
        elif len(row) != len(header):
            raise InputError(
                f"found {len(row)} fields, expected {len(header)} as in the header",
                file=path,
                where=f"line {reader.line_num}",
            )
        else:
            rows.append(row)
            lines.append(reader.line_num)
    if header is None or not rows:
        raise InputError("found no rows, expected a header and at least one row", file=path)
    return header, _Rows(path, dict(zip(header, zip(*rows, strict=True), strict=True)), tuple(lines))


def _check_header(path: Path, header: list[str], expected: list[str]) -> None:
    missing = [name for name in expected if name not in header]
    unknown = [name for name in header if name not in expected]
    twice = sorted({name for name in header if header.count(name) > 1})
    for what, names in (("is missing", missing), ("is unknown", unknown), ("is given twice", twice)):
        if names:
            raise InputError(
                f"column {', '.join(names)} {what}; expected {', '.join(expected)}", file=path, where="header"
            )


def _move_codes(rows: _Rows) -> list[int]:
    words = rows.columns["move"]
    try:
        return [_MOVE_WORDS[w] for w in words]
    except KeyError as error:
        row = words.index(str(error.args[0]))
        raise InputError(
            f"found {words[row]!r}, expected one of {', '.join(_MOVE_WORDS)}",
            file=rows.file,
            where=f"line {rows.lines[row]}, column move",
        ) from None


def _float_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
