"""Headerless lists of x, y, z in mm and w, p, r in degrees, as RoboDK writes them."""

from __future__ import annotations

import numpy as np

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.file_formats.csv_columns import iterate_data_lines, parse_number_cell, split_cells
from machopt.file_formats.source_file import TOOL_AXES, ReadOptions, SourceFile
from machopt.path_building.point_collector import PathBuilder
from machopt.toolpath.readers.tables.hole_rows import find_possible_holes
from machopt.toolpath.readers.tables.orientation_columns import compute_rotations
from machopt.toolpath.readers.tables.row_kinds import KIND_HELP

_WIDTHS = (6, 7)  # columns: x, y, z, w, p, r and maybe a running number


def read_xyzwpr(source: SourceFile, options: ReadOptions) -> Toolpath:
    """Read a headerless list of x, y, z in mm and w, p, r in degrees.

    R = Rz(r) Ry(p) Rx(w), about fixed X, Y, Z, is the orientation of the TCP. Every row is a cut at the given feed.

    Args:
        source: Lines of the file, with its path and the builders of its errors.
        options: Reading options of the user (unit, feed, tolerances, accepted words).

    Returns:
        The toolpath in the coordinate system ``workpiece``, SI units.

    Raises:
        InputError: see :func:`machopt.toolpath.toolpath_reader.read_toolpath`.
    """
    rows = [(line, split_cells(text)) for line, text in iterate_data_lines(source)]
    first, width = rows[0][0], len(rows[0][1])
    if width not in _WIDTHS:
        raise source.build_error(
            f"rows of {width} numbers without a header; expected a header with x_mm, y_mm, z_mm, or six or seven "
            "numbers x, y, z, w, p, r (mm, degrees)",
            first,
        )
    if options.unit == "inch":
        raise source.build_error("a list of x, y, z, w, p, r is in mm but --unit inch was given")
    table = np.empty((len(rows), width))
    for k, (line, row) in enumerate(rows):
        if len(row) != width:
            raise source.build_error(f"{len(row)} columns; expected {width}", line)
        table[k] = [parse_number_cell(source, str(c + 1), cell, line, False) for c, cell in enumerate(row)]
    if np.abs(np.linalg.norm(table[:, 3:6], axis=1) - 1.0).max() < 1e-3:
        raise source.build_error(
            "no header, and columns 4 to 6 have length 1 in every row: a tool axis i, j, k rather than angles w, p, r; "
            "write a header (x_mm,y_mm,z_mm,i,j,k)",
            first,
        )
    R = compute_rotations("wpr", np.radians(table[:, 3:6]))
    out = PathBuilder(source=source, options=options, format="csv/xyzwpr")
    column, sign = TOOL_AXES[options.tool_axis]
    out.meta.update(unit="mm", attitude=f"R = Rz(r) Ry(p) Rx(w), degrees; tool axis {options.tool_axis}")
    out.used_options.update(("--feed", "--tool-axis"))
    out.warn("no header: rows are read as x, y, z (mm), w, p, r (degrees about fixed X, Y, Z), all of them cuts")
    if width == 7:
        out.ignore("column 7 (running number)", first, understood=True)
    if options.default_feed is None:
        raise source.build_option_question(
            "feed", "a list of x, y, z, w, p, r has no feeds; give one with --feed", first
        )
    numbers = np.column_stack([table[:, :3], sign * R[:, :, column], np.full(len(rows), options.default_feed * 60e3)])
    if options.kind == "holes":
        raise source.build_error("a list without a header has no depth_mm and approach_mm, which holes need", first)
    move = np.full(len(rows), int(MoveKind.CUT), dtype=np.int32)
    out.add_table(numbers, move, np.array([line for line, _ in rows], dtype=np.int32), [])
    path = out.build(reference=R[:, :, find_reference_column(column)].copy())
    if options.kind is None and find_possible_holes(numbers[:, :3], numbers[:, 3:6], numbers[:, 6], [0]) is not None:
        raise source.build_error(f"does not state what its rows are, and they could be holes: {KIND_HELP}", first)
    return path


def find_reference_column(column: int) -> int:
    """Return the column of the tool frame that gives the reference direction: x, or y where x is the tool axis.

    Args:
        column: Column of the tool axis.

    Returns:
        Index of the column.
    """
    return 0 if column != 0 else 1
