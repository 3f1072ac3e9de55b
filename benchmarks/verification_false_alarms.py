# ruff: noqa: E501 (the table of jobs reads best with one job a line)
"""Intact jobs: what is planned without a fault must verify. A check that refuses good plans is switched off by its users.

Small made-up jobs on the shipped cells, and cells made around other robots, run through ``machopt optimize`` and then
``machopt verify``; each must end 0, or 3 with a place. Random paths follow with ``--random N``.

Run: ``python benchmarks/verification_false_alarms.py [--only WORD] [--random N] [--seed S] [--robots FOLDER] [--acceptance SCRIPT]``.
``--robots``: a folder NAME/NAME.urdf with meshes, for cells around other robots. ``--acceptance``: a program called
with CELL POINTS OUT that prints a JSON object with ``fail`` and exits 0 where it agrees.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from machopt.cli import main as machopt_main  # noqa: E402

CELLS = ROOT / "cells"
PLANE = (0.0, 0.0, 1.0)
# where a job may lie on the shipped cells: mm in the workpiece
AT = {
    "kr500_milling": (-100.0, 0.0, 0.0),
    "kr240_drilling": (0.0, 100.0, 0.0),
    "irb6700_drilling": (-60.0, 30.0, 0.0),
    "s420f_handling": (0.0, 0.0, 40.0),
    "cutting_cobot": (-20.0, 0.0, 2.0),
}


@dataclass(frozen=True)
class Row:
    """One point: place in mm relative to the job's own, axis, move, feed in mm/min, label, further columns."""

    x: float
    y: float
    z: float
    move: str = "cut"
    feed: float | None = 1500.0
    axis: tuple[float, float, float] = PLANE
    label: str = "op"


@dataclass(frozen=True)
class Job:
    """One job: cell, path, how the file is written, options and what is changed in the cell."""

    name: str
    cell: str
    rows: Sequence[Row]
    options: tuple[str, ...] = ()
    writer: str = "csv"
    edit: Callable[[dict[str, Any], Path], None] | None = None
    gaps: bool = False  # points may be given up: the acceptance program does not know that
    reading: tuple[str, ...] = ()
    extra: dict[str, list[str]] = field(default_factory=dict)  # further columns of the table
    infeasible: bool = False  # 3 is the right answer
    refused: bool = False  # 2 is


# ---- paths ---------------------------------------------------------------------------------------------------------
def rapid(x: float, y: float, z: float, **more: Any) -> Row:
    return Row(x, y, z, "rapid", None, **more)


def line(points: Sequence[Sequence[float]], feed: float = 1500.0, **more: Any) -> list[Row]:
    """Rapid above the first, plunge at a feed, the points, retract by a rapid move."""
    first, last = points[0], points[-1]
    return [
        rapid(first[0], first[1], 60, **more),
        Row(first[0], first[1], 3, "approach", 2000.0, **more),
        *(Row(p[0], p[1], p[2], "cut", feed, **more) for p in points),
        rapid(last[0], last[1], 60, **more),
    ]


def circle(r: float, n: int, z: float = -0.5) -> list[list[float]]:
    return [[r * math.cos(a), r * math.sin(a), z] for a in np.linspace(0, 2 * math.pi, n)]


def spiral(r: float, n: int, turns: float = 3.0, z: float = -0.5) -> list[list[float]]:
    return [
        [r * f * math.cos(a), r * f * math.sin(a), z]
        for f, a in zip(np.linspace(0.1, 1, n), np.linspace(0, 2 * math.pi * turns, n), strict=True)
    ]


def pocket(w: float, h: float, step: float) -> list[list[float]]:
    out: list[list[float]] = []
    for n, y in enumerate(np.arange(0, h + 1e-9, step)):
        out += [[0 if n % 2 == 0 else w, y, -0.5], [w if n % 2 == 0 else 0, y, -0.5]]
    return out


def tilted(r: float, n: int, most_deg: float) -> list[Row]:
    """A straight cut whose axis swings."""
    out: list[Row] = []
    for f in np.linspace(0, 1, n):
        a, b = math.radians(most_deg) * math.sin(2 * math.pi * f), math.radians(most_deg) * math.sin(3 * math.pi * f)
        v = np.array([math.sin(a), math.sin(b) * math.cos(a), math.cos(a) * math.cos(b)])
        v /= np.linalg.norm(v)
        out.append(Row(2 * r * f, 10 * math.sin(math.pi * f), 0.5, "cut", 1200.0, (v[0], v[1], v[2])))
    first, last = out[0], out[-1]
    return [
        rapid(first.x, first.y, 60, axis=first.axis),
        Row(first.x, first.y, 5, "approach", 2000.0, first.axis),
        *out,
        Row(last.x, last.y, 5, "retract", 2000.0, last.axis),
        rapid(last.x, last.y, 60, axis=last.axis),
    ]


def holes(n: int, deep: float = -8.0, *, retract: bool = True) -> list[Row]:
    out: list[Row] = []
    for k in range(n):
        x, y = 12.0 * (k % 3), 15.0 * (k // 3)
        out += [rapid(x, y, 20), Row(x, y, deep, "cut", 300.0)]
        out += [Row(x, y, 2, "cut" if k % 2 else "retract", 3000.0)] if retract else []
        out += [rapid(x, y, 20)]
    return out


def random_path(rng: np.random.Generator) -> list[Row]:
    """Runs of cuts with arbitrary feeds, sharp corners, doubled points, ramps, plunges and bare rapid moves."""
    out: list[Row] = []
    for run in range(int(rng.integers(1, 4))):
        label = f"run {run}"
        tilt = math.radians(float(rng.choice([0, 0, 5, 12])))
        phase = float(rng.uniform(0, 2 * math.pi))
        here = rng.uniform([-30, -30, -0.8], [30, 30, 0.3])
        out.append(rapid(here[0], here[1], 50.0, label=label))
        if rng.random() < 0.6:
            out.append(Row(here[0], here[1], 3.0, "approach", float(rng.choice([300, 2000])), label=label))
        feed = float(rng.choice([30, 200, 1500, 6000]))
        count = int(rng.integers(1, 25))
        for n in range(count):
            share = math.sin(math.pi * n / max(count - 1, 1))  # upright at either end
            a = tilt * share
            v = (math.sin(a) * math.cos(phase), math.sin(a) * math.sin(phase), math.cos(a))
            kind = rng.random()
            if kind < 0.08 and n:
                pass  # the same place again
            elif kind < 0.2:
                here = here + np.array([0, 0, rng.uniform(-1.0, 0.6)])  # along the axis
                here[2] = min(max(here[2], -2.0), 3.0)
            else:
                here = here + np.array([*rng.normal(size=2) * rng.choice([0.2, 3, 15]), rng.normal() * 0.2])
                here[:2] = np.clip(here[:2], -45, 45)
            if rng.random() < 0.25:
                feed = float(rng.choice([30, 60, 200, 600, 1500, 3000, 6000]))
            feed = max(feed, 200.0) if kind > 0.2 else feed  # a minute of path is enough
            out.append(Row(here[0], here[1], here[2], "cut", feed, v, label))
        if rng.random() < 0.4:
            out.append(Row(here[0], here[1], here[2] + 5, "retract", 3000.0, out[-1].axis, label))
        out.append(rapid(here[0], here[1], 50.0, label=label))
    return out


# ---- files ---------------------------------------------------------------------------------------------------------
def write_table(
    file: Path, rows: Sequence[Row], extra: dict[str, list[str]], scale: float = 1.0, unit: str = "_mm"
) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        out = csv.writer(stream)
        out.writerow(
            [*(c + unit for c in "xyz"), "i", "j", "k", "move", "feed_mm_min" if unit else "feed", "operation", *extra]
        )
        for n, r in enumerate(rows):
            feed = "" if r.feed is None else f"{r.feed * scale:.6f}"
            place = [f"{v * scale:.7f}" for v in (r.x, r.y, r.z)]
            out.writerow(
                [
                    *place,
                    *(f"{v:.9f}" for v in r.axis),
                    r.move,
                    feed,
                    r.label,
                    *(column[n] for column in extra.values()),
                ]
            )


def write_gcode(file: Path, rows: Sequence[Row], *, inch: bool = False) -> None:
    s = 1 / 25.4 if inch else 1.0
    out = ["%", "O1", "G20" if inch else "G21", "G17 G40 G90 G94", "T1 M6", "S5000 M3"]
    for n, r in enumerate(rows):
        word = "G0" if r.feed is None else "G1"
        feed = "" if r.feed is None else f" F{r.feed * s:.5f}"
        axis = ("G43.5 H1 " if n == 0 else "") + "{} X{:.6f} Y{:.6f} Z{:.6f} I{:.9f} J{:.9f} K{:.9f}"
        out.append(axis.format(word, r.x * s, r.y * s, r.z * s, *r.axis) + feed)
    file.write_text("\n".join([*out, "M5", "M30", "%"]) + "\n", encoding="utf-8")


def write_apt(file: Path, rows: Sequence[Row], *, clsf: bool = False) -> None:
    out = ["TOOL PATH/A,TOOL,T", "MSYS/0,0,0,1,0,0,0,1,0"] if clsf else ["PARTNO A", "UNITS/MM", "MULTAX"]
    for r in rows:
        if r.feed is None:
            out.append("RAPID")
        else:
            out.append(f"FEDRAT/MMPM,{r.feed:.4f}" if clsf else f"FEDRAT/{r.feed:.4f},MMPM")
        out.append("GOTO/" + ",".join(f"{v:.7f}" for v in (r.x, r.y, r.z, *r.axis)))
    out.append("END-OF-PATH" if clsf else "FINI")
    file.write_text("\n".join(out) + "\n", encoding="utf-8")


def write_heidenhain(file: Path, rows: Sequence[Row]) -> None:
    out = ["0 BEGIN PGM A MM", "1 TOOL CALL 1 Z S5000", "2 M3", "3 FUNCTION TCPM F TCP AXIS SPAT PATHCTRL AXIS"]
    for n, r in enumerate(rows):
        feed = "FMAX" if r.feed is None else f"F{r.feed:.0f}"
        normal = "" if r.axis == PLANE else " TX{:+.7f} TY{:+.7f} TZ{:+.7f}".format(*r.axis)
        word = "LN" if normal else "L"
        out.append(f"{n + 4} {word} X{r.x:+.5f} Y{r.y:+.5f} Z{r.z:+.5f}{normal} {feed}")
    file.write_text("\n".join([*out, f"{len(rows) + 4} M30", f"{len(rows) + 5} END PGM A MM"]) + "\n", encoding="utf-8")


def write_path(folder: Path, job: Job, rows: Sequence[Row]) -> tuple[Path, tuple[str, ...]]:
    """The CAM file, and reading options it needs."""
    match job.writer:
        case "gcode" | "gcode_inch":
            write_gcode(file := folder / "job.nc", rows, inch=job.writer == "gcode_inch")
        case "apt" | "clsf":
            write_apt(
                file := folder / ("job.aptsource" if job.writer == "apt" else "job.cls"),
                rows,
                clsf=job.writer == "clsf",
            )
        case "heidenhain":
            write_heidenhain(file := folder / "job.h", rows)
        case "inch":
            write_table(file := folder / "job.csv", rows, job.extra, 1 / 25.4, "")
            return file, ("--unit", "inch")
        case _:
            write_table(file := folder / "job.csv", rows, job.extra)
    return file, ()


# ---- cells ---------------------------------------------------------------------------------------------------------
def soft(k: float) -> Callable[[dict[str, Any], Path], None]:
    def edit(cell: dict[str, Any], folder: Path) -> None:
        (folder / cell["stiffness"]).write_text(f"machopt_stiffness: 1\njoints_Nm_per_rad: {[k] * 6}\n", "utf-8")

    return edit


def stiffness(text: str) -> Callable[[dict[str, Any], Path], None]:
    """More lines for stiffness.yaml."""

    def edit(cell: dict[str, Any], folder: Path) -> None:
        file = folder / cell["stiffness"]
        file.write_text(file.read_text("utf-8") + "\n" + text + "\n", "utf-8")

    return edit


def kinematics(text: str) -> Callable[[dict[str, Any], Path], None]:
    def edit(cell: dict[str, Any], folder: Path) -> None:
        (folder / "kinematics.yaml").write_text("machopt_kinematics: 1\n" + text, "utf-8")
        cell["kinematics"] = "kinematics.yaml"

    return edit


def change(**at: Any) -> Callable[[dict[str, Any], Path], None]:
    """Set (or with None drop) keys, written section__key."""

    def edit(cell: dict[str, Any], folder: Path) -> None:
        del folder
        for path, value in at.items():
            *parents, key = path.split("__")
            here = cell
            for p in parents:
                here = here.setdefault(p, {})
            if value is None:
                here.pop(key, None)
            else:
                here[key] = value

    return edit


def make_cell(folder: Path, job: Job, robots: Path | None) -> Path | None:
    """The job's cell: a shipped one as it is, an edited copy, or one around another robot."""
    known = CELLS / job.cell
    if known.is_dir() and job.edit is None:
        return known
    out = folder / "cell"
    yaml = YAML(typ="safe", pure=True)
    if known.is_dir():
        shutil.copytree(known, out, ignore=shutil.ignore_patterns("recordings"))
        cell = yaml.load((out / "cell.yaml").read_text("utf-8"))
    else:
        source = None if robots is None else robots / job.cell
        if source is None or not source.is_dir():
            return None
        shutil.copytree(source, out)
        cell = around(out, job.cell)
    if job.edit is not None:
        job.edit(cell, out)
    with (out / "cell.yaml").open("w", encoding="utf-8") as stream:
        yaml.dump(cell, stream)
    return out


def around(folder: Path, name: str) -> dict[str, Any]:
    """A cell with a simple spindle and a block within reach."""
    import xml.etree.ElementTree as ET

    tree = ET.parse(folder / f"{name}.urdf")
    links = {str(link.get("name")) for link in tree.iter("link")}
    moving = [j for j in tree.iter("joint") if j.get("type") == "revolute"]
    small = name in ("m20ia", "rx160")
    ahead, high = (900.0, 450.0) if small else (1700.0, 700.0)
    (folder / "stiffness.yaml").write_text(
        "machopt_stiffness: 1\njoints_Nm_per_rad: [2e6, 2e6, 1.5e6, 4e5, 3e5, 2e5]\n"
    )
    return {
        "machopt_cell": 1,
        "name": name,
        "robot": {
            "urdf": f"{name}.urdf",
            "base_link": "base_link",
            "flange_link": "flange" if "flange" in links else "tool0",
            "arm_joints": [str(j.get("name")) for j in moving],
            "external_joints": [],
            "packages": {p.name: p.name for p in folder.iterdir() if p.is_dir()},
            "home_deg": {"m20ia": [0, 0, 0, 0, -45, 0], "rx160": [0, 20, 80, 0, 45, 0]}.get(
                name, [0, -90, 90, 0, 45, 0]
            ),
            "limits": {"velocity_deg_s": [100.0] * 6, "acceleration_deg_s2": [300.0] * 6, "jerk_deg_s3": [2000.0] * 6},
        },
        "tool": {
            "tcp": {"xyz_mm": [120, 0, 180], "rpy_deg": [0, 30, 0]},
            "mass_kg": 8,
            "com_mm": [30, 0, 80],
            "geometry": [{"name": "spindle", "cylinder_mm": [30, 90], "xyz_mm": [40, 0, 50]}],
            "cutter": {"diameter_mm": 8, "length_mm": 50},
        },
        "workpiece": {
            "link": "world",
            "pose": {"xyz_mm": [ahead, 0, high]},
            "geometry": [{"name": "block", "box_mm": [220, 220, 60], "xyz_mm": [0, 0, -30]}],
        },
        "obstacles": [{"name": "table", "box_mm": [400, 600, 40], "xyz_mm": [ahead, 0, high - 90]}],
        "stiffness": "stiffness.yaml",
    }


# ---- the jobs ------------------------------------------------------------------------------------------------------
GRID = """grid:
  origin_mm: [1840.7, -600.0, 184.3]
  cell_mm: 600
  shape: [1, 2, 1]
  joints_Nm_per_rad: [[1.48e7, 5.57e6, 6.80e6, 3.38e5, 1.20e5, 2.17e5], [1.5e7, 6.29e6, 4.56e6, 2.79e5, 3.28e5, 1.61e5]]"""
TERMS = """terms:
  - {effect: link_compliance, location: "link:4", parameters: {compliance_diagonal: [1e-9, 1e-9, 1e-9, 1e-7, 1e-7, 1e-7]}}
  - {effect: joint_coupling, location: "joint:4-5", parameters: {compliance_rad_per_Nm: 2e-7}}"""
COVARIANCE = "covariance: " + str([[1e-16 if r == c else 0.0 for c in range(6)] for r in range(6)])
OFFSETS = """corrections:
  - {effect: joint_zero_offset, location: "joint:2", parameters: {offset_deg: -0.1}}
  - {effect: joint_zero_offset, location: "joint:5", parameters: {offset_deg: 0.2}}
  - {effect: transmission_error, location: "joint:1", parameters: {per_turn: 30, cos_arcsec: 18, sin_arcsec: -9}}
"""
ODD = ('a, "b"', "=1+1", "  two  words ", "Größe µ 中", "it's;#1", "-x", "@home")


def at(job: Job) -> list[Row]:
    """The rows where the cell has its job."""
    x, y, z = AT.get(job.cell, (0.0, 0.0, 0.0))
    return [Row(r.x + x, r.y + y, r.z + z, r.move, r.feed, r.axis, r.label) for r in job.rows]


def fixed_jobs() -> list[Job]:
    """Every kind of path, file, option and cell once."""
    L = line([[0, 0, -0.5], [30, 0, -0.5], [30, 20, -0.5]])
    short = line([[0, 0, -0.5], [10, 0, -0.5], [12, 6, -0.5]])
    bare = [rapid(0, 0, 60), Row(0, 0, -0.5), Row(10, 0, -0.5), rapid(10, 0, 60)]
    feeds = line([[x, 0, -0.5] for x in range(8)])
    feeds = [
        Row(r.x, r.y, r.z, r.move, None if r.feed is None else (30, 6000, 60, 3000)[n % 4]) for n, r in enumerate(feeds)
    ]
    double = line([[0, 0, -0.5], [0, 0, -0.5], [8, 0, -0.5], [8, 0, -0.5], [8, 0, -0.5], [8, 8, -0.5], [0, 8, -0.5]])
    odd = [r for n, word in enumerate(ODD) for r in line([[n * 6, 0, -0.5], [n * 6, 5, -0.5]], label=word)]
    arc = circle(300, 25)
    far = line([[x - 300, y, z] for x, y, z in arc[:13]])
    jobs = [
        Job("bare step 30", "kr500_milling", bare, ("--set", "rotation_step_deg=30")),
        Job("bare", "kr500_milling", bare),
        Job(
            "L default", "kr500_milling", L, ("--method", "default"), infeasible=True
        ),  # gamma = 0 turns 90° on the spot
        Job("L jiao", "kr500_milling", L, ("--method", "jiao2022")),
        Job(
            "L default bare",
            "kr500_milling",
            [rapid(0, 0, 60), *(Row(*p) for p in ((0, 0, -0.5), (30, 0, -0.5), (30, 20, -0.5))), rapid(30, 20, 60)],
            ("--method", "default"),
            infeasible=True,
        ),
        Job("pocket", "kr500_milling", line(pocket(30, 12, 4))),
        Job("spiral", "kr500_milling", line(spiral(15, 60)), ("--set", "sample_ms=4")),
        Job("circle closed", "kr500_milling", line(circle(15, 37)), ("--sample-ms", "20")),
        Job("tilts", "kr500_milling", tilted(20, 25, 15)),
        Job("tilts default", "kr500_milling", tilted(20, 25, 15), ("--method", "default")),
        Job("feeds", "kr500_milling", feeds),
        Job("doubled points", "kr500_milling", double),
        Job("odd labels", "kr500_milling", odd, ("--post", "csv", "--post", "krl")),
        Job("one point", "kr500_milling", [Row(0, 0, -0.5)]),
        Job("one point between rapids", "kr500_milling", [rapid(0, 0, 40), Row(0, 0, -0.5), rapid(0, 0, 40)]),
        Job("no rapids", "kr500_milling", [Row(0, 0, -0.5), Row(10, 0, -0.5), Row(10, 10, -0.5)]),
        Job(
            "ramp and plunge",
            "kr500_milling",
            [
                rapid(0, 0, 30),
                Row(0, 0, 2, "approach", 3000),
                Row(20, 0, -2, "cut", 600),
                Row(0, 0, -4, "cut", 600),
                Row(0, 0, -6, "cut", 100),
                Row(0, 0, 30, "retract", 3000),
            ],
        ),
        Job("compensate", "kr500_milling", L, ("--compensate",)),
        Job(
            "compensate circle",
            "kr500_milling",
            line(circle(12, 25)),
            ("--compensate", "--set", "force_N={travel: 300, normal: 100, axial: 500}"),
        ),
        Job("compensate plunge", "kr500_milling", holes(3), ("--compensate",)),
        Job(
            "compensate soft",
            "kr500_milling",
            L,
            ("--compensate", "--set", "compensation_max_mm=5"),
            edit=soft(2e5),
            infeasible=True,
        ),  # the shift would be too steep, and that is said
        Job("soft 1e3", "kr500_milling", short, edit=soft(1e3), refused=True),
        Job("soft 5e4", "kr500_milling", short, edit=soft(5e4)),
        Job("two grid", "kr500_milling", short, edit=change(stiffness="stiffness_two_grid.yaml")),
        Job("terms", "kr500_milling", short, edit=stiffness(TERMS)),
        Job("terms compensate", "kr500_milling", short, ("--compensate",), edit=stiffness(TERMS)),
        Job("covariance", "kr500_milling", short, edit=stiffness(COVARIANCE)),
        Job("index stiffness", "kr500_milling", short, ("--index", "stiffness")),
        Job("index jiao", "kr500_milling", short, ("--index", "jiao2022")),
        Job("index deflection", "kr500_milling", short, ("--index", "deflection")),
        Job("step 2", "kr500_milling", short, ("--set", "rotation_step_deg=2")),
        Job("no collision", "kr500_milling", short, ("--set", "collision=false")),
        Job("fixed", "kr500_milling", short, ("--set", "fixed=[{point: 3, gamma_deg: 30}]")),
        Job("zero offsets", "kr500_milling", L, edit=kinematics(OFFSETS)),
        Job("zero offsets compensate", "kr500_milling", short, ("--compensate",), edit=kinematics(OFFSETS)),
        Job("no tool mesh", "kr500_milling", short, edit=change(tool__geometry=[])),
        Job("no workpiece", "kr500_milling", short, edit=change(workpiece__geometry=[])),
        Job("no cutter", "kr500_milling", line([[0, 0, 1], [10, 0, 1]]), edit=change(tool__cutter=None)),
        Job("cls", "kr500_milling", L, writer="clsf"),
        Job("apt", "kr500_milling", L, writer="apt"),
        Job("gcode", "kr500_milling", tilted(15, 12, 10), writer="gcode"),
        Job("gcode inch", "kr500_milling", L, writer="gcode_inch"),
        Job("heidenhain", "kr500_milling", L, writer="heidenhain"),
        Job("inch table", "kr500_milling", L, writer="inch"),
        Job("gap middle", "kr500_milling", far, ("--allow-gaps",), gaps=True),
        Job(
            "gap first",
            "kr500_milling",
            line([[3000, 0, 0], [10, 0, -0.5], [20, 0, -0.5], [20, 10, -0.5]]),
            ("--allow-gaps",),
            gaps=True,
        ),
        Job(
            "gap one in the middle",
            "kr500_milling",
            [
                *line([[0, 0, -0.5], [10, 0, -0.5], [20, 0, -0.5]])[:-1],
                Row(20, 3000, -0.5),
                *line([[30, 0, -0.5], [40, 0, -0.5]])[2:],
            ],
            ("--allow-gaps",),
            gaps=True,
        ),
        Job(
            "gap last",
            "kr500_milling",
            line([[0, 0, -0.5], [10, 0, -0.5], [20, 0, -0.5], [20, 3000, -0.5]]),
            ("--allow-gaps",),
            gaps=True,
        ),
        Job(
            "gap operation",
            "kr500_milling",
            [
                *line([[0, 0, -0.5], [10, 0, -0.5]], label="a"),
                *line([[3000, 0, -0.5], [3000, 10, -0.5]], label="b"),
                *line([[0, 20, -0.5], [10, 20, -0.5]], label="c"),
            ],
            ("--allow-gaps",),
            gaps=True,
        ),
        Job("unreachable", "kr500_milling", line([[0, 0, -0.5], [3000, 0, -0.5]]), infeasible=True),
        Job("drilling", "irb6700_drilling", holes(5)),
        Job("drilling no retract", "irb6700_drilling", holes(4, retract=False)),
        Job("drilling milled", "irb6700_drilling", L),
        Job("drilling compensate", "irb6700_drilling", holes(3), ("--compensate", "--set", "force_N={axial: 400}")),
        Job("panel holes", "kr240_drilling", holes(3)),
        Job("panel L default", "kr240_drilling", short, ("--method", "default")),
        Job(
            "handling",
            "s420f_handling",
            [
                rapid(0, 0, 120),
                Row(0, 0, 30, "approach", 6000),
                Row(0, 0, 2, "cut", 600),
                Row(0, 0, 60, "retract", 6000),
                rapid(300, 300, 120),
                Row(300, 300, 2, "cut", 600),
                Row(300, 300, 60, "retract", 6000),
            ],
        ),
        Job("cobot", "cutting_cobot", line([[0, 0, 0.5], [5, 0, 0.5], [10, 1, 0.5]], 120)),
    ]
    posts = (
        "krl",
        "krl_pos",
        "krl_spline",
        "rapid",
        "fanuc",
        "fanuc_joint",
        "urscript",
        "urscript_movep",
        "urscript_servoj",
        "val3",
        "jbi",
        "jbi_rectan",
        "csv",
        "json",
        "ros_yaml",
        "ros_json",
    )
    for k in range(0, len(posts), 4):
        chosen = tuple(word for post in posts[k : k + 4] for word in ("--post", post))
        jobs.append(Job(f"posts {' '.join(posts[k : k + 4])}", "kr500_milling", short, chosen))
        jobs.append(Job(f"posts drilling {' '.join(posts[k : k + 4])}", "irb6700_drilling", holes(2), chosen))
    jobs += [
        Job(f"{name} {n}", name, rows)
        for name in ("m20ia", "rx160", "kr210l150", "kr500_r2800_2")
        for n, rows in (("L", L), ("tilts", tilted(15, 12, 10)), ("circle", line(circle(15, 25))))
    ]
    return jobs


def random_jobs(count: int, seed: int) -> list[Job]:
    rng = np.random.default_rng(seed)
    options: list[tuple[str, ...]] = [
        (),
        (),
        ("--method", "default"),
        ("--method", "jiao2022"),
        ("--set", "rotation_step_deg=30"),
        ("--compensate", "--set", "force_N={travel: 100, normal: 50, axial: 80}"),
        ("--sample-ms", "4"),
        ("--sample-ms", "20"),
        ("--post", "rapid", "--post", "fanuc"),
        ("--post", "urscript_movep", "--post", "jbi_rectan"),
        ("--index", "jiao2022"),
    ]
    cells = ("kr500_milling", "irb6700_drilling")
    return [
        Job(f"random {seed}:{n}", str(rng.choice(cells)), random_path(rng), options[int(rng.integers(len(options)))])
        for n in range(count)
    ]


# ---- running -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Outcome:
    """What the commands said."""

    optimize: int
    verify: int | None
    accepted: str  # "yes", "no: …", "-" where not asked
    failing: tuple[str, ...]
    said: str

    def alarm(self, job: Job) -> bool:
        if job.refused:
            return self.optimize != 2
        right = (3,) if job.infeasible else (0,)
        return self.optimize not in right or self.verify not in right or self.accepted.startswith("no")


def called(arguments: list[str]) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = machopt_main(arguments)
        except SystemExit as end:
            code = int(end.code or 0) if not isinstance(end.code, str) else 2
    return code, out.getvalue(), err.getvalue()


def run(job: Job, folder: Path, robots: Path | None, acceptance: Path | None) -> Outcome | None:
    """Plan and verify; None where the robot is not at hand."""
    cell = make_cell(folder, job, robots)
    if cell is None:
        return None
    rows = at(job)
    file, reading = write_path(folder, job, rows)
    reading += job.reading
    out = folder / "out"
    code, _, err = called(["optimize", str(cell), str(file), "-o", str(out), "--quiet", *reading, *job.options])
    if not out.is_dir():
        return Outcome(code, None, "-", (), err.strip())
    verified, text, _ = called(["verify", str(cell), str(file), str(out), "--json"])
    checks = json.loads(text).get("checks", []) if text.strip() else []
    failing = tuple(
        f"{c['name']}: {c['value']:.4g} > {c['limit']:.4g} {c['unit']} ({c['where'][:160]})"
        for c in checks
        if not c["passed"] and c["value"] is not None
    )
    failing += tuple(f"{c['name']}: {c['where'][:160]}" for c in checks if not c["passed"] and c["value"] is None)
    accepted = "-"
    if acceptance is not None and code == 0 and not job.gaps and len(rows) > 1 and "--compensate" not in job.options:
        write_table(truth := folder / "truth.csv", rows, {})
        done = subprocess.run(
            [sys.executable, str(acceptance), str(cell), str(truth), str(out)],
            capture_output=True,
            text=True,
            check=False,
        )
        accepted = "yes" if done.returncode == 0 else "no: " + str(json.loads(done.stdout or '{"fail": "?"}')["fail"])
    return Outcome(code, verified, accepted, failing, err.strip())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="jobs whose name contains this")
    parser.add_argument("--random", type=int, default=0, help="so many random jobs instead of the fixed ones")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--robots", type=Path)
    parser.add_argument("--acceptance", type=Path)
    parser.add_argument("--keep", type=Path, help="leave the jobs' folders here")
    args = parser.parse_args()
    jobs = random_jobs(args.random, args.seed) if args.random else fixed_jobs()
    alarms = ran = 0
    print(f"{'job':44} {'cell':18} optimize verify accepted")
    for n, job in enumerate(jobs):
        if args.only not in job.name:
            continue
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) if args.keep is None else args.keep / f"{n:03d}"
            if args.keep is not None:
                shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True, exist_ok=True)
            start = time.perf_counter()
            found = run(job, folder, args.robots, args.acceptance)
        if found is None:
            continue
        ran += 1
        bad = found.alarm(job)
        alarms += bad
        print(
            f"{job.name:44} {job.cell:18} {found.optimize:^8} {found.verify!s:^6} {found.accepted[:80]}"
            f"{'  <-- ALARM' if bad else ''} {time.perf_counter() - start:.1f} s",
            flush=True,
        )
        for text in found.failing:
            print(f"    {text}")
        if (bad or found.optimize) and found.said:
            print(f"    said: {found.said[:600]}", flush=True)
    print(f"{ran} jobs, {alarms} false alarms")
    sys.exit(1 if alarms else 0)


if __name__ == "__main__":
    main()
