"""Pairs of bodies in contact by construction: excluded by the planner, confirmed by the verifier."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import pose, small_cell

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell, CollisionShape
from machopt.kinematics.urdf_loading import load_chain
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.touching_pairs import list_checked_pairs
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

CLEARANCE = 0.002


def cell_with(folder: Path, size: float, offset: float) -> Cell:
    """Return the small cell with a box on the flange that touches the forearm in a fraction of all poses."""
    cell = small_cell(folder)
    box = CollisionShape(
        name="box", kind="box", size=(size, size, 0.3), mesh=None, T_parent_shape=pose(offset, 0, -0.1)
    )
    return replace(cell, tool=replace(cell.tool, geometry=(box,)))


def excluded_by_planner(cell: Cell) -> list[tuple[str, str]]:
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, CLEARANCE)
    return [(e.a, e.b) for e in model.excluded if np.isfinite(e.share)]


def list_checked_and_unconfirmed(cell: Cell, listed: list[tuple[str, str]]) -> tuple[set[frozenset[str]], list[str]]:
    """Return the pairs that the verifier checks, and the listed ones that it does not confirm."""
    arm = UrdfKinematics(cell)
    found, unfounded = list_checked_pairs(cell, arm, build_bodies(cell, arm), CLEARANCE, listed)
    return {frozenset((a.name, b.name)) for a, b in found}, unfounded


@pytest.mark.parametrize("offset", [0.0, 0.1])
@pytest.mark.parametrize("size", [0.1, 0.2, 0.3, 0.36, 0.4, 0.44, 0.5, 0.6, 0.8])
def test_verifier_confirms_what_the_planner_excludes(size: float, offset: float, tmp_path: Path) -> None:
    cell = cell_with(tmp_path, size, offset)
    listed = excluded_by_planner(cell)
    checked, unfounded = list_checked_and_unconfirmed(cell, listed)
    assert unfounded == []
    assert not {frozenset(pair) for pair in listed} & checked


def test_pair_that_does_not_touch_is_named_and_checked(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, 0.1, 0.0)
    checked, unfounded = list_checked_and_unconfirmed(cell, [("link_2_0", "box")])
    assert unfounded == ["link_2_0 ~ box"]
    assert frozenset(("link_2_0", "box")) in checked


def test_verifier_decides_without_a_list(tmp_path: Path) -> None:
    cell = cell_with(tmp_path, 0.1, 0.0)
    arm = UrdfKinematics(cell)
    found, unfounded = list_checked_pairs(cell, arm, build_bodies(cell, arm), CLEARANCE, None)
    assert unfounded == []
    assert any(b.name == "box" for _, b in found)
