"""A planned motion as programs: the way points lead a controller along the motion that was planned and checked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from machopt.domain.options import PlanOptions
from machopt.domain.program import LIN, PTP, Controller, RobotProgram
from machopt.domain.toolpath import Event, Move, Toolpath
from machopt.formats.cell import load_cell
from machopt.formats.posts import needs_samples, post_names, program_name, write_program
from machopt.formats.posts.densify import Tolerance
from machopt.formats.programs import read_program
from machopt.formats.toolpath import read_toolpath
from machopt.job.program import Programmed, robot_program, sampled_program
from machopt.job.readback import read_back
from machopt.plan.pipeline import Plan, plan
from machopt.plan.timeline import Timeline, build_timeline

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.slow


@cache
def job(cell: str, name: str) -> tuple[Plan, Toolpath, Timeline]:
    t = read_toolpath(ROOT / "toolpaths" / name)
    p = plan(load_cell(ROOT / "cells" / cell), t, PlanOptions(collision=False))
    return p, t, build_timeline(p, t)


def drawn(p: RobotProgram, k: int, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the controller draws on LIN move k, at shares of it."""
    a, b = p.T_workpiece_tcp[k - 1], p.T_workpiece_tcp[k]
    line = a[:3, 3] + share[:, None] * (b[:3, 3] - a[:3, 3])
    return line, Slerp([0, 1], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))(share).as_matrix()


@pytest.mark.parametrize(
    ("cell", "name"), [("kr240_drilling", "panel_holes.csv"), ("kr500_milling", "cylinder_head_face.cls")]
)
def test_straight_lines_between_way_points_are_the_motion(cell: str, name: str) -> None:
    """Every sample of the exported trajectory lies on the controller's lines, within the options' tolerances.

    The trajectory rounds corners by ``path_tolerance``; the rotation may leave the even turn between two points by
    0.1° before a way point is added, and the driven one is smoothed by ``axis_tolerance``.
    """
    the_plan, t, timeline = job(cell, name)
    p = robot_program(the_plan, t, timeline).program
    options = the_plan.options
    assert p.kind[0] == PTP
    inverse = np.linalg.inv(the_plan.setup.arm.T_base_workpiece)
    row = 1
    worst_gap = worst_angle = 0.0
    for leg in timeline.legs:
        moves = range(row, row + len(leg.waypoints))
        row += len(leg.waypoints)
        if leg.name == "rapid" or len(leg.q) < 3:
            assert all(p.kind[k] == PTP for k in moves if leg.name == "rapid")
            continue
        T = inverse @ the_plan.setup.robot.fk(leg.q, the_plan.setup.cell.tool.T_flange_tcp)
        best = np.full(len(T), np.inf)
        angle = np.full(len(T), np.inf)
        for k in moves:
            a, b = p.T_workpiece_tcp[k - 1, :3, 3], p.T_workpiece_tcp[k, :3, 3]
            way = b - a
            share = np.clip((T[:, :3, 3] - a) @ way / max(way @ way, 1e-18), 0.0, 1.0)
            near = np.linalg.norm(T[:, :3, 3] - a - share[:, None] * way, axis=1)
            closer = near < best - 1e-9
            if closer.any():
                _, R = drawn(p, k, share[closer])
                best[closer] = near[closer]
                turn = np.linalg.norm(R - T[closer, :3, :3], axis=(1, 2)) / np.sqrt(8)
                angle[closer] = 2 * np.arcsin(np.clip(turn, 0, 1))
        worst_gap, worst_angle = max(worst_gap, float(best.max())), max(worst_angle, float(angle.max()))
    assert row == len(p)
    assert worst_gap <= options.path_tolerance + 3e-6  # the bow that planning allows, and rounding
    assert worst_angle <= np.radians(0.1) + 2 * options.axis_tolerance + np.radians(0.05)


def test_operations_moves_and_events_are_those_of_the_toolpath() -> None:
    the_plan, t, timeline = job("kr240_drilling", "panel_holes.csv")
    p = robot_program(the_plan, t, timeline).program
    lin = p.kind == LIN
    assert (p.moves[p.cutting] == Move.CUT).all()
    assert (p.moves[~lin] == Move.RAPID).all()
    assert p.cutting.sum() == (t.move == Move.CUT).sum()  # a hole is one stroke; lifts do not cut
    assert p.behind is not None
    assert not p.behind.any()  # it drills in front of itself
    assert p.elbow_up is not None
    assert p.elbow_up.all()
    s = sampled_program(the_plan, t, timeline).program
    assert timeline.trajectory is not None
    assert len(s) == len(timeline.trajectory.time)
    np.testing.assert_array_equal(s.q, timeline.trajectory.q)


@pytest.mark.parametrize("post", post_names())
def test_every_post_writes_the_job_and_it_comes_back(tmp_path: Path, post: str) -> None:
    the_plan, t, timeline = job("kr240_drilling", "panel_holes.csv")
    made = (sampled_program if needs_samples(post) else robot_program)(the_plan, t, timeline)
    p, motion = made.program, driven(timeline)
    if post == "ros_yaml":  # the strict YAML reader takes 20 µs a number
        columns = ("kind", "q", "T_workpiece_tcp", "feed", "cutting", "operation", "move", "time", "behind", "elbow_up")
        p = replace(p, **{f: getattr(p, f)[:400] for f in columns}, events=())
        made, motion = Programmed(p, made.at[:400], 0), motion[:400]
    files = write_program(tmp_path, program_name(t.source, post), p, post, Controller(nonflip_j5="positive"))
    found = read_back(made, Controller(nonflip_j5="positive"), files[0], the_plan.setup.robot, motion, Tolerance())
    assert found.ok, found
    configured = post.startswith(("krl", "rapid", "val3")) or post in ("fanuc", "jbi_rectan")
    assert found.configurations == (0 if not configured else int(parsed_poses(files[0])))
    assert found.path_error < 2e-5  # the corners that the motion rounds, and what print leaves
    assert found.moves == len(p)
    assert found.position_error < 4e-6  # JBI's four decimals of a degree, three metres away; the others are far below
    parsed = read_program(files[0])
    pose = parsed.has_pose
    np.testing.assert_allclose(parsed.T_base_tcp[pose][:, :3, 3], p.T_workpiece_tcp[pose][:, :3, 3], atol=0.51e-7)


def parsed_poses(file: Path) -> int:
    return int(read_program(file).has_pose.sum())


def driven(timeline: Timeline) -> np.ndarray:
    assert timeline.trajectory is not None
    return timeline.trajectory.q


@pytest.mark.parametrize(
    ("old", "new", "difference"),
    [
        (b"LIN {X -", b"LIN {X 1", "goes elsewhere"), (b",B -", b",B 1", "turns elsewhere"),
        (b"$VEL.CP=0", b"$VEL.CP=1", "feed"), (b"LIN {X ", b"LIN {X 1", "cannot be read back"),
        (b"; CAM: ", b"; CAM: not ", "events"),
        (b"END\r\n", b"LIN {X 0,Y 0,Z 0,A 0,B 0,C 0}\r\nEND\r\n", "moves instead of"),
        (b"PTP {A1 ", b"PTP {A1 9", "goes elsewhere"), (b"A6 0.0", b"A6 360.0", "with other joints"),
        (b",S 2,", b",S 3,", "another configuration"), (b",T 2}", b",T 34}", "another configuration"),
        (b"MO_BASE={X 1", b"MO_BASE={X 2", "base frame MO_BASE lies elsewhere"),
        (b"MO_TOOL={X ", b"MO_TOOL={X 1", "tool frame MO_TOOL lies elsewhere"),
    ],
)  # fmt: skip
def test_what_was_changed_is_noticed(tmp_path: Path, old: bytes, new: bytes, difference: str) -> None:
    the_plan, t, timeline = job("kr240_drilling", "panel_holes.csv")
    made = robot_program(the_plan, t, timeline)
    made = replace(made, program=replace(made.program, events=(Event(3, "spindle", "SPINDL/9000", 9000.0),)))
    files = write_program(tmp_path, "part", made.program, "krl")
    robot, motion = the_plan.setup.robot, driven(timeline)
    assert read_back(made, Controller(), files[0], robot, motion, Tolerance()).ok
    file = files[1] if old.startswith(b"MO_") else files[0]
    data = file.read_bytes()
    assert old in data
    file.write_bytes(data.replace(old, new, 1))
    found = read_back(made, Controller(), files[0], robot, motion, Tolerance())
    assert any(difference in d for d in found.differences), found
