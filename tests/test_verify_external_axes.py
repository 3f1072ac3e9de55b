"""Verification of motions with moving rail and table that were generated without the planner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from external_axis_cells import external_cell
from test_verify_trajectory import CYCLE, FEED, GAMMA, MOVES, POINTS, Damage, names, shift, toolpath, write

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.robot_program import LIN, PTP, RobotProgram
from machopt.data_types.toolpath import MoveKind
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.machine import Machine, load_machine
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.planning.motion.rapid_moves import retime_straight_segments
from machopt.programs.program_writer import write_program
from machopt.programs.writing.target_insertion import ProgramTolerance, insert_targets
from machopt.verification import Verification
from machopt.verification.folder.programs.post_lookup import build_short_program
from machopt.verification.folder.programs.program_comparison_result import ListedProgram
from machopt.verification.folder.programs.read_back import check_programs
from machopt.verification.motion.kinematics.posture import compute_posture
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.motion_verification import verify_motion
from machopt.verification.tables.exported_tables import ExportedMotion, read_motion

WAY = {"rail": 0.25, "tilt": 0.08, "turn": 0.3}  # m or rad, during a cut of 0.2 m
KINDS = {"rail": {"rail": True}, "table": {"table": True, "tilt": True}, "both": {"rail": True, "table": True}}
Columns = dict[str, list[object]]


def solve(m: Machine, cell: Cell, tips: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return (N, 6 + E) by Newton's method in the arm's columns, starting from (N, 6 + E).

    The TCP is at ``tips`` (N, 3) in the part and points down; its x axis is opposite to that of the part.
    """
    R = np.diag([-1.0, 1.0, -1.0])
    for _ in range(30):
        now, J = m.compute_fk_jacobian(x, cell.tool.T_flange_tcp)
        turn = 0.5 * np.cross(now[:, :3, :3], R[None], axis=1).sum(axis=2)
        step = np.linalg.solve(J[:, :, :6], np.hstack([tips - now[:, :3, 3], turn])[..., None])[..., 0]
        x = np.hstack([x[:, :6] + np.clip(step, -0.3, 0.3), x[:, 6:]])
        if np.abs(step).max() < 1e-12:
            break
    return x


def build_correct_columns(cell: Cell) -> tuple[Columns, np.ndarray]:
    """Return the columns of a correct trajectory, and (P, 6 + E) at the points."""
    m = load_machine(cell, load_robot(cell))
    home = np.append(cell.home, cell.external_home)
    way = np.array([WAY[name] for name in cell.external_joints])
    index, moves, tips, rested = [np.zeros(1)], [MoveKind.RAPID], [POINTS[:1]], [np.zeros((1, len(way)))]
    for a, b, move in ((0, 1, MoveKind.APPROACH), (1, 3, MoveKind.CUT), (3, 4, MoveKind.RETRACT)):
        count = int(np.ceil(1.875 * np.linalg.norm(POINTS[b] - POINTS[a]) / (0.9 * FEED) / CYCLE))
        u = np.arange(1, count + 1)[:, None] / count
        share = u**3 * (10 - 15 * u + 6 * u * u)
        index.append(a + share[:, 0] * (b - a))
        moves += [move] * count
        tips.append(POINTS[a] + share * (POINTS[b] - POINTS[a]))
        rested.append(
            0.5 * (1.0 - np.cos(np.pi * share)) * way
            if move == MoveKind.CUT
            else np.full((count, 1), float(a >= 3)) * way
        )
    e = np.vstack([*rested, np.array([[0.0], [0.0], [0.5], [1.0], [1.0]]) * way])
    start = np.tile(np.deg2rad([0, -60, 100, 0, 50, 0]), (len(e), 1))
    x = solve(m, cell, np.vstack([*tips, POINTS]), np.hstack([start, e]))
    led, at = x[: -len(POINTS)], x[-len(POINTS) :]
    there, back = (
        retime_straight_segments(np.array(ends), cell.limits, 0.8, CYCLE) for ends in ([home, led[0]], [led[-1], home])
    )
    X = np.vstack([there[:-1], led, back[1:]])
    s = np.r_[np.full(len(there) - 1, np.nan), np.concatenate(index), np.full(len(back) - 1, np.nan)]
    moves = [MoveKind.RAPID] * (len(there) - 1) + moves + [MoveKind.RAPID] * (len(back) - 1)
    T = m.compute_fk(X, cell.tool.T_flange_tcp)
    speed = np.r_[0.0, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / CYCLE]
    last = int(np.flatnonzero(np.isfinite(s))[-1])
    table: Columns = {
        "time_s": [n * CYCLE for n in range(len(X))],
        "point": s.tolist(),
        "operation": ["slot" if n <= last else "" for n in range(len(X))],
        "move": [move.word for move in moves],
        **joints(cell, X),
        "gamma_deg": [np.nan if move == MoveKind.RAPID else GAMMA for move in moves],
        "feed_mm_min": (6e4 * speed).tolist(),
    }
    return table, at


def joints(cell: Cell, X: np.ndarray) -> Columns:
    out: Columns = {f"q{k + 1}_deg": np.degrees(X[:, k]).tolist() for k in range(6)}
    for k, slides in enumerate(cell.external_prismatic):
        values = X[:, 6 + k]
        out[f"e{k + 1}_{'mm' if slides else 'deg'}"] = (1e3 * values if slides else np.degrees(values)).tolist()
    return out


def points_table(cell: Cell, X: np.ndarray) -> Columns:
    """Return the values of the planner's own model at the points."""
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, 0.002)
    near = model.find_nearest_pair(X, np.ones(len(X), bool))
    found = build_solver(robot).solve(robot.compute_fk(X[:, :6]))
    off = np.abs(np.angle(np.exp(1j * (found.q - X[:, None, :6])))).max(axis=2)
    placed = compute_posture(UrdfKinematics(cell).compute_configuration(X[:, :6], X[:, 6:]))
    lower, upper = cell.limits.lower[:6], cell.limits.upper[:6]
    margin = np.minimum(X[:, :6] - lower, upper - X[:, :6]).min(axis=1)
    n = len(X)
    blank = [np.nan] * n
    return {
        "point": list(range(n)),
        "operation": ["slot"] * n,
        "move": [m.word for m in MOVES],
        **{f"{c}_mm": list(1e3 * POINTS[:, k]) for k, c in enumerate("xyz")},
        **{c: [float(c == "k")] * n for c in "ijk"},
        "gamma_deg": [GAMMA] * n,
        "branch": np.nanargmin(off, axis=1).tolist(),
        **joints(cell, X),
        "k_axial_N_mm": blank,
        "k_normal_N_mm": list(blank),
        "deflection_mm": list(blank),
        "clearance_mm": (1e3 * near.distance).tolist(),
        "limit_margin_deg": np.degrees(margin).tolist(),
        "singularity": np.degrees(placed.singularity).tolist(),
        "status": ["ok"] * n,
        "reason": [""] * n,
        "nearest_pair": [model.pairs[p].name if p >= 0 else "" for p in near.pair],
    }


Made = tuple[Cell, Columns, Columns]


@pytest.fixture(scope="module", params=KINDS)
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    cell = external_cell(tmp_path_factory.mktemp("cell"), **KINDS[request.param])
    table, at = build_correct_columns(cell)
    return cell, table, points_table(cell, at)


def verify_damaged(
    made: Made, out: Path, damage: Damage | None = None, points: Damage | None = None, cell: Cell | None = None
) -> Verification:
    motion, message = ({name: list(column) for name, column in of.items()} for of in made[1:])
    for change, of in ((damage, motion), (points, message)):
        if change is not None:
            change(of)
    write(out / "trajectory.csv", motion)
    write(out / "points.csv", message)
    return verify_motion(cell or made[0], toolpath(), out)


def external(made: Made) -> str:
    return next(name for name in made[1] if name.startswith("e1_"))


def test_correct_motion_passes(made: Made, tmp_path: Path) -> None:
    result = verify_damaged(made, tmp_path)
    assert result.ok, result.failed
    by_name = {check.name: check for check in result.checks}
    assert by_name["path"].value < 1e-4
    assert 0.85 < by_name["feed"].value <= 0.95  # feed of the tool relative to the part; relative to world it differs
    assert by_name["points.csv on the toolpath"].passed


def test_damages_are_detected(made: Made, tmp_path: Path) -> None:
    cut = np.flatnonzero(np.array(made[1]["move"]) == "cut")
    middle, e = int(cut[len(cut) // 2]), external(made)
    here, size = slice(middle, middle + 1), 0.1  # mm or deg
    assert {"path", "joint jerk"} <= names(verify_damaged(made, tmp_path, shift(e, here, size)))
    assert {"path", "from home to home"} <= names(verify_damaged(made, tmp_path, shift(e, slice(None), size)))
    assert "points.csv on the toolpath" in names(verify_damaged(made, tmp_path, None, shift(e, slice(2, 3), size)))

    def exchanged(t: Columns) -> None:
        wrong = e.replace("_mm", "_deg") if e.endswith("_mm") else e.replace("_deg", "_mm")
        t[wrong] = t.pop(e)

    (unread,) = verify_damaged(made, tmp_path, exchanged).failed
    assert f"column '{e}' is missing" in unread.where

    cell = made[0]
    slower = replace(cell.limits, velocity=np.append(cell.limits.velocity[:6], 0.01 * cell.limits.velocity[6:]))
    (fast,) = (
        c for c in verify_damaged(made, tmp_path, cell=replace(cell, limits=slower)).failed if "velocity" in c.name
    )
    assert "external axis e" in fast.where


def program(cell: Cell, motion: ExportedMotion, tolerance: ProgramTolerance) -> RobotProgram:
    """Return a program: home, the first point, lines to each point and to inserted targets, home.

    Targets are inserted where the motion of the axes is not uniform.
    """
    arm, x = UrdfKinematics(cell), np.hstack([motion.q, motion.external])
    T = arm.compute_tcp_in_workpiece(motion.q, motion.external)
    known = np.flatnonzero(np.isfinite(motion.point))
    at = np.r_[0, [known[np.abs(motion.point[known] - k).argmin()] for k in range(len(POINTS))], len(x) - 1]
    kind = np.array([PTP, PTP, *[LIN] * (len(POINTS) - 1), PTP], np.int8)
    move = np.array([MoveKind.RAPID, *MOVES, MoveKind.RAPID], np.int8)
    external = motion.external, motion.external[at]
    added = insert_targets(T, T[at], at.astype(float), kind == LIN, tolerance, external)
    place = np.searchsorted(at, added)
    at, kind, move = np.insert(at, place, added), np.insert(kind, place, LIN), np.insert(move, place, move[place])
    return replace(
        build_short_program(cell, load_robot(cell), cell.controller),
        kind=kind,
        q=x[at, :6],
        external=x[at, 6:],
        T_workpiece_tcp=T[at],
        feed=np.where(kind == LIN, FEED, np.nan),
        cutting=move == MoveKind.CUT,
        move=move,
        operation=np.where(np.isfinite(motion.point[at]), 0, -1).astype(np.int32),
        operations=("slot",),
        wrist_behind=None,
        elbow_up=None,
        time=None,
    )


def test_program_with_uniform_axis_motion_between_targets(made: Made, tmp_path: Path) -> None:
    """With enough inserted targets the program follows the motion; without them, the external axes deviate from it."""
    cell = made[0]
    verify_damaged(made, tmp_path)
    motion = read_motion(tmp_path / "trajectory.csv", cell)
    for tolerance, passed in ((ProgramTolerance(), True), (ProgramTolerance(external=1.0), False)):
        write_program(tmp_path, "slot", program(cell, motion, tolerance), "krl", cell.controller)
        posted = [ListedProgram("krl", "krl", ("slot.src", "slot.dat"))]
        (found,) = check_programs(
            cell, toolpath(), tmp_path, posted, options=PlanOptions(), tolerance=ProgramTolerance(), tables=motion
        )
        assert found.get_verdict("external axes at targets") is True
        assert found.get_verdict("lines along the motion") is True
        assert found.get_verdict("external axes along lines") is passed, found.get_value("external axes along lines")
        wrong = [d for d in found.differences if not d.startswith(("wording", "zones", "external axes along"))]
        assert wrong == []
