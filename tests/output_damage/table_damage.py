"""Damages of points.csv and trajectory.csv: every column, small and large errors, units, signs, rows, labels, and dips.

``how_much`` is the smallest detectable size where there is one; smaller changes are within the printed decimals.
Dependent columns are changed consistently (a dip has matching time, index and feed).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from machopt.cell.cell_reader import load_cell
from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.kinematics.urdf_loading import load_robot
from output_damage.damage_case import Damage, Job, build_table_change, build_text_change

Row = dict[str, str]
Rows = list[Row]
Change = Callable[[Rows], object]
JOINTS = [f"q{i}_deg" for i in range(1, 7)]
CUT = slice(3, 7)  # points of the pass that end a cutting move
ONE = slice(4, 5)
EVERY = slice(None)


def add(column: str, by: float, rows: slice = EVERY) -> Change:
    def change(table: Rows) -> None:
        for row in table[rows]:
            if row[column]:
                row[column] = f"{float(row[column]) + by:.9f}"

    return change


def times(columns: str | Sequence[str], factor: float, rows: slice = EVERY) -> Change:
    def change(table: Rows) -> None:
        for row in table[rows]:
            for column in [columns] if isinstance(columns, str) else columns:
                if row[column]:
                    row[column] = f"{float(row[column]) * factor:.12f}"

    return change


def set_value(column: str, word: str, rows: slice = ONE) -> Change:
    def change(table: Rows) -> None:
        for row in table[rows]:
            row[column] = word

    return change


def remove_first_reason(table: Rows) -> None:
    next(row for row in table if row["reason"])["reason"] = ""


def swap(a: str, b: str) -> Change:
    def change(table: Rows) -> None:
        for row in table:
            row[a], row[b] = row[b], row[a]

    return change


def shift_columns_by_one_row(columns: Sequence[str]) -> Change:
    """Return a change that shifts the columns by one row relative to the others."""

    def change(table: Rows) -> None:
        before = [{c: row[c] for c in columns} for row in table]
        for row, old in zip(table[1:], before, strict=False):
            row.update(old)

    return change


def change_cutting_rows(change: Callable[[Rows], object], rows: slice = EVERY) -> Change:
    """Return the change applied to the cutting rows of trajectory.csv."""
    return lambda table: change([row for row in table if row["move"] == "cut"][rows])


def given_up(table: Rows) -> None:
    """Mark a point as unreachable in the planner's format, although the motion reaches it."""
    row = table[5]
    row.update(status="unreachable", reason="out of reach at every rotation")
    for name in (
        "gamma_deg",
        "branch",
        *JOINTS,
        "k_axial_N_mm",
        "k_normal_N_mm",
        "deflection_mm",
        "clearance_mm",
        "limit_margin_deg",
        "singularity",
        "k_jiao_x_N_mm",
        "nearest_pair",
    ):
        row[name] = ""


def rewrite_times(table: Rows) -> None:
    for n, row in enumerate(table):
        row["time_s"] = f"{0.012 * n:.3f}"


def remove_rows(rows: slice) -> Change:
    def change(table: Rows) -> None:
        del table[rows]
        rewrite_times(table)

    return change


def middle(table: Rows) -> int:
    cut = [n for n, row in enumerate(table) if row["move"] == "cut"]
    return cut[len(cut) // 2]


def lost_row(table: Rows) -> None:
    del table[middle(table)]
    rewrite_times(table)


def repeated_row(table: Rows) -> None:
    n = middle(table)
    table.insert(n, dict(table[n]))
    rewrite_times(table)


def reversed_rows(table: Rows) -> None:
    n = middle(table)
    part = [{c: row[c] for c in JOINTS} for row in table[n : n + 16]]
    for row, old in zip(table[n : n + 16], reversed(part), strict=True):
        row.update(old)


def rapids(word: str) -> Change:
    """Return a change of the move label at the end of the first rapid move, which has an index."""

    def change(table: Rows) -> None:
        last = next(n for n, row in enumerate(table) if row["move"] != "rapid") - 1
        table[last]["move"] = word

    return change


def rotate_tool_at_point_4(degrees: float) -> Callable[[Job], None]:
    """Return a damage that rotates the tool at point 4 about its own axis: joints and rotation are consistent, but
    the motion differs."""

    def apply(job: Job) -> None:
        cell = load_cell(job.cell)
        robot, tcp = load_robot(cell), cell.tool.T_flange_tcp

        def change(table: Rows) -> None:
            row = table[4]
            q = np.radians([float(row[c]) for c in JOINTS])
            a = np.radians(degrees)
            turn = np.eye(4)
            turn[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
            q, _ = refine_by_newton(robot, robot.compute_fk(q, tcp) @ turn, q, tcp, 8)
            row.update({c: f"{np.degrees(v):.6f}" for c, v in zip(JOINTS, q, strict=True)})
            row["gamma_deg"] = f"{float(row['gamma_deg']) + degrees:.6f}"

        build_table_change("points.csv", change)(job)

    return apply


def insert_dip(depth_mm: float, word: str) -> Callable[[Job], None]:
    """Return a damage in which the tool moves straight down and up after the retract, with matching time, index and
    feed."""

    def apply(job: Job) -> None:
        cell = load_cell(job.cell)
        robot, tcp = load_robot(cell), cell.tool.T_flange_tcp

        def change(table: Rows) -> None:
            at = max(n for n, row in enumerate(table) if row["point"] and float(row["point"]) == 8.0)
            q = np.radians([float(table[at][c]) for c in JOINTS])
            pose = robot.compute_fk(q, tcp)
            count = int(np.ceil(depth_mm / 0.4))  # 0.4 mm per sample: 33 mm/s
            u = np.linspace(0.0, 1.0, count + 1)[1:]
            down = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
            way, new, before = np.concatenate([down, down[::-1][1:], [0.0]]), [], 0.0
            for share in way:
                there = pose.copy()
                there[:3, 3] += 1e-3 * depth_mm * share * pose[:3, 2]
                q, _ = refine_by_newton(robot, there, q, tcp, 4)
                speed = abs(share - before) * depth_mm / 0.012 * 60.0
                before = share
                joints = {c: f"{np.degrees(v):.9f}" for c, v in zip(JOINTS, q, strict=True)}
                new.append({**table[at], **joints, "move": word, "feed_mm_min": f"{speed:.3f}"})
            table[at + 1 : at + 1] = new
            rewrite_times(table)

        build_table_change("trajectory.csv", change)(job)

    return apply


def points(name: str, how_much: str, change: Change, caught_by: str) -> Damage:
    return Damage(f"points.csv {name}", how_much, build_table_change("points.csv", change), caught_by)


def motion(name: str, how_much: str, change: Change, caught_by: str) -> Damage:
    return Damage(f"trajectory.csv {name}", how_much, build_table_change("trajectory.csv", change), caught_by)


P, T = "points.csv", "trajectory.csv"
READ = "can be read"
DAMAGES: list[Damage] = [
    # --- points.csv: numbers and data from the CAM file
    points("number doubled", "one row", set_value("point", "3"), f"{P} complete"),
    points("row lost", "one row", lambda t: t.pop(5), f"{P} complete"),
    points("rows in another order", "two rows", lambda t: t.insert(3, t.pop(5)), f"{P} complete"),
    points("operation renamed", "one row", set_value("operation", "other"), f"{P} operation"),
    points("cut called link", "one row", set_value("move", "link"), f"{P} move"),
    points("x moved", "2e-6 mm, one row", add("x_mm", 2e-6, ONE), f"{P} x y z"),
    points("y mirrored", "sign", times("y_mm", -1.0), f"{P} x y z"),
    points("x and y exchanged", "columns", swap("x_mm", "y_mm"), f"{P} x y z"),
    points("place in m", "unit", times(("x_mm", "y_mm", "z_mm"), 1e-3), f"{P} x y z"),
    points("place a row late", "one row", shift_columns_by_one_row(("x_mm", "y_mm", "z_mm")), f"{P} x y z"),
    points("i and k exchanged", "columns", swap("i", "k"), f"{P} i j k"),
    points("axis off", "2e-9, one row", add("j", 2e-9, ONE), f"{P} i j k"),
    points("axis reversed", "sign", times("k", -1.0), f"{P} i j k"),
    points("feed raised", "0.002 mm/min, one row", add("feed_mm_min", 0.002, ONE), f"{P} feed_mm_min"),
    points("feed in m/min", "unit", times("feed_mm_min", 1e-3), f"{P} feed_mm_min"),
    # --- points.csv: rotation and joints
    points("rotation turned", "2e-5 deg, one row", add("gamma_deg", 2e-5, ONE), f"{P} gamma_deg"),
    points("rotation with the other sign", "sign", times("gamma_deg", -1.0), f"{P} gamma_deg"),
    points("rotation in rad", "unit", times("gamma_deg", np.pi / 180.0), f"{P} gamma_deg"),
    points("rotation empty", "one row", set_value("gamma_deg", ""), f"{P} status"),
    points("another branch", "one row", add("branch", 1.0, ONE), f"{P} branch"),
    points("joint 1 off", "1e-4 deg, one row", add("q1_deg", 1e-4, ONE), f"{P} on the toolpath"),
    points("joint 6 off", "0.2 deg, one row", add("q6_deg", 0.2, ONE), f"{P} on the toolpath"),
    points("joint 5 off", "1e-4 deg, one row", add("q5_deg", 1e-4, ONE), f"{P} along the axis"),
    points("joints in rad", "unit", times(JOINTS, np.pi / 180.0), f"{P} on the toolpath"),
    points("joints 4 and 5 exchanged", "columns", swap("q4_deg", "q5_deg"), f"{P} on the toolpath"),
    points("joints a row late", "one row", shift_columns_by_one_row(JOINTS), f"{P} on the toolpath"),
    points("joints empty", "one row", lambda t: t[4].update(dict.fromkeys(JOINTS, "")), f"{P} status"),
    points("joint not a number", "one field", set_value("q3_deg", "nan"), f"{P} {READ}"),
    points("joint 6 a turn on", "360 deg, one row", add("q6_deg", 360.0, ONE), f"{P} as driven"),
    Damage(f"{P} tool turned, joints to fit", "5 deg, one row", rotate_tool_at_point_4(5.0), f"{P} as driven"),
    # --- points.csv: stiffness and deflection
    points("softer along the axis", "-5 %", times("k_axial_N_mm", 0.95), f"{P} k_axial_N_mm"),
    points("stiffer along the axis", "2e-5, one row", times("k_axial_N_mm", 1.00002, ONE), f"{P} k_axial_N_mm"),
    points("axial and normal exchanged", "columns", swap("k_axial_N_mm", "k_normal_N_mm"), f"{P} k_axial_N_mm"),
    points("normal in N/m", "unit", times("k_normal_N_mm", 1e3), f"{P} k_normal_N_mm"),
    points(
        "normal stiffness a row late", "one row", shift_columns_by_one_row(("k_normal_N_mm",)), f"{P} k_normal_N_mm"
    ),
    points("deflection smaller", "-5 %", times("deflection_mm", 0.95), f"{P} deflection_mm"),
    points("deflection of one point", "2e-5, one row", times("deflection_mm", 0.99998, ONE), f"{P} deflection_mm"),
    points("deflection in m", "unit", times("deflection_mm", 1e-3), f"{P} deflection_mm"),
    points("deflection empty", "one row", set_value("deflection_mm", ""), f"{P} deflection_mm"),
    points("index of the paper", "+1 %, one row", times("k_jiao_x_N_mm", 1.01, ONE), f"{P} k_jiao_x_N_mm"),
    # --- points.csv: clearance, margins, status
    points("clearance raised", "0.002 mm, one row", add("clearance_mm", 0.002, ONE), f"{P} clearance_mm"),
    points("clearance raised everywhere", "x 10", times("clearance_mm", 10.0), f"{P} clearance_mm"),
    points("clearance lowered", "0.002 mm, one row", add("clearance_mm", -0.002, ONE), f"{P} nearest_pair"),
    points("clearance empty", "one row", set_value("clearance_mm", ""), f"{P} clearance_mm"),
    points("another pair", "one row", set_value("nearest_pair", "pedestal ~ link_3_0"), f"{P} nearest_pair"),
    points("no such pair", "one row", set_value("nearest_pair", "tool ~ moon"), f"{P} nearest_pair"),
    points("limit margin raised", "5e-5 deg, one row", add("limit_margin_deg", 5e-5, ONE), f"{P} limit_margin_deg"),
    points("limit margin in rad", "unit", times("limit_margin_deg", np.pi / 180.0), f"{P} limit_margin_deg"),
    points("singularity farther", "5e-5 deg, one row", add("singularity", 5e-5, ONE), f"{P} singularity"),
    points("singularity doubled", "x 2", times("singularity", 2.0), f"{P} singularity"),
    points("driven point given up", "one row", given_up, "points given up are not driven"),
    points("status flipped", "one word", set_value("status", "colliding"), f"{P} status"),
    points("status made up", "one word", set_value("status", "fine"), f"{P} status"),
    points("ok with a reason", "one field", set_value("reason", "out of reach", slice(-1, None)), f"{P} status"),
    points("slow with another reason", "one field", set_value("reason", "out of reach"), "result.json feed"),
    points("slow without a reason", "one field", remove_first_reason, "result.json feed"),
    Damage(f"{P} column renamed", "one column", build_text_change(P, "deflection_mm", "deflection"), f"{P} {READ}"),
    Damage(f"{P} column doubled", "one name", build_text_change(P, "k_normal_N_mm", "k_axial_N_mm"), f"{P} {READ}"),
    # --- trajectory.csv: time, home, rows
    motion("faster", "10 %", times("time_s", 0.9), "control cycle and start"),
    motion("time in ms", "unit", times("time_s", 1e3), "control cycle and start"),
    motion("time of one row", "1e-5 s", add("time_s", 1e-5, slice(500, 501)), "uniform time"),
    motion("begins late", "1 s", add("time_s", 1.0), "control cycle and start"),
    motion("first row lost", "one row", remove_rows(slice(0, 1)), "from home to home"),
    motion("last rows lost", "ten rows", remove_rows(slice(-10, None)), "from home to home"),
    motion("row lost in a cut", "one row", lost_row, "feed column"),
    motion("row repeated in a cut", "one row", repeated_row, "feed column"),
    motion("stretch reversed", "16 rows", reversed_rows, "index of the samples"),
    # --- trajectory.csv: index
    motion(
        "index shifted", "0.01 of a point in the cuts", change_cutting_rows(add("point", 0.01)), "index of the samples"
    ),
    motion(
        "index of one row",
        "0.01 of a point",
        change_cutting_rows(add("point", 0.01), slice(40, 41)),
        "index of the samples",
    ),
    motion(
        "index three rows late",
        "three rows",
        lambda t: [shift_columns_by_one_row(("point",))(t) for _ in range(3)],
        "index of the samples",
    ),
    motion("index falls", "one row", change_cutting_rows(add("point", -0.5), slice(60, 61)), "in order"),
    motion(
        "index empty in a cut", "one row", change_cutting_rows(set_value("point", "", EVERY), slice(60, 61)), "in order"
    ),
    # --- trajectory.csv: labels
    motion(
        "operation renamed", "one row", set_value("operation", "other", slice(500, 501)), "operations of the samples"
    ),
    motion(
        "operation on the way home",
        "one row",
        set_value("operation", "other", slice(-1, None)),
        "operations of the samples",
    ),
    motion(
        "cut called rapid",
        "20 rows",
        change_cutting_rows(set_value("move", "rapid", EVERY), slice(40, 60)),
        "moves of the samples",
    ),
    motion(
        "cut called link",
        "20 rows",
        change_cutting_rows(set_value("move", "link", EVERY), slice(40, 60)),
        "moves of the samples",
    ),
    motion(
        "one cut row called rapid",
        "one row",
        change_cutting_rows(set_value("move", "rapid", EVERY), slice(40, 41)),
        "moves of the samples",
    ),
    motion(
        "all cuts called link",
        "all rows",
        change_cutting_rows(set_value("move", "link", EVERY)),
        "moves of the samples",
    ),
    motion("rapid called cut", "one row", rapids("cut"), "moves of the samples"),
    motion("rapid called link", "one row", rapids("link"), "moves of the samples"),
    motion("move made up", "one word", set_value("move", "fly", slice(500, 501)), f"{T} {READ}"),
    # --- trajectory.csv: joints
    motion(
        "joint 1 of one cut row", "0.002 deg", change_cutting_rows(add("q1_deg", 0.002), slice(40, 41)), "joint jerk"
    ),
    motion("joint 2 of one cut row", "0.002 deg", change_cutting_rows(add("q2_deg", 0.002), slice(40, 41)), "path"),
    motion("joint 4 everywhere", "0.2 deg", add("q4_deg", 0.2), "from home to home"),
    motion("joint 4 in the cuts", "0.2 deg", change_cutting_rows(add("q4_deg", 0.2)), "path"),
    motion("joints in rad", "unit", times(JOINTS, np.pi / 180.0), "from home to home"),
    motion("joints 2 and 3 exchanged", "columns", swap("q2_deg", "q3_deg"), "from home to home"),
    motion("joints a row late", "one row", shift_columns_by_one_row(JOINTS), "feed column"),
    motion("joint not a number", "one field", set_value("q5_deg", "NaN", slice(500, 501)), f"{T} {READ}"),
    motion("joint of the last row", "2e-6 deg", add("q6_deg", 2e-6, slice(-1, None)), "from home to home"),
    # --- trajectory.csv: rotation and feed
    motion("rotation in the cuts", "0.2 deg", change_cutting_rows(add("gamma_deg", 0.2)), "rotation of the samples"),
    motion(
        "rotation of one row",
        "0.2 deg",
        change_cutting_rows(add("gamma_deg", 0.2), slice(40, 41)),
        "rotation of the samples",
    ),
    motion("rotation in rad", "unit", times("gamma_deg", np.pi / 180.0), "rotation of the samples"),
    motion(
        "rotation empty in a cut",
        "one row",
        change_cutting_rows(set_value("gamma_deg", "", EVERY), slice(40, 41)),
        "rotation of the samples stated",
    ),
    motion(
        "rotation in a rapid move",
        "one row",
        set_value("gamma_deg", "0.0", slice(5, 6)),
        "rotation of the samples stated",
    ),
    motion("feed of one row", "0.01 mm/min", add("feed_mm_min", 0.01, slice(500, 501)), "feed column"),
    motion("feed in m/min", "unit", times("feed_mm_min", 1e-3), "feed column"),
    motion("feed empty", "one row", set_value("feed_mm_min", "", slice(500, 501)), f"{T} {READ}"),
    Damage(f"{T} column renamed", "one column", build_text_change(T, "gamma_deg", "gamma"), f"{T} {READ}"),
    # --- dips: the tool moves into the part between two moves
    Damage(f"{T} dip called link", "60 mm", insert_dip(60.0, "link"), "contacts"),
    Damage(f"{T} dip called retract", "60 mm", insert_dip(60.0, "retract"), "contacts"),
    Damage(f"{T} dip called rapid", "60 mm", insert_dip(60.0, "rapid"), "contacts"),
    Damage(f"{T} dip called cut", "60 mm", insert_dip(60.0, "cut"), "contacts"),
    Damage(f"{T} shallow dip", "6 mm, 1 mm deep", insert_dip(6.0, "approach"), "contacts"),
    Damage(f"{T} dip above the part", "4 mm, touches nothing", insert_dip(4.0, "link"), "index of the samples"),
]
