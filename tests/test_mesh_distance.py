"""Distances of triangle surfaces compared with fcl, and the nearest pair for any number of cores."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from small_cell import small_cell

from machopt.collision import nearest_pair
from machopt.collision.bounding_box_tree import MAX_TRIANGLES, _subdivide_long_triangles, build_box_tree
from machopt.collision.collision_model import CollisionModel
from machopt.collision.fcl_distance import FclSurfaces
from machopt.collision.mesh_distance import compute_distance, compute_distances_along_rows
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics import parallel_map
from machopt.numerics.rigid_transforms import build_transform, invert_transform

EXACT = 1e-11  # m, in addition to the rounding of fcl; TIE of the module is a tenth of that


def soup(rng: np.random.Generator, count: int, size: float) -> Any:
    """Return random triangles in a box; some are slivers, some are in planes along the axes, one is a line."""
    corners = rng.uniform(-size, size, (count, 3, 3))
    corners[::3, :, 2] = corners[::3, :1, 2]
    corners[1::5] = corners[1::5, :1] + 0.02 * (corners[1::5] - corners[1::5, :1]) * [1, 1, 40]
    corners[0, 2] = corners[0, 1]
    return SimpleNamespace(vertices=corners.reshape(-1, 3), faces=np.arange(3 * count).reshape(-1, 3))


def test_distances_equal_fcl_and_crossing_surfaces_have_none() -> None:
    rng = np.random.default_rng(3)
    a, b = soup(rng, 40, 0.2), soup(rng, 23, 0.1)
    turn = Rotation.random(300, random_state=1).as_matrix()
    T = build_transform(turn, rng.uniform(-0.3, 0.3, (300, 3)))
    T[::7, :3, :3] = np.eye(3)  # planes of both are parallel
    x, y = build_box_tree(a), build_box_tree(b)
    far, none = np.full(300, np.inf), np.full(300, -np.inf)
    d, _ = compute_distances_along_rows(
        x.corners,
        x.normals,
        x.low,
        x.high,
        x.child,
        x.first,
        x.count,
        x.order,
        y.corners,
        y.normals,
        y.child,
        y.first,
        y.count,
        y.order,
        np.arange(300),
        T,
        10.0 * np.arange(300),
        none,
        far,
    )
    surfaces = FclSurfaces([a, b])
    theirs = np.array([max(surfaces.compute_distance((0, 1), M), 0.0) for M in T])
    assert 0.02 < (theirs == 0.0).mean() < 0.9
    np.testing.assert_allclose(d, theirs, rtol=0.0, atol=EXACT)
    for still, moving, motion in (
        (x, y, T),
        (y, x, invert_transform(T)),
    ):  # one by one, starting from the previous result
        guess, single = (0, 0), []
        for M in motion:
            apart, guess = compute_distance(still, moving, M, guess)
            single.append(apart)
        np.testing.assert_allclose(single, theirs, rtol=0.0, atol=EXACT)


def test_nearest_pair_is_the_minimum_on_any_number_of_cores(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = small_cell(tmp_path)
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, 0.0)
    rng = np.random.default_rng(0)
    ends = robot.lower + (robot.upper - robot.lower) * rng.random((6, 6))
    q = np.vstack([np.linspace(a, b, 100) for a, b in itertools.pairwise(ends)])
    cutting = np.arange(len(q)) % 3 > 0
    found = []
    for many in (1, 2):
        monkeypatch.setattr(parallel_map, "count_threads", lambda many=many: many)
        found.append(model.find_nearest_pair(q, cutting))
    np.testing.assert_array_equal(found[0].distance, found[1].distance)
    np.testing.assert_array_equal(found[0].pair, found[1].pair)
    poses = robot.compute_link_poses(q)
    for n in range(0, len(q), 61):
        every = []
        for pair, (i, j), (low, high) in zip(model.pairs, model.stack.index, model.stack.links, strict=True):
            T = np.linalg.inv(poses[n, low]) @ poses[n, high]
            within = model.surfaces.is_contained((i, j), T)
            d = 0.0 if within else max(model.surfaces.compute_distance((i, j), T), 0.0)
            every.append(np.inf if pair.unless_cutting and cutting[n] else d)
        assert found[0].distance[n] == pytest.approx(min([*every, nearest_pair.MAX_DISTANCE_M]), abs=EXACT)


def test_dividing_long_triangles_preserves_the_surface() -> None:
    slender = trimesh.creation.cylinder(0.05, 1.0, sections=12).triangles
    fine = _subdivide_long_triangles(slender, 0.1)
    edges = np.linalg.norm(fine - np.roll(fine, -1, axis=1), axis=2)
    assert len(fine) > 10 * len(slender)
    assert edges.max() <= 0.1
    area = [0.5 * np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() for t in (slender, fine)]
    assert area[0] == pytest.approx(area[1], rel=1e-12)
    assert (
        len(_subdivide_long_triangles(slender, 1e-3)) <= len(slender) + MAX_TRIANGLES
    )  # a bound on the cost of many long triangles
    flat = np.zeros((3, 3, 3))
    np.testing.assert_array_equal(_subdivide_long_triangles(flat, 0.0), flat)
