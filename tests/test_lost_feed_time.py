"""Time lost to acceleration and jerk limits, predicted from the joint path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_planning_path import Rows
from test_planning_pipeline import small_job

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell, JointLimits
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind
from machopt.kinematics.machine import load_machine
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_robot
from machopt.planning.cost import clearance_cost, lost_feed_time
from machopt.planning.cost.lost_feed_time import FeedMotion, compute_excess
from machopt.planning.cost.objective import AXIS_SPEED
from machopt.planning.retiming.joint_derivatives import solve_joints_near_seeds
from machopt.planning.retiming.run_retiming import RunFailure, RunInput, retime_run
from machopt.planning.retiming.time_law import ACCELERATION_SHARE, JERK_SHARE

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = PlanOptions()


def load(name: str) -> tuple[Cell, Robot]:
    cell = load_cell(ROOT / "cells" / name)
    return cell, load_robot(cell)


def segment(twist: np.ndarray) -> FeedMotion:
    """Return one second of a straight segment."""
    one = np.ones(1)
    return FeedMotion(
        twist=twist[None], turn=np.zeros((1, 6)), rounding=one, spacing=one, count=np.zeros(1), seconds=one
    )


def lose(cell: Cell, robot: Robot, limits: JointLimits, q: np.ndarray, motion: FeedMotion) -> float:
    return float(compute_excess(robot, cell.tool.T_flange_tcp, limits, OPTIONS, q[None], motion, np.zeros(1, int))[0])


def rotate(vector: np.ndarray) -> np.ndarray:
    """Return the rotation by a vector (3,) rad."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def follow(cell: Cell, robot: Robot, q: np.ndarray, twist: np.ndarray, t: float) -> np.ndarray:
    """Return the joints t seconds later: the tool moves straight and rotates uniformly."""
    T = robot.compute_fk(q[None], cell.tool.T_flange_tcp)[0].copy()
    T[:3, 3] += t * twist[:3]
    T[:3, :3] = rotate(t * twist[3:]) @ T[:3, :3]
    out, failed = solve_joints_near_seeds(robot, cell.tool.T_flange_tcp, T[None], q[None])
    assert failed < 0
    return np.asarray(out[0])


@pytest.mark.parametrize("name", ["kr500_milling", "cutting_cobot"])
def test_segment_time_follows_from_finite_differences(name: str) -> None:
    """The drives are weak: their accelerations limit before their velocities."""
    cell, robot = load(name)
    weak = replace(cell.limits, acceleration=cell.limits.acceleration / 16.0, jerk=cell.limits.jerk / 100.0)
    rng = np.random.default_rng(3)
    bounds = np.stack([getattr(weak, k)[:6] for k in ("velocity", "acceleration", "jerk")]) * OPTIONS.limit_scale
    bounds *= np.array([[1.0], [ACCELERATION_SHARE], [JERK_SHARE]])
    observed = 0
    for n in range(40):
        q = rng.uniform(-1.2, 1.2, 6)
        q[2] = rng.uniform(0.7, 1.6)  # neither stretched nor folded
        q[4] = 0.15 if n % 2 else rng.uniform(0.6, 1.2)  # every second one is near a wrist singularity
        twist = np.r_[rng.normal(size=3) * 0.1, rng.normal(size=3) * 0.2]
        found = lose(cell, robot, weak, q, segment(twist))
        J = robot.compute_fk_jacobian(q[None], cell.tool.T_flange_tcp)[1][0]
        h = min(5e-3, 5e-3 / float(np.abs(np.linalg.solve(J, twist)).max()))
        y = np.array([follow(cell, robot, q, twist, k * h) for k in (-2, -1, 0, 1, 2)])
        first = (y[0] - 8 * y[1] + 8 * y[3] - y[4]) / (12 * h)
        second = (-y[0] + 16 * y[1] - 30 * y[2] + 16 * y[3] - y[4]) / (12 * h * h)
        third = (-y[0] + 2 * y[1] - 2 * y[3] + y[4]) / (2 * h**3)
        need = [np.abs(first) / bounds[0], np.sqrt(np.abs(second) / bounds[1]), np.cbrt(np.abs(third) / bounds[2])]
        by_speed = max(1.0, float((np.abs(first) / (AXIS_SPEED * weak.velocity[:6])).max()))
        expected = max(max(1.0, float(np.max(need))) - by_speed, 0.0)
        observed += expected > 0.05
        assert found == pytest.approx(expected, rel=2e-2, abs=1e-2)
    assert observed >= 5


def drive_corner(cell: Cell, robot: Robot, q: np.ndarray, legs: np.ndarray, feed: float) -> float:
    """Return the duration in s of two straight moves (2, 3) m that meet at the pose of ``q``, retimed at a feed."""
    T = robot.compute_fk(q[None], cell.tool.T_flange_tcp)[0]
    machine = load_machine(cell, robot)
    s = np.linspace(-1.0, 1.0, 41)
    poses = np.repeat(T[None], len(s), axis=0)
    poses[:, :3, 3] += np.where(s[:, None] < 0, s[:, None] * legs[0], s[:, None] * legs[1])
    joints, failed = solve_joints_near_seeds(robot, cell.tool.T_flange_tcp, poses, np.repeat(q[None], len(s), axis=0))
    assert failed < 0
    W = np.linalg.inv(machine.T_base_workpiece_zero) @ poses
    keep = [0, 10, 20, 30, 40]
    reach = np.full(6, 10.0)
    run = RunInput(
        position=W[keep, :3, 3],
        axis=-W[keep, :3, 2],
        reference=W[keep, :3, 0],
        phi=np.zeros(len(keep)),
        q=joints[keep],
        feed=np.full(len(keep), feed),
        machine=machine,
        external=np.empty((len(keep), 0)),
        T_flange_tcp=cell.tool.T_flange_tcp,
        robot=robot,
        limits=replace(cell.limits, lower=-reach, upper=reach),
        sample=0.002,
        path_tolerance=OPTIONS.path_tolerance,
        axis_tolerance=OPTIONS.axis_tolerance,
        limit_scale=OPTIONS.limit_scale,
    )
    out = retime_run(run)
    assert not isinstance(out, RunFailure)
    return 0.002 * (len(out.q) - 1)


def test_lost_time_at_a_corner_is_near_that_of_the_retiming() -> None:
    cell, robot = load("kr500_milling")
    rng = np.random.default_rng(5)
    message, driven = [], []
    for n in range(24):
        q = np.r_[rng.uniform(-0.5, 0.5), -1.0, rng.uniform(1.2, 2.0), rng.uniform(-1, 1), 0.0, rng.uniform(-1, 1)]
        q[4] = np.radians((5.2, 15.0, 60.0)[n % 3])
        legs = 0.02 * np.array([[1.0, 0, 0], rotate(np.radians([0, 0, (20, 60, 90)[n % 3 - 1]])) @ [1.0, 0, 0]])
        feed = float(rng.uniform(0.02, 0.06))
        straight = drive_corner(cell, robot, q, np.array([legs[0], legs[0]]), feed)
        driven.append(drive_corner(cell, robot, q, legs, feed) - straight)
        v = feed * legs / 0.02
        turn = np.r_[v[1] - v[0], np.zeros(3)]
        bend = np.linalg.norm(turn) / OPTIONS.path_tolerance
        motion = FeedMotion(
            twist=np.r_[v[1], np.zeros(3)][None],
            turn=turn[None],
            rounding=np.array([min(1.0 / (0.15625 * bend), 0.1)]),
            spacing=np.array([0.01 / feed]),
            count=np.ones(1),
            seconds=np.array([0.01 / feed]),
        )
        message.append(lose(cell, robot, cell.limits, q, motion))
    ratio = np.array(message) / np.array(driven)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.5)
    assert np.corrcoef(message, driven)[0, 1] > 0.8


def test_no_motion_loses_no_time() -> None:
    cell, robot = load("kr500_milling")
    q = np.array([0.1, -0.9, 1.5, 0.2, 0.5, 0.4])
    assert lose(cell, robot, cell.limits, q, segment(np.zeros(6))) == 0.0


def test_grid_costs_do_not_depend_on_the_block_size(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    rows: Rows = [((x, 0.02 * (n % 3), 0.01), (0.0, 0.0, 1.0), MoveKind.CUT) for n, x in enumerate(np.arange(9) * 0.03)]
    plan = small_job(tmp_path, [((0.0, 0.0, 0.06), (0.0, 0.0, 1.0), MoveKind.RAPID), *rows], PlanOptions())
    assert plan.setup.collision is not None
    modules = (lost_feed_time, clearance_cost)
    by_size = []
    for size in (512, 4):
        for module in modules:
            monkeypatch.setattr(module, "BLOCK", size)
        price = lost_feed_time.compute_grid_price(plan.path, plan.setup.drives, plan.options, plan.candidates)
        crowding = clearance_cost.compute_grid_crowding(plan.path, plan.setup.collision, plan.candidates, plan.options)
        assert price is not None
        assert crowding is not None
        assert price.any()
        by_size.append((price, crowding))
    for whole, in_blocks in zip(*by_size, strict=True):
        np.testing.assert_allclose(in_blocks, whole, rtol=1e-12, atol=1e-15)
