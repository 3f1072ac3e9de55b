"""Several setups in one job: work offsets of the cell, their bodies, and paths that change them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell
from test_cell_format import change, expect, folder, refusal  # noqa: F401 the fixture

from machopt.cell.cell_reader import load_cell
from machopt.cell.work_offsets import place_toolpath
from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

HEAD = "x_mm,y_mm,z_mm,i,j,k,rx,ry,rz,move,feed_mm_min,offset\n"
G55 = np.array([[1, 0, 0, 0.1], [0, 0, -1, 0.2], [0, 1, 0, 0.0], [0, 0, 0, 1.0]])  # 90° about x


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    shifted = np.eye(4)
    shifted[:3, 3] = 0.0, -0.1, 0.0
    return replace(small_cell(tmp_path), offsets={"G54": shifted, "G55": G55})


def read(tmp_path: Path, text: str, cell: Cell, name: str = "path.csv") -> Toolpath:
    (tmp_path / name).write_text(text)
    return place_toolpath(read_toolpath(tmp_path / name, cell_offsets=tuple(cell.offsets)), cell)


def test_column_of_offsets_is_modal_and_rotates_axes(tmp_path: Path, cell: Cell) -> None:
    rows = ["0,0,50,0,0,1,1,0,0,rapid,,", "0,0,5,0,0,1,1,0,0,rapid,,g54", "10,0,0,0,0,1,1,0,0,cut,600,"]
    rows += ["10,0,50,0,0,1,1,0,0,rapid,,G55", "10,5,0,0,0,1,0,1,0,cut,600,", "20,5,0,0,0,1,0,1,0,cut,600,"]
    path = read(tmp_path, HEAD + "\n".join(rows) + "\n", cell)
    np.testing.assert_allclose(path.position[:3], [[0, 0, 0.05], [0, -0.1, 0.005], [0.01, -0.1, 0]])
    np.testing.assert_allclose(path.position[3:], [[0.11, 0.15, 0], [0.11, 0.2, 0.005], [0.12, 0.2, 0.005]], atol=1e-15)
    np.testing.assert_allclose(path.axis[[2, 4]], [[0, 0, 1], [0, -1, 0]])
    np.testing.assert_allclose(path.reference[[2, 4]], [[1, 0, 0], [0, 0, 1]])
    assert path.offsets == ()
    assert path.meta["work_offsets"] == "G54, G55"
    assert place_toolpath(path, cell) is path
    message = "no work offset: they count in workpiece, not in one of the cell's (G54, G55)"
    assert path.warnings[-1] == f"points 0 to 0 name {message}"
    bare = read(tmp_path, HEAD.replace(",offset", "") + "0,0,0,0,0,1,1,0,0,cut,600\n5,0,0,0,0,1,1,0,0,cut,600\n", cell)
    assert bare.warnings[-1] == f"all points name {message}"
    assert place_toolpath(bare, cell) is bare


def test_offsets_of_g_code_are_those_of_the_cell(tmp_path: Path, cell: Cell) -> None:
    first = "G21 G90 G17\nG54\nT1 M6\nG0 X0 Y0\nG0 Z5\nG1 Z0 F600\nG1 X10\nG0 Z50\n"
    code = f"{first}G55\nG0 X10 Y0\nZ5\nG1 Z-1 F300\nX20\nG0 Z50\nM30\n"
    path = read(tmp_path, code, cell, "part.nc")
    cut = path.position[path.move == MoveKind.CUT]
    np.testing.assert_allclose(cut[:2], [[0, -0.1, 0], [0.01, -0.1, 0]], atol=1e-15)
    np.testing.assert_allclose(cut[2:], [[0.11, 0.201, 0], [0.12, 0.201, 0]], atol=1e-15)
    np.testing.assert_allclose(path.axis[-1], [0, -1, 0])
    with pytest.raises(InputError, match=r"line 9.*G56 is not in the cell's offsets.*G54.*G55"):
        read(tmp_path, code.replace("G55", "G56"), cell, "part.nc")
    with pytest.raises(InputError, match=r"points before G55 name no work offset"):
        read(tmp_path, code.replace("G54\n", ""), cell, "part.nc")
    with pytest.raises(InputError, match="the cell defines the work offsets"):
        read_toolpath(tmp_path / "part.nc", cell_offsets=("G54",), offsets=("G55=1,2,3",))


def test_unknown_offset_and_a_change_within_a_cut_are_refused(tmp_path: Path, cell: Cell) -> None:
    rows = ["0,0,5,0,0,1,1,0,0,rapid,,G54", "10,0,0,0,0,1,1,0,0,cut,600,", "20,0,0,0,0,1,1,0,0,cut,600,FIXTURE_B"]
    with pytest.raises(InputError, match=r"work offset 'FIXTURE_B' is not in the cell's offsets.*G54.*G55"):
        read(tmp_path, HEAD + "\n".join(rows) + "\n", cell)
    with pytest.raises(InputError, match=r"work offset 'G54' is not in the cell's offsets, which has none"):
        read(tmp_path, HEAD + "\n".join(rows) + "\n", replace(cell, offsets={}))
    rows[2] = rows[2].replace("FIXTURE_B", "G55")
    with pytest.raises(InputError, match=r"cuts from point 1 to point 2, and the work offset changes to G55"):
        read(tmp_path, HEAD + "\n".join(rows) + "\n", cell)


def test_bodies_of_an_offset_are_in_its_frame(folder: Path) -> None:  # noqa: F811
    before = load_cell(folder)
    change(
        folder,
        (
            "obstacles:",
            "offsets:\n  g54: {}\n  FIXTURE_B:\n    pose: {xyz_mm: [300, 0, 0], rpy_deg: [0, 0, 90]}\n"
            "    geometry: [{box_mm: [50, 50, 20], xyz_mm: [10, 0, -10]}]\n"
            "    fixtures: [{name: vice, box_mm: [90, 90, 40], xyz_mm: [0, 0, -40]}]\nobstacles:",
        ),
    )
    cell = load_cell(folder)
    assert list(cell.offsets) == ["G54", "FIXTURE_B"]
    np.testing.assert_array_equal(cell.offsets["G54"], np.eye(4))
    part, vice = cell.workpiece.geometry[-1], cell.obstacles[-1]
    assert (part.name, vice.name, vice.link) == ("FIXTURE_B_part_0", "vice", cell.workpiece.link)
    np.testing.assert_allclose(part.T_parent_shape[:3, 3], [0.3, 0.01, -0.01], atol=1e-12)
    T = cell.workpiece.T_link_workpiece @ cell.offsets["FIXTURE_B"]
    np.testing.assert_allclose(vice.T_parent_shape[:3, 3], (T @ [0, 0, -0.04, 1])[:3], atol=1e-12)
    assert len(cell.workpiece.geometry) == len(before.workpiece.geometry) + 1
    text = (folder / "cell.yaml").read_text()
    (folder / "cell.yaml").write_text(text.replace("fixtures:", "fixture:"))
    expect(refusal(folder), "offsets.FIXTURE_B.fixture")
