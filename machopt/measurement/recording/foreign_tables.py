"""Tables of other programs as tables of a recording: names, separator, decimal mark, units, and several files.

``columns``, ``format`` and ``join`` of recording.yaml say how a file is to be understood. It is converted to the text
of a table with our names and units, line by line, so that messages about cells still name the line of the file.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from machopt.errors import RecordingError, suggest_nearest_word
from machopt.file_formats.file_reading import TABLE, read_file
from machopt.measurement.recording.recording_schema import FormatKeys, JoinKeys
from machopt.measurement.recording.workbook_tables import MATLAB, WORKBOOK, read_matlab_rows, read_workbook_rows

SEPARATORS = {"tab": "\t", "space": " "}
LENGTH = {"mm": 1.0, "m": 1000.0, "cm": 10.0, "um": 1e-3, "µm": 1e-3, "in": 25.4, "inch": 25.4}
ANGLE = {"deg": 1.0, "°": 1.0, "rad": 57.29577951308232, "mrad": 0.05729577951308232}
FORCE = {"n": 1.0, "kn": 1000.0, "lbf": 4.4482216152605, "kgf": 9.80665, "kg": 9.80665}
MOMENT = {"nm": 1.0, "n·m": 1.0, "knm": 1000.0, "kn·m": 1000.0, "nmm": 1e-3, "n·mm": 1e-3, "lbfft": 1.3558179483314}
ROTATION = {"mrad": 1.0, "rad": 1000.0, "deg": 17.453292519943297, "°": 17.453292519943297}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "h": 3600.0}
SPEED = {"deg/s": 1.0, "rad/s": 57.29577951308232}
UNITS = {
    "_deg_s": SPEED,
    "_mm_s": {"mm/s": 1.0, "m/s": 1000.0},
    "_deg": ANGLE,
    "_mrad": ROTATION,
    "_mm": LENGTH,
    "_Nm": MOMENT,
    "_N": FORCE,
    "_s": TIME,
}
"""Factors to the unit of our columns, by the end of the column's name. The longest end that fits counts."""
QUATERNION = ("qw", "qx", "qy", "qz")
_BRACKET = re.compile(r"[\[(](?!:,[0-9])\s*([^\])]+?)\s*[\])]\s*$")


@dataclass(frozen=True)
class _RawTable:
    path: Path
    lines: tuple[int, ...]  # 1-based line of each row
    header_line: int
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def convert_foreign_table(
    path: Path,
    columns: Mapping[str, str],
    form: FormatKeys,
    join: JoinKeys | None,
    known: Sequence[str],
) -> bytes:
    """Convert a file to the text of a table with our names, separators and units.

    Args:
        path: Path of the table.
        columns: Our name → name in the file; other columns that we do not know are left out.
        form: Separator, decimal mark, encoding and units.
        join: Further files whose columns are added.
        known: Our column names.

    Returns:
        UTF-8 text with one line for each line of the file.

    Raises:
        RecordingError: A named column or key is missing, a unit is unknown, or the files do not match.
    """
    tables = _read_tables(path, columns, form, join, known)
    _check_mapped_names(tables, columns, known)
    first = tables[0]
    parts: dict[str, list[str]] = {}
    for n, table in enumerate(tables):
        order = list(range(len(first.rows))) if n == 0 else _match_rows(first, table, join, columns)
        for ours, cells in _select_columns(table, columns, form, known).items():
            if ours not in parts:
                parts[ours] = [cells[k] for k in order]
            elif n == 0 or not join or join.by not in (ours, columns.get(ours)):
                raise RecordingError(f"column {ours} is in two of the joined files; keep one", file=table.path)
    if form.quaternion == "xyzw" and all(name in parts for name in QUATERNION):
        x, y, z, w = (parts[name] for name in QUATERNION)
        parts |= {"qw": w, "qx": x, "qy": y, "qz": z}
    return _write_lines(first, parts)


def _read_tables(
    path: Path, columns: Mapping[str, str], form: FormatKeys, join: JoinKeys | None, known: Sequence[str]
) -> list[_RawTable]:
    """Return the table and those that are joined to it."""
    wanted = {*columns.values(), *known, *((join.by,) if join else ())}
    return [_read_raw(file, form, wanted) for file in (path, *(path.parent / n for n in (join.files if join else ())))]


@dataclass(frozen=True)
class ColumnReading:
    """How one column of a file is understood."""

    file: str
    column: str  # its name in the file
    name: str  # our name; empty: not used
    factor: float  # from the file's unit to ours
    first: str  # first cell, as the file has it


def list_column_readings(
    path: Path, columns: Mapping[str, str], form: FormatKeys, join: JoinKeys | None, known: Sequence[str]
) -> tuple[ColumnReading, ...]:
    """Return how each column of a file, and of those joined to it, is understood.

    Args:
        path: Path of the table.
        columns: Our name → name in the file.
        form: Separator, decimal mark, encoding and units.
        join: Further files whose columns are added.
        known: Our column names.

    Raises:
        RecordingError: As :func:`convert_foreign_table`.
    """
    tables = _read_tables(path, columns, form, join, known)
    _check_mapped_names(tables, columns, known)
    theirs = {name: ours for ours, name in columns.items()}
    out = []
    for table in tables:
        for n, name in enumerate(table.header):
            ours = theirs.get(name) or (name if name in known and name not in columns else "")
            factor = _find_factor(table, name, ours, form) if ours else 1.0
            out.append(ColumnReading(table.path.name, name, ours, factor, table.rows[0][n] if table.rows else ""))
    return tuple(out)


def is_binary_table(path: Path) -> bool:
    """Return whether a data file is an Excel workbook or a MATLAB file, by its name.

    Args:
        path: Path of the file.
    """
    return path.suffix.lower() in (WORKBOOK, MATLAB)


def _read_raw(path: Path, form: FormatKeys, wanted: Collection[str] = ()) -> _RawTable:
    if not is_binary_table(path):
        return _build_raw_table(path, _read_text_rows(path, form), form)
    if path.suffix.lower() == WORKBOOK:
        rows = read_workbook_rows(path, form.sheet)
        return _build_raw_table(path, ((line, row) for line, row in rows if line > form.skip_lines), form)
    return _build_raw_table(path, read_matlab_rows(path, wanted), form)


def _read_text_rows(path: Path, form: FormatKeys) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Yield line number and cells of each line that holds any."""
    data = read_file(path, expected="a table of readings", most=TABLE)
    try:
        text = data.decode("utf-8-sig" if form.encoding.lower() in ("utf-8", "utf8") else form.encoding)
    except (UnicodeDecodeError, LookupError):
        raise RecordingError(
            f"is not {form.encoding} text; another format.encoding would work, latin-1 for example", file=path
        ) from None
    mark = SEPARATORS.get(form.separator, form.separator)
    for line, row in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        if line <= form.skip_lines or not row.strip() or row.lstrip().startswith("#"):
            continue
        cells = row.split() if mark == " " else next(csv.reader([row], delimiter=mark))
        yield line, tuple(c.strip() for c in cells)


def _build_raw_table(path: Path, found: Iterator[tuple[int, tuple[str, ...]]], form: FormatKeys) -> _RawTable:
    """Return header and rows; refuse none at all, and rows of another width than the header."""
    lines, rows = [], []
    for line, cells in found:
        lines.append(line)
        rows.append(cells)
    if not rows:
        raise RecordingError("holds no rows; expected a header line and one line a reading", file=path)
    header = rows[0]
    for line, fields in zip(lines[1:], rows[1:], strict=True):
        if len(fields) != len(header):
            raise RecordingError(
                f"found {len(fields)} fields; expected {len(header)} as in the header (separator {form.separator!r})",
                file=path,
                where=f"line {line}",
            )
    return _RawTable(path, tuple(lines[1:]), lines[0], header, tuple(rows[1:]))


def _check_mapped_names(tables: Sequence[_RawTable], columns: Mapping[str, str], known: Sequence[str]) -> None:
    there = [name for t in tables for name in t.header]
    for ours, theirs in columns.items():
        if ours not in known:
            raise RecordingError(
                f"columns: {ours!r} is no column of a recording; {suggest_nearest_word(ours, list(known))}",
                file=tables[0].path,
            )
        if theirs not in there:
            raise RecordingError(
                f"has no column {theirs!r}, which columns.{ours} names; {suggest_nearest_word(theirs, there)}",
                file=tables[0].path,
                where=f"line {tables[0].header_line}",
            )


def _select_columns(
    table: _RawTable, columns: Mapping[str, str], form: FormatKeys, known: Sequence[str]
) -> dict[str, list[str]]:
    """Return the cells of our columns in our units."""
    theirs = {name: ours for ours, name in columns.items()}
    out: dict[str, list[str]] = {}
    for n, name in enumerate(table.header):
        ours = theirs.get(name) or (name if name in known and name not in columns else None)
        if ours is None:
            continue
        factor = _find_factor(table, name, ours, form)
        out[ours] = [_convert_cell(row[n], factor, form.decimal) for row in table.rows]
    return out


def _find_factor(table: _RawTable, name: str, ours: str, form: FormatKeys) -> float:
    end = next((e for e in UNITS if ours.endswith(e)), None)
    if end is None:
        return 1.0
    allowed = UNITS[end]
    bracket = _BRACKET.search(name)
    if bracket is not None:
        unit = bracket.group(1).replace(" ", "").lower()
        if unit not in allowed:
            raise RecordingError(
                f"column {name!r} is in {bracket.group(1)!r}, and {ours} needs one of {', '.join(allowed)}",
                file=table.path,
                where=f"line {table.header_line}",
            )
        return allowed[unit]
    if end == "_deg" and form.angle_unit:
        return ANGLE[form.angle_unit]
    if end == "_deg_s" and form.angle_unit in ("deg", "rad"):
        return SPEED[f"{form.angle_unit}/s"]
    if end == "_mrad" and form.angle_unit:
        return ROTATION[form.angle_unit]
    if end == "_mm" and form.length_unit:
        return LENGTH[form.length_unit]
    return 1.0


def _convert_cell(cell: str, factor: float, decimal: str) -> str:
    if decimal != ".":
        cell = cell.replace(".", "").replace(decimal, ".") if cell.count(decimal) == 1 else cell.replace(decimal, ".")
    if factor == 1.0:
        return cell
    try:
        return repr(float(cell) * factor)
    except ValueError:
        return cell  # the table reader names the cell


def _match_rows(first: _RawTable, other: _RawTable, join: JoinKeys | None, columns: Mapping[str, str]) -> list[int]:
    """Return for each row of the first table the row of the other one."""
    assert join is not None  # there are other tables only with it
    if join.by == "row":
        if len(other.rows) != len(first.rows):
            raise RecordingError(
                f"has {len(other.rows)} rows and {first.path.name} has {len(first.rows)}; expected the same number, or "
                "join.by with the name of a column that both have",
                file=other.path,
            )
        return list(range(len(first.rows)))
    keys = []
    for table in (first, other):
        names = [n for n in (join.by, columns.get(join.by, "")) if n in table.header]
        if not names:
            raise RecordingError(f"has no column {join.by!r}, which join.by names", file=table.path)
        at = table.header.index(names[0])
        keys.append([row[at] for row in table.rows])
    place = {key: k for k, key in enumerate(keys[1])}
    if len(place) < len(keys[1]):
        raise RecordingError(f"has a value of {join.by} twice; expected each once", file=other.path)
    missing = next((k for k, key in enumerate(keys[0]) if key not in place), None)
    if missing is not None:
        line = f"line {first.lines[missing]} of {first.path.name}"
        raise RecordingError(f"has no row with {join.by} = {keys[0][missing]!r}, as {line} has", file=other.path)
    return [place[key] for key in keys[0]]


def _write_lines(first: _RawTable, parts: Mapping[str, Sequence[str]]) -> bytes:
    """Return the text with every row on its own line of the file."""
    rows = dict(zip(first.lines, zip(*parts.values(), strict=True), strict=True))
    rows[first.header_line] = tuple(parts)
    last = max(rows)
    return "\n".join(",".join(rows[k]) if k in rows else "#" for k in range(1, last + 1)).encode("utf-8")
