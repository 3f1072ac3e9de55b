"""Columns of a CSV file by name: numbers in blocks of any length, words where a column holds words."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Array
from machopt.verification.tables.table_cache import read_cached

TEXT_COLUMNS = frozenset(
    {"operation", "move", "status", "reason", "nearest_pair", "stiffness_from", "tool", "outcome", "cause", "chatter"}
)  # columns of words
BLOCK_ROWS = 5_000  # turned into numbers at once: a million rows as words would be gigabytes
MAX_NUMBER = 1e18  # in size: no column holds more, and its powers are still finite
NUMBER_CHARACTERS = frozenset("0123456789+-.eE")  # float() takes digits of other scripts and underscores too
_NUMBER_REMOVAL = dict.fromkeys(map(ord, NUMBER_CHARACTERS))  # what they are translated into


@dataclass(frozen=True)
class ColumnTable:
    """Columns of a table by name; a column of numbers is read as such, and as words only where it has none."""

    file: Path
    text: dict[str, list[str]]
    parts: dict[str, list[Array | list[str]]]  # block after block; words where one of them is no finite number

    def __contains__(self, name: str) -> bool:
        return name in self.text or name in self.parts

    @property
    def column_names(self) -> tuple[str, ...]:
        return (*self.text, *self.parts)

    def read_words(self, name: str) -> list[str]:
        """Return a column of words.

        Args:
            name: Name of the column.
        """
        self._get_column(name)
        return self.text[name]

    def read_numbers(self, name: str, *, empty: bool = False) -> Array:
        """Return the (rows,) numbers of a column, NaN where a field is empty.

        Args:
            name: Name of the column.
            empty: Allow empty fields.

        Raises:
            InputError: the column is missing, or a field is no finite number, or empty where it must not be.
        """
        self._get_column(name)
        done: list[Array] = []
        for part in self.parts[name]:
            before = sum(map(len, done))
            done.append(_parse_numbers(part, name, self.file, before) if isinstance(part, list) else part)
            missing = np.isnan(done[-1])
            if not empty and missing.any():
                row = before + int(np.flatnonzero(missing)[0]) + 1
                raise OutputFolderError("'' is not a finite number", file=self.file, where=f"data row {row}, {name}")
        return np.concatenate(done)

    def _get_column(self, name: str) -> None:
        if name not in self:
            raise OutputFolderError(
                f"column {name!r} is missing; there are {', '.join(self.column_names)}", file=self.file
            )


def read_columns(file: Path) -> dict[str, list[str]]:
    """Return a short table's columns by name, as words.

    Args:
        file: Path of the CSV file.

    Raises:
        InputError: the file cannot be read, holds no rows, or a row has more or fewer fields than the header.
    """
    out: dict[str, list[str]] = {}
    for block in _read_blocks(file):
        for name, words in block.items():
            out.setdefault(name, []).extend(words)
    return out


def read_table(file: Path) -> ColumnTable:
    """Return a table of any length; within :func:`machopt.verification.tables.table_cache.cache_tables` it is read
    once.

    Args:
        file: Path of the CSV file.

    Raises:
        InputError: the file cannot be read, holds no rows, or a row has more or fewer fields than the header.
    """
    return read_cached(file, _read_table)


def _read_table(file: Path) -> ColumnTable:
    text: dict[str, list[str]] = {}
    parts: dict[str, list[Array | list[str]]] = {}
    known: dict[str, str] = {}  # equal words are one
    for block in _read_blocks(file):
        for name, words in block.items():
            if name in TEXT_COLUMNS:
                text.setdefault(name, []).extend([known.setdefault(word, word) for word in words])
            else:
                parts.setdefault(name, []).append(_parse_plain_numbers(words))
    return ColumnTable(file, text, parts)


def _read_blocks(file: Path) -> Iterator[dict[str, list[str]]]:
    """The columns of some thousand rows after the other, as words."""
    try:
        with file.open(encoding="utf-8-sig") as lines:
            yield from _split_blocks((line for line in lines if not line.startswith("#") and line.strip()), file)
    except (OSError, UnicodeDecodeError) as error:
        raise OutputFolderError(f"cannot be read: {getattr(error, 'strerror', None) or error}", file=file) from error
    except csv.Error as error:
        raise OutputFolderError(f"is no CSV table: {error}", file=file) from error


def _split_blocks(lines: Iterator[str], file: Path) -> Iterator[dict[str, list[str]]]:
    header = [name.strip() for name in next(csv.reader(islice(lines, 1)), [])]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise OutputFolderError(f"column {twice[0]!r} is given twice", file=file)
    done, width = 0, len(header)
    while block := list(islice(lines, BLOCK_ROWS)):
        text = "".join(block)
        rows = list(csv.reader(block)) if '"' in text else None
        fields = [line.count(",") + 1 for line in block] if rows is None else [*map(len, rows)]
        if {*fields} != {width}:
            number, count = next((n, count) for n, count in enumerate(fields, done + 1) if count != width)
            raise OutputFolderError(f"{count} fields, the header has {width}", file=file, where=f"data row {number}")
        if rows is None:  # no list of fields for every row
            flat = ",".join(block).split(",")
            columns = [flat[k::width] for k in range(width)]
        else:
            columns = [list(column) for column in zip(*rows, strict=True)]
        done += len(fields)
        quoted = "'" in text  # only then can a field need more than its blanks stripped
        yield {
            name: [_remove_apostrophe(field.strip()) for field in column] if quoted else _strip_fields(column)
            for name, column in zip(header, columns, strict=True)
        }
    if not done:
        raise OutputFolderError("holds no rows", file=file)


def _strip_fields(column: list[str]) -> list[str]:
    """Fields without blanks around them; most columns have none anywhere, as one look at all of it shows."""
    whole = "".join(column)
    return column if whole.split(None, 1) == [whole] else [*map(str.strip, column)]


def _remove_apostrophe(field: str) -> str:
    """A field without the apostrophe that keeps a spreadsheet from running it."""
    formula = field.lstrip("'").lstrip(" ").startswith(("=", "+", "-", "@", "＝", "＋", "－", "＠"))
    return field[1:] if formula and field.startswith("'") else field


def _parse_plain_numbers(words: list[str]) -> Array | list[str]:
    """Words as numbers, NaN where they are empty; as they are where one is no number in plain digits or too large."""
    if not "".join(words).translate(_NUMBER_REMOVAL):
        try:
            out = np.fromiter(map(float, words if all(words) else [word or "nan" for word in words]), float, len(words))
        except ValueError:
            return words
        if not (np.abs(out) > MAX_NUMBER).any():
            return out
    return words


def _parse_numbers(words: list[str], name: str, file: Path, before: int) -> Array:
    """Numbers of a block in which something is none; ``before``: rows of the table before it."""
    if not set("".join(words)) <= NUMBER_CHARACTERS:
        row = next(n for n, text in enumerate(words) if not set(text) <= NUMBER_CHARACTERS)
        raise OutputFolderError(
            f"{words[row]!r} is not a finite number in plain digits",
            file=file,
            where=f"data row {before + row + 1}, {name}",
        )
    out = np.array([_parse_float(text) for text in words])
    bad = np.abs(out) > MAX_NUMBER
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise OutputFolderError(
            f"{words[row]!r} is not a finite number of at most {MAX_NUMBER:g}",
            file=file,
            where=f"data row {before + row + 1}, {name}",
        )
    return out


def _parse_float(text: str) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return np.inf
