"""Table of measured numbers, CSV or Parquet: known columns, finite cells, errors by line and column.

Files are parsed by NumPy. Only a file that it rejects is read cell by cell to locate the error.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from machopt.errors import InputError, RecordingError, suggest_nearest_word
from machopt.file_formats import parquet_tables
from machopt.file_formats.file_reading import TABLE, read_file
from machopt.numerics.array_types import Array, Ints

_ROWS_AT_ONCE = 4096
_MOST = {"_Nm": 1e7, "_N": 1e7, "_mm": 1e7, "_mrad": 1e5, "_deg": 1e8, "_deg_s": 1e8, "_A": 1e5, "_C": 1e4}
"""Largest plausible absolute value by unit suffix of a column: at least a hundred times any real measurement."""
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+", re.ASCII)
_NOT_READ = ("", "nan")
COORDINATES = ("dx_mm", "dy_mm", "dz_mm", "x_mm", "y_mm", "z_mm")  # of a position or displacement
THREE = (
    "a place is read with all three coordinates, by a tracker or by three dial gauges; those of one gauge alone are "
    "not taken"
)
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf|infinity)", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class AllowedColumns:
    """Columns that a table may have."""

    numbers: tuple[str, ...]  # names of columns of numbers
    words: tuple[str, ...]  # names of columns of words
    listed_names: str  # abbreviated list of all names for messages
    refused_names: dict[str, str] = field(default_factory=dict)  # known names that are not accepted, and why
    names: tuple[str, ...] = ()  # word columns that may contain integers
    sparse: tuple[str, ...] = ()  # number columns with optional cells (empty or nan)


@dataclass(frozen=True)
class RecordingTable:
    """Cells of one file by column."""

    path: Path
    numbers: dict[str, Array]  # (N,) each, finite, in the file's units
    words: dict[str, list[str]]  # (N,) each
    lines: Ints  # (N,) 1-based line of a CSV file, 1-based row of a Parquet file
    header_line: int  # 0: the header of a Parquet file

    def __len__(self) -> int:
        return len(self.lines)

    def build_error(self, message: str, row: int | None = None, column: str | None = None) -> InputError:
        """Build an error that names file, line and column.

        Args:
            message: What is wrong and what would be accepted.
            row: Row, 0-based; None: the header.
            column: Column name, or None.

        Returns:
            The error; the caller raises it.
        """
        if row is not None:
            place = f"{'line' if self.header_line else 'row'} {self.lines[row]}"
        else:
            place = f"line {self.header_line}" if self.header_line else "schema"
        return RecordingError(message, file=self.path, where=place + ("" if column is None else f", column {column}"))


def read_table(path: Path, vocabulary: AllowedColumns, converted: bytes | None = None) -> RecordingTable:
    """Read a CSV file (UTF-8, commas, decimal points, one header line, ``#`` comment lines) or a Parquet file.

    Args:
        path: Path of the file.
        vocabulary: Allowed columns.
        converted: Text of the table where the file itself is written otherwise.

    Returns:
        The table.

    Raises:
        InputError: The file is missing or damaged; a column is unknown, duplicated or not accepted; a row has a
            wrong number of fields; a cell is empty, no number or not finite. Names file, line (row of a Parquet
            file) and column.
    """
    if converted is not None:
        table = _read_csv(path, converted, vocabulary)
        _refuse_absurd_values(table)
        return table
    data = read_file(path, expected="a table of readings, CSV or Parquet", most=TABLE)
    if data.startswith(b"PAR1") or path.suffix.lower() == ".parquet":
        table = _read_parquet(path, data, vocabulary)
    else:
        table = _read_csv(path, data, vocabulary)
    _refuse_absurd_values(table)
    return table


def _refuse_absurd_values(table: RecordingTable) -> None:
    for name, values in table.numbers.items():
        unit = next((u for u in _MOST if name.endswith(u)), None)
        if unit is None:
            continue
        wild = np.flatnonzero(np.abs(values) > _MOST[unit])
        if wild.size:
            raise table.build_error(
                f"found {values[wild[0]]:g}; expected at most {_MOST[unit]:g} to either side: no instrument reads more",
                int(wild[0]),
                name,
            )


def _read_csv(path: Path, data: bytes, vocabulary: AllowedColumns) -> RecordingTable:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = data.count(b"\n", 0, problem.start) + 1
        raise RecordingError("is not UTF-8 text; expected CSV in UTF-8", file=path, where=f"line {line}") from None
    lines: list[int] = []
    rows: list[str] = []
    for line, row in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        bare = row.lstrip()
        if bare and not bare.startswith("#"):
            lines.append(line)
            rows.append(row)
    if not rows:
        raise RecordingError("holds no rows; expected a header line and one line a reading", file=path)
    quoted = '"' in text
    head, body = rows[0], rows[1:]
    table = RecordingTable(path, {}, {}, np.array(lines[1:], dtype=np.int64), lines[0])
    _refuse_other_separator(table, head, body)
    header = [name.strip() for name in _split_row(table, head, quoted, None)]
    _check_header(table, header, vocabulary)
    if not body:
        raise table.build_error("holds a header but no rows; expected one line a reading")
    fields = [_split_row(table, row, True, k) for k, row in enumerate(body)] if quoted else None
    _check_width(table, header, [len(f) for f in fields] if fields else [row.count(",") + 1 for row in body], body)
    at = {name: k for k, name in enumerate(header)}
    words = {
        name: [(f if fields else row.split(","))[at[name]].strip() for f, row in zip(fields or body, body, strict=True)]
        for name in vocabulary.words
        if name in at
    }
    names = [name for name in header if name not in words]
    values = _parse_rows(table, body, fields, names, at, vocabulary.sparse)
    return RecordingTable(path, dict(zip(names, values.T, strict=True)), words, table.lines, table.header_line)


def _parse_rows(
    table: RecordingTable,
    body: list[str],
    fields: list[list[str]] | None,
    names: list[str],
    at: dict[str, int],
    sparse: Sequence[str],
) -> Array:
    """(N, len(names)) numbers, all finite but NaN where a cell of a sparse column is empty."""
    out = np.empty((len(body), len(names)))
    use = [at[name] for name in names]
    for start in range(0, len(body) if names else 0, _ROWS_AT_ONCE):
        part = slice(start, start + _ROWS_AT_ONCE)
        if fields is None:
            try:
                out[part] = np.loadtxt(body[part], delimiter=",", comments=None, ndmin=2, usecols=use)
            except ValueError:
                pass  # a cell of this block is no number; located below
            else:
                if np.isfinite(out[part]).all():
                    continue
        for k, row in enumerate(body[part], start):
            cells = row.split(",") if fields is None else fields[k]
            for c, name in enumerate(names):
                cell = cells[at[name]].strip()
                out[k, c] = float(cell) if _NUMBER.fullmatch(cell) else np.nan
                if not np.isfinite(out[k, c]) and not (name in sparse and cell.lower() in _NOT_READ):
                    raise table.build_error(
                        f"found {_format_cell(cell)}; expected {_describe_expected_cell(cell, name)}", k, name
                    )
    return out


def _describe_expected_cell(cell: str, name: str) -> str:
    if not cell and name in COORDINATES:
        return f"a number: {THREE}"
    if _DECIMAL_COMMA.fullmatch(cell):
        return f"a number with a decimal point, {cell.replace(',', '.')}"
    if _NOT_FINITE.fullmatch(cell) or _NUMBER.fullmatch(cell):
        return "a finite number; leave a reading out rather than write one that is not there"
    return "a number"


def _format_cell(cell: str) -> str:
    return repr(cell[:40]) if cell else "an empty cell"


def _split_row(table: RecordingTable, row: str, quoted: bool, number: int | None) -> list[str]:
    if not quoted:
        return row.split(",")
    try:
        return next(csv.reader([row], strict=True, skipinitialspace=True))
    except csv.Error as problem:
        raise table.build_error(f"is not CSV: {problem}", number) from None


def _refuse_other_separator(table: RecordingTable, head: str, body: Sequence[str]) -> None:
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if mark in head and head.count(mark) > head.count(","):
            comma = bool(body) and _DECIMAL_COMMA.search(body[0]) is not None
            raise table.build_error(
                f"columns are separated by {name}{' and decimals marked by commas' if comma else ''}; "
                "expected commas between columns and a decimal point"
            )


def _check_header(table: RecordingTable, header: Sequence[str], vocabulary: AllowedColumns) -> None:
    if all(_NUMBER.fullmatch(name) for name in header):
        raise table.build_error(f"holds numbers; expected a header line with column names: {vocabulary.listed_names}")
    known = (*vocabulary.numbers, *vocabulary.words)
    for k, name in enumerate(header):
        if not name:
            raise table.build_error(f"column {k + 1} has no name; expected one of {vocabulary.listed_names}")
        if name in header[:k]:
            raise table.build_error(
                f"column {name!r} is given twice, as columns {header.index(name) + 1} and {k + 1}; keep one"
            )
        if name in vocabulary.refused_names:
            raise table.build_error(vocabulary.refused_names[name], column=name)
        if name not in known:
            hint = _suggest_column(name, known)
            raise table.build_error(f"unknown column {name!r}; {hint}valid: {vocabulary.listed_names}")


def _suggest_column(name: str, known: Sequence[str]) -> str:
    """Return ``did you mean 'fx_N'? `` or nothing."""
    same = {k.lower(): k for k in known}
    if name.lower() in same:
        return f"did you mean {same[name.lower()]!r}? "
    hint, found, _ = suggest_nearest_word(name.lower(), list(same)).partition("? ")
    return f"did you mean {same[hint.split(chr(39))[1]]!r}? " if found else ""


def _check_width(table: RecordingTable, header: Sequence[str], widths: list[int], body: Sequence[str]) -> None:
    for k, width in enumerate(widths):
        if width != len(header):
            why = ""
            if width > len(header) and "." not in body[k]:
                why = "; a decimal comma would do that: numbers are written with a decimal point"
            raise table.build_error(f"found {width} fields; expected {len(header)} as in the header{why}", k)


def _read_parquet(path: Path, data: bytes, vocabulary: AllowedColumns) -> RecordingTable:
    with parquet_tables.open_parquet(path) as pyarrow:
        content = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(data))
        header = list(content.schema_arrow.names)
        table = RecordingTable(path, {}, {}, np.arange(1, content.metadata.num_rows + 1), 0)
        _check_header(table, header, vocabulary)
        columns = content.read()
    if not len(table):
        raise table.build_error("holds no rows; expected one row a reading")
    numbers = {
        n: _convert_arrow_numbers(table, n, columns.column(n), pyarrow, sparse=n in vocabulary.sparse)
        for n in header
        if n not in vocabulary.words
    }
    words = {
        n: _convert_arrow_words(table, n, columns.column(n), number=n in vocabulary.names)
        for n in header
        if n in vocabulary.words
    }
    return RecordingTable(path, numbers, words, table.lines, 0)


def _convert_arrow_numbers(table: RecordingTable, name: str, column: Any, pyarrow: Any, *, sparse: bool) -> Array:
    kind = column.type
    if not (pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind)):
        raise table.build_error(f"is of type {kind}; expected numbers", column=name)
    if column.null_count and not sparse:
        empty = column.is_null().to_pylist().index(True)
        raise table.build_error(f"found an empty cell; expected {_describe_expected_cell('', name)}", empty, name)
    values = np.asarray(column.to_numpy(), dtype=np.float64)
    bad = np.flatnonzero(np.isinf(values) if sparse else ~np.isfinite(values))
    if bad.size:
        raise table.build_error(
            f"found {values[bad[0]]}; expected {_describe_expected_cell(str(values[bad[0]]), name)}", int(bad[0]), name
        )
    return values


def _convert_arrow_words(table: RecordingTable, name: str, column: Any, *, number: bool) -> list[str]:
    out: list[str] = []
    for k, value in enumerate(column.to_pylist()):
        known = isinstance(value, str) or (number and isinstance(value, int) and not isinstance(value, bool))
        if value is not None and not known:
            raise table.build_error(f"found {value!r}; expected a word", k, name)
        out.append("" if value is None else str(value))
    return out
