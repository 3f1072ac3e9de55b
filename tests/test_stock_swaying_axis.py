"""Contact of layered jobs with a varying tool axis, compared with sampled cutter points; grazing plunges.

The reference does not use code of the product: a point of the outline is in contact if it is in the block and in no
earlier pose of the cutter, with poses 0.1 mm apart.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from stock_jobs import RADIUS, write_stock_cell

from machopt.cell.cell_reader import load_cell
from machopt.cell.tool_selection import split_into_tool_segments
from machopt.data_types.stock import StockBody
from machopt.data_types.tool_segments import ToolSegment
from machopt.process.binding.job_binding import attach_forces
from machopt.process.binding.operation_matching import attach_process
from machopt.process.stock.distance_field import build_distance_field
from machopt.process.stock.field_path import remove_field_path
from machopt.toolpath.toolpath_reader import read_toolpath
from machopt.verification.motion.process.stock_contact import check_stock_contact

HALF = np.array([0.03, 0.02, 0.01])  # m, half the sides of the block, whose top is at z = 0
LENGTH = 0.03  # m, of the cutter
ANGLES, HEIGHTS, POSES = 90, 90, 1e-4  # of the reference; distance of poses in m


def build_layers(seed: int, sway: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 3) m tips and (N, 3) axes of two layers of lanes with a plunge before each."""
    g = np.random.default_rng(seed)
    depth, spacing, step = g.uniform(1.5e-3, 3.5e-3), g.uniform(3e-3, 6e-3), g.uniform(1.5e-3, 3e-3)
    x, y = np.arange(-0.008, 0.008, step), np.arange(-0.5, 1.0) * spacing
    flat = np.concatenate([np.column_stack([x[:: (-1) ** n], np.full_like(x, v)]) for n, v in enumerate(y)])
    parts = []
    for z in (-depth, -2.0 * depth):
        layer = np.column_stack([flat, np.full(len(flat), z)])
        above = np.array([0.0, 0.0, 2e-3 - z])
        parts += [layer[:1] + above, layer, layer[-1:] + above]
    tip = np.concatenate(parts)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))]
    lean = sway * np.sin(way[:, None] / g.uniform(0.02, 0.05, 2) + g.uniform(0, 6, 2)) * [1.0, 0.5]
    axis = np.column_stack([np.tan(lean), np.ones(len(tip))])
    return tip, axis / np.linalg.norm(axis, axis=1)[:, None]


def list_touching(tip: np.ndarray, axis: np.ndarray, k: int, height: float) -> np.ndarray:
    """Return (HEIGHTS, ANGLES) whether points of the outline are in contact at the end of a move."""
    step = tip[k] - tip[k - 1]
    travel = step - (step @ axis[k]) * axis[k]
    travel /= np.linalg.norm(travel)
    phi = (np.arange(ANGLES) + 0.5) * np.pi / ANGLES
    out = np.cos(phi)[:, None] * np.cross(axis[k], travel) + np.sin(phi)[:, None] * travel
    w = (np.arange(HEIGHTS) + 0.5) / HEIGHTS * height
    place = (tip[k] + w[:, None, None] * axis[k] + RADIUS * out).reshape(-1, 3)
    left = (np.abs(place[:, :2]) < HALF[:2]).all(axis=1) & (place[:, 2] < 0.0) & (place[:, 2] > -2.0 * HALF[2])
    for j in range(1, k + 1):
        count = max(int(np.ceil(np.linalg.norm(tip[j] - tip[j - 1]) / POSES)), 1)
        for share in np.arange(1, count + (j < k)) / count:
            some = np.flatnonzero(left)
            direction = axis[j - 1] + share * (axis[j] - axis[j - 1])
            direction /= np.linalg.norm(direction)
            v = place[some] - tip[j - 1] - share * (tip[j] - tip[j - 1])
            along = v @ direction
            across = np.sqrt(np.maximum(np.sum(v * v, axis=1) - along**2, 0.0))
            left[some[(across < RADIUS - 1e-8) & (along > 0.0) & (along < LENGTH)]] = False
    return left.reshape(HEIGHTS, ANGLES)


def integrate_arcs(low: np.ndarray, high: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the integrals of 1, sin φ and cos φ over angle and height, mm."""
    height = 1e3 * (high - low)
    return np.array(
        [height @ (end - start), height @ (np.cos(start) - np.cos(end)), height @ (np.sin(end) - np.sin(start))]
    )


@pytest.mark.proof
@pytest.mark.parametrize("seed", [101, 102, 103])
def test_arcs_of_layers_with_a_swaying_axis_equal_sampled_points(seed: int) -> None:
    tip, axis = build_layers(seed, np.radians(7.0))
    mesh = trimesh.creation.box(2.0 * HALF)
    mesh.apply_translation([0, 0, -HALF[2]])
    body = StockBody(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, np.int64), cell_size=0.25e-3)
    stock = build_distance_field(body)
    cutter = (RADIUS, 0.0, 0.0, LENGTH)
    _, point, rows = remove_field_path(stock, tip, axis, np.ones(len(tip), bool), cutter)
    cuts = np.flatnonzero(np.linalg.norm(np.diff(tip, axis=0, prepend=tip[:1]) * [1, 1, 0], axis=1) > 1e-4)
    turn = np.pi / ANGLES
    phi = np.arange(ANGLES) * turn
    for k in cuts[:: len(cuts) // 4].tolist():
        height = 9e-3
        touching = list_touching(tip, axis, k, height)
        w, m = np.nonzero(touching)
        thick = height / HEIGHTS
        wanted = integrate_arcs(w * thick, (w + 1) * thick, phi[m], phi[m] + turn)
        found = integrate_arcs(*rows[point == k].T)
        assert np.abs(found - wanted).max() < 0.06 * wanted[0] + 0.02, k


def attach(folder: Path, rows: list[tuple[np.ndarray, np.ndarray, str]]) -> tuple[ToolSegment, ...]:
    """Write a cell with the block of the tests and a toolpath of tips, axes and moves; return its segments."""
    cell = write_stock_cell(folder / "cell")
    process = cell / "process.yaml"
    process.write_text(process.read_text().replace("cell_mm: 0.5", "cell_mm: 0.25"))
    mesh = trimesh.creation.box(2.0 * HALF)
    mesh.apply_translation([0, 0, -HALF[2]])
    mesh.export(cell / "meshes" / "stock.stl")
    lines = ["x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation"]
    for tip, axis, move in rows:
        numbers = ",".join(f"{v:.7f}" for v in (*(1e3 * tip), *(axis / np.linalg.norm(axis))))
        lines.append(f"{numbers},{move},{'1500' if move == 'cut' else ''},pocket")
    (folder / "path.csv").write_text("\n".join(lines) + "\n")
    model = load_cell(cell)
    toolpath = attach_process(model.process, read_toolpath(folder / "path.csv"))
    return attach_forces(split_into_tool_segments(model, toolpath))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "lean", "is_cut"), [(0.03e-3, 0.0, False), (-0.06e-3, 0.0, True), (0.4e-3, 0.09, True)]
)
def test_plunge_that_touches_the_stock_differs_from_one_that_passes_it(
    tmp_path: Path, gap: float, lean: float, is_cut: bool
) -> None:
    """The cutter plunges next to the block; if it is inclined,
    its side reaches the upper edge at the end of the plunge."""
    x, up, axis = -HALF[0] - RADIUS - gap, np.array([0.0, 0.0, 1.0]), np.array([lean, 0.0, 1.0])
    tips = [(x, 0.0, z) for z in (0.05, 0.003, -0.0035, -0.007)]
    rows = [(np.array(t), axis, "rapid" if n < 2 else "cut") for n, t in enumerate(tips)]
    rows += [(np.array([x + 1.5e-3 * n, 0.0, -0.007]), axis, "cut") for n in range(1, 4)]
    rows += [(np.array([x - 0.02, 0.0, 0.05]), up, "rapid"), (np.array([0.0, 0.0, 0.05]), up, "rapid")]
    segments = attach(tmp_path, rows)
    found = segments[0].toolpath.engagement
    assert found is not None
    assert found.is_end_cut[2:4].any() == is_cut
    assert not np.isin(found.point, [2, 3]).any()
    assert [check.passed for check in check_stock_contact(segments)] == [True, True]
    changed = found.is_end_cut.copy()
    changed[3] = not changed[3]
    wrong = replace(segments[0], toolpath=replace(segments[0].toolpath, engagement=replace(found, is_end_cut=changed)))
    # within one grid cell either result is accepted
    assert not check_stock_contact((wrong,))[1].passed or abs(gap) < 0.1e-3
