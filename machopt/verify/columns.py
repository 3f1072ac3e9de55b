"""The columns of a CSV file by name, however long it is: numbers in plain digits, words where a column holds words."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from machopt.arrays import Array
from machopt.errors import InputError
from machopt.verify.readonce import held

TEXT = frozenset(
    {"operation", "move", "status", "reason", "nearest_pair", "stiffness_from", "tool"}
)  # columns of words
ROWS = 20_000  # turned into numbers at once: a million rows as words would be gigabytes
PLAIN = frozenset("0123456789+-.eE")  # float() takes digits of other scripts and underscores too
_NOTHING = dict.fromkeys(map(ord, PLAIN))  # what they are translated into


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
