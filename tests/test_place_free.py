"""Placement of cells whose external joints may choose, whose jobs change tools, and whose setups move together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_cell import external_cell
from small_cell import small_cell

from machopt.domain.cell import Cell
from machopt.domain.options import ExternalAxis, PlanOptions
from machopt.domain.stiffness import Stiffness
from machopt.errors import InputError
from machopt.formats.cell import load_cell
from machopt.formats.movedcell import write_moved_cell
from machopt.formats.toolchoice import stints_of
from machopt.formats.toolpath import read_toolpath
from machopt.model.machine import load_machine
from machopt.model.robot import load_robot
from machopt.placement.asked import HERE, Search, Shift
from machopt.placement.found import Place
from machopt.placement.freedom import grid_of
from machopt.placement.moved import Carried, centre_of, frames_of, moved, named
from machopt.placement.search import Asked, Site
from machopt.placement.standing import Standing
from machopt.placement.task import Task, stints_whole
from machopt.plan.job.run import plan_job
from machopt.plan.pipeline.setup import Timings
from machopt.plan.stations.path import build_path
from machopt.plan.stations.subpath import part_of

CELLS = Path(__file__).resolve().parents[1] / "cells"
SPRINGS = Stiffness(joints=np.array([2.0, 2.0, 1.5, 0.5, 0.4, 0.3]) * 1e6)
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


def test_a_part_on_a_turned_table_is_shifted_along_the_world(tmp_path: Path) -> None:
    cell = replace(external_cell(tmp_path, table=True), external_home=np.array([0.7]))
    frames = frames_of(cell)
    assert set(frames) == {"plate"}
    middle = centre_of(cell, np.array([[-0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]), base=False)
    carried = Carried(False, frozenset(), middle, frames)
    shift = Shift(0.05, -0.02, 0.01, 0.4)

    def in_world(cell: Cell) -> np.ndarray:
        return load_machine(cell, load_robot(cell)).T_world_workpiece(cell.external_home[None])[0]

    np.testing.assert_allclose(in_world(moved(cell, carried, shift)), shift.matrix(middle) @ in_world(cell), atol=1e-12)


def test_a_part_does_not_sink_into_the_plate_it_stands_on(tmp_path: Path) -> None:
    cell = replace(external_cell(tmp_path, table=True, rail=True), external_home=np.array([1.0, 0.3]))
    standing = Standing.of(cell)
    assert standing.links == {"plate", "carriage"}
    assert standing.holding(base=False) == set()
    centre = centre_of(cell, np.zeros((1, 3)), base=False)
    refusal = standing.refusal(frozenset(), base=False)
    assert refusal.why(HERE, HERE.matrix(centre)) == ""
    down = Shift(z=-0.08)
    assert "plate" in refusal.why(down, down.matrix(centre))
    to_the_arm = Shift(x=-1.5, y=1.0, z=-0.6)
    assert "workpiece would stand in" in refusal.why(to_the_arm, to_the_arm.matrix(centre))


def test_setups_and_what_holds_them_move_together(tmp_path: Path) -> None:
    cell = load_cell(CELLS / "kr240_setups")
    assert set(cell.fixtures) == {"jaw_fixed", "jaw_moved", "vice", "angle_plate", "angle_foot"}
    names = named(cell, Search(carry=("table",)), frozenset())
    assert names == {*cell.fixtures, "table"}
    with pytest.raises(InputError, match="stands in a work offset"):
        named(cell, Search(stay=("vice",)), frozenset())
    at = moved(cell, Carried(False, names, np.array([1.7, 0.0, 0.85])), Shift(0.12, -0.03, 0.0, 0.5))
    file = write_moved_cell(tmp_path / "cell", cell, at, "a head")
    found = load_cell(file.parent)
    for a, b in zip(found.obstacles, at.obstacles, strict=True):
        np.testing.assert_allclose(a.T_parent_shape, b.T_parent_shape, atol=2e-8)
    for name, T in found.offsets.items():
        np.testing.assert_allclose(T, cell.offsets[name], atol=1e-12)


def test_an_obstacle_of_another_link_is_not_carried(tmp_path: Path) -> None:
    cell = external_cell(tmp_path, table=True)
    post = replace(small_cell(tmp_path).obstacles[1], name="post")
    with pytest.raises(InputError, match="stands on world, what moves on plate"):
        named(replace(cell, obstacles=(post,)), Search(carry=("post",)), frozenset())


def test_the_bound_is_that_of_the_best_value_and_moving_has_the_least(tmp_path: Path) -> None:
    """Against every value of the grid, each as if the rail were locked there."""
    cell = replace(external_cell(tmp_path, rail=True), stiffness=SPRINGS)
    path = read_toolpath(_holes(tmp_path, [(0.0, -800.0), (0.0, 300.0)]))
    path = replace(path, operation=np.zeros_like(path.operation))  # one operation, one value
    options = PlanOptions(rotation_step=np.radians(30.0))

    def bound(**axis: object) -> float:
        own = replace(options, external=(ExternalAxis(joint="rail", **axis),))  # type: ignore[arg-type]
        task = Task.of(stints_whole(cell, path)[0], own)
        assert task.free == (axis["mode"] != "locked")
        return task.outlook(Carried(False, frozenset(), np.zeros(3)), HERE, own).bound

    group = Task.of(stints_whole(cell, path)[0], replace(options, external=(ExternalAxis(joint="rail"),))).groups[0]
    locked = [bound(mode="locked", at=float(v[0])) for v in grid_of(group, cell.external_home)]
    assert np.isinf(locked).any()
    assert bound(mode="operation") == pytest.approx(min(locked), rel=1e-12)
    assert bound(mode="moving") < min(locked) * 0.99


def test_few_places_that_are_cut_are_never_left_out_of_a_part(tmp_path: Path) -> None:
    path = build_path(read_toolpath(_holes(tmp_path, [(10.0 * k, 0.0) for k in range(12)])))
    part = part_of(path, tuple(range(len(path.runs))), 50)
    assert len(part.stations) < len(path.stations)
    assert part.counted[part.stations].sum() == part.counted.sum()


@pytest.mark.slow
def test_a_place_of_a_job_that_changes_tools_is_planned_as_the_job_is(tmp_path: Path) -> None:
    cell = replace(small_cell(tmp_path), stiffness=SPRINGS)
    tools = {"a": cell.tool, "b": replace(cell.tool, mass=cell.tool.mass + 15.0)}
    cell = replace(cell, tools=tools, tool_name=None)
    path = read_toolpath(_holes(tmp_path, [(-60.0, 50.0), (60.0, -50.0), (60.0, 50.0)], "abb", depth=4.0))
    options = PlanOptions(rotation_step=np.radians(30.0))
    stints = stints_of(cell, path)
    assert len(stints) == 2
    site = Site.of(cell, (path,), options, Search(), [stints])
    place = site.place(Asked(0, HERE))
    assert place.open
    found = site.planned(Place(number=0, shift=HERE))
    job = plan_job(stints, path, options, Timings())
    own = job.plan.chosen.objective.worst * job.plan.scores.scale
    assert found.worst == pytest.approx(own, rel=2e-3)  # the job's is of the motion as driven
    assert place.bound <= found.worst * (1 + 2e-3)
    assert job.timeline is not None
    assert job.timeline.trajectory is not None
    assert found.cycle_time == pytest.approx(float(job.timeline.trajectory.time[-1]), abs=0.2)
