"""Verification of a trajectory: a correct one passes, each kind of damage is detected."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cell import pose, real_cell, small_cell

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model import CollisionModel
from machopt.collision.collision_pairs import CollisionPair
from machopt.data_types.cell import Cell, CollisionShape, Tool
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.kinematics.inverse.solver import build_solver
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain, load_robot
from machopt.planning.motion.rapid_moves import retime_straight_segments
from machopt.verification import Verification
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.contact_search import find_contacts
from machopt.verification.motion.collision.cutter_contact_depth import check_cut_level
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.motion_verification import verify_motion
from machopt.verification.motion.path_geometry.sample_location import locate_samples
from machopt.verification.tables.exported_tables import read_motion

CYCLE = 0.012
FEED = 0.05  # m/s
GAMMA = 180.0  # deg: the x axis of the TCP is opposite to the travel, see solve()
# A slot 10 mm deep: entry over 40 mm and retract (m, in the workpiece frame on top of the block).
POINTS = np.array([[-0.1, 0, 0.04], [-0.1, 0, -0.01], [0, 0, -0.01], [0.1, 0, -0.01], [0.1, 0, 0.04]])
MOVES = [MoveKind.RAPID, MoveKind.APPROACH, MoveKind.CUT, MoveKind.CUT, MoveKind.RETRACT]


def toolpath() -> Toolpath:
    n = len(POINTS)
    feed = np.where(np.array(MOVES) == MoveKind.RAPID, np.nan, FEED)
    return Toolpath(
        position=POINTS.copy(),
        axis=np.tile([0, 0, 1.0], (n, 1)),
        move=np.array(MOVES, np.int8),
        feed=feed,
        operation=np.zeros(n, np.int32),
        operations=(ToolpathOperation("slot", "trajectory"),),
        reference=np.full((n, 3), np.nan),
        tolerance=np.full(n, np.nan),
        line=np.arange(1, n + 1, dtype=np.int32),
        source="slot.csv",
        format="csv",
        sha256="",
    )


def solve(robot: Robot, cell: Cell, tip: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Solve for the TCP at ``tip`` in the workpiece frame by Newton's method:
    pointing down, x opposite to the workpiece's."""
    T = cell.workpiece.T_link_workpiece @ np.vstack([np.column_stack([np.diag([-1.0, 1, -1]), tip]), [0, 0, 0, 1]])
    for _ in range(30):
        now, J = robot.compute_fk_jacobian(q, cell.tool.T_flange_tcp)
        turn = 0.5 * sum(np.cross(now[:3, k], T[:3, k]) for k in range(3))
        step = np.linalg.solve(J, np.append(T[:3, 3] - now[:3, 3], turn))
        q = q + np.clip(step, -0.3, 0.3)
        if np.abs(step).max() < 1e-12:
            break
    return q


def build_correct_columns(cell: Cell) -> dict[str, list[object]]:
    """Return the columns of a correct trajectory: home, rapid, down, cut, up, home."""
    robot = load_robot(cell)
    q = solve(robot, cell, POINTS[0], np.deg2rad([0, -60, 100, 0, 50, 0]))
    rapid = retime_straight_segments(np.array([cell.home, q]), cell.limits, 0.8, CYCLE)
    rows = [(np.nan if n < len(rapid) - 1 else 0.0, MoveKind.RAPID, row) for n, row in enumerate(rapid)]
    for a, b, move in ((0, 1, MoveKind.APPROACH), (1, 3, MoveKind.CUT), (3, 4, MoveKind.RETRACT)):
        way = np.linalg.norm(POINTS[b] - POINTS[a])
        count = int(np.ceil(1.875 * way / (0.9 * FEED) / CYCLE))  # a fifth-order ramp peaks at 15/8 of its mean
        for u in np.arange(1, count + 1) / count:
            share = u**3 * (10 - 15 * u + 6 * u * u)
            q = solve(robot, cell, POINTS[a] + share * (POINTS[b] - POINTS[a]), q)
            rows.append((a + share * (b - a), move, q))
    rows += [
        (np.nan, MoveKind.RAPID, row)
        for row in retime_straight_segments(np.array([q, cell.home]), cell.limits, 0.8, CYCLE)[1:]
    ]
    T = np.linalg.inv(cell.workpiece.T_link_workpiece) @ robot.compute_fk(
        np.array([r[2] for r in rows]), cell.tool.T_flange_tcp
    )
    speed = np.r_[0.0, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / CYCLE]
    s = np.array([r[0] for r in rows])
    back = int(np.flatnonzero(np.isfinite(s))[-1])
    table: dict[str, list[object]] = {
        "time_s": [n * CYCLE for n in range(len(rows))],
        "point": [r[0] for r in rows],
        "operation": ["slot" if n <= back else "" for n in range(len(rows))],
        "move": [r[1].word for r in rows],
    }
    for i in range(6):
        table[f"q{i + 1}_deg"] = [float(np.degrees(r[2][i])) for r in rows]
    table["gamma_deg"] = [np.nan if r[1] == MoveKind.RAPID else GAMMA for r in rows]
    table["feed_mm_min"] = [6e4 * v for v in speed.tolist()]
    return table


def points_table(table: dict[str, list[object]], cell: Cell) -> dict[str, list[object]]:
    """Return the values of the planner's own model at the points, with the words of its exporter."""
    q = np.array([table[f"q{i}_deg"] for i in range(1, 7)], float).T
    s = np.array(table["point"], float)
    known = np.flatnonzero(np.isfinite(s))
    at = np.array([[np.interp(k, s[known], q[known, i]) for i in range(6)] for k in range(len(POINTS))])
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, 0.002)
    near = model.find_nearest_pair(np.radians(at), np.ones(len(POINTS), bool))
    solver = build_solver(robot)
    found = solver.solve(robot.compute_fk(np.radians(at)))
    branch = np.nanargmin(np.abs(np.angle(np.exp(1j * (found.q - np.radians(at)[:, None])))).max(axis=2), axis=1)
    rows = np.arange(len(POINTS))
    singular = np.minimum(found.wrist[rows, branch], found.elbow[rows, branch])
    singular = np.degrees(np.minimum(singular, np.arctan(found.shoulder[rows, branch])))
    margin = np.degrees(np.minimum(np.radians(at) - cell.limits.lower, cell.limits.upper - np.radians(at)).min(axis=1))
    blank = [np.nan] * len(POINTS)
    out: dict[str, list[object]] = {
        "point": list(range(len(POINTS))),
        "operation": ["slot"] * len(POINTS),
        "move": [m.word for m in MOVES],
        **{f"{c}_mm": list(1e3 * POINTS[:, n]) for n, c in enumerate("xyz")},
        "i": [0.0] * 5,
        "j": [0.0] * 5,
        "k": [1.0] * 5,
        "gamma_deg": [GAMMA] * 5,
        "branch": branch.tolist(),
        **{f"q{i + 1}_deg": at[:, i].tolist() for i in range(6)},
        "k_axial_N_mm": blank,
        "k_normal_N_mm": list(blank),
        "deflection_mm": list(blank),
        "clearance_mm": (1e3 * near.distance).tolist(),
        "limit_margin_deg": margin.tolist(),
        "singularity": singular.tolist(),
        "status": ["ok"] * len(POINTS),
        "reason": [""] * len(POINTS),
        "nearest_pair": [model.pairs[p].name if p >= 0 else "" for p in near.pair],
    }
    return out


def write(file: Path, table: dict[str, list[object]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        stream.write("# written by a test\n")
        writer = csv.writer(stream)
        writer.writerow(table)
        for row in zip(*table.values(), strict=True):
            writer.writerow(
                [
                    f"{x:.9f}" if isinstance(x, float) and np.isfinite(x) else ("" if isinstance(x, float) else x)
                    for x in row
                ]
            )


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    return small_cell(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def table(cell: Cell) -> dict[str, list[object]]:
    return build_correct_columns(cell)


Damage = Callable[[dict[str, list[object]]], None]


def verify_damaged(
    cell: Cell,
    table: dict[str, list[object]],
    out: Path,
    damage: Damage | None = None,
    points: Damage | None = None,
    options: PlanOptions | None = None,
) -> Verification:
    copy = {name: list(column) for name, column in table.items()}
    of_points = points_table(copy, cell)
    if damage is not None:
        damage(copy)
    if points is not None:
        points(of_points)
    write(out / "trajectory.csv", copy)
    write(out / "points.csv", of_points)
    return verify_motion(cell, toolpath(), out, options=options)


def names(result: Verification) -> set[str]:
    return {check.name for check in result.failed}


def test_correct_trajectory_passes(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    result = verify_damaged(cell, table, tmp_path)
    assert result.ok, result.failed
    assert result.samples == len(table["time_s"])
    by_name = {check.name: check for check in result.checks}
    assert by_name["path"].value < 1e-4
    assert 0.85 < by_name["feed"].value <= 0.95
    assert by_name["joint velocity"].value < 0.85


def shift(name: str, rows: slice, by: float) -> Damage:
    def damage(t: dict[str, list[object]]) -> None:
        t[name][rows] = [float(x) + by for x in t[name][rows]]  # type: ignore[arg-type]

    return damage


def cut_rows(table: dict[str, list[object]]) -> np.ndarray:
    return np.flatnonzero(np.array(table["move"]) == "cut")


def test_each_damage_is_detected(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    cut = cut_rows(table)
    middle = int(cut[len(cut) // 2])
    here = slice(middle, middle + 1)

    def failed(damage: Damage, **more: object) -> set[str]:
        return names(verify_damaged(cell, table, tmp_path, damage, **more))  # type: ignore[arg-type]

    # 0.002° of joint 1 at a radius of 1.5 m is 52 µm along the path.
    assert {"path", "joint jerk"} <= failed(shift("q1_deg", here, 0.002))
    assert {"tool axis"} <= failed(shift("q4_deg", slice(None), 0.1))
    assert failed(shift("time_s", here, 0.0001)) == {"uniform time"}
    assert {"joint velocity", "joint acceleration"} <= failed(shift("q6_deg", slice(middle, None), 10.0))
    assert {"joint positions"} <= failed(shift("q6_deg", slice(None), 360.0))

    def quicker(t: dict[str, list[object]]) -> None:
        t["time_s"] = [0.8 * float(x) for x in t["time_s"]]  # type: ignore[arg-type]

    assert {"feed"} <= failed(quicker)

    def skip(t: dict[str, list[object]]) -> None:
        for n in cut:
            if float(t["point"][n]) > 2.4:  # type: ignore[arg-type]
                t["move"][n] = "link"

    assert "cutting points visited" in failed(skip)

    def lifted(t: dict[str, list[object]]) -> None:
        for n in cut:
            if 2.2 < float(t["point"][n]) < 2.8:  # type: ignore[arg-type]
                t["move"][n] = "link"

    # both end points are visited, the middle is not, although the file cuts there
    assert failed(lifted) == {"cut throughout", "moves of the samples"}

    def swapped(t: dict[str, list[object]]) -> None:
        t["point"][middle], t["point"][middle + 4] = t["point"][middle + 4], t["point"][middle]

    assert "in order" in failed(swapped)

    def lost(t: dict[str, list[object]]) -> None:
        t["point"][middle] = np.nan

    assert "path" in failed(lost)

    def nothing_cut(t: dict[str, list[object]]) -> None:
        t["move"] = ["link"] * len(t["move"])

    result = failed(nothing_cut)
    assert {"path", "moves of the samples", "cutting points visited"} <= result


def test_contradicting_points_are_detected(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    def other_wrist(t: dict[str, list[object]]) -> None:
        t["q6_deg"][2] = float(t["q6_deg"][2]) + 5.0  # type: ignore[arg-type]

    assert {"points.csv as driven", "points.csv gamma_deg"} <= names(
        verify_damaged(cell, table, tmp_path, points=other_wrist)
    )

    def elsewhere(t: dict[str, list[object]]) -> None:
        t["q1_deg"][3] = float(t["q1_deg"][3]) + 0.01  # type: ignore[arg-type]

    assert "points.csv on the toolpath" in names(verify_damaged(cell, table, tmp_path, points=elsewhere))

    def shorter(t: dict[str, list[object]]) -> None:
        for column in t.values():
            del column[-1]

    assert names(verify_damaged(cell, table, tmp_path, points=shorter)) == {"points.csv complete"}


def test_gaps_are_accepted_only_where_allowed(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    def stop_early(t: dict[str, list[object]]) -> None:
        for n in cut_rows(table):
            if float(t["point"][n]) > 2.4:  # type: ignore[arg-type]
                t["move"][n] = "link"

    def given_up(t: dict[str, list[object]]) -> None:
        t["status"][3] = "unreachable"
        for i in range(1, 7):
            t[f"q{i}_deg"][3] = np.nan

    assert "cutting points visited" in names(verify_damaged(cell, table, tmp_path, stop_early, given_up))
    # the gap itself is allowed; a motion to the omitted point, labelled as another kind of move, is not
    gap = PlanOptions(allow_gaps=True)
    failed = names(verify_damaged(cell, table, tmp_path, stop_early, given_up, gap))
    assert {"points given up are not driven", "moves of the samples", "points.csv status"} <= failed
    assert not {"cutting points visited", "cut throughout"} & failed


def test_contacts_are_detected(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    part = cell.workpiece

    def hits(changed: Cell, damage: Damage | None = None) -> str:
        result = verify_damaged(changed, table, tmp_path, damage)
        assert names(result) in ({"contacts"}, {"contacts", "requested: clearance_mm"}), result.failed
        return next(check.where for check in result.failed if check.name == "contacts")

    clamp = CollisionShape(
        name="clamp", kind="box", size=(0.03, 0.03, 0.06), mesh=None, T_parent_shape=pose(1.5, 0.0, 0.63)
    )
    assert "clamp ~ cutter" in hits(replace(cell, obstacles=(*cell.obstacles, clamp)))
    boss = CollisionShape(
        name="boss",
        kind="box",
        size=(0.02, 0.02, 0.08),
        mesh=None,
        T_parent_shape=pose(0.05, 0.05, 0.04),  # next to the cutter, below the spindle
    )
    assert "boss ~ spindle" in hits(replace(cell, workpiece=replace(part, geometry=(*part.geometry, boss))))
    wall = CollisionShape(
        name="wall", kind="box", size=(0.02, 2.0, 2.0), mesh=None, T_parent_shape=pose(-0.5, 0.0, 1.5)
    )  # behind the robot, where nothing moves
    assert verify_damaged(replace(cell, obstacles=(*cell.obstacles, wall)), table, tmp_path).ok
    bulky = Tool(
        T_flange_tcp=cell.tool.T_flange_tcp,
        geometry=(
            CollisionShape(
                name="cabinet", kind="box", size=(0.1, 0.1, 1.4), mesh=None, T_parent_shape=pose(0.4, 0, -0.3)
            ),
        ),
    )
    assert "cabinet" in hits(replace(cell, tool=bulky))

    def rapid(t: dict[str, list[object]]) -> None:
        # the file leaves the slot with a feed move
        t["move"] = ["rapid" if word == "retract" else word for word in t["move"]]

    assert {"moves of the samples", "in order"} <= names(verify_damaged(cell, table, tmp_path, rapid))

    def unmeasured(t: dict[str, list[object]]) -> None:
        t["clearance_mm"] = [np.nan] * len(POINTS)
        t["nearest_pair"] = [""] * len(POINTS)

    off = verify_damaged(
        replace(cell, obstacles=(*cell.obstacles, clamp)),
        table,
        tmp_path,
        points=unmeasured,
        options=PlanOptions(collision=False),
    )
    assert off.ok
    assert [c.name for c in off.checks if c.passed is None and "switched off" in c.where] == ["collisions"]


def test_contact_between_samples_is_detected(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    """A sheet thinner than one sample step is placed between two samples of the rapid move."""
    tcp = UrdfKinematics(cell).compute_tcp_in_workpiece(
        np.deg2rad(np.array([table[f"q{i}_deg"] for i in range(1, 7)], float).T), np.zeros((len(table["q1_deg"]), 0))
    )
    x = tcp[:, :3, 3]
    way = np.linalg.norm(np.diff(x, axis=0), axis=1)
    n = int(np.argmax(way))
    assert way[n] > 0.01
    normal = (x[n + 1] - x[n]) / way[n]
    across = np.linalg.svd(normal[None])[2][1:]
    place = np.eye(4)
    place[:3, :3] = np.column_stack([across[0], across[1], np.cross(across[0], across[1])])
    place[:3, 3] = 0.5 * (x[n] + x[n + 1])
    sheet = CollisionShape(
        name="sheet",
        kind="box",
        size=(0.004, 0.004, 0.0005),
        mesh=None,
        T_parent_shape=cell.workpiece.T_link_workpiece @ place,
    )
    pin = replace(cell.tool.cutter, diameter=0.002, length=0.003) if cell.tool.cutter else None
    slim = replace(cell, tool=replace(cell.tool, cutter=pin), obstacles=(sheet,))
    result = verify_damaged(slim, table, tmp_path)
    assert "sheet ~ cutter" in {c.name: c for c in result.checks}["contacts"].where


def coal_distance(cell: Cell, arm: UrdfKinematics, q: np.ndarray, pair: CollisionPair) -> float:
    import coal

    bodies = {b.name: b for b in build_bodies(cell, arm)}
    world = arm.compute_placements(q[None], np.zeros((1, 0)))[0]
    ends = []
    for name in (pair.a, pair.b):
        body = bodies[name]
        T = body.place if body.carrier < 0 else world[body.carrier] @ body.place
        ends += [body.shape, coal.Transform3s(T[:3, :3], T[:3, 3])]
    return float(coal.distance(*ends, coal.DistanceRequest(), coal.DistanceResult()))


@pytest.mark.parametrize("name", ["small", "kr210l150", "kr500_r2800_2"])
def test_contacts_agree_with_the_collision_model_of_the_planner(tmp_path: Path, name: str) -> None:
    """Two libraries and two bounds give the same contacting pairs for random motions."""
    cell = small_cell(tmp_path) if name == "small" else real_cell(tmp_path, name, meshes=True)
    robot, shapes = load_chain(cell)
    cell = replace(cell, limits=replace(cell.limits, lower=robot.lower, upper=robot.upper))
    model, arm = CollisionModel(cell, robot, shapes, 0.0), UrdfKinematics(cell)
    rng = np.random.default_rng(4)
    outcomes = []
    for _ in range(12):
        a = robot.lower + (robot.upper - robot.lower) * rng.random(6)
        q = a + np.linspace(0, 1, 8)[:, None] * rng.uniform(-0.8, 0.8, 6)
        rapid = np.ones(8, bool)
        theirs = find_contacts(arm, list_checked_pairs(cell, arm, build_bodies(cell, arm)), q, np.zeros((8, 0)), rapid)
        ours = model.check_motion(q, ~rapid, np.deg2rad(1))
        named = {c.pair for c in theirs}
        for n in np.flatnonzero(ours.hit):
            # then the contact is marginal: the spheres of the planner are up to 0.7 % too large
            if model.pairs[ours.pair[n]].name not in named:
                where = q[0] + ours.row[n] / 7 * (q[7] - q[0])
                assert coal_distance(cell, arm, where, model.pairs[ours.pair[n]]) < 0.09 * 0.007
        assert ours.any or not theirs
        outcomes.append(ours.any)
    assert any(outcomes)
    assert not all(outcomes)


def test_unreadable_tables_are_refused(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    def drop(t: dict[str, list[object]]) -> None:
        del t["q3_deg"]

    def word(t: dict[str, list[object]]) -> None:
        t["move"][3] = "fly"

    def number(t: dict[str, list[object]]) -> None:
        t["q2_deg"][4] = "1,5"

    for damage, message in ((drop, "'q3_deg' is missing"), (word, "'fly' is no move"), (number, "not a finite number")):
        (check,) = verify_damaged(cell, table, tmp_path, damage).failed
        assert check.name == "trajectory.csv can be read"
        assert message in check.where
    (check,) = verify_motion(cell, toolpath(), tmp_path / "nowhere").failed
    assert "cannot be read" in check.where


def test_cuts_give_the_material_level_without_a_mesh(
    cell: Cell, table: dict[str, list[object]], tmp_path: Path
) -> None:
    """Below a cut is material, above it is air; next to it the level is unknown, which is reported."""
    bare = replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    write(tmp_path / "trajectory.csv", table)
    motion, path = read_motion(tmp_path / "trajectory.csv", cell), toolpath()
    tcp = UrdfKinematics(cell).compute_tcp_in_workpiece(motion.q, motion.external)
    every = np.arange(len(path), dtype=float)

    def told(tip: tuple[float, float, float]) -> list[tuple[str, bool | None]]:
        moved = tcp.copy()
        n = int(np.flatnonzero(np.isfinite(motion.point))[0])  # the end of the first rapid move
        moved[n, :3, 3] = tip
        on = locate_samples(motion, path, every, path.position, moved, PlanOptions())
        assert on.is_free[n]
        return [(c.name, c.passed) for c in check_cut_level(motion, path, on, bare)]

    assert told((0.05, 0.0, 0.03)) == [("level of the cuts", True)]
    assert told((0.05, 0.0, -0.07)) == [("level of the cuts", False)]
    assert told((0.05, 0.1, -0.07)) == [("level of the cuts", True), ("level beside the cuts", None)]
    on = locate_samples(motion, path, every, path.position, tcp, PlanOptions())
    assert check_cut_level(motion, path, on, cell) == []  # the mesh defines the material


def test_moves_from_and_to_home_remain_over_the_cuts(
    cell: Cell, table: dict[str, list[object]], tmp_path: Path
) -> None:
    """These moves were not checked; a tip at rest below a cut cannot be checked, which is reported."""
    bare = replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    write(tmp_path / "trajectory.csv", table)
    motion, path = read_motion(tmp_path / "trajectory.csv", cell), toolpath()
    tcp = UrdfKinematics(cell).compute_tcp_in_workpiece(motion.q, motion.external)
    on_path, every = np.flatnonzero(np.isfinite(motion.point)), np.arange(len(path), dtype=float)

    def told(row: int, tip: tuple[float, float, float]) -> list[tuple[str, bool | None]]:
        moved = tcp.copy()
        moved[row] = tcp[on_path[0]]
        moved[row, :3, 3] = tip
        on = locate_samples(motion, path, every, path.position, moved, PlanOptions())
        return [(c.name, c.passed) for c in check_cut_level(motion, path, on, bare)]

    last = len(tcp) - 1
    assert on_path[0] > 1
    assert on_path[-1] < last - 1
    for row in (1, on_path[0] - 1, on_path[-1] + 1, last - 1):
        assert told(int(row), (0.05, 0.0, -0.07)) == [("level of the cuts", False)]
        assert told(int(row), (0.05, 0.0, 0.03)) == [("level of the cuts", True)]
        # next to the cut the level is unknown
        assert told(int(row), (0.05, 0.1, -0.07)) == [("level of the cuts", True)]
    for row in (0, last):
        expected = [("level of the cuts", True), ("level of moves from and to rest", None)]
        assert told(row, (0.05, 0.0, -0.07)) == expected


def test_shifted_cut_is_left_at_its_end(cell: Cell, table: dict[str, list[object]], tmp_path: Path) -> None:
    """A path without a mesh, compensated by 0.6 mm downwards, failed at the first sample of the retract."""
    bare = replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    write(tmp_path / "trajectory.csv", table)
    motion, path = read_motion(tmp_path / "trajectory.csv", cell), toolpath()
    tcp = UrdfKinematics(cell).compute_tcp_in_workpiece(motion.q, motion.external)
    n = int(np.flatnonzero(np.isfinite(motion.point))[0])
    tcp[n, :3, 3] = path.position[path.cutting][0] - 0.6e-3 * path.axis[path.cutting][0]
    every = np.arange(len(path), dtype=float)
    on = locate_samples(motion, path, every, path.position, tcp, PlanOptions())
    shifted = every, path.position - np.where(path.cutting, 0.6e-3, 0.0)[:, None] * path.axis
    assert not check_cut_level(motion, path, on, bare)[0].passed
    assert check_cut_level(motion, path, on, bare, shifted)[0].passed


def test_verification_shares_nothing_with_the_planner() -> None:
    import machopt.verification as package

    own = ("planning", "kinematics", "collision", "dynamics", "stiffness", "numerics.rigid_transforms")
    readers = ("cell", "toolpath", "path_building", "programs", "file_formats", "input_files", "options")
    folder = Path(package.__file__).parent
    files = [f for f in folder.rglob("*.py") if f.relative_to(folder).parts[0] != "folder"]
    assert len(files) > 40
    for file in files:
        text = file.read_text(encoding="utf-8")
        for word in (*own, *readers):
            assert not re.search(rf"machopt\.{word}\b", text), (file, word)


CELLS = Path(__file__).resolve().parents[1] / "cells"


@pytest.mark.parametrize("name", sorted(p.parent.name for p in CELLS.glob("*/cell.yaml")))
def test_planner_and_verification_check_the_same_pairs_in_the_shipped_cells(name: str) -> None:
    cell = load_cell(CELLS / name)
    robot, shapes = load_chain(cell)
    model, arm = CollisionModel(cell, robot, shapes, 0.002), UrdfKinematics(cell)
    checked = {frozenset((a.name, b.name)) for a, b in list_checked_pairs(cell, arm, build_bodies(cell, arm))}
    assert checked == {frozenset((p.a, p.b)) for p in model.pairs}
    assert not model.suspicious
