"""Proximity test compared with distances by fcl, and containment of bodies."""

from __future__ import annotations

import fcl
import numpy as np
import pytest
import trimesh
from small_cell import pose

from machopt.collision.bodies import CollisionBody
from machopt.collision.fcl_distance import FclSurfaces
from machopt.collision.proximity_test import BLOCK, build_outline, is_nearer_than


def body_of(mesh: trimesh.Trimesh) -> CollisionBody:
    v = np.array(mesh.vertices)
    low, high = v.min(0), v.max(0)
    return CollisionBody(
        name="b",
        kind="link",
        link=1,
        vertices=v,
        faces=np.array(mesh.faces, np.int64),
        box_rotation=np.eye(3),
        box_centre=(low + high) / 2,
        box_half=(high - low) / 2,
        sphere_centres=np.zeros((1, 3)),
        sphere_radius=1.0,
    )


def placements(count: int, spread: float) -> np.ndarray:
    rng = np.random.default_rng(3)
    out = np.tile(np.eye(4), (count, 1, 1))
    for T in out:
        T[:3, :3] = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
    out[:, :3, 3] = rng.normal(scale=spread, size=(count, 3))
    return out


@pytest.mark.parametrize("limit", [0.0, 0.01, 0.2])
def test_proximity_agrees_with_fcl(limit: float) -> None:
    a = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    b = trimesh.creation.cylinder(radius=0.05, height=0.7, sections=9)
    a.apply_scale([1.0, 2.0, 0.5])
    objects = []
    for mesh in (a, b):
        model = fcl.BVHModel()
        model.beginModel(len(mesh.faces), len(mesh.vertices))
        model.addSubModel(np.array(mesh.vertices), np.array(mesh.faces))
        model.endModel()
        objects.append(fcl.CollisionObject(model))
    T = placements(600, 0.4)
    want = []
    for t in T:
        objects[1].setTransform(fcl.Transform(t[:3, :3], t[:3, 3]))
        cross = fcl.collide(*objects, fcl.CollisionRequest(), fcl.CollisionResult())
        apart = fcl.distance(*objects, fcl.DistanceRequest(), fcl.DistanceResult())
        want.append(bool(cross) or apart < limit)
    found = is_nearer_than(build_outline(body_of(a)), build_outline(body_of(b)), T, limit)
    assert np.array_equal(found, want)
    assert 50 < found.sum() < 550


def test_flat_and_hollow_bodies() -> None:
    """A sheet has no hull, and a body in a bowl is inside the hull of the bowl but does not touch it."""
    sheet = body_of(trimesh.Trimesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]))
    bowl = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.3)
    ball = body_of(trimesh.creation.icosphere(subdivisions=1, radius=0.1))
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, 2, 3] = 0.05, 0.12, 0.4
    assert is_nearer_than(build_outline(sheet), build_outline(ball), T, 0.03).tolist() == [True, True, False]
    T[:, 2, 3] = 0.0, -0.88, -0.95
    assert is_nearer_than(build_outline(body_of(bowl)), build_outline(ball), T, 0.03).tolist() == [False, True, True]


def test_long_inputs_are_combined_in_order() -> None:
    a = build_outline(body_of(trimesh.creation.box((0.3, 0.3, 0.3))))
    T = placements(2 * BLOCK + 7, 0.3)
    whole = is_nearer_than(a, a, T, 0.05)
    assert np.array_equal(
        whole, np.concatenate([is_nearer_than(a, a, T[n : n + 100], 0.05) for n in range(0, len(T), 100)])
    )
    assert is_nearer_than(a, a, T[:0], 0.05).shape == (0,)


def test_body_inside_another_is_found_at_every_placement() -> None:
    a, b = body_of(trimesh.creation.box((1, 1, 1))), body_of(trimesh.creation.box((0.1, 0.1, 0.1)))
    T = placements(300, 0.5)
    for bodies in ([a, b], [b, a]):
        surfaces = FclSurfaces(bodies)
        big, small = (T, np.linalg.inv(T)) if bodies[0] is a else (np.linalg.inv(T), T)
        corner = big[:, :3, :3] @ b.vertices[0] + big[:, :3, 3]  # corner of the small box in the frame of the large one
        other = small[:, :3, :3] @ a.vertices[0] + small[:, :3, 3]
        fixed = (np.abs(corner) < 0.5).all(axis=1) | (np.abs(other) < 0.05).all(axis=1)
        found = surfaces.find_contained((0, 1), T)
        assert np.array_equal(found, fixed)
        assert np.array_equal(found, [surfaces.is_contained((0, 1), t) for t in T])
        assert 0 < found.sum() < 300
    assert not surfaces.find_contained((0, 1), pose(5.0, 0.0, 0.0)[None])[0]


def test_free_result_is_reused_only_while_nothing_can_come_near() -> None:
    """The result of a free row is reused for later rows only while no body can have come near.

    A ball moves in a bowl, inside its hull; all rows in one call are compared with single calls.
    """
    bowl = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.3)
    a, ball = (build_outline(body_of(m)) for m in (bowl, trimesh.creation.icosphere(subdivisions=1, radius=0.1)))
    rng = np.random.default_rng(8)
    T = np.tile(np.eye(4), (400, 1, 1))
    T[:, :3, 3] = np.cumsum(rng.normal(scale=2e-5, size=(400, 3)), axis=0)
    T[:, 2, 3] -= 0.8
    depth = T[:, 2, 3].copy()
    for near in (0.0002, 0.001, 0.02):
        T[:, 2, 3] = depth - np.linspace(0.0, near, 400)
        limit = 0.0983 - 0.5 * near  # 0.0983 m is the initial distance
        alone = np.array([is_nearer_than(a, ball, t[None], limit)[0] for t in T])
        assert np.array_equal(is_nearer_than(a, ball, T, limit), alone)
        assert 0 < alone.sum() < len(T)


@pytest.mark.parametrize("limit", [0.0, 0.004, 0.05])
def test_results_carried_between_rows_equal_single_results(limit: float) -> None:
    """Contacts and free results are reused, and a separating plane is tested again in the next row.

    A random walk enters and leaves contact in small and large steps; all rows in one call are compared with single
    calls.
    """
    stick = trimesh.creation.cylinder(radius=0.03, height=0.5, sections=9)
    ring = trimesh.creation.annulus(r_min=0.2, r_max=0.3, height=0.1)
    a, b = build_outline(body_of(ring)), build_outline(body_of(stick))
    rng = np.random.default_rng(11)
    step = rng.choice([2e-4, 2e-3, 3e-2], size=1500)[:, None] * rng.normal(size=(1500, 3))
    T = placements(1500, 0.0)
    T[:, :3, :3] = np.repeat(T[::100, :3, :3], 100, axis=0)
    T[:, :3, 3] = 0.4 * np.sin(np.cumsum(step, axis=0))
    alone = np.array([is_nearer_than(a, b, t[None], limit)[0] for t in T])
    assert np.array_equal(is_nearer_than(a, b, T, limit), alone)
    assert 100 < alone.sum() < 1400
