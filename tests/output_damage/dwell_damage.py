"""Damages of a plan with dwells: longer dwell, joint motion during the dwell, joint jump."""

from __future__ import annotations

from output_damage.damage_case import Damage, build_table_change


def _in_dwell(rows: list[dict[str, str]]) -> None:
    joints = [f"q{j}_deg" for j in range(1, 7)]
    still = [k for k in range(1, len(rows) - 1) if all(rows[k][c] == rows[k - 1][c] == rows[k + 1][c] for c in joints)]
    for k in still:
        rows[k]["q1_deg"] = f"{float(rows[k]['q1_deg']) + 0.01:.6f}"


def lengthen_dwells(rows: list[dict[str, str]]) -> None:
    for row in rows:
        row["dwell_s"] = "9.5"


def shift_joint_6(rows: list[dict[str, str]]) -> None:
    for row in rows[len(rows) // 2 :]:
        row["q6_deg"] = f"{float(row['q6_deg']) + 10.0:.6f}"


DAMAGES = [
    Damage(
        "trajectory.csv joint 6 jumps",
        "10°",
        build_table_change("trajectory.csv", shift_joint_6),
        "joint velocity",
        "in krl",
    ),
    Damage(
        "points.csv dwell", "+8 s", build_table_change("points.csv", lengthen_dwells), "points.csv dwell_s", "in krl"
    ),
    Damage(
        "trajectory.csv moves while it dwells",
        "0.01°",
        build_table_change("trajectory.csv", _in_dwell),
        "dwells",
        "in krl",
    ),
]
