"""Cutter depth of the verifier: computed by hand, and compared with the independent planner."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import coal
import numpy as np
import pytest
import trimesh

from machopt.collision.gouge_depth import build_cutter_points
from machopt.collision.gouge_depth import compute_gouge_depth as planners
from machopt.data_types.cell import CollisionShape, CutterGeometry
from machopt.data_types.plan_options import PlanOptions
from machopt.verification.check_results import VerificationCheck
from machopt.verification.motion.collision.bodies import CoalBody, _build_body
from machopt.verification.motion.collision.gouge_check import (
    build_cutter_points as verification_build_cutter_points,
)
from machopt.verification.motion.collision.gouge_check import (
    check_gouges,
    find_deepest_point,
)

LIMIT = 1e-4


def body(shape: object, place: np.ndarray | None = None) -> CoalBody:
    return _build_body("part", "workpiece", -1, -1, np.eye(4) if place is None else place, shape)


def mesh(folder: Path, made: trimesh.Trimesh) -> tuple[CollisionShape, CoalBody]:
    made.export(folder / "part.stl")
    loaded = coal.MeshLoader().load(str(folder / "part.stl"), np.ones(3))
    return CollisionShape(
        name="part", kind="mesh", size=(1.0,), mesh=folder / "part.stl", T_parent_shape=np.eye(4)
    ), body(loaded)


def build_pose(x: float, y: float, z: float, tilt: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    c, s = np.cos(tilt), np.sin(tilt)
    T[:3, :3] = [[1, 0, 0], [0, -c, s], [0, -s, -c]]  # the TCP points down
    T[:3, 3] = x, y, z
    return T


@pytest.mark.parametrize("corner", [0.0, 0.002, 0.006])
def test_points_cover_the_cutter(corner: float) -> None:
    x = verification_build_cutter_points(CutterGeometry(0.012, 0.03, corner))
    r, h = np.hypot(x[:, 0], x[:, 1]), -x[:, 2]
    off = np.hypot(np.maximum(r - (0.006 - corner), 0.0), np.maximum(corner - h, 0.0)) - corner
    assert ((np.abs(off) < 1e-6) | (np.abs(r - 0.006) < 1e-9)).all()
    # every point of the planner's rings has a verifier point nearby
    rings = build_cutter_points(CutterGeometry(0.012, 0.03, corner))
    gap = np.array([np.linalg.norm(x - p, axis=1).min() for p in rings])
    assert gap.max() < 0.0016  # 1.5 steps of 1 mm


def test_tilted_cutter_in_a_flat_face(tmp_path: Path) -> None:
    points, tilt = verification_build_cutter_points(CutterGeometry(0.012, 0.05)), np.radians(3.0)
    expected = 0.006 * np.sin(tilt)
    block = trimesh.creation.box((0.2, 0.2, 0.05))
    block.apply_translation((0, 0, -0.025))
    T = np.array([build_pose(0, 0, 0.001), build_pose(0.01, 0, 0, tilt), build_pose(0.02, 0, 0)])
    for part in (body(coal.Box(0.2, 0.2, 0.05), build_pose(0, 0, -0.025)), mesh(tmp_path, block)[1]):
        depth, row, x = find_deepest_point(part, points, T, LIMIT)
        assert row == 1
        assert depth == pytest.approx(expected, abs=2e-6)
        np.testing.assert_allclose((part.place[:3, :3] @ x + part.place[:3, 3])[2], -expected, atol=2e-6)
        assert find_deepest_point(part, points, T[[0, 2]], LIMIT)[0] == 0.0


def test_depth_agrees_with_the_planner_on_a_part_with_a_pocket(tmp_path: Path) -> None:
    ring = trimesh.creation.annulus(r_min=0.03, r_max=0.08, height=0.05, sections=32)
    shape, part = mesh(tmp_path, ring)
    cutter = CutterGeometry(0.01, 0.06, 0.002)
    rng = np.random.default_rng(4)
    T = np.array([build_pose(*row) for row in rng.uniform((-0.1, -0.1, -0.03, -0.5), (0.1, 0.1, 0.05, 0.5), (25, 4))])
    ours = planners((shape,), build_cutter_points(cutter), T, LIMIT).depth
    theirs = np.array(
        [find_deepest_point(part, verification_build_cutter_points(cutter), row[None], LIMIT)[0] for row in T]
    )
    assert 5 < (ours > 0).sum() < 25
    np.testing.assert_allclose(theirs, ours, atol=0.0011)  # the points are 1 and 1.25 mm apart
    np.testing.assert_array_equal(theirs[ours > 0.0012] > 0, True)
    np.testing.assert_array_equal(theirs[ours == 0] < 0.0012, True)


def test_only_cutting_moves_count_and_the_place_is_named() -> None:
    cutter = CutterGeometry(0.012, 0.05)
    tcp = np.array([build_pose(0.001 * n, 0, 0) for n in range(40)])
    tcp[20:, 2, 3] = -0.0007
    part: Any = body(coal.Box(0.2, 0.2, 0.05), build_pose(0, 0, -0.025))
    arm: Any = SimpleNamespace(cell=SimpleNamespace(tool=SimpleNamespace(cutter=cutter)))
    motion: Any = SimpleNamespace(describe_row=lambda n: f"sample {n}", point=np.linspace(0.0, 1.0, 40))
    line: Any = SimpleNamespace()  # used only if the path is shifted

    def found(fed: np.ndarray, gouge: float | None) -> list[VerificationCheck]:
        ride: Any = SimpleNamespace(tcp=tcp, tool=tcp, on_feed_move=fed, path_limit=2e-5)
        return check_gouges(motion, line, ride, arm, [part], PlanOptions(gouge=gouge), shifted=False)

    everywhere = np.ones(40, bool)
    (deep,) = found(everywhere, 5e-4)
    assert deep.passed is False
    assert deep.value == pytest.approx(0.7, abs=1e-6)
    assert "mm, sample 2" in deep.where
    assert found(everywhere, 7e-4)[0].passed
    assert found(np.arange(40) < 20, 5e-4)[0].passed
    assert found(everywhere, None) == []
