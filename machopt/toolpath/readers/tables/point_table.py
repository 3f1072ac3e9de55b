"""Reader of point tables: CSV and Parquet with named columns, robot poses (no header: ``xyzwpr_list.py``)."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from machopt.data_types.toolpath import Toolpath
from machopt.file_formats import parquet_tables
from machopt.file_formats.csv_columns import (
    CsvColumns,
    WordColumn,
    is_number,
    iterate_data_lines,
    parse_number_cell,
    read_columns,
    split_cells,
)
from machopt.file_formats.source_file import ReadOptions, SourceFile
from machopt.numerics.array_types import Array
from machopt.toolpath.readers.tables.point_table_columns import PointTable
from machopt.toolpath.readers.tables.table_layout import convert_layout, find_layout
from machopt.toolpath.readers.tables.xyzwpr_list import read_xyzwpr


def is_point_table(source: SourceFile) -> bool:
    """Return whether the file has a header with x, y, z or begins with a row of plain numbers.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
    """
    return find_layout(source) is not None


def read_csv(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a CSV point table; row k is point k.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    layout = find_layout(source)
    notes: list[tuple[str, int]] = []
    if layout is not None:
        source, notes = convert_layout(source, layout)
    data = iterate_data_lines(source)
    line, text = next(data, (0, ""))
    if not text:
        raise source.build_error("holds no rows; expected a header line and one row a point")
    header = [c.strip() for c in split_cells(text)]
    if all(map(is_number, header)):
        return read_xyzwpr(source, options)
    if next(data, None) is None:
        raise source.build_error("holds a header but no rows; expected one row a point", line)
    if len(set(header)) != len(header):
        twice = next(n for k, n in enumerate(header) if n in header[:k])
        raise source.build_error(f"column {twice!r} is given twice in the header", line)
    table = PointTable(source, options, line, "csv")
    for note, at in notes:
        table.out.warn(note, at)
    table.sort_columns(header)
    table.columns = read_columns(source, header, table.list_number_columns(), table.list_word_columns())
    if not source.complete and len(table.columns.line) > 1:
        table.out.warn("the last line does not end: its last number may be cut off", int(table.columns.line[-1]))
    return table.build()


def read_parquet(path: Path, data: bytes, options: ReadOptions) -> Toolpath:
    """Read a Parquet point table with the same columns as CSV; ``line`` is the 1-based row.

    Args:
        path: Path of the file.
        data: Content of the file.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: pyarrow is not installed, the file is damaged, or as for CSV.
    """
    with parquet_tables.open_parquet(path) as pyarrow:
        found = pyarrow.parquet.read_table(pyarrow.BufferReader(data))
    source = SourceFile(path, [], hashlib.sha256(data).hexdigest(), True)
    if not found.num_rows:
        raise source.build_error("holds no rows; expected one row a point")
    table = PointTable(source, options, 1, "parquet")
    table.sort_columns(list(found.column_names))
    lines = list(range(1, found.num_rows + 1))
    numbers: dict[str, Array] = {}
    for name, empty_allowed in table.list_number_columns().items():
        cells = ["" if v is None else str(v) for v in found.column(name).to_pylist()]
        numbers[name] = np.array(
            [parse_number_cell(source, name, c, n, empty_allowed) for c, n in zip(cells, lines, strict=True)]
        )
    words: dict[str, WordColumn] = {}
    for name in table.list_word_columns():
        words[name] = WordColumn()
        cells = ["" if v is None else str(v) for v in found.column(name).to_pylist()]
        words[name].codes = np.array(words[name].encode(cells), dtype=np.int32)
    table.columns = CsvColumns(numbers, words, np.array(lines, dtype=np.int32))
    return table.build()
