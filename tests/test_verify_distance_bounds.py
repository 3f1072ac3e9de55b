"""Distance bounds of the verifier compared with exact distances of coal in every row, and their use."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pytest
from small_cell import small_cell

from machopt.verification.motion.collision import clearance_column
from machopt.verification.motion.collision.bodies import build_bodies, compute_distance
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.contact_search import PlacedBodies
from machopt.verification.motion.collision.convex_parts import ConvexParts, build_convex_parts, split_convex_shells
from machopt.verification.motion.collision.distance_bounds import BOUND_GAP_M, CLAIM_MARGIN_M, bound_distances
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

EXACT = 2e-9  # m, error of coal's distances of triangles
ROUND = 1e-5  # m, coal's iteration for cylinders ends too early and gives distances that are too large by this
SIZE = (0.3, 0.2, 0.5)  # m


def mesh(vertices: np.ndarray, faces: np.ndarray) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    triangles = coal.StdVec_Triangle()
    for face in faces.tolist():
        triangles.append(coal.Triangle(*face))
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    model.addSubModel(points, triangles)
    model.endModel()
    return model


def box_mesh() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * np.array(SIZE)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])


def bowl() -> tuple[np.ndarray, np.ndarray]:
    """A non-convex surface: a paraboloid over a grid."""
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.3, 0.3, 9), np.linspace(-0.3, 0.3, 9)))
    k = np.array([9 * i + j for i in range(8) for j in range(8)])
    return np.column_stack([x, y, 2.0 * (x * x + y * y)]), np.concatenate(
        [np.column_stack([k, k + 1, k + 9]), np.column_stack([k + 1, k + 10, k + 9])]
    )


SHAPES = {
    "box": lambda: coal.Box(*SIZE),
    "sphere": lambda: coal.Sphere(0.2),
    "capsule": lambda: coal.Capsule(0.1, 0.4),
    "cylinder": lambda: coal.Cylinder(0.15, 0.4),
    "shell": lambda: mesh(*box_mesh()),
    "bowl": lambda: mesh(*bowl()),
}


def build_known_parts(shape: Any) -> ConvexParts:
    parts = build_convex_parts(shape)
    assert parts is not None
    return parts


def poses(count: int, far: float, seed: int) -> np.ndarray:
    """Return (count, 4, 4) poses of a body that moves around the origin and rotates."""
    rng = np.random.default_rng(seed)
    turn, wander = rng.normal(size=3), rng.normal(size=(2, 3))
    t = np.linspace(0.0, 3.0, count)
    T = np.tile(np.eye(4), (count, 1, 1))
    for n, s in enumerate(t):
        T[n, :3, :3] = np.asarray(coal.AngleAxis(float(s), turn / np.linalg.norm(turn)).toRotationMatrix())
    way = np.cos(t)[:, None] * wander[0] + np.sin(t)[:, None] * wander[1]
    T[:, :3, 3] = far * way / np.linalg.norm(way, axis=1, keepdims=True)
    return T


def measure_distance(a: Any, b: Any, T: np.ndarray) -> np.ndarray:
    """Return (K,) distances in m by coal, 0 in contact."""
    still = coal.Transform3s(np.eye(3), np.zeros(3))
    return np.array(
        [
            max(
                coal.distance(
                    a, still, b, coal.Transform3s(x[:3, :3], x[:3, 3]), coal.DistanceRequest(), coal.DistanceResult()
                ),
                0.0,
            )
            for x in T
        ]
    )


@pytest.mark.parametrize("first", SHAPES)
def test_distance_lies_between_the_bounds_in_every_row(first: str) -> None:
    for n, second in enumerate(SHAPES):
        a, b = SHAPES[first](), SHAPES[second]()
        T = np.concatenate([poses(40, far, 10 * n + k) for k, far in enumerate((0.35, 0.6, 2.0))])
        below, above = bound_distances(build_known_parts(a), build_known_parts(b), T)
        d = measure_distance(a, b, T)
        apart = d > 0.0  # for a shell inside another one, coal returns the distance of the surfaces
        apart &= ~((above == 0.0) & ({first, second} <= {"shell", "bowl"}))
        off = ROUND if "cylinder" in (first, second) else EXACT
        assert apart.sum() > 40
        assert (below[apart] <= d[apart] + EXACT).all(), (second, (below - d)[apart].max())
        assert (above[apart] >= d[apart] - off).all(), (second, (d - above)[apart].max())
        assert (above - below).max() < 2 * BOUND_GAP_M, second
        assert (below[d == 0.0] <= EXACT).all()


def test_no_false_claim_is_proven() -> None:
    a, b = build_known_parts(SHAPES["bowl"]()), build_known_parts(SHAPES["shell"]())
    T = poses(300, 0.6, 5)
    corners = box_mesh()[0]
    moved = np.einsum("nij,kj->nki", T[:, :3, :3], corners) + T[:, None, :3, 3]
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(moved, axis=0), axis=2).max(axis=1)))  # corners of the shell
    d = measure_distance(SHAPES["bowl"](), SHAPES["shell"](), T)
    claim = d + np.where(np.arange(300) % 7 == 0, 1e-6, -2e-2)  # one in seven claims is wrong
    rows = np.flatnonzero(np.arange(300) % 5 != 2)
    below, above = bound_distances(a, b, T, rows, way, claim)
    assert ((below < claim)[rows] == (claim > d)[rows]).all()
    assert (below <= d + EXACT).all()
    assert (above >= d - EXACT).all()
    assert np.isinf(above).sum() > 60 + 10  # rows not requested, and some that the bound of the preceding row proves
    far, _ = bound_distances(a, b, poses(20, 3.0, 1), claim=np.full(20, 0.1))
    assert (far >= 0.1 + CLAIM_MARGIN_M - EXACT).all()


def test_closed_convex_shells_are_one_part() -> None:
    corners, faces = box_mesh()
    assert split_convex_shells(corners, faces)[1] == [8]
    assert split_convex_shells(corners[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))[1] == [
        8
    ]  # each face has its own corners
    assert split_convex_shells(corners, faces[1:])[1] == [3] * 11  # open surface
    additional = np.concatenate([corners, corners + 2.0, bowl()[0] - 3.0])
    assert split_convex_shells(additional, np.concatenate([faces, faces + 8, bowl()[1] + 16]))[1] == [8, 8, *[3] * 128]
    dent = corners.copy()
    dent[0] += 0.3 * np.array(SIZE)
    assert split_convex_shells(dent, faces)[1] == [3] * 12
    assert split_convex_shells(np.empty((0, 3)), np.empty((0, 3), int))[1] == []


def test_exact_distance_is_computed_only_for_unproven_claims(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = small_cell(tmp_path)
    arm = UrdfKinematics(cell)
    bodies = build_bodies(cell, arm)
    wanted = [(a, b) for a, b in list_checked_pairs(cell, arm, bodies) if b.kind != "grazing"]
    q = cell.home + np.linspace(0.0, 0.3, 30)[:, None] * np.array([1.0, -0.5, 0.7, 1.0, 0.8, -1.0])
    scene = PlacedBodies(arm, bodies, q)
    every = np.array([[compute_distance(a, b, T) for T in scene.compute_relative_motion(a, b)] for a, b in wanted])
    claim, nearest = every.min(axis=0), every.argmin(axis=0)
    assert claim.min() > 0.0
    named = tuple(f"{wanted[p][0].name} ~ {wanted[p][1].name}" for p in nearest)
    requested: list[float] = []

    def counted(*of: Any) -> float:
        requested.append(compute_distance(*of))
        return requested[-1]

    monkeypatch.setattr(clearance_column, "compute_distance", counted)
    free = np.ones(30, bool)
    sound = clearance_column.check_clearances(scene, wanted, claim, named, free)
    assert not sound.too_small.any()
    assert not sound.too_large.any()
    assert len(requested) == 0
    wrong = claim.copy()
    wrong[11], wrong[17] = wrong[11] + 3e-6, wrong[17] - 2e-3
    found = clearance_column.check_clearances(scene, wanted, wrong, named, free)
    assert found.too_small[11] == pytest.approx(3e-6, abs=1e-9)
    assert found.too_large[17] == pytest.approx(2e-3, abs=1e-9)
    assert found.pair[11] == named[11]
    assert np.count_nonzero(found.too_small) == np.count_nonzero(found.too_large) == 1
    assert len(requested) <= 3


def test_no_row_is_assumed_free_without_motion() -> None:
    a = build_known_parts(coal.Box(*SIZE))
    T = np.tile(np.eye(4), (2, 1, 1))
    T[0, 0, 3], T[1, 0, 3] = 2.0, 0.5  # first far, then near
    below, _ = bound_distances(a, a, T, claim=np.full(2, 0.5))
    assert below[0] >= 0.5
    assert below[1] == pytest.approx(0.5 - SIZE[0], abs=2 * BOUND_GAP_M)
