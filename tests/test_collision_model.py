"""Collision model, compared with coal (an independent library) and with exhaustive sampling."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh
from small_cell import pose, real_cell, small_cell

from machopt.collision.bodies import CollisionBody, build_cutter_body, is_point_inside
from machopt.collision.collision_model import CollisionModel
from machopt.collision.distance_bounds import MotionRows
from machopt.collision.fcl_distance import _find_boxed_vertices
from machopt.data_types.cell import Cell, CollisionShape, CutterGeometry, Tool, Workpiece
from machopt.errors import InputError
from machopt.kinematics.machine import load_machine
from machopt.kinematics.urdf_loading import load_chain

ROUND = 0.0022  # the prisms that replace cylinders are up to 0.22 % larger; spheres up to 0.7 %


def model_of(cell: Cell, clearance: float = 0.0) -> CollisionModel:
    robot, shapes = load_chain(cell)
    return CollisionModel(cell, robot, shapes, clearance)


def random_q(model: CollisionModel, count: int, seed: int = 0) -> np.ndarray:
    robot = model.stack.robot
    return robot.lower + (robot.upper - robot.lower) * np.random.default_rng(seed).random((count, 6))


def coal_shape(shape: CollisionShape) -> coal.CollisionGeometry:
    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    return coal.MeshLoader().load(str(shape.mesh), np.full(3, shape.size[0]))


def coal_distances(cell: Cell, model: CollisionModel, q: np.ndarray) -> np.ndarray:
    """Return the distances (S, P) computed by coal with its own shapes; pairs with the cutter are NaN."""
    robot, shapes = load_chain(cell)
    T_base_world = np.linalg.inv(cell.T_world_base)
    frames = {s.shape.name: (s.link, s.shape.T_parent_shape, s.shape) for s in shapes}
    for s in cell.tool.geometry:
        frames[s.name] = (6, robot.T_base_flange_zero @ s.T_parent_shape, s)
    for s in cell.workpiece.geometry:
        frames[s.name] = (0, T_base_world @ cell.workpiece.T_link_workpiece @ s.T_parent_shape, s)
    for s in cell.obstacles:
        frames[s.name] = (0, T_base_world @ s.T_parent_shape, s)
    geometry = {name: coal_shape(f[2]) for name, f in frames.items()}
    out = np.full((len(q), len(model.pairs)), np.nan)
    for n, row in enumerate(robot.compute_link_poses(q)):
        placed = {name: row[link] @ T for name, (link, T, _) in frames.items()}
        for p, pair in enumerate(model.pairs):
            if "cutter" not in pair.kinds:
                at = [coal.Transform3s(placed[k][:3, :3], placed[k][:3, 3]) for k in (pair.a, pair.b)]
                out[n, p] = coal.distance(
                    geometry[pair.a], at[0], geometry[pair.b], at[1], coal.DistanceRequest(), coal.DistanceResult()
                )
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cell")


@pytest.fixture(scope="module")
def model(folder: Path) -> CollisionModel:
    return model_of(small_cell(folder))


def agree(cell: Cell, model: CollisionModel, q: np.ndarray, band: float) -> None:
    """Check for the same contacts and the same minimum distance as coal, except within ``band`` m of contact."""
    theirs = np.nanmin(coal_distances(cell, model, q), axis=1)
    free_of_cutter = model_of(replace(cell, tool=replace(cell.tool, cutter=None)))
    cutting = np.ones(len(q), bool)
    hit = free_of_cutter.check_configurations(q, cutting).hit
    near = free_of_cutter.find_nearest_pair(q, cutting).distance
    clear = np.abs(theirs) > band
    assert 0.05 < hit.mean() < 0.95  # both cases occur in the comparison
    np.testing.assert_array_equal(hit[clear], theirs[clear] <= 0)
    free = (theirs > band) & (theirs < 0.49)
    np.testing.assert_allclose(near[free], theirs[free], atol=band)


def test_agrees_with_coal_on_primitives(folder: Path, model: CollisionModel) -> None:
    cell = replace(small_cell(folder), T_world_base=pose(0.1, -0.05, 0.02, 0.03))
    agree(cell, model_of(cell), random_q(model, 150), band=0.09 * 0.007 + 0.28 * ROUND)


@pytest.mark.parametrize("name", ["kr210l150", "m20ia"])
def test_agrees_with_coal_on_a_real_robot(folder: Path, name: str) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.3)
    ball.export(folder / "ball.stl")
    cell = real_cell(folder, name, meshes=True)
    part = CollisionShape(
        name="ball", kind="mesh", size=(1.0,), mesh=folder / "ball.stl", T_parent_shape=pose(0, 0, 0.2)
    )
    cell = replace(cell, workpiece=replace(cell.workpiece, geometry=(part,)))
    model = model_of(cell)
    agree(cell, model, random_q(model, 60), band=0.05 * ROUND)


def test_bound_is_the_distance_of_covering_spheres_from_the_box(model: CollisionModel) -> None:
    stack = model.stack
    rows = MotionRows(stack, random_q(model, 300))  # more than one block of rows
    for p, (i, j) in enumerate(stack.index):
        ball, boxed = (stack.bodies[k] for k in ((i, j) if stack.flip[p] else (j, i)))
        T = [np.eye(4) if body.link == 0 else rows.poses[:, body.link] for body in (ball, boxed)]
        place = (T[0] @ np.c_[ball.sphere_centres, np.ones(len(ball.sphere_centres))].T)[..., :3, :]
        to_link = np.linalg.inv(T[1]) @ np.concatenate([place, np.ones_like(place[..., :1, :])], axis=-2)
        away = np.maximum(np.abs(stack.to_box[p] @ to_link) - boxed.box_half[:, None], 0.0)
        expected = np.linalg.norm(away, axis=-2).min(axis=-1) - ball.sphere_radius
        np.testing.assert_allclose(rows.bound[:, p], expected, atol=1e-9)


def test_bounds_never_exceed_the_distance_nor_the_motion(folder: Path, model: CollisionModel) -> None:
    q = random_q(model, 40)
    exact = coal_distances(small_cell(folder), model, q)
    bound = MotionRows(model.stack, q).bound
    assert (bound[~np.isnan(exact)] <= np.maximum(exact[~np.isnan(exact)], 0) + 1e-9).all()
    # Motion: every vertex of the second body in the frame of the first, at ten positions of each joint step.
    rng = np.random.default_rng(3)
    for start in q[:10]:
        end = start + rng.uniform(-0.06, 0.06, 6)
        way = np.linspace(start, end, 11)
        rows = MotionRows(model.stack, np.array([start, end]))
        steps = MotionRows(model.stack, way)
        for p, (_, j) in enumerate(model.stack.index):
            v = model.stack.bodies[j].vertices
            T = steps.compute_relative_motion(p)
            path = np.einsum("sij,vj->svi", T[:, :3, :3], v) + T[:, None, :3, 3]
            length = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0).max()
            assert length <= rows.bound_motion(p)[0] + 1e-12
            assert rows.bound_motion(p)[0] <= rows.reach[0] + 1e-12


def test_clearance_from_carried_distances_equals_fresh_ones(folder: Path) -> None:
    model = model_of(small_cell(folder), clearance=0.03)
    a, b = random_q(model, 2, seed=5)
    q = a + np.linspace(0, 1, 600)[:, None] * (b - a)  # close configurations: distances are reused
    cutting = np.zeros(len(q), bool)
    together = model.check_configurations(q, cutting)
    alone = np.array([model.check_configurations(row[None], cutting[:1]).hit[0] for row in q])
    np.testing.assert_array_equal(together.hit, alone)
    near = model.find_nearest_pair(q, cutting)
    wide = np.array([pair.clearance > 0 for pair in model.pairs])
    sure = (near.pair >= 0) & wide[near.pair]
    np.testing.assert_array_equal(near.distance[sure] < 0.03, together.hit[sure])
    assert together.hit.any()
    assert not together.hit.all()


def test_contact_between_rows_is_found(folder: Path, model: CollisionModel) -> None:
    """A thin plate in contact with no sampled row, compared with 2,000 sampled positions."""
    plate = CollisionShape(
        name="plate", kind="box", size=(0.6, 0.002, 0.6), mesh=None, T_parent_shape=pose(1.2, 0.0, 1.2)
    )
    cell = replace(small_cell(folder), obstacles=(plate,))
    thin = model_of(cell)
    ends = np.deg2rad([[-30, -60, 80, 0, 40, 0], [30, -60, 80, 0, 40, 0.0]])
    free = np.zeros(2, bool)
    assert not thin.check_configurations(ends, free).hit.any()
    found = thin.check_motion(ends, free, step=np.deg2rad(10))
    assert found.first == 1
    assert "plate" in thin.pairs[found.pair[1]].name
    fine = ends[0] + np.linspace(0, 1, 2001)[:, None] * (ends[1] - ends[0])
    brute = thin.check_configurations(fine, np.zeros(len(fine), bool)).hit
    assert brute[round(found.row[1] * 2000)]
    assert not model.check_motion(ends, free, step=np.deg2rad(10)).any


@pytest.mark.parametrize("seed", range(4))
def test_motion_agrees_with_brute_force(model: CollisionModel, seed: int) -> None:
    q = random_q(model, 6, seed=10 + seed)
    cutting = np.zeros(6, bool)
    found = model.check_motion(q, cutting, step=np.deg2rad(2))
    for n in range(1, 6):
        fine = q[n - 1] + np.linspace(0, 1, 800)[:, None] * (q[n] - q[n - 1])
        assert found.hit[n] == model.check_configurations(fine, np.zeros(800, bool)).hit.any()
    alone = model.check_motion(q, cutting, step=np.deg2rad(2), first_only=True)
    assert alone.any == found.any


def reach_pose(model: CollisionModel, cell: Cell, tip: tuple[float, float, float]) -> np.ndarray:
    """Return the joint position with the TCP at ``tip`` (m, base_link), pointing down."""
    from scipy.optimize import least_squares

    robot = model.stack.robot

    def miss(q: np.ndarray) -> np.ndarray:
        T = robot.compute_fk(q, cell.tool.T_flange_tcp)
        return np.append(T[:3, 3] - tip, T[:3, 2] - [0, 0, -1])

    return least_squares(miss, np.deg2rad([0, -60, 100, 0, 50, 0]), xtol=1e-15, ftol=1e-15, gtol=1e-15).x


def test_cutter_may_touch_only_while_cutting(folder: Path, model: CollisionModel) -> None:
    cell = small_cell(folder)
    depth = [0.02, 0.0, -0.00005, -0.00015, -0.03]  # m above the block's top at z = 0.6 m
    q = np.array([reach_pose(model, cell, (1.5, 0.1, 0.6 + d)) for d in depth])
    rapid, cut = np.zeros(5, bool), np.ones(5, bool)
    np.testing.assert_array_equal(model.check_configurations(q, rapid).hit, [False, False, False, True, True])
    assert not model.check_configurations(q, cut).hit.any()
    drill = reach_pose(model, cell, (1.5, 0.1, 0.6 - 0.075))[None]  # cutter length 60 mm: the spindle is in the block
    hit = model.check_configurations(drill, cut[:1])
    assert model.pairs[hit.pair[0]].name == "block ~ spindle"
    # A large clearance does not forbid a rapid move that starts in contact with the cut.
    wide = model_of(cell, clearance=0.02)
    assert not wide.check_configurations(q[1:2], rapid[:1]).hit.any()
    assert wide.check_configurations(
        np.array([reach_pose(model, cell, (1.5, 0.1, 0.54))]), cut[:1]
    ).hit.all()  # the spindle is 10 mm away


def test_body_wholly_inside_another_is_a_contact(folder: Path, model: CollisionModel) -> None:
    cell = small_cell(folder)
    q = reach_pose(model, cell, (1.5, 0.1, 1.0))
    tip = model.stack.robot.compute_fk(q, cell.tool.T_flange_tcp)[:3, 3]
    speck = CollisionShape(
        name="speck", kind="sphere", size=(0.004,), mesh=None, T_parent_shape=pose(tip[0], tip[1], tip[2] + 0.2)
    )  # inside the spindle
    hidden = model_of(replace(cell, obstacles=(speck,)))
    assert hidden.check_configurations(q[None], np.zeros(1, bool)).hit.all()
    assert hidden.check_motion(q[None], np.zeros(1, bool), step=0.01).hit.all()
    assert hidden.find_nearest_pair(q[None], np.zeros(1, bool)).distance[0] == 0.0


def test_inside_test_by_solid_angle() -> None:
    mesh = trimesh.creation.box((2, 2, 2))
    v, f = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    body = CollisionBody(
        name="b",
        kind="obstacle",
        link=0,
        vertices=v,
        faces=f,
        box_rotation=np.eye(3),
        box_centre=np.zeros(3),
        box_half=np.ones(3),
        sphere_centres=np.zeros((1, 3)),
        sphere_radius=2.0,
    )
    assert is_point_inside(body, np.array([0.9, -0.9, 0.3]))
    assert not is_point_inside(body, np.array([1.1, 0, 0]))
    assert not is_point_inside(replace(body, faces=f[:, ::-1]), np.zeros(3))  # inverted normals
    assert not is_point_inside(replace(body, faces=f[1:]), np.zeros(3))  # open mesh


def test_always_touching_pairs_are_computed(folder: Path, model: CollisionModel) -> None:
    names = {pair.name for pair in model.pairs}
    assert "base_link_0 ~ link_2_0" in names
    assert "link_5_0 ~ cutter" in names  # the tool is attached to link 6
    assert not any(f"link_{i}_0 ~ link_{i + 1}_0" in names for i in range(1, 6))
    assert not any(name.startswith("base_link_0") and ("table" in name or "block" in name) for name in names)
    assert not model.excluded
    assert not model.suspicious
    stuck = Tool(
        T_flange_tcp=np.eye(4),
        geometry=(
            CollisionShape(name="hood", kind="box", size=(0.5, 0.5, 0.6), mesh=None, T_parent_shape=pose(0, 0, -0.1)),
        ),
    )
    cell = replace(small_cell(folder), tool=stuck)
    excluded = {(e.a, e.b): e for e in model_of(cell).excluded}
    assert excluded["link_5_0", "hood"].share == 1.0
    pedestal = CollisionShape(
        name="pedestal", kind="box", size=(0.7, 0.7, 0.9), mesh=None, T_parent_shape=pose(0, 0, 0.2)
    )
    cell = replace(small_cell(folder), obstacles=(pedestal,))
    assert ("link_1_0", "pedestal") in {(e.a, e.b)[::d] for e in model_of(cell).excluded for d in (1, -1)}


def test_pairs_touching_at_home_are_named(folder: Path) -> None:
    wall = CollisionShape(name="wall", kind="box", size=(0.1, 2.0, 2.0), mesh=None, T_parent_shape=pose(1.2, 0, 1.5))
    suspicious = model_of(replace(small_cell(folder), obstacles=(wall,))).suspicious
    assert any("wall" in text for text in suspicious)


def test_cutter_extends_back_from_the_tcp(folder: Path) -> None:
    cell = small_cell(folder)
    robot, _ = load_chain(cell)
    T = np.linalg.inv(robot.T_base_flange_zero @ cell.tool.T_flange_tcp)
    for shrink in (0.0, 1e-4):
        v = (
            build_cutter_body(cell, load_machine(cell, robot), CutterGeometry(0.012, 0.06), shrink).vertices
            @ T[:3, :3].T
            + T[:3, 3]
        )
        np.testing.assert_allclose([v[:, 2].min(), v[:, 2].max()], [-0.06, -shrink], atol=1e-9)
        np.testing.assert_allclose(np.hypot(v[:, 0], v[:, 1]).max(), 0.006 - shrink, rtol=ROUND)


def test_invalid_input_is_answered_with_what_is_accepted(folder: Path) -> None:
    cell = small_cell(folder)
    with pytest.raises(InputError, match="'a1' moves the base or the workpiece and is not listed"):
        model_of(replace(cell, workpiece=Workpiece("link_3", np.eye(4))))
    for name, text, expected in (("gone.stl", None, "not a file"), ("x.stl", "solid x\nendsolid x\n", "mesh of 'm'")):
        if text is not None:
            (folder / name).write_text(text)
        shape = CollisionShape(name="m", kind="mesh", size=(1.0,), mesh=folder / name, T_parent_shape=np.eye(4))
        with pytest.raises(InputError, match=expected):
            model_of(replace(cell, obstacles=(shape,)))


def test_empty_rows_and_pairs_are_accepted(folder: Path, model: CollisionModel) -> None:
    none = np.zeros((0, 6)), np.zeros(0, bool)
    assert not model.check_configurations(*none).any
    assert model.check_motion(*none, step=0.1).first == -1
    assert len(model.find_nearest_pair(*none).distance) == 0
    robot, _ = load_chain(small_cell(folder))
    bare = replace(
        small_cell(folder), tool=Tool(T_flange_tcp=np.eye(4)), obstacles=(), workpiece=Workpiece("world", np.eye(4))
    )
    empty = CollisionModel(bare, robot, (), 0.0)
    q = np.zeros((3, 6))
    assert not empty.check_motion(q, np.zeros(3, bool), 0.1).any
    assert empty.find_nearest_pair(q, np.zeros(3, bool)).pair.max() == -1


def test_long_motions_are_checked_block_by_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = model_of(small_cell(tmp_path), 0.005)
    corners = random_q(model, 6, seed=2)
    q = np.vstack([np.linspace(a, b, 12, endpoint=False) for a, b in pairwise(corners)])
    touch = np.zeros(len(q), bool)
    whole = model.check_motion(q, touch, 0.05)
    monkeypatch.setattr("machopt.collision.collision_model.MAX_BLOCK_ROWS", 17)
    parts = model.check_motion(q, touch, 0.05)
    assert 0 < whole.hit.sum() < len(q)
    assert np.array_equal(parts.hit, whole.hit)
    assert model.check_motion(q, touch, 0.05, first_only=True).hit.sum() == 1


@pytest.mark.parametrize("seed", range(6))
def test_motions_checked_together_equal_those_checked_alone(tmp_path: Path, seed: int) -> None:
    model = model_of(small_cell(tmp_path), 0.005)
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 6, 12)
    corners = random_q(model, len(lengths), seed=20 + seed)
    motions = [x + np.cumsum(0.03 * rng.standard_normal((n, 6)), axis=0) for x, n in zip(corners, lengths, strict=True)]
    starts = np.zeros(lengths.sum(), bool)
    starts[np.cumsum([0, *lengths[:-1]])] = True
    together = model.check_motion(np.vstack(motions), np.zeros(len(starts), bool), 0.05, starts=starts)
    alone = [model.check_motion(q, np.zeros(len(q), bool), 0.05) for q in motions]
    assert 0 < together.hit.sum() < len(starts)
    assert np.array_equal(together.hit, np.concatenate([found.hit for found in alone]))
    first = np.repeat(np.flatnonzero(starts), lengths)
    row = np.concatenate([found.row for found in alone]) + first
    at = together.hit
    assert np.allclose(together.row[at], row[at], atol=1e-12)


def test_vertices_in_boxes_equal_numpy() -> None:
    """Random motions of two rotated boxes, with the vertex of either one inside of, outside of and on a face."""
    rng = np.random.default_rng(8)
    R = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(2)]
    boxes = [(rng.normal(size=3), np.ascontiguousarray(r), rng.uniform(1.0, 2.0, 3)) for r in R]
    va, vb = (centre + axes @ (half * [1.0, 0.2, -0.4]) for centre, axes, half in boxes)  # on a face
    T = np.tile(np.eye(4), (200, 1, 1))
    T[1:, :3, :3] = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(199)]
    T[1:, :3, 3] = rng.normal(size=(199, 3))

    def is_in(points: np.ndarray, box: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        centre, axes, half = box
        return (np.abs((points - centre) @ axes) <= half + 1e-9).all(axis=1)

    b_in_a = T[:, :3, :3] @ vb + T[:, :3, 3]
    a_in_b = np.einsum("sji,sj->si", T[:, :3, :3], va - T[:, :3, 3])
    expected = is_in(b_in_a, boxes[0]) | is_in(a_in_b, boxes[1])
    assert 20 < expected.sum() < 180, expected.sum()
    assert np.array_equal(_find_boxed_vertices(T, va, vb, *boxes), expected)
