"""Milling cell with a block of stock and its finished part, and a toolpath for the difference."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

ROOT = Path(__file__).resolve().parents[1]
KR500 = ROOT / "cells" / "kr500_milling"
LOW, HIGH = np.array([-0.06, -0.04, -0.03]), np.array([0.06, 0.04, 0.0])  # m, corners of the block in the CAM frame
HALF, DEPTH = np.array([0.04, 0.02]), 0.012  # m, half the sides of the pocket, and its depth
RADIUS = 0.0085  # m, of the cell's cutter and of the pocket's corners

PROCESS = """machopt_process: 1
materials:
  al7075:
    milling: {Ktc: 767, Krc: 169, Kac: 222, Kte: 27.7, Kre: 26.6, Kae: 0.7, spread_percent: 25, source: test}
operations:
  default: {kind: milling, material: al7075, spindle_rpm: 12000, engagement: stock, surface: floor,
    tolerance: {surface_mm: 0.15, reference: relative}}
stock: {mesh: meshes/stock.stl, cell_mm: 0.5}
modes: {damping_percent: 3, source: assumed}
"""


def build_pocket_path(layers: int = 2, stepover: float = 0.006, step: float = 0.004) -> np.ndarray:
    """Return the points (N, 3) in m of concentric pocket rings from the inside out, layer by layer."""
    inset = float(HALF.min()) - RADIUS
    rings = []
    for size in np.linspace(0.0005, inset, max(int(np.ceil(inset / stepover)), 1) + 1):
        a, b = HALF - RADIUS - (inset - size)
        corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b], [-a, -b]])
        for p, q in pairwise(corners):
            n = max(int(np.ceil(np.linalg.norm(q - p) / step)), 1)
            rings.append(p + np.linspace(0, 1, n, endpoint=False)[:, None] * (q - p))
        rings.append(corners[-1:])
    flat = np.concatenate(rings)
    depths = -DEPTH * (np.arange(layers) + 1) / layers
    return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in depths])


def write_toolpath(path: Path, points: np.ndarray, feed: float = 1500.0) -> None:
    """Write points as a toolpath table with one vertical tool axis and a rapid move above the first point."""
    lines = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
    x, y, _ = 1e3 * points[0]
    lines += [
        f"{x:.4f},{y:.4f},{z},0,0,1,{move},{feed},pocket" for z, move, feed in ((60, "rapid", ""), (2, "rapid", ""))
    ]
    lines += [f"{1e3 * x:.4f},{1e3 * y:.4f},{1e3 * z:.4f},0,0,1,cut,{feed:g},pocket" for x, y, z in points]
    path.write_text("\n".join(lines) + "\n")


def build_block() -> trimesh.Trimesh:
    """Return the block before machining."""
    mesh = trimesh.creation.box(HIGH - LOW)
    mesh.apply_translation((LOW + HIGH) / 2)
    return mesh


def build_pocketed_block(depth: float = DEPTH, corner_points: int = 24) -> trimesh.Trimesh:
    """Return the block with its pocket, whose corners have the radius of the cutter."""
    turn = np.linspace(0, np.pi / 2, corner_points)
    inner = []
    for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = turn + k * np.pi / 2
        centre = (HALF - RADIUS) * [sx, sy]
        inner.append(centre + RADIUS * np.column_stack([np.cos(angle), np.sin(angle)]))
    ring = np.concatenate(inner)
    n = len(ring)
    half = HIGH[:2]
    scale = np.min(half / np.maximum(np.abs(ring), 1e-12), axis=1)
    outer = ring * scale[:, None]  # on the sides of the block, at the angle of each pocket point
    nearest = [int(np.argmin(np.linalg.norm(outer - half * s, axis=1))) for s in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    outer[nearest] = [half * s for s in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    levels = [(outer, LOW[2]), (outer, HIGH[2]), (ring, HIGH[2]), (ring, HIGH[2] - depth)]
    vertices = np.concatenate([np.column_stack([flat, np.full(n, z)]) for flat, z in levels])
    vertices = np.vstack([vertices, [0, 0, LOW[2]], [0, 0, HIGH[2] - depth]])
    faces = []
    for k in range(n):
        m = (k + 1) % n
        for level in range(3):
            a, b, c, d = level * n + k, level * n + m, (level + 1) * n + m, (level + 1) * n + k
            faces += [[a, b, c], [a, c, d]]
        faces += [[4 * n, m, k], [4 * n + 1, 3 * n + k, 3 * n + m]]
    return trimesh.Trimesh(vertices, faces, process=False)


def write_stock_cell(folder: Path, process: str = PROCESS) -> Path:
    """Write the shipped milling cell with a stock and the finished part as its workpiece; return the folder."""
    shutil.copytree(KR500, folder)
    build_block().export(folder / "meshes" / "stock.stl")
    build_pocketed_block().export(folder / "meshes" / "finished.stl")
    text = (folder / "cell.yaml").read_text()
    text = text.replace("meshes/workpiece.stl", "meshes/finished.stl")
    (folder / "cell.yaml").write_text(text + "process: process.yaml\n")
    (folder / "process.yaml").write_text(process)
    return folder
