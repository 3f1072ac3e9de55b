"""Start values of external axes that follow the tool around the part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machopt.cell.cell_reader import load_cell
from machopt.data_types.plan_options import PlanOptions
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axes.positioner_azimuth_following import AZIMUTHS, list_following_paths
from machopt.planning.pipeline.planning_setup import PlanningSetup, fix_external_axes, prepare_planning
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def drum() -> tuple[PlanningSetup, PlanningPath, list[OperationGroup]]:
    """Return radial holes around a drum on a tilting turntable."""
    cell = load_cell(ROOT / "cells" / "kr240_turntable")
    toolpath = read_toolpath(ROOT / "toolpaths" / "drum_holes.csv")
    options = PlanOptions(collision=False)
    setup = prepare_planning(cell, options)
    path = fix_external_axes(build_planning_path(toolpath), cell.external_home)
    return setup, path, build_operation_groups(cell, toolpath, path, resolve_axis_options(cell, options))


def test_tool_keeps_its_azimuth(drum: tuple[PlanningSetup, PlanningPath, list[OperationGroup]]) -> None:
    setup, path, groups = drum
    home = [setup.cell.external_home for _ in groups]
    found = list_following_paths(setup, path, groups, home)
    assert AZIMUTHS <= len(found) <= 2 * AZIMUTHS
    # those of the rotating axis; the tilt axis does not follow here
    turning = [e for e in found if np.ptp(e[:, 1]) > 3.0]
    assert len(turning) == AZIMUTHS
    for e in turning:
        axis = setup.arm.directions(e, path.axis)
        np.testing.assert_allclose(axis, np.broadcast_to(axis[0], axis.shape), atol=1e-6)
        low = min(float(g.least[1]) for g in groups)
        high = max(float(g.most[1]) for g in groups)
        assert low <= e[:, 1].min()
        assert e[:, 1].max() <= high


def test_constant_values_are_spread_over_one_turn(
    drum: tuple[PlanningSetup, PlanningPath, list[OperationGroup]],
) -> None:
    setup, path, groups = drum
    found = list_following_paths(setup, path, groups, [setup.cell.external_home for _ in groups])
    first = np.sort([e[0, 1] % (2 * np.pi) for e in found if np.ptp(e[:, 1]) > 3.0])
    np.testing.assert_allclose(np.diff(first), 2 * np.pi / AZIMUTHS, atol=1e-9)


def test_constant_joint_follows_nothing(
    drum: tuple[PlanningSetup, PlanningPath, list[OperationGroup]],
) -> None:
    setup, path, groups = drum
    still = [replace(g, moving=np.zeros_like(g.moving)) for g in groups]
    assert list_following_paths(setup, path, still, [setup.cell.external_home for _ in groups]) == []
