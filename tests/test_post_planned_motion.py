"""Planned motion as programs: the targets make a controller follow the planned and checked motion."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from planned_program_output import write_and_compare_program
from scipy.spatial.transform import Rotation, Slerp

from machopt.cell.cell_reader import load_cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.robot_program import LIN, PTP, RobotProgram
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.planning.motion.trajectory_builder import MotionTimeline, build_timeline
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.program_export.program_moves import build_robot_program, build_sampled_program
from machopt.programs.program_writer import has_sampled_output, list_post_names
from machopt.programs.writing.target_insertion import ProgramTolerance
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow


Planned = tuple[Plan, Toolpath, MotionTimeline]


@cache
def job(cell: str, name: str) -> Planned:
    return _plan_cell(cell, ROOT / "toolpaths" / name)


def _plan_cell(cell: str, file: Path) -> Planned:
    t = read_toolpath(file)
    p = plan_path(load_cell(ROOT / "cells" / cell), t, PlanOptions(collision=False))
    return p, t, build_timeline(p, t)


@pytest.fixture(scope="module")
def two_rows(tmp_path_factory: pytest.TempPathFactory) -> Planned:
    """Return the first two of the panel's ten rows of holes.

    They contain every kind of move and both rotations of the tool axis between rows. Posts with sampled output write
    and read a line every few milliseconds, so ten rows would take five times as long.
    """
    head, *rows = (ROOT / "toolpaths" / "panel_holes.csv").read_text(encoding="utf-8").splitlines(keepends=True)[1:]
    file = tmp_path_factory.mktemp("two_rows") / "panel_holes.csv"
    file.write_text(head + "".join(r for r in rows if r.strip().endswith(("row 1", "row 2"))), encoding="utf-8")
    found = _plan_cell("kr240_drilling", file)
    assert len(found[1].operations) == 2
    return found


def interpolate_line(p: RobotProgram, k: int, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the controller's interpolation of LIN move k at the given fractions."""
    a, b = p.T_workpiece_tcp[k - 1], p.T_workpiece_tcp[k]
    line = a[:3, 3] + share[:, None] * (b[:3, 3] - a[:3, 3])
    return line, Slerp([0, 1], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))(share).as_matrix()


@pytest.mark.parametrize(
    ("cell", "name"), [("kr240_drilling", "panel_holes.csv"), ("kr500_milling", "cylinder_head_face.cls")]
)
def test_straight_lines_between_targets_follow_the_motion(cell: str, name: str) -> None:
    """Every sample of the exported trajectory is on the controller's lines, within the tolerances of the options.

    The trajectory rounds corners by ``path_tolerance``. The rotation may deviate by 0.1° from uniform rotation between
    two points before a way point is added, and the executed rotation is smoothed by ``axis_tolerance``.
    """
    the_plan, t, timeline = job(cell, name)
    p = build_robot_program(the_plan, t, timeline).program
    options = the_plan.options
    assert p.kind[0] == PTP
    inverse = np.linalg.inv(the_plan.setup.arm.machine.T_base_workpiece_zero)
    row = 1
    worst_gap = worst_angle = 0.0
    for leg in timeline.legs:
        moves = range(row, row + len(leg.waypoints))
        row += len(leg.waypoints)
        if leg.name == "rapid" or len(leg.q) < 3:
            assert all(p.kind[k] == PTP for k in moves if leg.name == "rapid")
            continue
        T = inverse @ the_plan.setup.robot.compute_fk(leg.q, the_plan.setup.cell.tool.T_flange_tcp)
        best = np.full(len(T), np.inf)
        angle = np.full(len(T), np.inf)
        for k in moves:
            a, b = p.T_workpiece_tcp[k - 1, :3, 3], p.T_workpiece_tcp[k, :3, 3]
            way = b - a
            share = np.clip((T[:, :3, 3] - a) @ way / max(way @ way, 1e-18), 0.0, 1.0)
            near = np.linalg.norm(T[:, :3, 3] - a - share[:, None] * way, axis=1)
            best = np.minimum(best, near)
            # passes cross: only one of several near lines belongs to the sample
            on = near <= options.path_tolerance + 3e-6
            if on.any():
                _, R = interpolate_line(p, k, share[on])
                turn = np.linalg.norm(R - T[on, :3, :3], axis=(1, 2)) / np.sqrt(8)
                angle[on] = np.minimum(angle[on], 2 * np.arcsin(np.clip(turn, 0, 1)))
        worst_gap, worst_angle = max(worst_gap, float(best.max())), max(worst_angle, float(angle.max()))
    assert row == len(p)
    assert worst_gap <= options.path_tolerance + 3e-6  # deviation allowed by the planner, plus rounding
    assert worst_angle <= np.radians(0.1) + 2 * options.axis_tolerance + np.radians(0.05)


def test_operations_moves_and_events_are_those_of_the_toolpath() -> None:
    the_plan, t, timeline = job("kr240_drilling", "panel_holes.csv")
    p = build_robot_program(the_plan, t, timeline).program
    lin = p.kind == LIN
    assert (p.moves[p.cutting] == MoveKind.CUT).all()
    assert (p.moves[~lin] == MoveKind.RAPID).all()
    assert p.cutting.sum() == (t.move == MoveKind.CUT).sum()  # a hole is one stroke; retracts do not cut
    assert p.wrist_behind is not None
    assert not p.wrist_behind.any()  # all holes are in front of the robot
    assert p.elbow_up is not None
    assert p.elbow_up.all()
    s = build_sampled_program(the_plan, t, timeline).program
    assert timeline.trajectory is not None
    assert len(s) == len(timeline.trajectory.time)
    np.testing.assert_array_equal(s.q, timeline.trajectory.q)


@pytest.mark.parametrize("post", list_post_names())
def test_every_post_writes_the_job_and_it_is_read_back(tmp_path: Path, post: str, two_rows: Planned) -> None:
    _comes_back(tmp_path, post, two_rows)


@pytest.mark.parametrize("post", ["krl", "urscript_movep"])  # one with free rotation between points, one with lines
def test_whole_panel_is_read_back(tmp_path: Path, post: str) -> None:
    _comes_back(tmp_path, post, job("kr240_drilling", "panel_holes.csv"))


def _comes_back(tmp_path: Path, post: str, planned: Planned) -> None:
    the_plan, t, timeline = planned
    cell = the_plan.setup.cell
    known = replace(cell, controller=replace(cell.controller, nonflip_j5="negative"))
    the_plan = replace(the_plan, setup=replace(the_plan.setup, cell=known))
    made = (build_sampled_program if has_sampled_output(post) else build_robot_program)(the_plan, t, timeline)
    found = write_and_compare_program(tmp_path / "out", the_plan, t, timeline, made, ProgramTolerance(), post)
    assert found.differences == ()
    assert found.moves == len(made.program)
    configured = post.startswith(("krl", "rapid", "val3")) or post in ("fanuc", "jbi_rectan")
    assert found.get_verdict("configuration") is (True if configured else None)
    assert found.get_verdict("wording") is True
    if not has_sampled_output(post):
        assert found.get_value("CAM points") < 4e-3  # JBI's four decimals of a degree at a distance of three metres
        assert found.get_value("lines along the motion") < 0.02  # corners rounded by the motion, plus printed decimals
