"""Depth of a cutter in a part, compared with analytic solids and trimesh."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_cell import pose

from machopt.collision.gouge_depth import build_cutter_points, build_spiral_points, compute_gouge_depth
from machopt.data_types.cell import CollisionShape, CutterGeometry
from machopt.errors import InputError

LIMIT = 1e-4


def export_part(mesh: trimesh.Trimesh, folder: Path, name: str = "part.stl") -> CollisionShape:
    mesh.export(folder / name)
    return CollisionShape(name="part", kind="mesh", size=(1.0,), mesh=folder / name, T_parent_shape=np.eye(4))


def poses(count: int, seed: int, spread: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    T[:, :3, 3] = rng.uniform(-spread, spread, (count, 3))
    return T


def test_points_lie_on_the_cutter() -> None:
    for corner in (0.0, 0.002, 0.006):
        x = build_cutter_points(CutterGeometry(0.012, 0.05, corner))
        r, h = np.hypot(x[:, 0], x[:, 1]), -x[:, 2]
        core, rise = np.maximum(r - (0.006 - corner), 0.0), np.maximum(corner - h, 0.0)
        assert h.min() == 0.0
        np.testing.assert_allclose(h.max(), 0.05)
        np.testing.assert_allclose(r.max(), 0.006)
        on = (np.abs(np.hypot(core, rise) - corner) < 1e-12) | (np.abs(r - 0.006) < 1e-12)
        assert on[h < 0.05 - 1e-12].all()


def test_meshes_agree_with_their_analytic_solids(tmp_path: Path) -> None:
    points, T = build_cutter_points(CutterGeometry(0.01, 0.04)), poses(60, 0, 0.12)
    box = CollisionShape(
        name="box", kind="box", size=(0.16, 0.2, 0.1), mesh=None, T_parent_shape=pose(0.01, 0, 0.02, 0.3)
    )
    mesh = trimesh.creation.box(box.size)
    by_mesh = replace(export_part(mesh, tmp_path), T_parent_shape=box.T_parent_shape)
    a, b = (compute_gouge_depth((s,), points, T, LIMIT) for s in (box, by_mesh))
    assert 10 < (a.depth > 0).sum() < 60
    np.testing.assert_allclose(a.depth, b.depth, atol=1e-7)  # STL has single precision
    np.testing.assert_allclose(a.place[a.depth > 0], b.place[a.depth > 0], atol=1e-7)


@pytest.mark.parametrize(
    ("shape", "mesh"),
    [
        (
            CollisionShape(name="bar", kind="cylinder", size=(0.08, 0.15), mesh=None, T_parent_shape=np.eye(4)),
            trimesh.creation.cylinder(0.08, 0.15, sections=256),
        ),
        (
            CollisionShape(name="ball", kind="sphere", size=(0.1,), mesh=None, T_parent_shape=np.eye(4)),
            trimesh.creation.icosphere(5, 0.1),
        ),
    ],
)
def test_faceted_solids_converge_to_round_ones(shape: CollisionShape, mesh: trimesh.Trimesh, tmp_path: Path) -> None:
    points, T = build_cutter_points(CutterGeometry(0.01, 0.04)), poses(60, 1, 0.12)
    round_, faceted = (compute_gouge_depth((s,), points, T, LIMIT) for s in (shape, export_part(mesh, tmp_path)))
    inside = round_.depth > 0.0
    assert 10 < inside.sum() < 60
    # a facet is up to r (1 − cos(π/256)) = 6 µm below the bar, a triangle of the ball (edge² / 6r) 50 µm
    np.testing.assert_allclose(np.maximum(round_.depth, 0.0), np.maximum(faceted.depth, 0.0), atol=5e-5)


def test_part_with_a_pocket_agrees_with_trimesh(tmp_path: Path) -> None:
    """The rows are consecutive, so the cached result of the previous row is used;
    the reference distance is independent."""
    ring = trimesh.creation.annulus(r_min=0.03, r_max=0.08, height=0.05, sections=16)
    part, points = export_part(ring, tmp_path), build_cutter_points(CutterGeometry(0.008, 0.06, 0.002))[::7]
    t = np.linspace(0.0, 1.0, 12)
    T = np.tile(np.eye(4), (12, 1, 1))
    T[:, :3, 3] = np.column_stack([0.09 - 0.09 * t, 0.01 * t, 0.04 - 0.05 * t])
    found = compute_gouge_depth((part,), points, T, LIMIT)
    for m in range(12):
        x = points + T[m, :3, 3]
        tri = ring.triangles - x[:, None, None]
        a, b, c = tri[:, :, 0], tri[:, :, 1], tri[:, :, 2]
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        top = np.einsum("kfi,kfi->kf", a, np.cross(b, c))
        low = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
        inside = np.arctan2(top, low).sum(axis=1) > np.pi
        best = 0.0
        if inside.any():
            each = np.repeat(x[inside], len(ring.triangles), axis=0)
            near = trimesh.triangles.closest_point(np.tile(ring.triangles, (int(inside.sum()), 1, 1)), each)
            best = float(np.linalg.norm(near - each, axis=1).reshape(int(inside.sum()), -1).min(axis=1).max())
        assert found.depth[m] == pytest.approx(best if best > LIMIT else 0.0, abs=1e-6)
    assert found.depth[0] == 0.0
    assert found.depth.max() > 0.004


def test_warm_start_does_not_change_the_result(tmp_path: Path) -> None:
    part = export_part(trimesh.creation.icosphere(subdivisions=3, radius=0.05), tmp_path)
    points, t = build_cutter_points(CutterGeometry(0.01, 0.05)), np.linspace(0, 1, 200)
    T = np.tile(np.eye(4), (200, 1, 1))
    T[:, :3, 3] = np.column_stack([0.1 - 0.2 * t, 0.02 * np.sin(9 * t), 0.05 - 0.01 * t])
    together = compute_gouge_depth((part,), points, T, LIMIT).depth
    alone = np.array([compute_gouge_depth((part,), points, row[None], LIMIT).depth[0] for row in T[::40]])
    np.testing.assert_array_equal(together[::40], alone)
    assert together.max() > 0.005


@pytest.mark.parametrize("seed", range(6))
def test_deepest_point_equals_that_of_each_pose_alone(seed: int, tmp_path: Path) -> None:
    """Thin lips, plates and balls near a rotating cutter: depths and positions are equal to the last bit."""
    rng = np.random.default_rng(seed)
    thin, plate = (
        rng.uniform((2.5e-4, 2e-3, 2e-3), (8e-4, 6e-3, 6e-3)),
        rng.uniform((0.01, 0.01, 2e-3), (0.03, 0.03, 6e-3)),
    )
    body = [
        trimesh.creation.box(thin),
        trimesh.creation.box(plate),
        trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(3e-3, 0.01)),
    ][seed % 3]
    M = trimesh.transformations.random_rotation_matrix(rng.random(3))
    M[:3, 3] = rng.uniform(-4e-3, 4e-3, 3)
    part, radius = export_part(body.apply_transform(M), tmp_path), rng.uniform(3e-3, 6e-3)
    cutter = CutterGeometry(2.0 * radius, 0.02, float(rng.choice([0.0, 0.3 * radius, radius])))
    points, between = build_cutter_points(cutter), build_spiral_points(cutter)
    t = np.linspace(0.0, 1.0, 60)
    T = np.array([trimesh.transformations.rotation_matrix(np.pi + 0.4 * v, [1.0, 0.2, 0.0]) for v in t])
    T[:, :3, 3] = np.column_stack([0.012 * t - 0.006, 2e-3 * np.sin(9 * t), 2e-3 * np.cos(5 * t)])
    together = compute_gouge_depth((part,), points, T, LIMIT, between)
    alone = [compute_gouge_depth((part,), points, row[None], LIMIT, between) for row in T]
    np.testing.assert_array_equal(together.depth, [one.depth[0] for one in alone])
    np.testing.assert_array_equal(together.place, [one.place[0] for one in alone])
    assert together.depth.max() > LIMIT


def test_open_surface_is_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    open_box = trimesh.Trimesh(box.vertices, box.faces[2:])
    with pytest.raises(InputError, match="open, so nothing is inside it"):
        compute_gouge_depth(
            (export_part(open_box, tmp_path),), build_cutter_points(CutterGeometry(0.01, 0.05)), np.eye(4)[None], LIMIT
        )
