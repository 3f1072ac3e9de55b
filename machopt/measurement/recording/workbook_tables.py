"""Tables in Excel workbooks (.xlsx) and MATLAB files (.mat) as rows of text, for the reader of foreign tables.

Both are untrusted input: the size of their unpacked content is counted before a library reads them. Numbers are written
with all digits, so nothing is lost on the way.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from machopt.errors import FileFormatError, RecordingError
from machopt.file_formats.file_reading import MIB, TABLE, read_file
from machopt.numerics.array_types import Array

WORKBOOK, MATLAB = ".xlsx", ".mat"
MOST_UNPACKED = 512 * MIB  # bytes of a file once unpacked
_MATLAB_HEADER = 128  # bytes
_DAMAGED = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OSError,
    EOFError,
    NotImplementedError,
    zlib.error,
)
_COMPRESSED = 15  # type of a compressed element (MAT-File Format, table 1-1)


def read_workbook_rows(path: Path, sheet: str | None) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Read a sheet of an Excel workbook; formulas count with the value that Excel stored.

    Args:
        path: Path of the .xlsx file.
        sheet: Name of the sheet; None: the first one.

    Returns:
        Number of each row in the sheet, from 1, and its cells as text; rows without content are left out.

    Raises:
        FileFormatError: openpyxl is not installed.
        RecordingError: No workbook, too large, or no such sheet.
    """
    try:
        import openpyxl
        from openpyxl.utils.exceptions import InvalidFileException
    except ImportError:
        raise FileFormatError(
            "is an Excel workbook, which needs openpyxl: pip install '.[excel]' in machopt's folder, or save the table "
            "as CSV",
            file=path,
        ) from None
    data = read_file(path, expected="an Excel workbook", most=TABLE)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _refuse_unpacked_size(path, sum(entry.file_size for entry in archive.infolist()))
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True)
    except (*_DAMAGED, zipfile.BadZipFile, ElementTree.ParseError, InvalidFileException) as problem:
        raise RecordingError(f"is not readable as an Excel workbook: {problem}", file=path) from None
    if sheet is not None and sheet not in book.sheetnames:
        raise RecordingError(
            f"has no sheet {sheet!r}, which format.sheet names; it has {', '.join(book.sheetnames)}", file=path
        )
    found = book[sheet] if sheet is not None else book.worksheets[0]
    rows: list[tuple[int, tuple[str, ...]]] = []
    for number, cells in enumerate(found.iter_rows(values_only=True), 1):
        words = tuple(_format_value(cell) for cell in cells)
        if any(words) and not words[0].startswith("#"):
            rows.append((number, words))
    width = max((n + 1 for _, words in rows for n, word in enumerate(words) if word), default=0)
    return iter([(number, (words + ("",) * width)[:width]) for number, words in rows])


def read_matlab_rows(path: Path, wanted: Collection[str]) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Read the vectors and matrices of a MATLAB file as columns of one table.

    A vector keeps its name; the columns of a matrix ``Q`` are ``Q(:,1)``, ``Q(:,2)`` …; a field of a structure ``log``
    is ``log.q``.

    Args:
        path: Path of the .mat file, version 5 to 7 (save -v7).
        wanted: Names of columns that are used; they fix the number of rows.

    Returns:
        The header as row 1, and sample k as row k + 1.

    Raises:
        RecordingError: No MATLAB file, version 7.3, too large, or wanted columns of different lengths.
    """
    data = read_file(path, expected="a MATLAB file", most=TABLE)
    if data[:8] == b"\x89HDF\r\n\x1a\n" or data[:19] == b"MATLAB 7.3 MAT-file":
        raise RecordingError("is a MATLAB 7.3 file; expected version 7, as save('name.mat', '-v7') writes", file=path)
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        _refuse_unpacked_size(path, _measure_unpacked_matlab(data))
        content = loadmat(io.BytesIO(data), struct_as_record=True)
    except (*_DAMAGED, MatReadError) as problem:
        raise RecordingError(f"is not readable as a MATLAB file: {problem}", file=path) from None
    columns: dict[str, Array] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            columns |= _list_columns(name, value)
    rows = _choose_length(path, columns, wanted)
    table = {name: values for name, values in columns.items() if len(values) == rows}
    numbers = zip(*(map(repr, values.tolist()) for values in table.values()), strict=True)
    return iter([(1, tuple(table)), *enumerate(numbers, 2)])


def _choose_length(path: Path, columns: dict[str, Array], wanted: Collection[str]) -> int:
    """Return the number of rows: that of the wanted columns, or the commonest where none is there."""
    lengths = {name: len(values) for name, values in columns.items() if name in wanted}
    if len(set(lengths.values())) > 1:
        first = next(iter(lengths))
        other = next(name for name in lengths if lengths[name] != lengths[first])
        raise RecordingError(
            f"{first!r} has {lengths[first]} values and {other!r} has {lengths[other]}; expected the same number",
            file=path,
        )
    if lengths:
        return next(iter(lengths.values()))
    if not columns:
        raise RecordingError("holds no vectors or matrices of numbers", file=path)
    return Counter(len(values) for values in columns.values()).most_common(1)[0][0]


def _list_columns(name: str, value: Any, depth: int = 0) -> dict[str, Array]:
    """Return the columns of numbers in a variable."""
    if not isinstance(value, np.ndarray):
        return {}
    if value.dtype.names is not None and value.size == 1 and depth < 4:
        fields = value.reshape(-1)[0]
        parts = [_list_columns(f"{name}.{field}", fields[field], depth + 1) for field in value.dtype.names]
        return {key: column for part in parts for key, column in part.items()}
    if value.dtype.kind not in "fiub" or value.ndim != 2 or not value.size:
        return {}
    numbers = np.asarray(value, float)
    if 1 in numbers.shape:
        return {name: numbers.reshape(-1)}
    return {f"{name}(:,{n + 1})": numbers[:, n] for n in range(numbers.shape[1])}


def _measure_unpacked_matlab(data: bytes) -> int:
    """Return the bytes of the file's variables once unpacked; counting ends above the limit."""
    order = "<" if data[126:128] == b"IM" else ">"
    total, at = 0, _MATLAB_HEADER
    while at + 8 <= len(data) and total <= MOST_UNPACKED:
        kind, size = struct.unpack(f"{order}II", data[at : at + 8])
        block = data[at + 8 : at + 8 + size]
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            while block and total <= MOST_UNPACKED:
                total += len(unpack.decompress(block, MIB))
                block = unpack.unconsumed_tail
        else:
            total += size
        at += 8 + size
    return total


def _refuse_unpacked_size(path: Path, size: int) -> None:
    if size > MOST_UNPACKED:
        raise RecordingError(
            f"unpacks to more than {MOST_UNPACKED // MIB} MiB; expected a smaller table, or CSV in several files",
            file=path,
        )


def _format_value(cell: object) -> str:
    """Return a cell as text; an empty one as no text."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, float):
        return repr(int(cell)) if cell.is_integer() and abs(cell) < 1e15 else repr(cell)
    return str(cell).strip()
