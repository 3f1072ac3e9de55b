"""Separators, title lines and mixed rows in point tables are read if unambiguous, else refused with the line."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from machopt.data_types.toolpath import Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

ROWS = (("x_mm", "y_mm", "z_mm", "move"), ("1.5", "2", "3", "rapid"), ("4", "5", "6", "cut"))
TITLES = ("", "Pocket of part 5\n", "Pocket, op 10, face 3\n\n", "# a comment\nPart 7\nOperator: N. N.\n")


def read(folder: Path, text: str) -> Toolpath:
    file = folder / "points.csv"
    file.write_text(text, encoding="utf-8")
    return read_toolpath(file, default_feed=0.01)


@pytest.mark.parametrize(("separator", "title", "end"), list(itertools.product(",;\t", TITLES, ("\n", "\r\n"))))
def test_unambiguous_layouts_are_read(separator: str, title: str, end: str, tmp_path: Path) -> None:
    text = title.replace("\n", end) + "".join(separator.join(row) + end for row in ROWS)
    path = read(tmp_path, text)
    assert np.allclose(path.position * 1e3, [(1.5, 2, 3), (4, 5, 6)])
    assert path.line.tolist() == [n for n, row in enumerate(text.splitlines(), 1) if row.startswith(("1.5", "4"))]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_quoted_separator_belongs_to_its_cell(separator: str, tmp_path: Path) -> None:
    rows = [
        ("x_mm", "y_mm", "z_mm", "operation"),
        ("1", "2", "3", f'"a{separator}b"'),
        ("4", "5", "6", f'"a{separator}b"'),
    ]
    file = tmp_path / "points.csv"
    file.write_text("".join(separator.join(row) + "\n" for row in rows), encoding="utf-8")
    path = read_toolpath(file, default_feed=0.01, kind="path")
    assert [o.label for o in path.operations] == [f"a{separator}b".replace("\t", " ")]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("x_mm;y_mm;z_mm\n1;2;3\n1,5;2;3\n", 3),
        ("x_mm\ty_mm\tz_mm\n1,5\t2\t3\n", 2),
        ("Title\nx_mm;y_mm;z_mm\n1;2;3,0\n", 3),
        ("x_mm y_mm z_mm\n1 2 3\n", 1),
        ("Title\nx_mm   y_mm   z_mm\n1 2 3\n", 2),
        ("| x_mm | y_mm | z_mm |\n| 1 | 2 | 3 |\n", 1),
        ("x_mm,y_mm,z_mm,move\nmm,mm,mm,-\n1,2,3,cut\n", 2),
        ("x_mm;y_mm;z_mm;move\n1;2;3\n", 2),
    ],
)
def test_ambiguous_layout_is_refused_with_its_line(text: str, line: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"line {line}[:,]"):
        read(tmp_path, text)


HEADER = "x_mm,y_mm,z_mm,kind,depth_mm,approach_mm,move,feed_mm_min\n"
HOLE, PATH = "10,10,-5,holes,5,3,,100\n", "50,40,-3,path,,,,200\n"


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        (HOLE + PATH, 3),
        (HOLE + HOLE + PATH, 4),
        (HOLE + "40,40,-3,path,,,cut,200\n" + PATH, 3),
        (PATH + HOLE, 3),
        (PATH + PATH + HOLE + PATH, 4),
        ("50,40,2.9,path,,,,200\n" + HOLE, 3),
        (HOLE + "40,40,-3,path,,,rapid,\n" + PATH + HOLE, 5),
    ],
)
def test_straight_move_through_the_material_is_refused(rows: str, line: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"line {line}[:,]"):
        read(tmp_path, HEADER + rows)


@pytest.mark.parametrize(
    ("rows", "points"),
    [
        (HOLE + "40,40,20,path,,,rapid,\n" + PATH, 5),
        (HOLE + "40,40,20,path,,,approach,\n" + PATH, 5),
        (HOLE + "40,40,20,path,,,link,\n" + PATH, 5),
        (PATH + "50,40,9,,,,retract,\n" + HOLE, 5),
        (PATH + "50,40,9,,,,rapid,\n" + HOLE, 5),
        ("50,40,3,path,,,,200\n" + HOLE, 4),
        (HOLE + HOLE.replace("10,10", "30,10"), 6),
    ],
)
def test_rows_of_two_kinds_with_a_move_between_them(rows: str, points: int, tmp_path: Path) -> None:
    assert len(read(tmp_path, HEADER + rows)) == points


def test_table_without_move_column_has_no_move_between_kinds(tmp_path: Path) -> None:
    text = "x_mm,y_mm,z_mm,kind,depth_mm,approach_mm,feed_mm_min\n10,10,-5,holes,5,3,100\n40,40,-3,path,,,200\n"
    with pytest.raises(InputError, match="column move"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "header", ["x_mm,\ty_mm,\tz_mm,i,j,k,feed_mm_min", 'x_mm,y_mm,z_mm,i,j,k,feed_mm_min,"note; x"']
)
def test_comma_separates_where_it_gives_the_header(tmp_path: Path, header: str) -> None:
    file = tmp_path / "path.csv"
    more = "," if "note" in header else ""
    file.write_text(f"{header}\n1,2,3,0,0,1,600{more}\n4,5,6,0,0,1,600{more}\n", encoding="utf-8")
    np.testing.assert_allclose(1e3 * read_toolpath(file, kind="path").position[-1], [4, 5, 6])
