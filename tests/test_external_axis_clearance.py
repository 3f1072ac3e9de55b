"""Path of external joints near contacts: a suspended arm that collides with itself when the rail is next to the
tool."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from external_axis_cells import external_folder

from machopt.cell.cell_reader import load_cell
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.options.plan_option_reader import load_options
from machopt.planning.external_axes.moving_axis_search import AxisCurveSearch, _find_near_contact, _number_neighbours
from machopt.planning.external_axis_optimization import coarse_to_fine_search, refinement_starts
from machopt.toolpath.toolpath_reader import read_toolpath


def test_values_next_to_a_contact_are_avoided() -> None:
    near = _number_neighbours([5])
    free = np.array([[1, 1, 1, 1, 1], [0, 1, 1, 1, 0], [0, 1, 1, 0, 0], [0, 0, 0, 0, 0]], bool)
    left = free & ~_find_near_contact(free, near)
    wanted = [[1, 1, 1, 1, 1], [0, 0, 1, 0, 0], [0, 1, 1, 0, 0], [0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(left, np.array(wanted, bool))


def test_self_colliding_hanging_arm_is_guided_along_the_tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Checked manually: with the rail 1.55 or 1.7 m from the tool all points are reachable, but no single rail
    position reaches all of them."""
    folder = external_folder(tmp_path, rail=True)
    text = (folder / "cell.yaml").read_text()
    hung = "  flange_link: flange\n  pose: {xyz_mm: [0, 0, 2600], rpy_deg: [180, 0, 0]}\n"
    text = text.replace("  flange_link: flange\n", hung).replace("xyz_mm: [1500, 0, 600]", "xyz_mm: [1700, 0, 800]")
    (folder / "cell.yaml").write_text(text)
    rows = [(-300.0, 60, "rapid", ""), (-300.0, 4, "approach", "1500")]
    rows += [(float(y), -1, "cut", "3000") for y in np.linspace(-300, 300, 13)] + [(300.0, 60, "retract", "3000")]
    lines = [f"0,{y:g},{z},0,0,1,{move},{feed}" for y, z, move, feed in rows]
    (tmp_path / "p.csv").write_text("\n".join(["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min", *lines]) + "\n")
    cell, path = load_cell(folder), read_toolpath(tmp_path / "p.csv")
    assert cell.T_world_base[2, 2] == pytest.approx(-1.0)
    options = load_options(cell.plan, None, ["rotation_step_deg=30"])
    looked: list[bool] = []
    made = refinement_starts.compute_moving_axis_path

    def noted(search: AxisCurveSearch, *given: Any) -> Array:
        looked.append(search.clear)
        return made(search, *given)

    monkeypatch.setattr(refinement_starts, "compute_moving_axis_path", noted)
    found = coarse_to_fine_search.find_best_external_axis_plan(cell, path, options)
    assert looked == [False, False, False, True]  # with three travel weights, then with contact-free poses
    assert not len(found.missing)
    assert not found.breaks
    cut = path.move[np.minimum(np.ceil(found.path.index).astype(int), len(path) - 1)] == MoveKind.CUT
    assert np.ptp(found.path.external[cut]) > 0.4  # m
