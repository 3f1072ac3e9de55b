"""Collisions of cells with rails and positioners, compared with pinocchio and coal, at and between configurations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from external_axis_cells import external_cell
from small_cell import pose

from machopt.collision.collision_model import CollisionModel
from machopt.collision.distance_bounds import DistanceMemory, MotionRows
from machopt.data_types.cell import Cell, CollisionShape
from machopt.kinematics.urdf_loading import load_chain
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.collision.checked_pairs import list_checked_pairs
from machopt.verification.motion.collision.clearance_column import list_varying_pairs
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

ROUND = 0.0022 * 0.5  # m: the prisms that replace cylinders (0.5 m at most) are up to 0.22 % larger
KINDS = [{"rail": True}, {"table": True, "tilt": True}, {"rail": True, "table": True, "tilt": True}]


def cell_of(folder: Path, **kind: bool) -> Cell:
    """Return a cell with fixed obstacles and obstacles that move with external axes."""
    cell = external_cell(folder, **kind)
    things = [
        CollisionShape(name="post", kind="cylinder", size=(0.05, 1.2), mesh=None, T_parent_shape=pose(1.0, 0.8, 0.6))
    ]
    if kind.get("rail"):
        things.append(
            CollisionShape(
                name="cabinet",
                kind="box",
                size=(0.3, 0.4, 0.9),
                mesh=None,
                T_parent_shape=pose(-0.1, -0.6, 0.5),
                link="carriage",
            )
        )
    if kind.get("table"):
        things.append(
            CollisionShape(
                name="clamp",
                kind="box",
                size=(0.08, 0.06, 0.25),
                mesh=None,
                T_parent_shape=pose(0.3, 0.1, 0.2),
                link="plate",
            )
        )
    hall = pose(0.3, -0.1, 0.2, 0.1)
    return replace(cell, obstacles=tuple(things), T_world_base=hall, tool=replace(cell.tool, cutter=None))


def model_of(cell: Cell, clearance: float = 0.0) -> CollisionModel:
    robot, shapes = load_chain(cell)
    return CollisionModel(cell, robot, shapes, clearance)


def random_x(cell: Cell, count: int, seed: int = 0) -> np.ndarray:
    low, high = cell.limits.lower, cell.limits.upper
    return low + (high - low) * np.random.default_rng(seed).random((count, len(low)))


class Independent:
    """All bodies of the cell as coal shapes on pinocchio's links."""

    def __init__(self, cell: Cell) -> None:
        self.cell, self.model = cell, pin.buildModelFromXML(cell.urdf_text)
        self.data, rest = self.model.createData(), pin.neutral(self.model)
        pin.framesForwardKinematics(self.model, self.data, rest)
        base = self.data.oMf[self.model.getFrameId(cell.base_link)].homogeneous
        self.to_world = cell.T_world_base @ np.linalg.inv(base)
        geometry = pin.buildGeomFromUrdfString(self.model, cell.urdf_text, pin.GeometryType.COLLISION)
        self.bodies = {
            g.name: (self.model.frames[g.parentFrame].name, None, g.geometry, g) for g in geometry.geometryObjects
        }
        parts = [(s, cell.flange_link, np.eye(4)) for s in cell.tool.geometry]
        parts += [(s, cell.workpiece.link, cell.workpiece.T_link_workpiece) for s in cell.workpiece.geometry]
        parts += [(s, s.link, np.eye(4)) for s in cell.obstacles]
        for s, link, T in parts:
            shape = coal.Box(*s.size) if s.kind == "box" else coal.Cylinder(*s.size)
            self.bodies[s.name] = (link, T @ s.T_parent_shape, shape, None)

    def places(self, x: np.ndarray) -> dict[str, np.ndarray]:
        q = pin.neutral(self.model)
        for name, value in zip((*self.cell.arm_joints, *self.cell.external_joints), x, strict=True):
            q[self.model.idx_qs[self.model.getJointId(name)]] = value
        pin.framesForwardKinematics(self.model, self.data, q)
        out = {}
        for name, (link, T, _, g) in self.bodies.items():
            if g is not None:
                out[name] = self.to_world @ self.data.oMi[g.parentJoint].homogeneous @ g.placement.homogeneous
            elif link == "world":
                out[name] = T
            else:
                out[name] = self.to_world @ self.data.oMf[self.model.getFrameId(link)].homogeneous @ T
        return out

    def distances(self, x: np.ndarray, pairs: list[tuple[str, str]]) -> np.ndarray:
        out = np.empty((len(x), len(pairs)))
        for n, row in enumerate(x):
            at = {k: coal.Transform3s(T[:3, :3], T[:3, 3]) for k, T in self.places(row).items()}
            for p, (a, b) in enumerate(pairs):
                shapes = self.bodies[a][2], self.bodies[b][2]
                ask = coal.DistanceRequest(), coal.DistanceResult()
                out[n, p] = coal.distance(shapes[0], at[a], shapes[1], at[b], *ask)
        return out


@pytest.fixture(scope="module", params=KINDS, ids="-".join)
def both(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, CollisionModel]:
    cell = cell_of(tmp_path_factory.mktemp("cell"), **request.param)
    return cell, model_of(cell)


def list_pair_names(model: CollisionModel) -> list[tuple[str, str]]:
    return [(p.a, p.b) for p in model.pairs]


def test_poses_agree_with_pinocchio_and_coal(both: tuple[Cell, CollisionModel]) -> None:
    cell, model = both
    x = random_x(cell, 50)
    exact = Independent(cell).distances(x, list_pair_names(model))
    touch = np.array([model.check_single_pairs(x, np.full(len(x), p)) for p in range(len(model.pairs))]).T
    sure = np.abs(exact) > ROUND
    np.testing.assert_array_equal(touch[sure], exact[sure] <= 0)
    assert 0.05 < touch.any(axis=1).mean() < 0.95  # both cases occur
    cutting = np.zeros(len(x), bool)
    np.testing.assert_array_equal(model.check_configurations(x, cutting).hit, touch.any(axis=1))
    near, least = model.find_nearest_pair(x, cutting).distance, exact.min(axis=1)
    free = (least > ROUND) & (least < 0.49)
    np.testing.assert_allclose(near[free], least[free], atol=ROUND)


def test_transform_between_two_links_follows_from_their_poses(both: tuple[Cell, CollisionModel]) -> None:
    cell, model = both
    theta = model.stack.lines.compute_line_positions(random_x(cell, 20))
    poses = model.stack.lines.compute_link_poses(theta)
    for p, (i, j) in enumerate(model.stack.links):
        want = np.linalg.inv(poses[:, i]) @ poses[:, j]
        np.testing.assert_allclose(model.stack.compute_relative_motion(p, theta), want, atol=1e-12)


def test_bounds_hold_for_prismatic_and_revolute_joints(both: tuple[Cell, CollisionModel]) -> None:
    cell, model = both
    x = random_x(cell, 12, seed=1)
    exact = Independent(cell).distances(x, list_pair_names(model))
    assert (MotionRows(model.stack, model._lines.compute_line_positions(x)).bound <= np.maximum(exact, 0) + 1e-9).all()
    rng, lines = np.random.default_rng(2), model._lines
    for start in lines.compute_line_positions(x):
        step = np.where(lines.slides, 0.3, 0.05) * rng.uniform(-1, 1, len(start))
        way = np.linspace(start, start + step, 9)
        rows, steps = MotionRows(model.stack, way[[0, -1]]), MotionRows(model.stack, way)
        for p, (_, j) in enumerate(model.stack.index):
            v = model.stack.bodies[j].vertices
            T = steps.compute_relative_motion(p)
            path = np.einsum("sij,vj->svi", T[:, :3, :3], v) + T[:, None, :3, 3]
            length = np.linalg.norm(np.diff(path, axis=0), axis=2).sum(axis=0).max()
            assert length <= rows.bound_motion(p)[0] + 1e-12
            assert rows.bound_motion(p)[0] <= rows.reach[0] + 1e-12


def test_memory_bounds_the_distance_over_one_or_two_lines(both: tuple[Cell, CollisionModel]) -> None:
    cell, model = both
    x = random_x(cell, 15, seed=3)
    theta, exact = model._lines.compute_line_positions(x), Independent(cell).distances(x, list_pair_names(model))
    for p, (i, j) in enumerate(model.stack.links):
        if j - i <= 2:
            memory = DistanceMemory(model._lines, i, model.stack.bodies[model.stack.index[p][1]])
            for n in range(10):
                memory.add_distance(theta[n], max(exact[n, p], 0.0))
            assert all(memory.bound_distance(theta[n]) <= max(exact[n, p], 0.0) + ROUND for n in range(len(x)))


@pytest.mark.parametrize("seed", range(2))
def test_motions_between_configurations_agree_with_brute_force(both: tuple[Cell, CollisionModel], seed: int) -> None:
    cell, model = both
    x = random_x(cell, 5, seed=10 + seed)
    cutting = np.zeros(5, bool)
    found = model.check_motion(x, cutting, step=np.deg2rad(2))
    for n in range(1, 5):
        fine = x[n - 1] + np.linspace(0, 1, 500)[:, None] * (x[n] - x[n - 1])
        assert found.hit[n] == model.check_configurations(fine, np.zeros(500, bool)).hit.any()


def test_thin_plate_passed_by_the_rail_is_found(tmp_path: Path) -> None:
    """The plate is thinner than a step, and no row touches it: bodies are translated past it, not rotated."""
    plate = CollisionShape(
        name="plate", kind="box", size=(2.0, 0.002, 0.4), mesh=None, T_parent_shape=pose(1.2, 0.313, 1.9)
    )
    cell = replace(external_cell(tmp_path, rail=True), obstacles=(plate,))
    model = model_of(cell)
    x = np.tile(np.append(cell.home, 0.0), (2, 1))
    x[:, 6] = -1.5, 1.5
    free = np.zeros(2, bool)
    assert not model.check_configurations(x, free).hit.any()
    found = model.check_motion(x, free, step=np.deg2rad(5))
    assert found.first == 1
    assert "plate" in model.pairs[found.pair[1]].name
    fine = x[0] + np.linspace(0, 1, 3001)[:, None] * (x[1] - x[0])
    assert model.check_configurations(fine, np.zeros(len(fine), bool)).hit[round(found.row[1] * 3000)]


def test_pairs_worth_checking_are_selected(tmp_path: Path) -> None:
    model = model_of(cell_of(tmp_path, rail=True, table=True, tilt=True))
    names = {frozenset(pair) for pair in list_pair_names(model)}
    for pair in (
        ("block", "post"),  # the part rotates past fixed obstacles
        ("clamp", "post"),
        ("clamp", "link_3_0"),
        ("plate_0", "spindle"),
        ("plate_0", "carriage_0"),
        ("plate_0", "link_1_0"),
        ("post", "base_link_0"),  # the rail moves the base past it
        ("block", "cabinet"),
        ("cabinet", "link_2_0"),
    ):
        assert frozenset(pair) in names, pair
    for pair in (
        ("block", "clamp"),  # on the same link
        ("block", "plate_0"),
        ("carriage_0", "base_link_0"),
        ("carriage_0", "cabinet"),
        ("base_link_0", "link_1_0"),  # adjacent links
    ):
        assert frozenset(pair) not in names, pair


def test_table_beside_the_base_is_no_neighbour_of_it(tmp_path: Path) -> None:
    """Both are mounted on the fixed frame: adjacent in the chain, but not in the URDF if the table has its own foot."""
    cell = external_cell(tmp_path, table=True)
    text = cell.urdf.read_text()
    foot = '<link name="foot"><collision><geometry><box size="0.3 0.3 0.4"/></geometry></collision></link>'
    floor = '<link name="floor"/>' + "".join(
        f'<joint name="to_{name}" type="fixed"><parent link="floor"/><child link="{name}"/>'
        f'<origin xyz="{xyz}"/></joint>'
        for name, xyz in (("base_link", "0 0 0"), ("foot", "1.6 0 0.2"))
    )
    text = text.replace('<parent link="base_link"/><child link="plate"/>', '<parent link="foot"/><child link="plate"/>')
    cell.urdf.write_text(text.replace("</robot>", foot + floor + "</robot>"))
    model = model_of(cell)
    names = {frozenset(pair) for pair in list_pair_names(model)}
    assert frozenset(("plate_0", "base_link_0")) in names
    assert frozenset(("foot_0", "link_1_0")) in names
    apart = {frozenset((e.a, e.b)) for e in model.adjacent}
    assert frozenset(("plate_0", "foot_0")) in apart
    assert frozenset(("base_link_0", "link_1_0")) in apart


def test_cutter_follows_the_part(tmp_path: Path) -> None:
    """A cutter in the block leaves it when the table rotates the part and the arm does not move; rapid moves may
    then touch it."""
    cell = external_cell(tmp_path, table=True)
    model = model_of(cell)
    x = np.zeros((1, 7))
    machine = model._lines.machine
    x[0, :6] = np.deg2rad([0, -60, 100, 0, 50, 0])
    tcp = machine.robot.compute_fk(x[0, :6], cell.tool.T_flange_tcp)
    # place the part so that the cutter is 5 mm below the block's top at e = 0, near its edge
    place = pose(0, 0, 0) @ np.linalg.inv(pose(1.6, 0, 0.5)) @ tcp @ np.diag([1.0, -1, -1, 1]) @ pose(0, 0.24, 0.005)
    cell = replace(cell, workpiece=replace(cell.workpiece, T_link_workpiece=place))
    model = model_of(cell)
    x = np.repeat(x, 2, axis=0)
    x[1, 6] = 1.2
    hit = model.check_configurations(x, np.zeros(2, bool))
    assert hit.hit[0]
    assert model.pairs[hit.pair[0]].name == "block ~ cutter"
    assert not model.check_configurations(x[:1], np.ones(1, bool)).hit.any()


def test_external_joints_at_home_need_no_values(both: tuple[Cell, CollisionModel]) -> None:
    cell, _ = both
    home = 0.4 * cell.limits.upper[6:]
    cell = replace(cell, external_home=home)
    robot, shapes = load_chain(cell)
    model, still = model_of(cell), CollisionModel(cell, robot, shapes, 0.0, still=True)
    q, free = random_x(cell, 60, seed=7)[:, :6], np.zeros(60, bool)
    x = np.hstack([q, np.tile(home, (60, 1))])
    np.testing.assert_array_equal(still.check_configurations(q, free).hit, model.check_configurations(x, free).hit)
    np.testing.assert_array_equal(still.find_nearest_pair(q, free).distance, model.find_nearest_pair(x, free).distance)
    bare = replace(cell, workpiece=replace(cell.workpiece, link="world", geometry=()), obstacles=())
    assert CollisionModel(bare, robot, shapes, 0.0, still=True).check_configurations(q, free).hit.shape == (60,)


def test_constant_distance_of_a_carriage_from_its_bed_is_no_clearance(tmp_path: Path) -> None:
    """The pair is checked for contact, but is excluded from the minimum clearance; planner and verifier exclude the
    same pairs.

    The distances to the stop at the end of the rail and to bodies on the plate vary and are included.
    """
    cell = external_cell(tmp_path, rail=True, table=True)
    things = (
        CollisionShape(
            name="cabinet",
            kind="box",
            size=(0.3, 0.4, 0.9),
            mesh=None,
            T_parent_shape=pose(-0.9, 0.0, 0.9),
            link="carriage",
        ),
        CollisionShape(name="bed", kind="box", size=(0.5, 9.0, 0.1), mesh=None, T_parent_shape=pose(-0.9, 0.0, 0.05)),
        CollisionShape(name="stop", kind="box", size=(0.5, 0.1, 2.0), mesh=None, T_parent_shape=pose(-0.9, 3.2, 1.0)),
        CollisionShape(
            name="wheel",
            kind="cylinder",
            size=(0.3, 0.1),
            mesh=None,
            T_parent_shape=pose(0.0, 0.0, -0.25),
            link="plate",
        ),
        CollisionShape(name="foot", kind="cylinder", size=(0.2, 0.05), mesh=None, T_parent_shape=pose(1.5, 0.0, 0.05)),
        CollisionShape(
            name="ram", kind="box", size=(0.1, 0.1, 0.1), mesh=None, T_parent_shape=pose(1.0, 0.0, -0.25), link="plate"
        ),
    )
    cell = replace(cell, obstacles=things)
    model, arm = model_of(cell), UrdfKinematics(cell)
    unchanging = {frozenset(("cabinet", "bed"))}
    named = [frozenset((p.a, p.b)) for p in model.pairs]
    assert unchanging <= set(named)  # still checked for contact
    q = random_x(cell, 200)
    values = {named[k] for k in model.find_nearest_pair(q, np.zeros(len(q), bool)).pair if k >= 0}
    assert values
    assert not unchanging & values
    wanted = list_checked_pairs(cell, arm, build_bodies(cell, arm))
    left_out = {frozenset((a.name, b.name)) for a, b in wanted} - {
        frozenset((a.name, b.name)) for a, b in list_varying_pairs(arm, wanted)
    }
    assert left_out == {named[k] for k in np.flatnonzero(model._told_nothing)}
    assert unchanging <= left_out
    assert frozenset(("cabinet", "stop")) not in left_out


@pytest.mark.parametrize(("bump", "tells"), [("end stop", True), ("weld", False)])
def test_planner_and_verifier_exclude_the_same_pairs_of_the_bed(tmp_path: Path, bump: str, tells: bool) -> None:
    """Both planner and verifier detect an end stop near the last 2 mm of 5 m travel; neither detects a weld of 20 mm
    length.

    With separate random positions only the verifier detected the weld, which gave exit code 4 for a correct plan.
    """
    cell = external_cell(tmp_path, rail=True)
    low, high = cell.limits.lower[6], cell.limits.upper[6]
    drawn = low + (high - low) * np.random.default_rng(21).random((24, 7))[:, 6]
    # m, distance from the positions that both sample
    off = np.abs(drawn[:, None] - np.linspace(low, high, 49)).min(axis=1)
    gap, half = 0.005, 0.02  # m, gap between cabinet and bed; half-length of the cabinet
    y, size = (high + half + 0.003 + 0.05, 0.1) if bump == "end stop" else (float(drawn[off.argmax()]), 0.02)
    bed = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.5, 9.0, 0.1), pose(-0.9, 0.0, 0.05)),
            trimesh.creation.box((0.5, size, 0.103), pose(-0.9, y, 0.0515)),
        ]
    )
    if bump == "end stop":
        bed = trimesh.util.concatenate([bed, trimesh.creation.box((0.5, size, 0.4), pose(-0.9, y, 0.2))])
    bed.export(tmp_path / "bed.stl")
    things = (
        CollisionShape(
            name="cabinet",
            kind="box",
            size=(0.3, 2 * half, 0.9),
            mesh=None,
            T_parent_shape=pose(-0.9, 0.0, 0.75 + gap),
            link="carriage",
        ),
        CollisionShape(name="bed", kind="mesh", size=(1.0,), mesh=tmp_path / "bed.stl", T_parent_shape=np.eye(4)),
    )
    cell = replace(cell, obstacles=things)
    model, arm = model_of(cell), UrdfKinematics(cell)
    pair = frozenset(("cabinet", "bed"))
    named = [frozenset((p.a, p.b)) for p in model.pairs]
    wanted = list_checked_pairs(cell, arm, build_bodies(cell, arm))
    values = {frozenset((a.name, b.name)) for a, b in list_varying_pairs(arm, wanted)}
    assert (pair in values) is tells
    assert {named[k] for k in np.flatnonzero(~model._told_nothing)} == values
