"""Placement with external joints, tool changes and several setups."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from small_cell import small_cell

from machopt.cell.cell_reader import load_cell
from machopt.cell.moved_cell_writer import write_moved_cell
from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_robot
from machopt.placement.external_joint_estimate import build_external_joint_grid
from machopt.placement.moved_cell import (
    MovedBodies,
    compute_link_frames,
    compute_rotation_centre,
    move_cell,
    select_moved_obstacles,
)
from machopt.placement.placement_site import CandidateQuery, PlacementSite
from machopt.placement.search_options import NO_SHIFT, PlacementOptions, PlacementShift
from machopt.placement.search_result import PlacementCandidate
from machopt.placement.segment_task import SegmentTask, build_single_segment
from machopt.placement.support_check import SupportModel
from machopt.planning.job.job_planner import plan_job
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.stations.path_subset import select_path_runs
from machopt.planning.stations.planning_path import build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath

CELLS = Path(__file__).resolve().parents[1] / "cells"
SPRINGS = ArmStiffness(joints=np.array([2.0, 2.0, 1.5, 0.5, 0.4, 0.3]) * 1e6)
HEAD = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation,tool\n"


def _holes(folder: Path, places: list[tuple[float, float]], tools: str = "", depth: float = 2.0) -> Path:
    out = folder / "holes.csv"
    out.write_text(
        HEAD
        + "".join(
            f"{x},{y},60,0,0,1,rapid,,o{k},{t}\n{x},{y},{-depth},0,0,1,cut,300,o{k},{t}\n"
            f"{x},{y},60,0,0,1,retract,3000,o{k},{t}\n"
            for k, ((x, y), t) in enumerate(zip(places, tools or [""] * len(places), strict=True))
        )
    )
    return out


def test_part_on_a_rotated_table_is_shifted_along_the_world(tmp_path: Path) -> None:
    cell = replace(external_cell(tmp_path, table=True), external_home=np.array([0.7]))
    frames = compute_link_frames(cell)
    assert set(frames) == {"plate"}
    middle = compute_rotation_centre(cell, np.array([[-0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]), base=False)
    carried = MovedBodies(False, frozenset(), middle, frames)
    shift = PlacementShift(0.05, -0.02, 0.01, 0.4)

    def in_world(cell: Cell) -> np.ndarray:
        return load_machine(cell, load_robot(cell)).compute_T_world_workpiece(cell.external_home[None])[0]

    np.testing.assert_allclose(
        in_world(move_cell(cell, carried, shift)), shift.build_matrix(middle) @ in_world(cell), atol=1e-12
    )


def test_part_does_not_sink_into_its_plate(tmp_path: Path) -> None:
    cell = replace(external_cell(tmp_path, table=True, rail=True), external_home=np.array([1.0, 0.3]))
    standing = SupportModel.build(cell)
    assert standing.links == {"plate", "carriage"}
    assert standing.find_moved_obstacles(base=False) == set()
    centre = compute_rotation_centre(cell, np.zeros((1, 3)), base=False)
    refusal = standing.build_shift_check(frozenset(), base=False)
    assert refusal.find_refusal_reason(NO_SHIFT, NO_SHIFT.build_matrix(centre)) == ""
    down = PlacementShift(z=-0.08)
    assert "plate" in refusal.find_refusal_reason(down, down.build_matrix(centre))
    to_the_arm = PlacementShift(x=-1.5, y=1.0, z=-0.6)
    assert "workpiece would intersect" in refusal.find_refusal_reason(to_the_arm, to_the_arm.build_matrix(centre))


def test_setups_and_their_fixtures_move_together(tmp_path: Path) -> None:
    cell = load_cell(CELLS / "kr240_setups")
    assert set(cell.fixtures) == {"jaw_fixed", "jaw_moved", "vice", "angle_plate", "angle_foot"}
    names = select_moved_obstacles(cell, PlacementOptions(carry=("table",)), frozenset())
    assert names == {*cell.fixtures, "table"}
    with pytest.raises(InputError, match="is in a work offset"):
        select_moved_obstacles(cell, PlacementOptions(stay=("vice",)), frozenset())
    at = move_cell(cell, MovedBodies(False, names, np.array([1.7, 0.0, 0.85])), PlacementShift(0.12, -0.03, 0.0, 0.5))
    file = write_moved_cell(tmp_path / "cell", cell, at, "a head")
    found = load_cell(file.parent)
    for a, b in zip(found.obstacles, at.obstacles, strict=True):
        np.testing.assert_allclose(a.T_parent_shape, b.T_parent_shape, atol=2e-8)
    for name, T in found.offsets.items():
        np.testing.assert_allclose(T, cell.offsets[name], atol=1e-12)


def test_obstacle_of_another_link_is_not_moved(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, table=True)
    post = replace(small_cell(tmp_path).obstacles[1], name="post")
    with pytest.raises(InputError, match="is on world, what moves on plate"):
        select_moved_obstacles(replace(cell, obstacles=(post,)), PlacementOptions(carry=("post",)), frozenset())


def test_bound_equals_that_of_the_best_value_and_moving_has_the_minimum(tmp_path: Path) -> None:
    """Compared with every value of the grid, with the rail locked at that value."""
    cell = replace(external_cell(tmp_path, rail=True), stiffness=SPRINGS)
    path = read_toolpath(_holes(tmp_path, [(0.0, -800.0), (0.0, 300.0)]))
    path = replace(path, operation=np.zeros_like(path.operation))  # a single operation, so one value
    options = PlanOptions(rotation_step=np.radians(30.0))

    def bound(**axis: object) -> float:
        own = replace(options, external=(ExternalJointOptions(joint="rail", **axis),))  # type: ignore[arg-type]
        task = SegmentTask.build(build_single_segment(cell, path)[0], own)
        assert task.has_free_external_joints == (axis["mode"] != "locked")
        return task.estimate(MovedBodies(False, frozenset(), np.zeros(3)), NO_SHIFT, own).bound

    group = SegmentTask.build(
        build_single_segment(cell, path)[0], replace(options, external=(ExternalJointOptions(joint="rail"),))
    ).groups[0]
    locked = [bound(mode="locked", at=float(v[0])) for v in build_external_joint_grid(group, cell.external_home)]
    assert np.isinf(locked).any()
    assert bound(mode="operation") == pytest.approx(min(locked), rel=1e-12)
    assert bound(mode="moving") < min(locked) * 0.99


def test_few_cut_places_are_never_left_out(tmp_path: Path) -> None:
    path = build_planning_path(read_toolpath(_holes(tmp_path, [(10.0 * k, 0.0) for k in range(12)])))
    part = select_path_runs(path, tuple(range(len(path.runs))), 50)
    assert len(part.stations) < len(path.stations)
    assert part.counted[part.stations].sum() == part.counted.sum()


@pytest.mark.slow
def test_place_of_a_job_with_tool_changes_is_planned_as_the_job(tmp_path: Path) -> None:
    cell = replace(small_cell(tmp_path), stiffness=SPRINGS)
    tools = {"a": cell.tool, "b": replace(cell.tool, mass=cell.tool.mass + 15.0)}
    cell = replace(cell, tools=tools, tool_name=None)
    path = read_toolpath(_holes(tmp_path, [(-60.0, 50.0), (60.0, -50.0), (60.0, 50.0)], "abb", depth=4.0))
    options = PlanOptions(rotation_step=np.radians(30.0))
    segments = split_into_tool_segments(cell, path)
    assert len(segments) == 2
    site = PlacementSite.build(cell, (path,), options, PlacementOptions(), [segments])
    place = site.evaluate_candidate(CandidateQuery(0, NO_SHIFT))
    assert place.is_feasible
    found = site.plan_candidate(PlacementCandidate(number=0, shift=NO_SHIFT))
    job = plan_job(segments, path, options, StageTimings())
    own = job.plan.chosen.objective.worst * job.plan.scores.scale
    assert found.worst == pytest.approx(own, rel=2e-3)  # the value of the job is that of the executed motion
    assert place.bound <= found.worst * (1 + 2e-3)
    assert job.timeline is not None
    assert job.timeline.trajectory is not None
    assert found.cycle_time == pytest.approx(float(job.timeline.trajectory.time[-1]), abs=0.2)
