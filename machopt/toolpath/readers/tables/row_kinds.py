"""Row kinds of a point table, path points or holes, from its ``kind`` column, the option, or the points."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind
from machopt.errors import InputError
from machopt.file_formats.csv_columns import CsvColumns, WordColumn
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.toolpath.readers.tables.hole_rows import find_possible_holes

KIND_HELP = (
    "give a column kind or --kind holes|path. path: the tool cuts from row to row. holes: each row is the bottom of "
    "one hole, with the columns depth_mm (from the surface to the row, along the axis) and approach_mm (above the "
    "surface, where the feed starts)"
)
_KINDS = ("path", "holes")


class RowTable(Protocol):
    """What is needed of a table that was read."""

    @property
    def source(self) -> SourceFile: ...
    @property
    def options(self) -> ReadOptions: ...
    @property
    def header_line(self) -> int: ...
    @property
    def names(self) -> dict[str, str]: ...  # quantity → column
    @property
    def columns(self) -> CsvColumns: ...

    def read_modal_column(self, name: str, n: int) -> tuple[WordColumn, NDArray[np.int64]]:
        """Return the words of a column and the row whose word is valid at each row.

        Args:
            name: Name of the column.
            n: Number of rows.

        Returns:
            The words, and the row index (N,) of the valid word.
        """
        ...

    def read_tools(self, n: int) -> tuple[NDArray[np.int64], list[str]]:
        """Return the tool of each row.

        Args:
            n: Number of rows.

        Returns:
            Index (N,) into the names, and the names.
        """
        ...

    def error(self, message: str, row: int, column: str) -> InputError:
        """Build the error of one cell.

        Args:
            message: Description of the error.
            row: Index of the row.
            column: Name of the column.

        Returns:
            The error, not raised.
        """
        ...


def find_hole_rows(table: RowTable, move: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Find the rows that are holes; none where nothing defines it, see :func:`refuse_possible_holes`.

    Args:
        table: its columns and options.
        move: (N,) Move codes.

    Raises:
        InputError: an unknown word, or an option that the table contradicts.
    """
    names, requested, n = table.names, table.options.kind, len(move)
    if "kind" in names:
        if requested is not None:
            raise table.source.build_error(
                f"--kind {requested} has no effect: the table has a column kind", table.header_line
            )
        is_hole = _read_kind_column(table, n)
    elif "move" in names:
        if requested is not None:
            raise table.source.build_error(
                f"--kind {requested} has no effect: the table has a column move, which says how the tool moves",
                table.header_line,
            )
        return np.zeros(n, bool)
    else:
        is_hole = np.full(n, requested == "holes")
    wrong = is_hole & (move != MoveKind.CUT)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise table.error("the row is a hole and has a move of another kind than cut", at, names.get("move", "move"))
    return is_hole


def refuse_possible_holes(table: RowTable, numbers: Array, starts: list[int]) -> None:
    """Require the row kind of a table whose rows could be holes, after all other errors.

    Args:
        table: its columns and options.
        numbers: (N, 7) x y z i j k feed (mm, mm/min).
        starts: first row of each operation.

    Raises:
        InputError: names the column and the option.
    """
    if table.options.kind is not None or {"kind", "move"} & table.names.keys():
        return
    at = find_possible_holes(numbers[:, :3], numbers[:, 3:6], numbers[:, 6], starts)
    if at is None and {"depth", "approach"} & table.names.keys():
        at = 0  # only holes have them
    if at is not None:
        raise table.source.build_error(
            f"has no column move or kind, and the rows from here on could be holes: {KIND_HELP}",
            int(table.columns.line[at]),
        )


def _read_kind_column(table: RowTable, n: int) -> NDArray[np.bool_]:
    words, rows = table.read_modal_column("kind", n)
    kinds = [w.strip().lower() for w in words.names]
    strange = np.array([bool(k) and k not in _KINDS for k in kinds])[words.codes]
    if strange.any():
        at = int(np.argmax(strange))
        raise table.error(f"kind {words.names[words.codes[at]]!r}; expected path or holes", at, table.names["kind"])
    if rows[0] < 0:
        raise table.error("the kind of the first row is empty; expected path or holes", 0, table.names["kind"])
    return np.array([k == "holes" for k in kinds])[words.codes[rows]]


def read_hole_lengths(table: RowTable, name: str, is_hole: NDArray[np.bool_]) -> Array:
    """Read the depth or approach of the holes.

    Args:
        table: The rows.
        name: Name of the column.
        is_hole: Whether each row is a hole (N,).

    Returns:
        Lengths (N,), unit of the table.

    Raises:
        InputError: the column is missing, or a length of a hole is empty or not positive.
    """
    if name not in table.names:
        raise table.source.build_error(
            f"column {name}_mm is missing: holes need depth_mm (surface to row, along the axis) and approach_mm (above "
            "the surface, where the feed starts)",
            table.header_line,
        )
    values = table.columns.numbers[table.names[name]]
    bad = is_hole & ~(values > 0.0)
    if bad.any():
        at = int(np.argmax(bad))
        found = "is empty" if np.isnan(values[at]) else f"is {values[at]:g}"
        raise table.error(f"the {name} of a hole {found}; expected a length above zero", at, table.names[name])
    return np.asarray(values)


def refuse_ways_through_material(
    table: RowTable, numbers: Array, is_hole: NDArray[np.bool_], move: NDArray[np.int32], clear: Array
) -> None:
    """Refuse straight ways between holes and a path that would lead through the material.

    A path that begins after a hole is not cut to from there: its first row is a rapid, approach or link move. A hole
    after a cut row begins above it: the cut row lies at the height where the feed of the hole starts, or higher. A
    change of tool lifts the tool by itself.

    Args:
        table: its columns and options.
        numbers: (N, 7) x y z i j k feed (mm, mm/min).
        is_hole: (N,) rows that are the bottom of a hole.
        move: (N,) Move codes.
        clear: (N,) mm from a hole's row to where its feed starts.

    Raises:
        InputError: such a row.
    """
    cut = ~is_hole & (move == MoveKind.CUT)
    entered = np.flatnonzero(cut[1:] & is_hole[:-1]) + 1
    tool = table.read_tools(len(move))[0]
    for at in (np.flatnonzero(is_hole[1:] & cut[:-1] & (tool[1:] == tool[:-1])) + 1).tolist():
        axis = numbers[at, 3:6] / max(float(np.linalg.norm(numbers[at, 3:6])), 1e-12)
        if float((numbers[at - 1, :3] - numbers[at, :3]) @ axis) < clear[at] - 1e-9:
            if len(entered) and entered[0] < at:
                break
            raise table.error(
                "a hole follows a cut row that lies below the height where the feed of the hole starts: the rapid to "
                "it would lead through the material. Expected a row with move retract or rapid before it",
                at,
                table.names.get("kind", "kind"),
            )
    if len(entered):
        at = int(entered[0])
        raise table.error(
            "a path begins here after a hole, and the row cuts: the tool would cut straight from the hole to it. "
            "Expected a row with move rapid, approach or link before it (column move)",
            at,
            table.names.get("move", "move"),
        )
