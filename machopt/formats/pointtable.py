"""Point tables: CSV and Parquet with the contract's columns, and headerless XYZWPR lists as RoboDK imports them."""

from __future__ import annotations

import csv
import difflib
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from machopt.domain.toolpath import Array, Move, Toolpath
from machopt.errors import InputError
from machopt.formats.pathbuilder import PathBuilder
from machopt.formats.source import UNIT_NAMES, ReadOptions, Source

_UNIT_ENDINGS = {"_mm": "mm", "_inch": "inch", "_in": "inch", "": None}
_POINT = ("x", "y", "z")
_AXIS = ("i", "j", "k")
_REFERENCE = ("rx", "ry", "rz")
_PLAIN = ("i", "j", "k", "move", "operation", "rx", "ry", "rz")
_MOVES = {m.word: m for m in Move}
_XYZWPR = (6, 7)  # columns of a headerless list: x, y, z, w, p, r and maybe a running number


def looks_like_table(source: Source) -> bool:
    """True where the first data line is a header with x, y, z or a row of plain numbers."""
    first = next((t for t in source.lines if t.strip() and not t.lstrip().startswith("#")), "")
    cells = [c.strip().strip('"').lower() for c in first.replace(";", ",").split(",")]
    if len(cells) < 3:
        return False
    return any(c.startswith("x") and c.rstrip("_minch") == "x" for c in cells) or all(map(_is_number, cells))


def read_csv(source: Source, options: ReadOptions) -> Toolpath:
    """Read a CSV point table; row k is point k.

    Raises:
        InputError: see :func:`machopt.formats.toolpath.read_toolpath`.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    for line, text in enumerate(source.lines, 1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        rows.append(next(csv.reader([text])) if '"' in text else text.split(","))
        lines.append(line)
    if not rows:
        raise source.error("holds no rows; expected a header line and one row a point")
    if all(_is_number(c) for c in rows[0]):
        return _read_xyzwpr(source, options, rows, lines)
    header = [c.strip() for c in rows[0]]
    if len(header) == 1 and ";" in header[0]:
        raise source.error("columns are separated by semicolons; expected commas", lines[0])
    if len(rows) == 1:
        raise source.error("holds a header but no rows; expected one row a point", lines[0])
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(header):
            raise source.error(f"{len(row)} columns; expected {len(header)} as in the header", line)
    columns = {name: [row[k].strip() for row in rows[1:]] for k, name in enumerate(header)}
    if len(columns) != len(header):
        twice = next(n for k, n in enumerate(header) if n in header[:k])
        raise source.error(f"column {twice!r} stands twice in the header", lines[0])
    return _Table(source, options, lines[0], lines[1:], "csv").read(columns)


def read_parquet(path: Path, data: bytes, options: ReadOptions) -> Toolpath:
    """Read a Parquet point table with the same columns as CSV; ``line`` is the 1-based row.

    Raises:
        InputError: pyarrow is not installed, the file is damaged, or as for CSV.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as problem:
        raise InputError(
            "is Parquet, which needs pyarrow: pip install machopt[parquet], or save the table as CSV", file=path
        ) from problem
    try:
        table = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
    except (pyarrow.ArrowException, OSError) as problem:
        raise InputError(f"is not readable as Parquet: {problem}", file=path) from problem
    source = Source(path, [], hashlib.sha256(data).hexdigest(), True)
    if not table.num_rows:
        raise source.error("holds no rows; expected one row a point")
    columns = {
        name: ["" if v is None else (v if isinstance(v, str) else repr(v)) for v in table.column(name).to_pylist()]
        for name in table.column_names
    }
    return _Table(source, options, 1, range(1, table.num_rows + 1), "parquet").read(columns)


class _Table:
    def __init__(self, source: Source, options: ReadOptions, header_line: int, lines: Sequence[int], kind: str) -> None:
        self.source, self.options, self.header_line, self.lines = source, options, header_line, lines
        self.out = PathBuilder(source, options, kind)

    def read(self, columns: dict[str, list[str]]) -> Toolpath:
        names, unit = self.names(list(columns))
        scale = UNIT_NAMES[unit]
        n = len(self.lines)
        p = self.block(columns, [names[c] for c in _POINT]) * scale
        axis = np.tile((0.0, 0.0, 1.0), (n, 1))
        if self.all_or_none(names, _AXIS):
            axis = self.block(columns, [names[c] for c in _AXIS])
        reference = None
        if self.all_or_none(names, _REFERENCE):
            reference = self.reference(self.block(columns, [names[c] for c in _REFERENCE], empty_allowed=True))
        feed = np.full(n, np.nan)
        if "feed" in names:
            feed = self.block(columns, [names["feed"]], empty_allowed=True)[:, 0] * scale
            if (feed < 0.0).any():
                at = int(np.argmax(feed < 0.0))
                raise self.error(f"feed {feed[at] / scale:g}; expected zero or more", at, names["feed"])
        tolerance = None
        if "tolerance" in names:
            tolerance = self.block(columns, [names["tolerance"]], empty_allowed=True)[:, 0] * scale
            if (tolerance <= 0.0).any():
                at = int(np.argmax(tolerance <= 0.0))
                raise self.error("the tolerance is not above zero", at, names["tolerance"])
        moves = columns.get("move")
        labels = columns.get("operation")
        for k in range(n):
            move = Move.CUT
            if moves is not None and moves[k]:
                found = _MOVES.get(moves[k].lower())
                if found is None:
                    raise self.error(f"move {moves[k]!r}; expected one of {', '.join(_MOVES)}", k, "move")
                move = found
            if labels is not None:
                self.out.begin_operation(labels[k])
            rate = float(feed[k])
            if move == Move.RAPID or (rate == 0.0 and move != Move.CUT):
                rate = math.nan
            (x, y, z), (i, j, kk) = p[k].tolist(), axis[k].tolist()
            self.out.add((x, y, z), (i, j, kk), move, rate, self.lines[k])
        self.out.meta["unit"] = unit
        return self.out.build(reference=reference, tolerance_mm=tolerance)

    def names(self, header: list[str]) -> tuple[dict[str, str], str]:
        """Column of each quantity, and the table's unit."""
        names: dict[str, str] = {}
        units: dict[str, str] = {}
        for column in header:
            plain = column.lower()
            if plain in _PLAIN:
                names[plain] = column
                continue
            base, unit = _split_unit(plain)
            if base is not None:
                if base in names:
                    raise self.source.error(
                        f"columns {names[base]!r} and {column!r} mean the same; expected one", self.header_line
                    )
                names[base] = column
                if unit:
                    units.setdefault(unit, column)
                continue
            known = [f"{c}_mm" for c in _POINT] + [*_PLAIN, "feed_mm_min", "tolerance_mm"]
            near = difflib.get_close_matches(plain, [k for k in known if k not in header], 1, 0.8)
            if near:
                raise self.source.error(f"unknown column {column!r}; did you mean {near[0]!r}?", self.header_line)
            self.out.ignore(f"column {column}", self.header_line, understood=False)
        missing = [f"{c}_mm" for c in _POINT if c not in names]
        if missing:
            raise self.source.error(
                f"columns {', '.join(missing)} are missing; found {', '.join(header)[:200]}", self.header_line
            )
        if len(units) == 2:
            raise self.source.error(
                f"columns {units['mm']!r} and {units['inch']!r} mix mm and inch; expected one unit", self.header_line
            )
        unit = next(iter(units), None)
        asked = self.options.unit
        if unit is None and asked is None:
            raise self.source.error(
                "columns x, y, z carry no unit; name them x_mm, y_mm, z_mm or give --unit mm or --unit inch",
                self.header_line,
            )
        if unit is not None and asked is not None and unit != asked:
            raise self.source.error(
                f"column {units[unit]!r} is in {unit} but --unit {asked} was given", self.header_line
            )
        return names, unit or asked or "mm"

    def all_or_none(self, names: dict[str, str], group: tuple[str, ...]) -> bool:
        have = [c for c in group if c in names]
        if have and len(have) < len(group):
            raise self.source.error(
                f"column {', '.join(c for c in group if c not in names)} is missing beside {', '.join(have)}",
                self.header_line,
            )
        return bool(have)

    def block(self, columns: dict[str, list[str]], names: list[str], *, empty_allowed: bool = False) -> Array:
        """(N, len(names)) numbers; empty cells are NaN where allowed."""
        out = np.empty((len(self.lines), len(names)))
        for c, name in enumerate(names):
            cells = columns[name]
            try:
                values = [float(v) if v else math.nan for v in cells] if empty_allowed else [float(v) for v in cells]
            except ValueError:
                at = next(k for k, v in enumerate(cells) if not (_is_number(v) or (empty_allowed and not v)))
                raise self.error(f"found {cells[at]!r}; expected a number", at, name) from None
            out[:, c] = values
            bad = ~np.isfinite(out[:, c])
            for row in np.flatnonzero(bad).tolist():
                if not (empty_allowed and not cells[row]):
                    raise self.error(f"found {cells[row]!r}; expected a finite number", row, name)
        return out

    def reference(self, r: Array) -> Array:
        given = ~np.isnan(r).any(axis=1)
        length = np.linalg.norm(np.nan_to_num(r), axis=1)
        bad = (given & (length < 1e-6)) | (np.isnan(r).any(axis=1) & ~np.isnan(r).all(axis=1))
        if bad.any():
            raise self.error("the reference direction is zero or incomplete", int(np.argmax(bad)), "rx, ry, rz")
        return np.asarray(r / np.where(given, length, 1.0)[:, None])

    def error(self, message: str, row: int, column: str) -> InputError:
        return self.source.error(message, self.lines[row], column)


def _split_unit(column: str) -> tuple[str | None, str | None]:
    for base in (*_POINT, "tolerance"):
        for ending, unit in _UNIT_ENDINGS.items():
            if column == base + ending:
                return base, unit
    for ending, unit in (("_mm_min", "mm"), ("_inch_min", "inch"), ("_in_min", "inch"), ("", None)):
        if column == "feed" + ending:
            return "feed", unit
    return None, None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _read_xyzwpr(source: Source, options: ReadOptions, rows: list[list[str]], lines: list[int]) -> Toolpath:
    """x, y, z in mm and w, p, r in degrees about fixed X, Y, Z: R = Rz(r) Ry(p) Rx(w) is the TCP's attitude.

    The tool axis is −z and the reference direction +x of that attitude; every row is a cut at the given feed.
    """
    width = len(rows[0])
    if width not in _XYZWPR:
        raise source.error(
            f"rows of {width} numbers without a header; expected a header with x_mm, y_mm, z_mm, or six or seven "
            "numbers x, y, z, w, p, r (mm, degrees)",
            lines[0],
        )
    if options.unit == "inch":
        raise source.error("a list of x, y, z, w, p, r is in mm but --unit inch was given")
    table = np.empty((len(rows), width))
    for k, (row, line) in enumerate(zip(rows, lines, strict=True)):
        if len(row) != width:
            raise source.error(f"{len(row)} columns; expected {width}", line)
        for c, cell in enumerate(row):
            if not _is_number(cell) or not math.isfinite(float(cell)):
                raise source.error(f"found {cell.strip()!r}; expected a finite number", line, c + 1)
            table[k, c] = float(cell)
    w, p, r = np.radians(table[:, 3:6]).T
    cw, sw, cp, sp, cr, sr = np.cos(w), np.sin(w), np.cos(p), np.sin(p), np.cos(r), np.sin(r)
    x_tcp = np.column_stack([cr * cp, sr * cp, -sp])
    z_tcp = np.column_stack([cr * sp * cw + sr * sw, sr * sp * cw - cr * sw, cp * cw])
    out = PathBuilder(source, options, "csv/xyzwpr")
    out.meta.update(unit="mm", attitude="R = Rz(r) Ry(p) Rx(w), degrees; tool axis -z, reference +x")
    out.warn("no header: rows are read as x, y, z (mm), w, p, r (degrees about fixed X, Y, Z), all of them cuts")
    if width == 7:
        out.ignore("column 7 (running number)", lines[0], understood=True)
    feed = math.nan if options.default_feed is None else options.default_feed * 60e3
    if math.isnan(feed):
        raise source.error("a list of x, y, z, w, p, r has no feeds; give one with --feed", lines[0])
    for (x, y, z), (i, j, k3), line in zip(table[:, :3].tolist(), (-z_tcp).tolist(), lines, strict=True):
        out.add((x, y, z), (i, j, k3), Move.CUT, feed, line)
    return out.build(reference=x_tcp)
