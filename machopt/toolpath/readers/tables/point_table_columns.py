"""Columns of a point table: which column holds which quantity, and the toolpath that they make."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.file_formats.csv_columns import CsvColumns, WordColumn
from machopt.file_formats.source_file import TOOL_AXES, UNIT_NAMES, ReadOptions, SourceFile, normalise_offset_name
from machopt.numerics.array_types import Array
from machopt.path_building.point_collector import PathBuilder
from machopt.spelling_suggestions import suggest_word
from machopt.toolpath.readers.tables.hole_rows import expand_hole_moves
from machopt.toolpath.readers.tables.orientation_columns import ORIENTATION_FORMATS, UNIT_QUATERNION, compute_rotations
from machopt.toolpath.readers.tables.row_kinds import (
    find_hole_rows,
    read_hole_lengths,
    refuse_possible_holes,
    refuse_ways_through_material,
)
from machopt.toolpath.readers.tables.unknown_columns import is_point_moving_column
from machopt.toolpath.readers.tables.xyzwpr_list import find_reference_column

_UNIT_ENDINGS = {"_mm": "mm", "_inch": "inch", "_in": "inch", "": None}
_POINT = ("x", "y", "z")
_AXIS = ("i", "j", "k")
_REFERENCE = ("rx", "ry", "rz")
_NORMAL = ("nx", "ny", "nz")
_WORDS = ("move", "operation", "tool", "offset", "kind")
_PLAIN = (*_AXIS, *_WORDS, *_REFERENCE, *_NORMAL)
_HOLE = ("depth", "approach")
_OPTIONAL = ("feed", "tolerance", *_HOLE, *_REFERENCE, *_NORMAL)
_MOVES = {m.word: m for m in MoveKind}


@dataclass(frozen=True, kw_only=True)
class _TableRows:
    """Rows of a table in mm."""

    table: Array  # (N, 7) position, tool axis, feed in mm/min
    move: NDArray[np.int32]  # (N,)
    is_hole: NDArray[np.bool_]  # (N,)
    reference: Array | None  # (N, 3) unit
    tolerance: Array | None  # (N,) mm
    normal: Array | None  # (N, 3) unit, surface normals


class PointTable:
    """Which column is which, and the toolpath they make."""

    columns: CsvColumns

    def __init__(self, source: SourceFile, options: ReadOptions, header_line: int, kind: str) -> None:
        self.source, self.options, self.header_line = source, options, header_line
        self.out = PathBuilder(source=source, options=options, format=kind)
        self.names: dict[str, str] = {}  # quantity → column
        self.unit = "mm"
        self.attitude: str | None = None
        self.angle_unit = 1.0  # rad per printed unit

    # ---- header

    def sort_columns(self, header: list[str]) -> None:
        """Find which column holds which quantity, and the unit of the table.

        Args:
            header: Names of the columns.

        Raises:
            InputError: columns are missing, occur twice, or mix units.
        """
        units: dict[str, str] = {}
        rest: list[str] = []
        for column in header:
            plain = column.lower()
            base, unit = (plain, None) if plain in _PLAIN else _split_column_unit(plain)
            if base is None:
                rest.append(column)
                continue
            if base in self.names:
                raise self.source.build_error(
                    f"columns {self.names[base]!r} and {column!r} mean the same; expected one", self.header_line
                )
            self.names[base] = column
            if unit:
                units.setdefault(unit, column)
        for column in self._take_attitude_columns(rest):
            self._note_unknown_column(column, header)
        missing = [f"{c}_mm" for c in _POINT if c not in self.names]
        if missing:
            raise self.source.build_error(
                f"columns {', '.join(missing)} are missing; found {', '.join(header)[:200]}", self.header_line
            )
        for group in (_AXIS, _REFERENCE):
            have = [c for c in group if c in self.names]
            if have and len(have) < len(group):
                lacking = ", ".join(c for c in group if c not in self.names)
                raise self.source.build_error(
                    f"column {lacking} is missing; it is required with {', '.join(have)}", self.header_line
                )
        if self.attitude and "i" in self.names:
            raise self.source.build_error(
                "gives tool axes (i, j, k) and attitudes; expected one of them", self.header_line
            )
        self.unit = self._select_unit(units)

    def _select_unit(self, units: dict[str, str]) -> str:
        if len(units) == 2:
            raise self.source.build_error(
                f"columns {units['mm']!r} and {units['inch']!r} mix mm and inch; expected one unit", self.header_line
            )
        unit, requested = next(iter(units), None), self.options.unit
        if unit is None and requested is None:
            raise self.source.build_option_question(
                "unit",
                "columns x, y, z carry no unit; name them x_mm, y_mm, z_mm or give --unit mm or --unit inch",
                self.header_line,
            )
        if unit is not None and requested is not None and unit != requested:
            raise self.source.build_error(
                f"column {units[unit]!r} is in {unit} but --unit {requested} was given", self.header_line
            )
        return unit or requested or "mm"

    def _take_attitude_columns(self, rest: list[str]) -> list[str]:
        """Columns of a TCP attitude; returns the columns that are none."""
        lower = {c.lower(): c for c in rest}
        if {"rx_rad", "ry_rad", "rz_rad"} & lower.keys() or {"rx_deg", "ry_deg", "rz_deg"} & lower.keys():
            raise self.source.build_error(
                "rx, ry, rz with a unit can be a rotation vector or angles: name them rvx_rad, rvy_rad, rvz_rad or "
                "w_deg, p_deg, r_deg (fixed X, Y, Z)",
                self.header_line,
            )
        for kind, one in ORIENTATION_FORMATS.items():
            endings = ("_deg", "_rad") if one.angles else ("",)
            for ending in endings:
                wanted = [c + ending for c in one.columns]
                have = [c for c in wanted if c in lower]
                if not have:
                    continue
                if len(have) < len(wanted):
                    lacking = ", ".join(c for c in wanted if c not in lower)
                    raise self.source.build_error(
                        f"column {lacking} is missing; it is required with {', '.join(have)}", self.header_line
                    )
                if self.attitude is not None:
                    raise self.source.build_error("gives the attitude in two ways; expected one", self.header_line)
                self.attitude = kind
                self.angle_unit = math.pi / 180.0 if ending == "_deg" else 1.0
                self.names.update({f"attitude{k}": lower[c] for k, c in enumerate(wanted)})
                rest = [c for c in rest if c.lower() not in wanted]
            bare = [c for c in one.columns if c in lower]
            if one.angles and len(bare) == len(one.columns):
                raise self.source.build_error(
                    f"columns {', '.join(bare)} carry no unit; name them {bare[0]}_deg … or {bare[0]}_rad …",
                    self.header_line,
                )
        return rest

    def _note_unknown_column(self, column: str, header: list[str]) -> None:
        known = [f"{c}_mm" for c in (*_POINT, *_HOLE, "tolerance")] + [*_PLAIN, "feed_mm_min"]
        near = difflib.get_close_matches(column.lower(), [k for k in known if k not in header], 1, 0.8)
        if near:
            hint = suggest_word(column, near) or f"{near[0]!r} is a column; drop or rename it"
            raise self.source.build_error(f"unknown column {column!r}; {hint.strip()}", self.header_line)
        stops = is_point_moving_column(column)
        self.out.ignore(f"column {column}", self.header_line, understood=False, stops=stops)

    def list_number_columns(self) -> dict[str, bool]:
        return {column: name in _OPTIONAL for name, column in self.names.items() if name not in _WORDS}

    def list_word_columns(self) -> list[str]:
        return [self.names[w] for w in _WORDS if w in self.names]

    # ---- rows

    def _stack_columns(self, *names: str) -> Array:
        """(N, len(names)) of the table, printed units."""
        return np.column_stack([self.columns.numbers[self.names[n]] for n in names])

    def build(self) -> Toolpath:
        scale = UNIT_NAMES[self.unit]
        n = len(self.columns.line)
        table = np.full((n, 7), np.nan)
        table[:, :3] = self._stack_columns(*_POINT) * scale
        table[:, 3:6] = (0.0, 0.0, 1.0)
        reference = None
        if "i" in self.names:
            table[:, 3:6] = self._stack_columns(*_AXIS)
        if self.attitude is not None:
            R = self._compute_attitudes()
            column, sign = TOOL_AXES[self.options.tool_axis]
            table[:, 3:6], reference = sign * R[:, :, column], R[:, :, find_reference_column(column)].copy()
        if "rx" in self.names:
            reference = self._normalise_directions(self._stack_columns(*_REFERENCE))
        normal = (
            self._normalise_directions(self._stack_columns(*_NORMAL), "surface normal", _NORMAL)
            if "nx" in self.names
            else None
        )
        if "feed" in self.names:
            table[:, 6] = self._read_positive_column("feed", zero_allowed=True) * scale
        tolerance = (
            self._read_positive_column("tolerance", zero_allowed=False) * scale if "tolerance" in self.names else None
        )
        move = self._read_moves()
        table[(move == MoveKind.RAPID) | ((table[:, 6] == 0.0) & (move != MoveKind.CUT)), 6] = np.nan
        self.out.meta["unit"] = self.unit
        labels, tools = self._list_operations()
        starts = [k for k, _ in labels] or [0]
        if self.options.default_feed is None:
            self._fill_empty_feeds(table[:, 6], move == MoveKind.CUT, np.array(starts))
        is_hole = find_hole_rows(self, move)
        if not is_hole.any():
            for first, name in self._list_offsets(n):
                self.out.count_from(name, first)
            self.out.add_table(table, move, self.columns.line, labels, tools)
            path = self.out.build(reference=reference, tolerance_mm=tolerance)
            refuse_possible_holes(self, table, starts)
            return replace(path, surface_normal=normal)
        return self._build_with_holes(
            _TableRows(
                table=table, move=move, is_hole=is_hole, reference=reference, tolerance=tolerance, normal=normal
            ),
            labels,
            tools,
        )

    def _build_with_holes(self, points: _TableRows, labels: list[tuple[int, str]], tools: dict[int, str]) -> Toolpath:
        """Return the toolpath of a table some of whose rows are holes, each expanded to its moves."""
        table, move, is_hole = points.table, points.move, points.is_hole
        reference, tolerance, normal = points.reference, points.tolerance, points.normal
        scale, n = UNIT_NAMES[self.unit], len(table)
        depth, approach = (read_hole_lengths(self, name, is_hole) * scale for name in _HOLE)
        refuse_ways_through_material(self, table, is_hole, move, depth + approach)
        rows = expand_hole_moves(is_hole, move, depth, approach)
        first_of = np.searchsorted(rows.source, np.arange(n))  # of each row of the table
        for first, name in self._list_offsets(n):
            self.out.count_from(name, int(first_of[first]))
        found = table[rows.source]
        unit = found[:, 3:6] / np.maximum(np.linalg.norm(found[:, 3:6], axis=1), 1e-12)[:, None]
        found[:, :3] += rows.offset[:, None] * unit
        found[rows.is_hole & (rows.move != MoveKind.CUT), 6] = np.nan
        self.out.meta["holes"] = str(int(is_hole.sum()))
        self.out.add_table(
            found,
            rows.move,
            self.columns.line[rows.source],
            [(int(first_of[k]), label) for k, label in labels],
            {int(first_of[k]): tool for k, tool in tools.items()},
            from_cycle=rows.is_hole,
        )
        for k in np.flatnonzero(rows.is_hole & (rows.move == MoveKind.CUT)).tolist():
            self.out.state_hole_depth(float(depth[rows.source[k]]), point=k)
        path = self.out.build(
            reference=None if reference is None else reference[rows.source],
            tolerance_mm=None if tolerance is None else tolerance[rows.source],
        )
        return replace(path, surface_normal=None if normal is None else normal[rows.source])

    def _compute_attitudes(self) -> Array:
        assert self.attitude is not None
        one = ORIENTATION_FORMATS[self.attitude]
        values = self._stack_columns(*(f"attitude{k}" for k in range(len(one.columns)))) * self.angle_unit
        if not one.angles:
            off = np.abs(np.linalg.norm(values, axis=1) - 1.0) > UNIT_QUATERNION
            if off.any():
                raise self.error("the quaternion is not of unit length", int(np.argmax(off)), ", ".join(one.columns))
        self.out.used_options.add("--tool-axis")
        self.out.meta["attitude"] = f"{one.words}; tool axis {self.options.tool_axis}"
        return compute_rotations(self.attitude, values)

    def _read_positive_column(self, name: str, *, zero_allowed: bool) -> Array:
        values = self._stack_columns(name)[:, 0]
        bad = values < 0.0 if zero_allowed else values <= 0.0
        if bad.any():
            at = int(np.argmax(bad))
            wanted = "expected zero or more" if zero_allowed else "is not above zero"
            raise self.error(
                f"{name} {values[at]:g}; {wanted}" if zero_allowed else f"the {name} {wanted}", at, self.names[name]
            )
        return values

    def _fill_empty_feeds(self, feed: Array, cut: NDArray[np.bool_], starts: NDArray[np.int64]) -> None:
        """An empty feed of a cut is that of the cut before, within its operation; ``feed`` (N,) is filled in place."""
        rows = np.arange(len(feed))
        last = np.maximum.accumulate(np.where(cut & ~np.isnan(feed), rows, -1))
        empty = cut & np.isnan(feed) & (last >= starts[np.searchsorted(starts, rows, side="right") - 1])
        feed[empty] = feed[last[empty]]
        if empty.any():
            at = int(self.columns.line[np.argmax(empty)])
            self.out.warn_once(
                f"{empty.sum()} cuts with an empty feed have that of the cut before, the first in line {at}"
            )

    def _read_moves(self) -> NDArray[np.int32]:
        n = len(self.columns.line)
        if "move" not in self.names:
            return np.full(n, int(MoveKind.CUT), dtype=np.int32)
        words = self.columns.words[self.names["move"]]
        codes: list[int] = []
        for k, name in enumerate(words.names):
            found = _MOVES.get(name.lower()) if name else MoveKind.CUT
            if found is None:
                at = int(np.argmax(words.codes == k))
                raise self.error(f"move {name!r}; expected one of {', '.join(_MOVES)}", at, "move")
            codes.append(int(found))
        return np.array(codes, dtype=np.int32)[words.codes]

    def _list_operations(self) -> tuple[list[tuple[int, str]], dict[int, str]]:
        """First row and label of each operation, and its tool, which holds until another one is named."""
        n = len(self.columns.line)
        tool, names = self.read_tools(n)
        if "operation" not in self.names:
            starts = np.concatenate([[0], np.flatnonzero(np.diff(tool)) + 1]).tolist() if names else []
            several = len(starts) > 1
            labels = [(k, f"T{names[tool[k]]}" if several and names[tool[k]] else "main") for k in starts]
        else:
            words = self.columns.words[self.names["operation"]]
            new = (np.diff(words.codes) != 0) | (np.diff(tool) != 0)
            starts = np.concatenate([[0], np.flatnonzero(new) + 1]).tolist()
            labels = [(k, words.names[words.codes[k]]) for k in starts]
        return labels, {k: names[tool[k]] for k in starts if names}

    def _list_offsets(self, n: int) -> list[tuple[int, str]]:
        """Rows from which another work offset counts, with its name; rows before the first count in the workpiece."""
        if "offset" not in self.names:
            return []
        words, rows = self.read_modal_column("offset", n)
        at = np.where(rows < 0, -1, words.codes[np.maximum(rows, 0)])
        starts = np.flatnonzero(np.diff(at, prepend=-1))
        return [(int(k), normalise_offset_name(words.names[at[k]])) for k in starts if at[k] >= 0]

    def read_modal_column(self, name: str, n: int) -> tuple[WordColumn, NDArray[np.int64]]:
        """Return the words of a column and the row whose word is valid at each row; empty fields repeat the row before.

        Args:
            name: Name of the column.
            n: Number of rows.
        """
        words = self.columns.words[self.names[name]]
        empty = np.array([not one.strip() for one in words.names])[words.codes]
        return words, np.maximum.accumulate(np.where(empty, -1, np.arange(n)))

    def read_tools(self, n: int) -> tuple[NDArray[np.int64], list[str]]:
        """Return the tool of each row; an empty field means the tool of the row before, in the first rows none.

        Args:
            n: Number of rows.

        Returns:
            Index (N,) into the names, and the names.
        """
        if "tool" not in self.names:
            return np.zeros(n, np.int64), []
        words, rows = self.read_modal_column("tool", n)
        codes = words.codes[np.where(rows < 0, np.arange(n), rows)]  # the first tool that is named is not on before
        return np.asarray(codes, np.int64), [name.strip() for name in words.names]

    def _normalise_directions(
        self, r: Array, what: str = "reference direction", names: tuple[str, ...] = _REFERENCE
    ) -> Array:
        given = ~np.isnan(r).any(axis=1)
        length = np.linalg.norm(np.nan_to_num(r), axis=1)
        bad = (given & (length < 1e-6)) | (np.isnan(r).any(axis=1) & ~np.isnan(r).all(axis=1))
        if bad.any():
            raise self.error(f"the {what} is zero or incomplete", int(np.argmax(bad)), ", ".join(names))
        return np.asarray(r / np.where(given, length, 1.0)[:, None])

    def error(self, message: str, row: int, column: str) -> InputError:
        """Build the error of a field.

        Args:
            message: What is wrong, and what would be accepted.
            row: Row of the table (0-based).
            column: Name of the column.
        """
        return self.source.build_error(message, int(self.columns.line[row]), column)


def _split_column_unit(column: str) -> tuple[str | None, str | None]:
    for base in (*_POINT, *_HOLE, "tolerance"):
        for ending, unit in _UNIT_ENDINGS.items():
            if column == base + ending:
                return base, unit
    for ending, unit in (("_mm_min", "mm"), ("_inch_min", "inch"), ("_in_min", "inch"), ("", None)):
        if column == "feed" + ending:
            return "feed", unit
    return None, None
