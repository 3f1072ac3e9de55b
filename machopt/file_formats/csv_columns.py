"""Columns of a CSV table, read in blocks of rows: numbers become arrays, words become integer codes."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.errors import InputError
from machopt.file_formats.plain_decimals import LARGEST, is_plain
from machopt.file_formats.source_file import SourceFile
from machopt.numerics.array_types import Array

_ROWS = 20_000  # split and converted at once


@dataclass
class WordColumn:
    """A column of words: (N,) codes into ``names`` (in order of appearance)."""

    names: list[str] = field(default_factory=list)
    codes: NDArray[np.int32] = field(default_factory=lambda: np.empty(0, dtype=np.int32))
    _known: dict[str, int] = field(default_factory=dict)

    def encode(self, cells: list[str]) -> list[int]:
        """Encode words as integer codes; a new word gets the next code.

        Args:
            cells: Words of the rows.

        Returns:
            One code per row.
        """
        known = self._known
        found: list[int] = []
        for cell in cells:
            code = known.get(cell)
            if code is None:
                code = known[cell] = len(self.names)
                self.names.append(cell)
            found.append(code)
        return found


def iterate_data_lines(source: SourceFile) -> Iterator[tuple[int, str]]:
    """Iterate over the lines that are neither comments nor empty.

    Args:
        source: Lines of the file, with its path and the builder of its errors.

    Returns:
        Line number (1-based) and text.
    """
    for line, text in enumerate(source.lines, 1):
        if text and not text.isspace() and not text.lstrip().startswith("#"):
            yield line, text


def split_cells(text: str) -> list[str]:
    """Split one line into cells; quoted text is parsed only where a quote occurs.

    Args:
        text: Text of the line.

    Returns:
        The cells.
    """
    if '"' not in text:
        return text.split(",")
    try:
        return next(csv.reader([text]))
    except csv.Error:
        return text.split(",")


@dataclass
class CsvColumns:
    """The requested columns; row k of the data is in line ``line[k]``."""

    numbers: dict[str, Array]  # name → (N,)
    words: dict[str, WordColumn]
    line: NDArray[np.int32]


def read_columns(source: SourceFile, header: list[str], numbers: dict[str, bool], words: list[str]) -> CsvColumns:
    """Read the named columns of a table whose first data line is its header.

    Args:
        source: the file.
        header: names of all its columns.
        numbers: name → whether a cell may be empty (NaN then).
        words: names of columns of words.
    Raises:
        InputError: a row of another length, a cell that is no finite number.
    """
    where = {name: header.index(name) for name in (*numbers, *words)}
    parts: dict[str, list[Array]] = {name: [] for name in numbers}
    found = {name: WordColumn() for name in words}
    codes: dict[str, list[NDArray[np.int32]]] = {name: [] for name in words}
    line_parts: list[NDArray[np.int32]] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    width = len(header)

    def take() -> None:
        columns = list(zip(*rows, strict=True)) if rows else []
        for name, empty_allowed in numbers.items():
            parts[name].append(_parse_numbers(source, name, columns[where[name]], lines, empty_allowed=empty_allowed))
        for name in words:
            cells = [c.strip() for c in columns[where[name]]]
            codes[name].append(np.array(found[name].encode(cells), dtype=np.int32))
        line_parts.append(np.array(lines, dtype=np.int32))
        rows.clear()
        lines.clear()

    data = iterate_data_lines(source)
    next(data)  # the header
    for line, text in data:
        row = split_cells(text)
        if len(row) != width:
            raise source.build_error(f"{len(row)} columns; expected {width} as in the header", line)
        rows.append(row)
        lines.append(line)
        if len(rows) == _ROWS:
            take()
    if rows:
        take()
    for name in words:
        found[name].codes = np.concatenate(codes[name])
    return CsvColumns({n: np.concatenate(p) for n, p in parts.items()}, found, np.concatenate(line_parts))


def _parse_numbers(
    source: SourceFile, name: str, cells: tuple[str, ...], lines: list[int], *, empty_allowed: bool
) -> Array:
    try:
        values = np.array([float(c) for c in cells])
    except ValueError:
        values = np.array(
            [parse_number_cell(source, name, c, n, empty_allowed) for c, n in zip(cells, lines, strict=True)]
        )
        return values
    if not (np.abs(values) < LARGEST).all() or not is_plain("".join(cells)):
        for c, n in zip(cells, lines, strict=True):
            parse_number_cell(source, name, c, n, empty_allowed)
    return values


def parse_number_cell(source: SourceFile, name: str, cell: str, line: int, empty_allowed: bool) -> float:
    """Parse one cell as a number.

    Args:
        source: Lines of the file, with its path and the builder of its errors.
        name: Name of the column.
        cell: Text of the cell.
        line: Line number (1-based).
        empty_allowed: Whether an empty cell is accepted.

    Returns:
        The number; NaN for an empty cell.

    Raises:
        InputError: the text is no number, or not finite.
    """
    text = cell.strip()
    if not text and empty_allowed:
        return math.nan
    if not is_number(text):
        raise _build_column_error(source, f"found {text!r}; expected a number", line, name)
    value = float(text)
    if not abs(value) < LARGEST:
        raise _build_column_error(
            source, f"found {text!r}; expected a finite number, not larger than {LARGEST:g}", line, name
        )
    return value


def is_number(text: str) -> bool:
    """Return whether a text is a number.

    Args:
        text: The text.
    """
    try:
        float(text)
    except ValueError:
        return False
    return is_plain(text.strip())


def _build_column_error(source: SourceFile, message: str, line: int, column: str) -> InputError:
    return source.build_error(message, line, column)
