"""Tool table of a cell: read, selected by the words of the CAM file, exported and verified."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import small_cell
from test_cell_format import change, expect, folder, refusal  # noqa: F401 the fixture
from test_verify_trajectory import build_correct_columns, toolpath, verify_damaged

from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import match_operation_tools, match_tool, select_single_tool
from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath, ToolpathOperation
from machopt.errors import InputError
from machopt.toolpath.toolpath_reader import read_toolpath

TABLE = """tools:
  3:
    tcp: {xyz_mm: [10, 20, 300], rpy_deg: [0, 90, 0]}
    mass_kg: 45
    geometry: [{name: spindle, mesh: spindle.stl}]
    cutter: {diameter_mm: 10, length_mm: 40}
  BALL_D6:
    tcp: {xyz_mm: [10, 20, 320], rpy_deg: [0, 90, 0]}
    mass_kg: 44
    geometry: [{name: spindle, mesh: spindle.stl}, {name: holder, box_mm: [40, 40, 60]}]
    cutter: {diameter_mm: 6, length_mm: 30}
"""
ONE = """tool:
  tcp: {xyz_mm: [10, 20, 300], rpy_deg: [0, 90, 0]}
  mass_kg: 45
  com_mm: [0, 0, 150]
  geometry: [{name: spindle, mesh: spindle.stl}]
  cutter: {diameter_mm: 10, length_mm: 40}
"""


@pytest.fixture
def cell(folder: Path) -> Cell:  # noqa: F811
    change(folder, (ONE, TABLE))
    return load_cell(folder)


def job(*tools: str, named: str = "") -> Toolpath:
    """Return a toolpath with one operation per word."""
    one = toolpath()
    operation = np.minimum(np.arange(len(one)), len(tools) - 1).astype(np.int32)
    labels = tuple(ToolpathOperation(f"op{k}", "trajectory", t, "", named) for k, t in enumerate(tools))
    return replace(one, operation=operation, operations=labels)


def test_table_is_read(cell: Cell) -> None:
    assert list(cell.tools) == ["3", "BALL_D6"]
    assert (cell.tool_name, cell.tool) == ("3", cell.tools["3"])
    np.testing.assert_allclose(cell.tools["BALL_D6"].T_flange_tcp[2, 3], 0.32)
    assert [s.name for s in cell.tools["BALL_D6"].geometry] == ["spindle", "holder"]


def test_invalid_table_is_refused(folder: Path) -> None:  # noqa: F811
    change(folder, (ONE, ""))
    expect(refusal(folder), "found no tool; expected tool or tools")
    (folder / "cell.yaml").write_text(
        (folder / "cell.yaml").read_text() + TABLE.replace("diameter_mm: 6", "diameter_mm: -6")
    )
    expect(refusal(folder), "tools.BALL_D6.cutter.diameter_mm")


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (job("3"), "3"),
        (job("T03"), "3"),
        (job("ball_d6"), "BALL_D6"),
        (job("7", named="BALL_D6"), "BALL_D6"),  # NX: the name in TOOL PATH, then LOADTL with another number
        (job("3", "", ""), "3"),  # applies until another tool is named
    ],
)
def test_tool_is_chosen_by_the_words_of_the_file(cell: Cell, path: Toolpath, name: str) -> None:
    chosen = select_single_tool(cell, path)
    assert chosen.tool_name == name
    assert chosen.tool is cell.tools[name]
    assert set(match_operation_tools(path, cell.tools)) == {name}


def test_unchoosable_tool_is_reported(cell: Cell) -> None:
    with pytest.raises(
        InputError, match=r"operation 'op1' wants the tool '5', which the cell does not have.*3.*BALL_D6"
    ):
        select_single_tool(cell, job("3", "5"))
    with pytest.raises(InputError, match=r"operation 'op0' names no tool, and the cell has 3, BALL_D6"):
        select_single_tool(cell, job(""))
    with pytest.raises(
        InputError, match=r"wants 2 tools of the cell \(3 from operation 'op0'.*BALL_D6 from operation 'op1'"
    ):
        select_single_tool(cell, job("3", "BALL_D6"))
    alone = replace(cell, tools={"3": cell.tools["3"]})
    assert select_single_tool(alone, job("")).tool_name == "3"


def test_column_of_tools(tmp_path: Path) -> None:
    """The column is modal, with or without operations; a change of tool begins an operation."""
    rows = [(0, "a", "3"), (1, "a", ""), (2, "a", "5"), (3, "b", "")]
    for header, cells, labels in (
        ("operation,tool", [f"{o},{t}" for _, o, t in rows], [("a", "3"), ("a", "5"), ("b", "5")]),
        ("tool", [t for _, _, t in rows], [("T3", "3"), ("T5", "5")]),
        ("tool", ["3", "", "", ""], [("main", "3")]),
        ("tool", ["", "", "5", ""], [("main", ""), ("T5", "5")]),  # the first tool is not stated, so it is requested
        ("operation,tool", ["a,", "a,", "b,5", "b,"], [("a", ""), ("b", "5")]),
    ):
        file = tmp_path / "path.csv"
        text = [f"{k},0,0,0,0,1,600,{c}" for k, c in enumerate(cells)]
        file.write_text("\n".join([f"x_mm,y_mm,z_mm,i,j,k,feed_mm_min,{header}", *text]) + "\n")
        assert [(o.label, o.tool) for o in read_toolpath(file, kind="path").operations] == labels


def test_name_takes_precedence_beside_a_number(tmp_path: Path) -> None:
    file = tmp_path / "part.cls"
    file.write_text(
        "TOOL PATH/FACE,TOOL,BALL_D6\nMSYS/0,0,0,1,0,0,0,1,0\nLOADTL/7\nFEDRAT/MMPM,600\nGOTO/0,0,0,0,0,1\n"
        "GOTO/10,0,0\nEND-OF-PATH\n"
    )
    (operation,) = read_toolpath(file).operations
    assert operation.tools == ("BALL_D6", "7")


def test_exported_table_names_the_tool(cell: Cell, tmp_path: Path) -> None:
    from small_cell import small_cell

    plain = small_cell(tmp_path)
    small = replace(plain, tools={"3": plain.tool, "5": plain.tool}, tool_name="3")
    table = build_correct_columns(small)
    assert {c.name for c in verify_damaged(small, table, tmp_path).failed} == {"trajectory.csv can be read"}
    table["tool"] = ["3"] * len(table["time_s"])
    assert verify_damaged(small, table, tmp_path).ok
    table["tool"][40] = "5"
    (failed,) = verify_damaged(small, table, tmp_path).failed
    assert "data row 41, tool: '5' is not the tool '3'; the toolpath wants another" in failed.where


def test_unknown_word_is_the_number_in_the_controller(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    tools = {"MILL": replace(cell.tool, number=5), "DRILL": replace(cell.tool, number=7)}
    assert match_tool(ToolpathOperation("a", "trajectory", "5"), tools) == "MILL"
    assert match_tool(ToolpathOperation("a", "trajectory", "T07"), tools) == "DRILL"
    # a name has priority
    assert match_tool(ToolpathOperation("a", "trajectory", "5"), {"5": cell.tool, **tools}) == "5"
    both = {**tools, "MILL2": replace(cell.tool, number=5)}
    assert match_tool(ToolpathOperation("a", "trajectory", "5"), both) is None
