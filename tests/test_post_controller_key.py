"""Key ``controller`` of a cell, and a planned motion as programs."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from cells_without_controller import without_controller

from machopt.cell.cell_reader import load_cell
from machopt.errors import InputError
from machopt.programs.program_writer import read_post_text

CELLS = Path(__file__).resolve().parents[1] / "cells"
CONTROLLER = """
controller:
  post: krl
  joint_map:
    sign: [-1, 1, 1, -1, 1, -1]
    offset_deg: [0, -90, 90, 0, 0, 0]
    coupling: {j3: {j2: 1}, j6: {j4: 0.5, j5: -1}}
  root: {xyz_mm: [0, 0, 450], rpy_deg: [0, 0, 180]}
  flange: {xyz_mm: [0, 0, 10], rpy_deg: [0, 0, 0]}
  tool_number: 3
  base_number: 5
  pulses_per_deg: [1000, 1001, 1002, 1003, 1004, -1005]
  moves_per_part: 2000
  nonflip_j5: negative
  lines: {spindle_on: "SPINDLE(@{value:.0f})", coolant_off: "$OUT[4]=FALSE"}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(CELLS / "kr240_drilling", tmp_path / "cell")
    return without_controller(tmp_path / "cell")


def add(folder: Path, text: str) -> Path:
    file = folder / "cell.yaml"
    file.write_text(file.read_text(encoding="utf-8") + text, encoding="utf-8")
    return folder


def test_cell_without_controller_has_defaults(folder: Path) -> None:
    c = load_cell(folder).controller
    assert c.post is None  # no maker is assumed
    assert (c.joint_map, c.T_base_root, c.T_flange_mount, c.tool_number, c.base_number, c.nonflip_j5) == (None,) * 6
    assert c.lines == {}


def test_all_keys_are_read(folder: Path) -> None:
    c = load_cell(add(folder, CONTROLLER)).controller
    assert c.joint_map is not None
    np.testing.assert_array_equal(c.joint_map.sign, [-1, 1, 1, -1, 1, -1])
    np.testing.assert_array_equal(c.joint_map.coupling[2], [0, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(c.joint_map.coupling[5], [0, 0, 0, 0.5, -1, 0])
    q = np.radians([10.0, 20, 30, 40, 50, 60])
    # axis 3: 30 + 90, plus axis 2 of the controller (20 − 90); axis 6: −60, plus half of −40, minus 50
    np.testing.assert_allclose(c.joint_map.compute_axes_deg(q), [-10, -70, 50, -40, 50, -130])
    assert c.T_base_root is not None
    np.testing.assert_allclose(c.T_base_root, [[-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0.45], [0, 0, 0, 1]], atol=1e-15)
    assert (c.tool_number, c.base_number, c.moves_per_part, c.nonflip_j5) == (3, 5, 2000, "negative")
    assert c.lines == {"spindle_on": "SPINDLE(@{value:.0f})", "coolant_off": "$OUT[4]=FALSE"}


def test_custom_post_is_read_from_the_cell_folder(folder: Path) -> None:
    (folder / "mine.toml").write_text(read_post_text("rapid"), encoding="utf-8")
    cell = load_cell(add(folder, "controller: {post: mine.toml}\n"))
    assert cell.controller.post == str(folder / "mine.toml")
    assert folder / "mine.toml" in cell.files  # included in the hash of the inputs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("controller: {posts: krl}", "unknown key 'posts'"),
        ("controller: {joint_map: {sign: [1, 1, 1, 1, 1, 2]}}", "controller.joint_map.sign"),
        ("controller: {joint_map: {sign: [1, 1, 1]}}", "6 values"),
        ("controller: {joint_map: {offset_deg: [0, 0, 0, 0, 0, .nan]}}", "finite"),
        ("controller: {joint_map: {coupling: {j2: {j3: 1}}}}", "j2 gains from j3; expected an axis before j2"),
        ("controller: {joint_map: {coupling: {j7: {j2: 1}}}}", "controller.joint_map.coupling"),
        ("controller: {post: none.toml}", "no such file: none.toml"),
        ("controller: {post: ../x.toml}", "no such file|outside the cell folder"),
        ("controller: {pulses_per_deg: [1, 1, 1, 1, 1, 0]}", "numbers other than 0"),
        ("controller: {lines: {spindel_on: x}}", "did you mean 'spindle_on'"),
        ("controller: {nonflip_j5: up}", "controller.nonflip_j5"),
    ],
)
def test_mistakes_are_named(folder: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_cell(add(folder, text + "\n"))
