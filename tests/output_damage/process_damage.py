"""Damages of the process columns of points.csv and of the process section of result.json."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from machopt.commands.optimize.request import OptimizeRequest
from machopt.commands.optimize.run import run_optimize
from output_damage.damage_case import CELLS, HEADER, JOBS, PASS, Damage, Job, build_json_change, build_table_change

Rows = list[dict[str, str]]
JOINTS = [f"q{n}_deg" for n in range(1, 7)]
HOLE = """operations:
  default:
    kind: drilling
    spindle_rpm: 3000
    layers: [{material: al7075, thickness_mm: 4}]
    depth_mm: 7
    tolerance: {position_mm: 0.4, axis_deg: 0.5, depth_mm: 1.5, reference: relative}
"""


def plan_milled_wall(folder: Path) -> Job:
    """Plan the pass as a finished wall with a tolerance, in the milling cell with its process file."""
    toolpath = folder / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS))
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    cell = folder / "cell" / "cell.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + "process: process.yaml\n", encoding="utf-8")
    out = folder / "out"
    overrides = ("rotation_step_deg=15", "min_stability_ratio=0.5")
    request = OptimizeRequest(cell=folder / "cell", toolpath=toolpath, out=out, overrides=overrides)
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, out)


def plan_slow_spindle(folder: Path) -> Job:
    """Plan the same pass at 1,200 rev/min: all modes rotate by more than 1 rad per tooth period, so that the delay
    does not act as damping."""
    toolpath = folder / "pass.csv"
    toolpath.write_text(HEADER + "\n" + "".join(f"{x},{y},{z},0,0,1,{move},{feed}\n" for x, y, z, move, feed in PASS))
    shutil.copytree(CELLS / "kr500_milling", folder / "cell")
    cell, file = folder / "cell" / "cell.yaml", folder / "cell" / "process.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + "process: process.yaml\n", encoding="utf-8")
    text = file.read_text(encoding="utf-8")
    assert "spindle_rpm: 12000" in text
    file.write_text(text.replace("spindle_rpm: 12000", "spindle_rpm: 1200"), encoding="utf-8")
    out, overrides = folder / "out", ("rotation_step_deg=15",)
    request = OptimizeRequest(cell=folder / "cell", toolpath=toolpath, out=out, overrides=overrides)
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, out)


def plan_drilled_hole(folder: Path) -> Job:
    """Plan one hole with limits of position, depth and axis, in the drilling cell."""
    return plan_holes(folder, (-150,))


def plan_two_holes(folder: Path) -> Job:
    """Plan two such holes."""
    return plan_holes(folder, (-150, -120))


def plan_holes(folder: Path, places: Sequence[int]) -> Job:
    """Plan holes at the given x coordinates in mm."""
    toolpath = folder / "pass.csv"
    rows = ((40, "rapid", ""), (25, "rapid", ""), (0, "cut", "420"), (40, "retract", ""))
    lines = [f"{x},-200,{z},0,0,1,{move},{feed}\n" for x in places for z, move, feed in rows]
    toolpath.write_text(HEADER + "\n" + "".join(lines))
    shutil.copytree(CELLS / "kr240_drilling", folder / "cell")
    cell, file = folder / "cell" / "cell.yaml", folder / "cell" / "process.yaml"
    cell.write_text(cell.read_text(encoding="utf-8") + "process: process.yaml\n", encoding="utf-8")
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.index("operations:")] + HOLE, encoding="utf-8")
    out = folder / "out"
    request = OptimizeRequest(cell=folder / "cell", toolpath=toolpath, out=out, overrides=("rotation_step_deg=15",))
    assert run_optimize(request).exit_code == 0
    return Job(folder / "cell", toolpath, out)


JOBS["process"] = plan_milled_wall
JOBS["slow spindle"] = plan_slow_spindle
JOBS["drilled"] = plan_drilled_hole
JOBS["two holes"] = plan_two_holes


def scale_column(name: str, factor: float, rows: Rows) -> None:
    """Scale one cell, the first that is neither empty nor zero."""
    row = next(r for r in rows if r[name] and float(r[name]) != 0.0)
    row[name] = repr(float(row[name]) * factor)


def scale_depths(factor: float, rows: Rows) -> None:
    """Scale planned and stable depth of the last cut far above the limit of the modes that the verifier computes."""
    row = [r for r in rows if r["a_lim_mm"]][-1]
    for name in ("ap_mm", "a_lim_mm"):
        row[name] = repr(float(row[name]) * factor)


def scale_limit(factor: float, rows: Rows) -> None:
    """Scale the limit of the last cut, and change the chatter column to match it."""
    row = [r for r in rows if r["a_lim_mm"]][-1]
    limit = float(row["a_lim_mm"]) * factor
    row["a_lim_mm"] = f"{limit:.4f}"
    if float(row["ap_mm"]) < limit:
        row["chatter"] = "stable"
    elif row["chatter"] == "stable":
        row["chatter"] = "robot:1"


def flip_chatter(rows: Rows) -> None:
    """Change the first non-empty cell: stable to a mode, a mode to stable."""
    row = next(r for r in rows if r["chatter"])
    row["chatter"] = "robot:3" if row["chatter"] == "stable" else "stable"


def replace_word(name: str, word: str, rows: Rows) -> None:
    """Replace the first non-empty cell that contains another word."""
    next(r for r in rows if r[name] and r[name] != word)[name] = word


def fill_cell(name: str, word: str, rows: Rows) -> None:
    """Fill the first empty cell of a column."""
    next(r for r in rows if not r[name])[name] = word


def name_operation_of_way_home(rows: Rows) -> None:
    rows[-1]["operation"] = next(r["operation"] for r in rows if r["operation"])


def forget_outcome(rows: Rows) -> None:
    row = next(r for r in rows if r["outcome"])
    row["outcome"], row["p_in"] = "unknown", ""


def in_points(name: str, factor: float) -> Callable[[Job], None]:
    return build_table_change("points.csv", partial(scale_column, name, factor))


def in_process(change: Callable[[dict[str, Any]], None]) -> Callable[[Job], None]:
    return build_json_change("result.json", lambda result: change(result["process"]))


def count_one_more(process: dict[str, Any]) -> None:
    counts = process["in_tolerance"]["after"]
    fewer = next(word for word, n in counts.items() if n)
    counts[fewer] -= 1
    more = next(word for word in counts if word != fewer)
    counts[more] += 1


def double_first_share(process: dict[str, Any]) -> None:
    shares = process["variance_shares"]
    shares[max(shares, key=shares.__getitem__)] *= 2.0


def demand_stability(job: Job) -> None:
    """Set a larger minimum stability ratio in manifest and result than the motion has."""
    for file in ("manifest.json", "result.json"):
        build_json_change(file, lambda told: told["options"].update(min_stability_ratio=3.9))(job)


def keep_rows(first: int | None, stop: int | None) -> Callable[[Rows], None]:
    """Keep only some rows of a table."""

    def change(rows: Rows) -> None:
        rows[:] = rows[slice(first, stop)]

    return change


def double_first_row(rows: Rows) -> None:
    rows.insert(0, dict(rows[0]))


def halve_rows(rows: Rows) -> None:
    del rows[len(rows) // 2 :]


def empty_columns(names: Sequence[str], rows: Rows) -> None:
    for row in rows:
        row.update(dict.fromkeys(names, ""))


def state_bare_probability(value: str, rows: Rows) -> None:
    """Change one cell at a point whose outcome is known."""
    next(row for row in rows if row["outcome"])["p_in_deflection_only"] = value


def zero_depth(rows: Rows) -> None:
    next(row for row in rows if row["ap_mm"])["ap_mm"] = "0.0"


def cut_motion(count: int, job: Job) -> None:
    """Keep only the first samples of trajectory.csv, without rounded corners."""
    (job.out / "rapid_corners.csv").unlink()
    build_table_change("trajectory.csv", keep_rows(0, count))(job)


def forget_feed_of_first_hole(rows: Rows) -> None:
    """Delete the feed of one of two holes."""
    assert sum(1 for row in rows if row["feed_max_mm_min"]) == 2
    next(row for row in rows if row["feed_max_mm_min"])["feed_max_mm_min"] = ""


ROWS = (  # changes of the rows of points.csv
    ("without the first row", keep_rows(1, None)),
    ("without the last row", keep_rows(0, -1)),
    ("with its first row twice", double_first_row),
    ("cut to half", halve_rows),
    ("cut to one row", keep_rows(0, 1)),
    ("without rows", list.clear),
)

COLUMNS = (  # column, factor, check that detects it
    ("ae_mm", 1.01, "points.csv ae_mm"),
    ("ap_mm", 1.01, "points.csv ap_mm"),
    ("phi_in_deg", 0.99, "points.csv phi_in_deg"),
    ("phi_out_deg", 0.99, "points.csv phi_out_deg"),
    ("f_travel_N", 1.03, "points.csv f_travel_N"),
    ("f_normal_N", 1.03, "points.csv f_normal_N"),
    ("f_axial_N", 3.0, "points.csv f_axial_N"),
    ("f_peak_N", 1.03, "points.csv f_peak_N"),
    ("error_normal_mm", 1.05, "points.csv error_normal_mm"),
    ("p_in", 0.8, "points.csv p_in"),
    ("tolerance_mm", 2.0, "points.csv tolerance_mm"),
    ("feed_max_mm_min", 4.0, "points.csv feed_max_mm_min"),
    ("f1_Hz", 1.05, "points.csv f1_Hz"),
)

HOLE_COLUMNS = (
    ("feed_max_mm_min", 1.6, "points.csv feed_max_mm_min is not too large"),
    ("feed_max_mm_min", 0.4, "points.csv feed_max_mm_min is the largest"),
    ("feed_max_mm_min", -1.0, "points.csv feed_max_mm_min"),
    ("m_axial_Nm", 1.05, "points.csv m_axial_Nm"),
    ("error_along_mm", 1.05, "points.csv error_along_mm"),
    ("error_across_mm", 1.3, "points.csv error_across_mm"),
    ("error_axis_deg", 1.3, "points.csv error_axis_deg"),
)

DAMAGES = [
    *(
        Damage(f"{job}: points.csv {name}", "rows", build_table_change("points.csv", change), "points.csv", job)
        for job in ("process", "drilled")
        for name, change in ROWS
    ),
    *(
        Damage(
            f"{job}: points.csv without joints",
            "6 columns",
            build_table_change("points.csv", partial(empty_columns, JOINTS)),
            "points.csv",
            job,
        )
        for job in ("process", "drilled")
    ),
    *(
        Damage(
            f"drilled: trajectory.csv cut to {count} samples",
            "rows",
            partial(cut_motion, count),
            "points.csv predicted errors" if count < 4 else "from home to home",
            "drilled",
        )
        for count in (2, 3, 100)
    ),
    Damage(
        "drilled: trajectory.csv operation on the way home",
        "1 cell",
        build_table_change("trajectory.csv", name_operation_of_way_home),
        "operations of the samples",
        "drilled",
    ),
    Damage(
        "drilled: trajectory.csv without points",
        "1 column",
        build_table_change("trajectory.csv", partial(empty_columns, ["point"])),
        "points.csv predicted errors",
        "drilled",
    ),
    Damage(
        "points.csv feed_max_mm_min of one of two holes lost",
        "1 cell",
        build_table_change("points.csv", forget_feed_of_first_hole),
        "points.csv feed_max_mm_min",
        "two holes",
    ),
    *(
        Damage(
            f"points.csv p_in_deflection_only {value}",
            "1 cell",
            build_table_change("points.csv", partial(state_bare_probability, value)),
            "points.csv p_in_deflection_only",
            "process",
        )
        for value in ("0.9", "-1")
    ),
    *(
        Damage(
            f"{job}: points.csv {name} where it must be empty",
            "1 cell",
            build_table_change("points.csv", partial(fill_cell, name, word)),
            "points.csv empty cells",
            job,
        )
        for job, name, word in (
            ("process", "error_along_lo_mm", "0.5"),
            ("process", "error_normal_hi_mm", "0.09"),
            ("drilled", "cause", "joint:3 0.62"),
            ("drilled", "a_lim_mm", "0.5"),
        )
    ),
    Damage(
        "points.csv f1_Hz lost",
        "1 cell",
        build_table_change("points.csv", partial(replace_word, "f1_Hz", "")),
        "points.csv f1_Hz is stated",
        "process",
    ),
    Damage(
        "points.csv a_lim_mm lost",
        "1 cell",
        build_table_change("points.csv", partial(replace_word, "a_lim_mm", "")),
        "points.csv chatter",
        "process",
    ),
    Damage(
        "points.csv ap_mm of zero", "1 cell", build_table_change("points.csv", zero_depth), "result.json", "process"
    ),
    Damage(
        "result.json stability without unknown_points",
        "1 key",
        in_process(lambda process: process["stability"].pop("unknown_points")),
        "result.json",
        "process",
    ),
    *(
        Damage(f"points.csv {name} ×{factor}", f"×{factor}", in_points(name, factor), check, "drilled")
        for name, factor, check in HOLE_COLUMNS
    ),
    Damage(
        "points.csv chatter changed",
        "1 cell",
        build_table_change("points.csv", flip_chatter),
        "points.csv chatter",
        "process",
    ),
    Damage(
        "points.csv chatter withheld",
        "1 cell",
        build_table_change("points.csv", partial(replace_word, "chatter", "unknown")),
        "points.csv chatter",
        "process",
    ),
    Damage(
        "points.csv outcome withheld",
        "1 cell",
        build_table_change("points.csv", forget_outcome),
        "points.csv unknown outcomes",
        "process",
    ),
    *(
        Damage(f"points.csv {name} scaled", f"×{factor}", in_points(name, factor), check, "process")
        for name, factor, check in COLUMNS
    ),
    Damage(
        "points.csv feed_max_mm_min lost",
        "1 cell",
        build_table_change("points.csv", partial(replace_word, "feed_max_mm_min", "")),
        "points.csv feed_max_mm_min",
        "process",
    ),
    Damage(
        "points.csv feed_max_mm_min at a higher end",
        "2880 → 400 mm/min",
        build_table_change("points.csv", lambda rows: rows[5].update(feed_max_mm_min="400")),
        "points.csv feed_max_mm_min is the largest",
        "process",
    ),
    Damage(
        "points.csv outcome changed",
        "1 cell",
        build_table_change("points.csv", partial(replace_word, "outcome", "unknown")),
        "points.csv outcome",
        "process",
    ),
    *(
        Damage(
            f"points.csv a_lim_mm of fast modes by {factor}",
            "1 cell",
            build_table_change("points.csv", partial(scale_limit, factor)),
            name,
            "slow spindle",
        )
        for factor, name in ((1.05, "points.csv a_lim_mm"), (0.6, "points.csv a_lim_mm is reached"))
    ),
    Damage("least ratio stated", "0.5 → 3.9", demand_stability, "requested: min_stability_ratio", "process"),
    *(
        Damage(
            f"depths of a cut scaled: {name}",
            "a factor of 200",
            build_table_change("points.csv", partial(scale_depths, 200.0)),
            name,
            "process",
        )
        for name in ("points.csv a_lim_mm", "points.csv stability at min_stability_ratio")
    ),
    *(
        Damage(
            f"result.json stability {key} {value}",
            f"{value}",
            in_process(lambda process, key=key, value=value: process["stability"].update({key: value})),
            "result.json process",
            "process",
        )
        for key, value in (
            ("unknown_points", [[3, 4]]),
            ("unknown_points", [[5, 0]]),
            ("unknown_points", [[-3_000_000, 5]]),
            ("unknown_points", [[0, 10**15]]),
            ("least_ratio", 9.0),
            ("least_point", 0),
            ("stable", 1),
            ("min_stability_ratio", 0.4),
        )
    ),
    Damage("result.json outcome counts", "1 point", in_process(count_one_more), "result.json process", "process"),
    Damage("result.json variance share", "×2", in_process(double_first_share), "result.json process", "process"),
    Damage(
        "result.json quantile",
        "0.95 → 0.9",
        in_process(lambda process: process.update(quantile=0.9)),
        "result.json process",
        "process",
    ),
]
