"""Engagement from the stock: error of volumes and entry angles, and processor seconds and memory for 100,000 points.

Run: ``python benchmarks/stock_engagement.py``. Cells of 0.25 mm. Exact values are closed forms.
"""

from __future__ import annotations

import resource
import time
from math import acos, degrees, pi

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from machopt.data_types.stock import StockBody
from machopt.process.stock.distance_field import build_distance_field
from machopt.process.stock.field_path import remove_field_path
from machopt.process.stock.height_map import HeightMap, build_height_map
from machopt.process.stock.path_removal import remove_path

CELL, POINTS, TURNING_POINTS = 0.25e-3, 100_000, 5_000
UP = np.array([0.0, 0.0, 1.0])
TURNS = ((0, 0, 0), (0.3, 0, 0), (0.2, -0.5, 0.3), (0.7, 0.4, 1.1), (pi / 4, 0, 0), (pi / 2, 0, 0))  # rad


def build_stock(mesh: trimesh.Trimesh) -> HeightMap:
    """Return the height map of a mesh."""
    return build_height_map(
        StockBody(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, np.int64), cell_size=CELL), UP
    )


def build_block(size: tuple[float, float, float]) -> HeightMap:
    """Return the height map of a block from the origin."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(np.array(size) / 2)
    return build_stock(mesh)


def remove(stock: HeightMap, path: np.ndarray, radius: float, corner: float = 0.0) -> tuple[np.ndarray, ...]:
    """Return volumes, points of arcs, and arcs."""
    return remove_path(stock, stock.convert_points(path), np.ones(len(path), bool), (radius, corner, 0.0), 0.05)


def measure_volumes() -> dict[str, float]:
    """Return the relative error of removed volumes."""
    out = {}
    for name, corner in (("flat", 0.0), ("bull-nose", 2e-3), ("ball", 6e-3)):
        R, depth, length, worst = 6e-3, 8e-3, 0.06, 0.0
        for angle in (0, 17, 45, 63):
            t = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
            path = np.array([0.06013, 0.05993, 0.012]) + np.linspace(-0.5, 0.5, 121)[:, None] * length * t
            found = remove(build_block((0.12, 0.12, 0.02)), path, R, corner)[0].sum()
            flat = R - corner
            section = 2 * R * (depth - corner) + 2 * flat * corner + pi * corner**2 / 2
            ends = pi * R**2 * (depth - corner) + pi * (
                flat**2 * corner + flat * pi * corner**2 / 2 + 2 / 3 * corner**3
            )
            worst = max(worst, abs(found / (section * length + ends) - 1))
        out[f"slot, {name}"] = worst
    for ae in (1e-3, 2e-3, 5e-3, 10e-3):
        worst = 0.0
        for radius in (10e-3, 8e-3, 6e-3):
            for step in (0.5e-3, 0.05e-3):
                for way in (1, -1):
                    path = build_pass(ae, radius, step)[::way]
                    found = remove(build_block((0.1, 0.06, 0.02)), path, radius)[0].sum()
                    worst = max(worst, abs(found / (0.1 * ae * 5e-3) - 1))
        out[f"block, one pass, ae {1e3 * ae:g} mm"] = worst
    cylinder = trimesh.creation.cylinder(radius=0.025, height=0.03, sections=720)
    stock = build_stock(cylinder)
    out["cylinder, whole"] = abs(stock.volume / cylinder.volume - 1)
    turn = np.linspace(0, 2 * pi, 1441)
    ring = np.column_stack([0.01 * np.cos(turn), 0.01 * np.sin(turn), np.full_like(turn, 0.005)])
    out["cylinder, ring"] = abs(remove(stock, ring, 0.004)[0].sum() / (pi * (0.014**2 - 0.006**2) * 0.01) - 1)
    return out


def measure_turned_volumes() -> dict[str, float]:
    """Return the relative error of the volume of a pass, of signed distances with the axis in six directions."""
    out = {}
    for ae in (1e-3, 2e-3, 5e-3, 10e-3):
        worst = 0.0
        for turn in TURNS:
            Q = Rotation.from_rotvec(turn).as_matrix()
            mesh = trimesh.creation.box((0.1, 0.06, 0.02))
            mesh.apply_translation((0.05, 0.03, 0.01))
            vertices, faces = np.array(mesh.vertices) @ Q.T, np.array(mesh.faces, np.int64)
            stock = build_distance_field(StockBody(vertices=vertices, faces=faces, cell_size=CELL))
            path = build_pass(ae, 10e-3, 0.5e-3)
            axis, every = np.tile(Q[:, 2], (len(path), 1)), np.ones(len(path), bool)
            volume = remove_field_path(stock, path @ Q.T, axis, every, (10e-3, 0.0, 0.0, 0.05))[0].sum()
            worst = max(worst, abs(float(volume) / (0.1 * ae * 5e-3) - 1))
        out[f"ae {1e3 * ae:g} mm"] = worst
    return out


def build_pass(ae: float, radius: float, step: float) -> np.ndarray:
    """Return a pass along the front of a block of 100 mm."""
    x = np.arange(-radius - 1e-3, 0.1 + radius + 1e-3, step)
    return np.column_stack([x, np.full_like(x, ae - radius), np.full_like(x, 0.015)])


def measure_angles() -> dict[str, float]:
    """Return the largest error of entry and exit angles, degrees."""
    out: dict[str, float] = {}
    for ae in (1e-3, 2e-3, 5e-3, 10e-3):
        for side in ("up", "down"):
            worst = 0.0
            for radius in (10e-3, 8e-3, 6e-3):
                for step in (0.5e-3, 0.05e-3):
                    path = build_pass(ae, radius, step)
                    path = path if side == "up" else path[::-1]
                    _, point, rows = remove(build_block((0.1, 0.06, 0.02)), path, radius)
                    theta = degrees(acos(1 - ae / radius))
                    wanted = (0.0, theta) if side == "up" else (180.0 - theta, 180.0)
                    inside = np.abs(path[point, 0] - 0.05) < 0.03
                    worst = max(worst, float(np.abs(np.degrees(rows[inside, 2:]) - wanted).max()))
            out[f"ae {1e3 * ae:g} mm, {side}"] = worst
    return out


def measure_time(radius: float, corner: float) -> tuple[float, int]:
    """Return processor seconds for ``POINTS`` points in steps of 0.5 mm, and the number of arcs."""
    s = np.arange(POINTS) * 0.5e-3
    lane = s // 0.3
    x = np.where(lane % 2 == 0, s % 0.3, 0.3 - s % 0.3)
    y = lane * 4e-3
    path = np.column_stack([x, y % 0.3, 0.03 - 5e-3 * (1 + y // 0.3)])
    stock = build_block((0.3, 0.3, 0.03))
    remove(build_block((0.02, 0.02, 0.02)), path[:10], radius, corner)  # compiles
    start = time.process_time()
    _, point, _ = remove(stock, path, radius, corner)
    return time.process_time() - start, len(point)


def measure_turning_time(radius: float, corner: float, turn: float) -> float:
    """Return processor seconds a point for a field of signed distances, on the first ``TURNING_POINTS`` of the path.

    Args:
        radius: m, of the cutter.
        corner: m, corner radius of the cutter.
        turn: degrees by which the axis sways to both sides.
    """
    s = np.arange(TURNING_POINTS) * 0.5e-3
    lane = s // 0.3
    path = np.column_stack([np.where(lane % 2 == 0, s % 0.3, 0.3 - s % 0.3), lane * 4e-3, np.full_like(s, 0.025)])
    lean = np.radians(turn) * np.sin(s / 0.05)
    axis = np.column_stack([np.zeros_like(s), np.sin(lean), np.cos(lean)])
    mesh = trimesh.creation.box((0.3, 0.3, 0.03))
    mesh.apply_translation((0.15, 0.15, 0.015))
    body = StockBody(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, np.int64), cell_size=CELL)
    cutter = (radius, corner, 0.0, 0.05)
    remove_field_path(build_distance_field(body), path[:2], axis[:2], np.ones(2, bool), cutter)  # compiles
    stock = build_distance_field(body)
    start = time.process_time()
    remove_field_path(stock, path, axis, np.ones(len(path), bool), cutter)
    return (time.process_time() - start) / TURNING_POINTS


def main() -> None:
    """Print all figures."""
    print("relative error of the removed volume")
    for name, error in measure_volumes().items():
        print(f"  {name:28} {100 * error:.4f} %")
    print("the same for a pass 5 mm deep, signed distances, axis in six directions")
    for name, error in measure_turned_volumes().items():
        print(f"  {name:28} {100 * error:.4f} %")
    print("largest error of entry and exit angle")
    for name, error in measure_angles().items():
        print(f"  {name:20} {error:.2f}°")
    print(f"{POINTS:,} points, D20, 0.5 mm steps, stock of 300 x 300 mm")
    for name, corner in (("flat", 0.0), ("bull-nose", 2e-3), ("ball", 10e-3)):
        seconds, arcs = measure_time(10e-3, corner)
        print(f"  {name:20} {seconds:.2f} CPU s, {arcs:,} arcs")
    print("axis that turns (signed distances), the same path")
    for name, corner, turn in (("flat, fixed axis", 0.0, 0.0), ("flat, ±10°", 0.0, 10.0), ("ball, ±10°", 10e-3, 10.0)):
        print(f"  {name:20} {1e3 * measure_turning_time(10e-3, corner, turn):.2f} ms CPU a point")
    print(f"largest memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
