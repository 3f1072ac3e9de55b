"""Random small jobs over a surface: lines, arcs, reversals, corners of the tool axis, holes, dense points, repeats."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
# cell: a toolpath at the position of its workpiece
CELLS = {
    "kr500_milling": "contour_5axis.csv",
    "kr240_drilling": "panel_holes.csv",
    "irb6700_drilling": "plate_holes.csv",
    "s420f_handling": "castings.csv",
    "cutting_cobot": "bone_tracks.csv",
    "kr500_rail": "beam_passes.csv",
    "kr240_turntable": "drum_holes.csv",
}
POSTS = ("krl", "rapid", "urscript", "val3", "jbi", "fanuc_joint", "ros", "csv")
FEATURES = ("line", "arc", "reversal", "pivot", "corner", "holes", "dense", "repeat", "zigzag")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Row:
    """A point of a job in its local frame: z is the tool axis."""

    place: np.ndarray  # (3,) mm
    axis: np.ndarray  # (3,) unit
    move: str
    feed: float | None  # mm/min


def tilt_axis(angle: float, direction: float) -> np.ndarray:
    """Return the tool axis tilted from z by an angle (rad) in a direction (rad)."""
    sine = np.sin(angle)
    return np.array([sine * np.cos(direction), sine * np.sin(direction), np.cos(angle)])


def write_job(file: Path, rows: list[Row], origin: np.ndarray, axis: np.ndarray) -> Path:
    """Write rows as a table, with their z axis along ``axis`` and the origin ``origin`` (mm) in the workpiece frame."""
    side = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
    side /= np.linalg.norm(side)
    R = np.column_stack([side, np.cross(axis, side), axis])
    with file.open("w", encoding="utf-8") as out:
        out.write("x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n")
        for row in rows:
            place, tool = origin + R @ row.place, R @ row.axis
            feed = "" if row.feed is None else f"{row.feed:g}"
            out.write(",".join(f"{v:.6f}" for v in place) + "," + ",".join(f"{v:.9f}" for v in tool))
            out.write(f",{row.move},{feed},op\n")
    return file


def random_job(rng: np.random.Generator, features: tuple[str, ...] = FEATURES) -> list[Row]:
    """Return one to three features, each with its approach and retract."""
    rows: list[Row] = []
    for _ in range(int(rng.integers(1, 4))):
        feature, feed = str(rng.choice(features)), float(rng.choice([100.0, 300.0, 1000.0, 3000.0, 6000.0]))
        if feature == "holes":
            rows += _holes(rng, feed)
            continue
        start = np.array([*rng.uniform(-30, 30, 2), 0.0])
        rows.append(Row(start + 20 * UP, UP, "rapid", None))
        if rng.random() < 0.6:
            rows.append(Row(start + 3 * UP, UP, "approach", feed))
        rows.append(Row(start, UP, "cut", feed))
        rows += [Row(place, axis, "cut", feed) for place, axis in _cut(feature, start, rng)]
        rows.append(Row(rows[-1].place + 20 * rows[-1].axis, rows[-1].axis, "rapid", None))
    return rows


def _cut(feature: str, start: np.ndarray, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    if feature == "line":
        way = rng.uniform(-1, 1, 3) * [1, 1, 0.1]
        return [(start + way * s, UP) for s in np.cumsum(rng.uniform(0.05, 15, int(rng.integers(1, 8))))]
    if feature == "arc":
        radius, end = float(rng.choice([0.3, 2.0, 15.0])), rng.uniform(0.5, 6.3)
        angles = np.linspace(0, end, int(rng.integers(4, 40)))[1:]
        return [(start + radius * np.array([np.sin(t), 1 - np.cos(t), 0.0]), UP) for t in angles]
    if feature == "reversal":
        out, place = [], start
        for _ in range(int(rng.integers(2, 7))):
            place = place + rng.uniform(-1, 1, 3) * float(rng.choice([0.05, 0.2, 1.0, 5.0])) * [1, 1, 0.8]
            out.append((place, UP))
        return [*out, (place + np.array([10.0, 0.0, 3.0]), UP)]
    if feature in ("pivot", "corner"):
        direction, angle, steps = rng.uniform(0, 6.28), np.radians(rng.uniform(3, 20)), int(rng.integers(1, 5))
        radius = 0.0 if feature == "pivot" else float(rng.choice([0.02, 0.1, 1.0]))
        return axis_corner(
            start + np.array([20.0, 0.0, 0.0]), angle, steps, radius, direction, rng.uniform(-15, 15, 3) * [1, 1, 0.2]
        )
    if feature == "dense":
        step, height = float(rng.choice([0.01, 0.03, 0.08])), float(rng.choice([0.0, 0.002, 0.01]))
        way = step * np.arange(1, int(rng.integers(50, 400)))
        return [(start + np.array([s, 2 * np.sin(s / 3), height * rng.standard_normal()]), UP) for s in way]
    if feature == "repeat":
        place = start + np.array([8.0, 3.0, 0.0])
        return [
            (place, UP),
            (place, UP),
            (place + np.array([0.0, 5.0, 0.0]), UP),
            (place + np.array([0.0, 5.0, 0.0]), UP),
        ]
    wide = float(rng.choice([0.3, 2.0, 10.0]))
    return [
        (start + np.array([wide * ((k + 1) // 2 % 2), 0.3 * wide * (k // 2), 0.0]), UP)
        for k in range(1, int(rng.integers(4, 14)))
    ]


def axis_corner(
    place: np.ndarray, angle: float, steps: int, radius: float, direction: float, leave: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a cut to ``place`` (mm), a tilt of the tool axis by ``angle`` (rad) over an arc of ``radius`` (mm), and
    a further move."""
    out = [(place, UP)]
    for k in range(1, steps + 1):
        turn = np.pi / 2 * k / steps
        at = place + radius * np.array([np.sin(turn), 1 - np.cos(turn), 0.0])
        out.append((at, tilt_axis(angle * k / steps, direction)))
    return [*out, (out[-1][0] + leave, out[-1][1])]


def _holes(rng: np.random.Generator, feed: float) -> list[Row]:
    rows: list[Row] = []
    for _ in range(int(rng.integers(1, 5))):
        place, depth = np.array([*rng.uniform(-30, 30, 2), 0.0]), rng.uniform(1, 12)
        rows += [Row(place + 15 * UP, UP, "rapid", None), Row(place + 2 * UP, UP, "approach", feed)]
        if rng.random() < 0.3:
            for z in np.linspace(0, -depth, 4)[1:]:
                rows += [Row(place + z * UP, UP, "cut", feed), Row(place + UP, UP, "cut", 3000.0)]
        rows += [Row(place - depth * UP, UP, "cut", feed), Row(place + 2 * UP, UP, "cut", 3000.0)]
    return [*rows, Row(rows[-1].place + 13 * UP, UP, "rapid", None)]


def choose_place_above_cut(toolpath: Path, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return a point 15 to 50 mm above a cut of a toolpath table, and the tool axis there."""
    lines = [line for line in toolpath.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    cuts = [row for row in csv.DictReader(lines) if row.get("move") in (None, "", "cut")]
    row = cuts[int(rng.integers(len(cuts)))]
    axis = np.array([float(row[c]) for c in "ijk"])
    axis /= np.linalg.norm(axis)
    return np.array([float(row[f"{c}_mm"]) for c in "xyz"]) + axis * rng.uniform(15, 50), axis
