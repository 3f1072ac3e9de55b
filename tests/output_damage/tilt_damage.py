"""Damages of a plan with a tilted ball cutter: columns, table, motion and permitted ranges."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.kinematics.urdf_loading import load_robot
from output_damage.damage_case import CELLS, JOBS, PASS, Damage, Job, build_json_change, plan_table
from output_damage.damage_case import build_table_change as table
from output_damage.table_damage import JOINTS, Change, Rows, add, change_cutting_rows, set_value, swap, times

RADIUS_MM = 8.5
BALL = f"corner_radius_mm: {RADIUS_MM}, length_mm"
RANGES = "tilt_deg={lead: [-4, 4], side: [1, 5]}"
MOTION, POINTS, TILT = "trajectory.csv", "points.csv", "tilt.csv"
COLUMNS = ("lead_deg", "side_deg")


def plan_tilted_pass(folder: Path) -> Job:
    """Plan the pass in the milling cell with a ball cutter that must be tilted."""
    cell = folder / "ball"
    shutil.copytree(CELLS / "kr500_milling", cell)
    text = (cell / "cell.yaml").read_text(encoding="utf-8")
    (cell / "cell.yaml").write_text(text.replace("length_mm", BALL, 1), encoding="utf-8")
    cut = (row for row in PASS if row[1] == 0)
    straight = (*cut, (-88, 0, 5, "retract", "1000"), (-88, 0, 60, "rapid", ""))
    return plan_table(folder, cell, straight, overrides=(RANGES,))


JOBS["tilted"] = plan_tilted_pass


def change_cutting_poses(change: Callable[[NDArray[np.float64]], None]) -> Callable[[Job], None]:
    """Return a damage that changes the tool poses (base_link) of all cutting rows, with matching joints and
    unchanged other columns."""

    def apply(job: Job) -> None:
        cell = load_cell(job.cell)
        robot, tcp = load_robot(cell), cell.tool.T_flange_tcp

        def drive(rows: Rows) -> None:
            q = np.radians([[float(row[c]) for c in JOINTS] for row in rows])
            poses = robot.compute_fk(q, tcp)
            change(poses)
            q, _ = refine_by_newton(robot, poses, q, tcp, 12)
            for row, joints in zip(rows, np.degrees(q), strict=True):
                row.update({c: f"{v:.9f}" for c, v in zip(JOINTS, joints, strict=True)})

        table(MOTION, change_cutting_rows(drive))(job)

    return apply


def lean_about_tip(angle_deg: float) -> Callable[[NDArray[np.float64]], None]:
    """Return a change that rotates the tool about its tip."""

    def change(poses: NDArray[np.float64]) -> None:
        a = np.radians(angle_deg)
        turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        poses[:, :3, :3] = poses[:, :3, :3] @ turn

    return change


def put_tip_on_path(poses: NDArray[np.float64]) -> None:
    """Shift the tilted tool so that its tip is at the position of a vertical tool: a' = −z; the axis in the file is
    z."""
    away = np.array([0.0, 0.0, 1.0]) + poses[:, :3, 2]
    poses[:, :3, 3] -= 1e-3 * RADIUS_MM * away


def change_every_row(change: Change) -> Callable[[Job], None]:
    def apply(job: Job) -> None:
        for name in (MOTION, POINTS, TILT):
            table(name, change)(job)

    return apply


def tilt(name: str, how_much: str, apply: Callable[[Job], None], caught_by: str) -> Damage:
    return Damage(f"tilt: {name}", how_much, apply, caught_by, job="tilted")


def samples(name: str, how_much: str, change: Change, caught_by: str = "tilt of the samples") -> Damage:
    return tilt(name, how_much, table(MOTION, change_cutting_rows(change)), caught_by)


def make_bull_nose(job: Job) -> None:
    """Give the cell that is used for the verification another cutter."""
    file = job.cell / "cell.yaml"
    file.write_text(file.read_text(encoding="utf-8").replace(BALL, "corner_radius_mm: 4, length_mm"), encoding="utf-8")


DAMAGES: list[Damage] = [
    Damage(
        "tilt: a cutter with a corner",
        "4 mm of 8.5 mm",
        make_bull_nose,
        "tilted cutter is a ball",
        job="tilted",
        as_is="made from these inputs",
    ),
    tilt(
        "a point without a lead",
        "one row",
        table(POINTS, set_value("lead_deg", "", slice(3, 4))),
        "points.csv tilt stated",
    ),
    samples("lead of the samples", "0.2 deg", add("lead_deg", 0.2)),
    samples("side of the samples", "0.2 deg", add("side_deg", -0.2)),
    samples("tilt in rad", "57 times", times(COLUMNS, np.pi / 180)),
    samples("lead and side exchanged", "all rows", swap(*COLUMNS)),
    samples("sign of the side", "all rows", times("side_deg", -1.0)),
    samples("no lead in a cutting row", "one row", set_value("lead_deg", ""), "tilt of the samples stated"),
    samples(
        "no side in cutting rows", "all rows", set_value("side_deg", "", slice(None)), "tilt of the samples stated"
    ),
    samples("samples outside the range", "20 deg", add("lead_deg", 20.0), "tilt range of the samples"),
    tilt("lead of a point", "1e-4 deg", table(POINTS, add("lead_deg", 1e-4, slice(3, 4))), "points.csv tilt"),
    tilt("side of points", "1e-4 deg", table(POINTS, add("side_deg", 1e-4)), "points.csv tilt"),
    tilt("lead of tilt.csv", "0.01 deg", table(TILT, add("lead_deg", 0.01)), "points.csv on the toolpath"),
    tilt(
        "a row of tilt.csv",
        "1e-6 deg",
        table(TILT, add("side_deg", 1e-6, slice(3, 4))),
        "points.csv and",
    ),
    tilt("a point missing in tilt.csv", "one row", table(TILT, lambda t: t.pop(3)), "tilt.csv complete"),
    tilt("tilt.csv outside the range", "20 deg", table(TILT, add("lead_deg", 20.0)), "tilt.csv range"),
    tilt("tables outside the range", "20 deg", change_every_row(add("lead_deg", 20.0)), "tilt range of the samples"),
    tilt("no tilt in any table", "all rows", change_every_row(times(COLUMNS, 0.0)), "tilt of the samples"),
    tilt("tool leaned about its tip", "0.2 deg", change_cutting_poses(lean_about_tip(0.2)), "tilt of the samples"),
    tilt("tip as of an upright tool", "8.5 mm (a − a')", change_cutting_poses(put_tip_on_path), "path"),
    tilt(
        "narrower range in result.json",
        "side up to 1.5 deg",
        build_json_change("result.json", lambda r: r["options"]["tilt_deg"].update(side=[1.0, 1.5])),
        "result.json options",
    ),
]
