"""Damages of a plan with blended rapid corners: table, motion, and blend zones of programs."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from output_damage.damage_case import CELLS, JOBS, Damage, Job, build_table_change, plan_table

CORNERS, MOTION = "rapid_corners.csv", "trajectory.csv"
JOINTS = [f"q{n}_deg" for n in range(1, 7)]
Rows = list[dict[str, str]]
# two short cuts, connected by three rapid moves with corners at points 6 and 7
TWO_CUTS: tuple[tuple[float, float, float, str, str], ...] = (
    (-100, 0, 60, "rapid", ""),
    (-100, 0, 5, "rapid", ""),
    (-100, 0, -0.5, "cut", "1000"),
    (-92, 0, -0.5, "cut", "1500"),
    (-92, 0, 5, "retract", "1000"),
    (-92, 0, 60, "rapid", ""),
    (40, 30, 60, "rapid", ""),
    (40, 30, 5, "rapid", ""),
    (40, 30, -0.5, "cut", "1000"),
    (48, 30, -0.5, "cut", "1500"),
    (48, 30, 5, "retract", "1000"),
    (48, 30, 60, "rapid", ""),
)


def plan_two_cuts(folder: Path) -> Job:
    """Plan two cuts, with programs whose blend zones are percentages and distances."""
    return plan_table(folder, CELLS / "kr500_milling", TWO_CUTS, posts=("krl", "rapid", "urscript", "val3"))


JOBS["two cuts"] = plan_two_cuts


def set_value(column: str, value: str, row: int = 1) -> Callable[[Job], None]:
    """Return a damage that changes one value of the corner table."""

    def change(rows: Rows) -> None:
        rows[row][column] = value

    return build_table_change(CORNERS, change)


def _turn_corner(rows: Rows) -> None:
    rows[1]["q1_deg"] = f"{float(rows[1]['q1_deg']) + 0.01:.9f}"


def _forget_corner(rows: Rows) -> None:
    del rows[1]


def _bend_motion(rows: Rows) -> None:
    """Shift samples in the middle of a rapid move by at most 0.01 degrees."""
    inside = [
        n for n, row in enumerate(rows) if row["move"] == "rapid" and row["point"] and 5 < float(row["point"]) < 6
    ]
    for n, share in zip(inside, np.linspace(0.0, np.pi, len(inside)), strict=True):
        rows[n]["q1_deg"] = f"{float(rows[n]['q1_deg']) + 0.01 * np.sin(share) ** 4:.9f}"


def _obstruct(job: Job) -> None:
    """Add a sphere next to the second corner, in collision with the tool on the rounded path."""
    file = job.cell / "cell.yaml"
    text = file.read_text(encoding="utf-8")
    ball = "obstacles:\n  - {name: ball, sphere_mm: 12, xyz_mm: [2140.7, -115.5, 860]}\n"
    file.write_text(text.replace("obstacles:\n", ball, 1), encoding="utf-8")


def swap(file: str, pattern: str, by: str | Callable[[re.Match[str]], str]) -> Callable[[Job], None]:
    """Return a damage that replaces the first match in a program file."""

    def apply(job: Job) -> None:
        path = next(job.out.glob(file))
        text = path.read_text(encoding="utf-8")
        assert re.search(pattern, text), path
        path.write_text(re.sub(pattern, by, text, count=1), encoding="utf-8", newline="")

    return apply


def _enlarge_corner_and_program(job: Job) -> None:
    set_value("before_percent", "50", 0)(job)
    swap("krl/*.src", r"CPTP=\d+", "CPTP=100")(job)


def _stop_clock(count: int, rows: Rows) -> None:
    """Set the same time in the first samples."""
    for row in rows[:count]:
        row["time_s"] = rows[0]["time_s"]


def _cut_motion(rows: Rows) -> None:
    del rows[len(rows) // 2 :]


BAD_CORNERS = (  # column and value of one row: values that no corner can have
    *(("before_percent", value) for value in ("1e4", "1e9", "1e300", "0", "-5", "nan")),
    *(("after_percent", value) for value in ("1e9", "-1e9")),
    *((joint, value) for joint in ("q1_deg", "q6_deg") for value in ("1e6", "-1e6", "1e300", "")),
    *(("sample", value) for value in ("0", "1e9", "7.5", "-1")),
    *(("from_sample", value) for value in ("-3", "1e9")),
    *(("to_sample", value) for value in ("0", "1e300")),
)


def change_middle_row(column: str, value: str, rows: Rows) -> None:
    """Change one sample in the middle."""
    rows[len(rows) // 2][column] = value


DAMAGES = [
    *(
        Damage(
            f"a motion whose {column} is {value} once",
            "1 cell",
            build_table_change(MOTION, partial(change_middle_row, column, value)),
            check,
            "two cuts",
        )
        for column, value, check in (
            ("q1_deg", "1e9", "joint velocity"),
            ("q6_deg", "-1e9", "joint velocity"),
            ("q3_deg", "1e300", "trajectory.csv"),
            ("time_s", "1e300", "trajectory.csv"),
        )
    ),
    *(
        Damage(f"a corner's {column} is {value!r}", "1 cell", set_value(column, value), "rapid_corners.csv", "two cuts")
        for column, value in BAD_CORNERS
    ),
    Damage(
        "a corner's to_sample is '1e6'",
        "1 cell",
        set_value("to_sample", "1e6"),
        "rapid corners between rapid moves",
        "two cuts",
    ),
    Damage(
        "a corner's joints within the limits", "60°", set_value("q1_deg", "60"), "rapid corners as driven", "two cuts"
    ),
    Damage(
        "two samples at the same time",
        "1 cell",
        build_table_change(MOTION, partial(_stop_clock, 2)),
        "trajectory.csv",
        "two cuts",
    ),
    Damage(
        "all samples at the same time",
        "1 column",
        build_table_change(MOTION, partial(_stop_clock, 10**6)),
        "trajectory.csv",
        "two cuts",
    ),
    Damage(
        "a motion cut to half", "rows", build_table_change(MOTION, _cut_motion), "cutting points visited", "two cuts"
    ),
    Damage(
        "a motion cut to two samples",
        "rows",
        build_table_change(MOTION, lambda rows: rows.__delitem__(slice(2, None))),
        "cutting points visited",
        "two cuts",
    ),
    Damage("a corner's share of its move", "51 %", set_value("before_percent", "51"), "rapid_corners.csv", "two cuts"),
    Damage("a corner's row", "beside a cut", set_value("from_sample", "1"), "rapid corners between", "two cuts"),
    Damage(
        "a corner's joints", "0.01°", build_table_change(CORNERS, _turn_corner), "rapid corners as driven", "two cuts"
    ),
    Damage("a smaller corner", "5 %", set_value("after_percent", "5"), "rapid corners as driven", "two cuts"),
    Damage("a larger corner", "24 to 50 %", set_value("before_percent", "50", 0), "rapid corner shares", "two cuts"),
    Damage(
        "a larger corner, driven later",
        "24 to 45 %",
        set_value("after_percent", "45", 3),
        "rapid corner shares",
        "two cuts",
    ),
    Damage(
        "a larger corner and its program",
        "24 to 50 %, CPTP 100",
        _enlarge_corner_and_program,
        "rapid corner shares",
        "two cuts",
    ),
    Damage("a rapid move off its line", "0.01°", build_table_change(MOTION, _bend_motion), "rapid corners", "two cuts"),
    Damage("a corner not listed", "1 of 4", build_table_change(CORNERS, _forget_corner), "rapid points", "two cuts"),
    Damage(
        "a ball at a corner",
        "24 mm",
        _obstruct,
        "rapid corners clear",
        "two cuts",
        as_is="made from these inputs",
    ),
    Damage("$APO.CPTP", "100", swap("krl/*.src", r"CPTP=\d+", "CPTP=100"), "krl/pass_csv.src: zones", "two cuts"),
    Damage(
        "the zone of MoveAbsJ",
        "x 10",
        swap(
            "rapid/*.mod",
            r"zonedata z1_(\w+):=\[FALSE,([\d.]+)",
            lambda m: f"zonedata z1_{m[1]}:=[FALSE,{10 * float(m[2]):.3f}",
        ),
        "rapid/pass_csv.mod: zones",
        "two cuts",
    ),
    Damage(
        "reach of movej",
        "x 10",
        swap(
            "val3/**/*.dtx",
            r'blend="joint" leave="([\d.]+)" reach="([\d.]+)"',
            lambda m: f'blend="joint" leave="{10 * float(m[1]):.4f}" reach="{10 * float(m[2]):.4f}"',
        ),
        "val3/pass_csv/pass_csv.pjx: zones",
        "two cuts",
    ),
    Damage(
        "C_PTP where the robot stops",
        "first move",
        swap("krl/*.src", r"PTP (\{[^}]*\})\r?\n", lambda m: f"PTP {m[1]} C_PTP\r\n"),
        "krl/pass_csv.src: zones",
        "two cuts",
    ),
    Damage(
        "r where movej stops",
        "5 mm",
        swap("urscript/*.script", r"(movej.*r=)0\)", r"\g<1>0.005000)"),
        "urscript/pass_csv.script: zones",
        "two cuts",
    ),
    Damage(
        "r where movel stops",
        "5 mm",
        swap("urscript/*.script", r"(movel.*r=)0\.000000\)", r"\g<1>0.005000)"),
        "urscript/pass_csv.script: zones",
        "two cuts",
    ),
    Damage(
        "fine of MoveAbsJ",
        "z1",
        swap("rapid/*.mod", r"(MoveAbsJ .*),fine,", r"\g<1>,z1_pass_csv,"),
        "rapid/pass_csv.mod: zones",
        "two cuts",
    ),
    Damage(
        "r of movej",
        "0.2 m",
        swap("urscript/*.script", r"(movej.*r=)0\.\d+", r"\g<1>0.200000"),
        "urscript/pass_csv.script: zones",
        "two cuts",
    ),
]
