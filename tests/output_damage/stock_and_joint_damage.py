"""Damages of the stock contact and of the values that the method ``joint`` writes."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from stock_jobs import PROCESS, build_pocket_path, write_stock_cell, write_toolpath

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from output_damage.damage_case import CELLS, HEADER, JOBS, PASS, Damage, Job, build_json_change, build_table_change

Rows = list[dict[str, str]]


def plan_pocket(folder: Path) -> Job:
    """Plan the roughing of a pocket with contact computed from the stock."""
    write_stock_cell(folder / "cell", PROCESS)
    toolpath = folder / "pass.csv"
    write_toolpath(toolpath, build_pocket_path(layers=1))
    request = OptimizeRequest(
        cell=folder / "cell", toolpath=toolpath, out=folder / "out", overrides=("rotation_step_deg=20",)
    )
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, folder / "out")


def plan_joint(folder: Path) -> Job:
    """Plan the pass as a finished wall, with rotation and feed optimized together."""
    toolpath = folder / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS))
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    cell = folder / "cell" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + "process: process.yaml\n", encoding="utf-8")
    overrides = ("rotation_step_deg=15", "method=joint")
    request = OptimizeRequest(cell=folder / "cell", toolpath=toolpath, out=folder / "out", overrides=overrides)
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, folder / "out")


JOBS["stock"] = plan_pocket
JOBS["joint"] = plan_joint

ENTRY = {"accepted": False, "reason": "no window is accepted", "fixed_path_s": 1.0, "joint_s": None, "windows": []}


def shift_column(name: str, by: float, rows: Rows) -> None:
    for row in rows:
        row[name] = f"{max(float(row[name]) + by, 0.0):.6f}"


def scale_first(name: str, factor: float, rows: Rows) -> None:
    """Scale one cell, the first that is neither empty nor zero."""
    row = next(r for r in rows if r[name] and float(r[name]) != 0.0)
    row[name] = f"{factor * float(row[name]):.6f}"


def fill_plunges(rows: Rows) -> None:
    """Give points without a force a force of zero."""
    for row in rows:
        for name in ("f_travel_N", "f_normal_N", "f_axial_N", "m_axial_Nm"):
            row[name] = row[name] or "0.000"


def limit_plunges(rows: Rows) -> None:
    """Give points without contact a stable depth."""
    for row in rows:
        if not row["a_lim_mm"] and not row["f_travel_N"]:
            row["a_lim_mm"] = "0.1234"


def drop_first_point(rows: Rows) -> None:
    rows[:] = [row for row in rows if row["point"] != rows[0]["point"]]


def in_entry(**values: object) -> Callable[[Job], None]:
    return build_json_change("result.json", lambda result: result["joint"][0].update(values))


def turn_decision(result: dict[str, Any]) -> None:
    entry = result["joint"][0]
    entry.update(accepted=not entry["accepted"], reason="" if entry["reason"] else "no window is accepted")


def in_arcs(change: Callable[[Rows], None]) -> Callable[[Job], None]:
    return build_table_change("engagement.csv", change)


def in_points(change: Callable[[Rows], None]) -> Callable[[Job], None]:
    return build_table_change("points.csv", change)


CONTACT = (("f_peak_N", 1.2), ("ae_mm", 1.02), ("ap_mm", 0.98), ("phi_in_deg", 1.02), ("phi_out_deg", 0.98))
EXACT, FEED, SECTION = "engagement.csv against exact shapes", "points.csv feed_advised_mm_min", "result.json joint"
DAMAGES = [
    Damage("stock: arcs begin too early", "20°", in_arcs(partial(shift_column, "phi_in_deg", -20.0)), EXACT, "stock"),
    Damage("stock: arcs too high", "1 mm", in_arcs(partial(shift_column, "high_mm", 1.0)), EXACT, "stock"),
    Damage(
        "stock: a force of zero on plunges",
        "0 N",
        in_points(fill_plunges),
        "points.csv forces of plunges and ramps",
        "stock",
    ),
    Damage(
        "stock: a largest stable depth of plunges",
        "0.12 mm",
        in_points(limit_plunges),
        "points.csv a_lim_mm is reached",
        "stock",
    ),
    Damage("stock: a point without its arcs", "1 point", in_arcs(drop_first_point), "points.csv ae_mm", "stock"),
    *(
        Damage(
            f"stock: {name} scaled", f"×{by}", in_points(partial(scale_first, name, by)), f"points.csv {name}", "stock"
        )
        for name, by in CONTACT
    ),
    Damage(
        "joint without the method",
        "1 entry",
        build_json_change("result.json", lambda r: r.update(joint=[ENTRY])),
        SECTION,
    ),
    Damage(
        "joint is null", "1 key", build_json_change("result.json", lambda r: r.update(joint=None)), SECTION, "joint"
    ),
    Damage("joint: the other decision", "1 word", build_json_change("result.json", turn_decision), SECTION, "joint"),
    Damage("joint: time of both paths", "1 s", in_entry(fixed_path_s=1.0, joint_s=1.0), SECTION, "joint"),
    Damage(
        "joint: a feed above the file's", "×9", in_points(partial(scale_first, FEED.split()[1], 9.0)), FEED, "joint"
    ),
]
