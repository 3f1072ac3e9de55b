"""Stock as a signed distance field: volumes and contact against closed forms, with tool axes in any direction."""

from __future__ import annotations

from math import acos, degrees, pi

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from machopt.data_types.stock import StockBody
from machopt.errors import CuttingInputError
from machopt.process.stock.distance_field import DistanceField, build_distance_field
from machopt.process.stock.field_path import remove_field_path
from machopt.process.stock.height_map_comparison import compare_with_finished_part

CELL = 0.25e-3
VOLUME, ANGLE = 1e-3, 2.5  # relative to the volume; degrees
TURNS = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.2, -0.5, 0.3), (0.7, 0.4, 1.1), (pi / 4, 0.0, 0.0), (pi / 2, 0.0, 0.0))


def build_body(mesh: trimesh.Trimesh, cell: float = CELL) -> StockBody:
    return StockBody(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, np.int64), cell_size=cell)


def build_block(low: tuple[float, ...], high: tuple[float, ...], turn: np.ndarray | None = None) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(np.subtract(high, low))
    mesh.apply_translation(np.add(low, high) / 2)
    if turn is not None:
        T = np.eye(4)
        T[:3, :3] = turn
        mesh.apply_transform(T)
    return mesh


def remove(
    stock: DistanceField, tips: np.ndarray, axes: np.ndarray, radius: float, corner: float = 0.0, height: float = 0.05
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the volume of each move, the point index of each arc, and low, high (m), start, end (deg) of each arc."""
    axes = np.tile(axes, (len(tips), 1)) if axes.ndim == 1 else axes
    wanted = np.ones(len(tips), bool)
    volume, point, rows = remove_field_path(stock, tips, axes, wanted, (radius, corner, 0.0, height))
    return volume, point, np.column_stack([rows[:, :2], np.degrees(rows[:, 2:])])


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("corner", [0.0, 2e-3, 6e-3])
def test_volume_of_a_slot_is_exact_in_any_direction(turn: tuple[float, ...], corner: float) -> None:
    Q = Rotation.from_rotvec(turn).as_matrix()
    R, depth, length = 6e-3, 8e-3, 0.03
    stock = build_distance_field(build_body(build_block((-0.04, -0.015, -0.015), (0.04, 0.015, 0.0), Q)))
    path = np.array([0.00013, -0.0007, -depth]) + np.linspace(-0.5, 0.5, 61)[:, None] * [length, 0, 0]
    before = stock.volume
    volume, point, rows = remove(stock, path @ Q.T, Q[:, 2], R, corner)
    flat = R - corner
    section = 2 * R * (depth - corner) + 2 * flat * corner + pi * corner**2 / 2
    ends = pi * R**2 * (depth - corner)
    ends += pi * (flat**2 * corner + flat * pi * corner**2 / 2 + 2 / 3 * corner**3)
    assert volume.sum() == pytest.approx(section * length + ends, rel=VOLUME)
    assert before - stock.volume == pytest.approx(volume.sum(), rel=1e-9)
    steady = (point > 25) & (point < 40)
    assert rows[steady, 2].max() == 0.0  # material on both sides of the slot: thin chips are included
    assert rows[steady, 3].min() == pytest.approx(180.0)
    assert rows[steady, 1].max() == pytest.approx(depth, abs=0.1 * CELL)
    assert rows[steady, 0].min() == pytest.approx(0.0, abs=0.25 * CELL)
    assert set(point[steady]) == set(range(26, 40))


@pytest.mark.parametrize("turn", TURNS[1:])
@pytest.mark.parametrize("side", ["up", "down"])
@pytest.mark.parametrize(("ae", "step"), [(1e-3, 0.5e-3), (1e-3, 0.06e-3), (4e-3, 0.5e-3)])
def test_arc_of_a_straight_pass_follows_from_its_radial_depth(
    turn: tuple[float, ...], side: str, ae: float, step: float
) -> None:
    Q, R = Rotation.from_rotvec(turn).as_matrix(), 10e-3
    stock = build_distance_field(build_body(build_block((0, 0, 0), (0.03, 0.02, 0.01), Q)))
    x = np.arange(-0.012, 0.042, step)
    path = np.column_stack([x, np.full_like(x, ae - R), np.full_like(x, 0.006)])
    path = path if side == "up" else path[::-1]
    _, point, rows = remove(stock, path @ Q.T, Q[:, 2], R)
    theta = degrees(acos(1 - ae / R))
    wanted = (0.0, theta) if side == "up" else (180 - theta, 180.0)
    inside = np.abs(path[point, 0] - 0.015) < 0.003
    assert inside.any()
    assert np.abs(rows[inside, 2:] - wanted).max() < ANGLE
    assert np.abs(rows[inside, :2] - (0.0, 4e-3)).max() < 0.1 * CELL


def test_volumes_of_bodies_are_exact() -> None:
    cylinder = trimesh.creation.cylinder(radius=0.015, height=0.02, sections=360)
    assert build_distance_field(build_body(cylinder)).volume == pytest.approx(cylinder.volume, rel=VOLUME)
    for turn in TURNS:
        block = build_block((0, 0, 0), (0.05, 0.03, 0.02), Rotation.from_rotvec(turn).as_matrix())
        assert build_distance_field(build_body(block)).volume == pytest.approx(3e-5, rel=VOLUME)


def build_cone(allowance: float, foot: float = 0.03, height: float = 0.01, lean: float = 0.25) -> trimesh.Trimesh:
    more = allowance / np.cos(lean)
    top = foot - height * np.tan(lean)
    profile = [(0, -0.005), (0.02, -0.005), (0.02, 0), (foot + more, 0), (top + more, height), (0, height)]
    return trimesh.creation.revolve(np.array(profile), sections=720)


def build_ring(shift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return tips and axes of a cutter of radius 5 mm with its side on the cone of ``build_cone``, over the full
    circumference."""
    turn, lean = np.linspace(0, -2 * np.pi, 361), 0.25
    out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    axis = np.cos(lean) * np.array([0, 0, 1.0]) - np.sin(lean) * out
    normal = np.cos(lean) * out + np.sin(lean) * np.array([0, 0, 1.0])
    return 0.03 * out + (5e-3 + shift) * normal - 2e-3 * axis, axis


@pytest.mark.slow
def test_cutter_turning_along_a_conical_wall_removes_the_allowance() -> None:
    stock, part = build_cone(0.8e-3), build_cone(0.0)
    field = build_distance_field(build_body(stock))
    tips, axes = build_ring()
    volume, point, rows = remove(field, tips, axes, 5e-3)
    assert volume.sum() == pytest.approx(stock.volume - part.volume, rel=VOLUME)
    steady = (point > 60) & (point < 300)
    assert rows[steady, 3].min() == pytest.approx(180.0)
    bend = 0.025 / np.cos(0.25)  # smallest radius of curvature of the wall, perpendicular to the generator
    d = bend + 5e-3
    wanted = 180 - degrees(acos((d**2 + 5e-3**2 - (bend + 0.8e-3) ** 2) / (2 * d * 5e-3)))
    below = steady & (rows[:, 0] < 11.9e-3)  # the inclined top of the stock ends the contact between 12.1 and 12.3 mm
    assert np.abs(rows[below, 2] - wanted).max() < ANGLE
    assert rows[steady & ~below, :2] == pytest.approx(12.2e-3, abs=0.2e-3)
    found = compare_with_finished_part(field, build_body(part))
    assert (found.gouge_depth, found.left_depth) == (0.0, 0.0)
    assert max(found.gouge_volume, found.left_volume) < VOLUME * volume.sum()


@pytest.mark.slow
@pytest.mark.parametrize("shift", [0.3e-3, -0.3e-3])
def test_remaining_material_and_gouges_have_the_correct_depth(shift: float) -> None:
    part = build_body(build_cone(0.0))
    field = build_distance_field(build_body(build_cone(0.8e-3)))
    volume = remove(field, *build_ring(shift), 5e-3)[0].sum()
    found = compare_with_finished_part(field, part)
    depth, other = (found.left_depth, found.gouge_depth) if shift > 0 else (found.gouge_depth, found.left_depth)
    assert depth == pytest.approx(abs(shift), abs=0.1 * CELL)
    assert other == 0.0
    size = found.left_volume if shift > 0 else found.gouge_volume
    exact = build_cone(0.8e-3).volume - build_cone(0.0).volume
    assert size == pytest.approx(abs(volume - exact), rel=0.02)


def test_gap_in_the_stock_remains_empty() -> None:
    """A height map along the axis fills a gap; a signed distance field does not."""
    lower, upper = build_block((0, 0, 0), (0.02, 0.02, 0.004)), build_block((0, 0, 0.008), (0.02, 0.02, 0.012))
    field = build_distance_field(build_body(trimesh.util.concatenate([lower, upper])))
    tips = np.array([[-0.01, 0.01, 0.001], [0.03, 0.01, 0.001]])
    volume = remove(field, tips, np.array([0.0, 0.0, 1.0]), 3e-3)[0].sum()
    # short edges: an error of a sixth of the squared cell size for each
    assert volume == pytest.approx(0.02 * 6e-3 * 7e-3, rel=2 * VOLUME)


@pytest.mark.parametrize("axis", [[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [0, -1.0, 0]])
def test_start_inside_material_and_any_rotation_are_accepted(axis: list[float]) -> None:
    field = build_distance_field(build_body(build_block((0, 0, 0), (0.02, 0.02, 0.02))))
    tips = np.tile([0.01, 0.01, 0.01], (2, 1))
    axes = np.array([[0, 0, 1.0], axis])
    volume, point, _ = remove(field, tips, axes, 2e-3, height=5e-3)
    assert volume[0] == pytest.approx(pi * 4e-6 * 5e-3, rel=0.01)
    assert np.isfinite(volume).all()
    assert volume[1] >= 0.0
    assert not len(point)  # without travel there is no contact angle


def test_second_pass_over_a_surface_cuts_air() -> None:
    field = build_distance_field(build_body(build_block((0, 0, 0), (0.03, 0.02, 0.01))))
    x = np.arange(-0.01, 0.04, 0.5e-3)
    tips = np.column_stack([x, np.full_like(x, 0.01), np.full_like(x, 0.006)])
    axis = np.array([0.0, np.sin(0.1), np.cos(0.1)])
    assert remove(field, tips, axis, 4e-3)[0].sum() > 0
    volume, point, _ = remove(field, tips[::-1], axis, 4e-3)
    assert volume.sum() < 1e-12
    assert not len(point)


@pytest.mark.parametrize(("cell", "words"), [(1e-7, "or more"), (5e-3, "or less"), (2e-5, "or more")])
def test_unsuitable_cell_size_is_refused_with_a_suitable_one(cell: float, words: str) -> None:
    mesh = build_block((0, 0, 0), (0.2, 0.2, 0.02))
    with pytest.raises(CuttingInputError, match=words) as caught:
        build_distance_field(build_body(mesh, cell))
    assert caught.value.key == "cell_mm"


@pytest.mark.parametrize("turn", [TURNS[0], TURNS[4], (0.0, 0.0, 0.615)])
@pytest.mark.parametrize("ae", [1e-3, 1.1e-3, 2.3e-3])
def test_volume_of_a_narrow_pass_does_not_depend_on_the_grid_offset(turn: tuple[float, ...], ae: float) -> None:
    Q, R = Rotation.from_rotvec(turn).as_matrix(), 6e-3
    mesh = build_block((0, 0, 0), (0.06, 0.015, 0.009), Q)
    stock = build_distance_field(build_body(mesh))
    assert stock.volume == pytest.approx(mesh.volume, rel=5e-4)
    x = np.arange(-R - 1e-3, 0.06 + R + 1e-3, 2e-3)
    path = np.column_stack([x, np.full_like(x, ae - R), np.full_like(x, 0.004)])
    volume, _, _ = remove(stock, path @ Q.T, Q[:, 2], R)
    assert volume.sum() == pytest.approx(0.06 * ae * 0.005, rel=5e-4)


LAYERS = (  # rotation (rad), cell size, radius, depths of both layers, step (m)
    ((0.0, 0.0, 0.0), 0.5e-3, 8.5e-3, (5e-3, 4e-3), 4e-3),
    ((0.2, -0.5, 0.3), 0.4e-3, 5e-3, (3.1e-3, 3.3e-3), 0.2e-3),
    ((0.3, 0.9, 0.1), 0.3e-3, 6e-3, (2e-3, 4.7e-3), 1e-3),
)


@pytest.mark.slow
@pytest.mark.parametrize(("turn", "cell", "radius", "depths", "step"), LAYERS)
def test_wall_of_the_upper_layer_is_not_in_contact(
    turn: tuple[float, ...], cell: float, radius: float, depths: tuple[float, float], step: float
) -> None:
    """The second layer has the outline of the first one, including its end."""
    Q = Rotation.from_rotvec(turn).as_matrix()
    stock = build_distance_field(build_body(build_block((-0.03, -0.02, -0.015), (0.03, 0.02, 0.0), Q), cell))
    x = np.arange(-0.006, 0.0061, step)
    first = np.column_stack([x, 0 * x, np.full_like(x, -depths[0])])
    path = np.vstack([np.add(first[:1], [0, 0, 0.02]), first, first[::-1] - [0, 0, depths[1]]])
    _, point, rows = remove(stock, path @ Q.T, Q[:, 2], radius)
    second = rows[point > len(x) + 1]
    assert len(second) == len(x) - 1
    assert second == pytest.approx(np.tile([0.0, depths[1], 0.0, 180.0], (len(x) - 1, 1)), abs=0.02 * cell)


@pytest.mark.parametrize("turn", [TURNS[0], TURNS[3]])
def test_wall_below_the_cut_is_not_in_contact(turn: tuple[float, ...]) -> None:
    """A short cutter leaves material above the cut; the next pass with the same outline is higher."""
    Q, cell, height = Rotation.from_rotvec(turn).as_matrix(), 0.4e-3, 8e-3
    stock = build_distance_field(build_body(build_block((-0.02, -0.01, -0.03), (0.02, 0.01, 0.0), Q), cell))
    x = np.arange(-0.026, 0.0101, 2e-3)
    low, high = (np.column_stack([x, 0 * x, np.full_like(x, z)]) for z in (-0.02, -0.0143))
    aside = np.array([[x[-1], 0.05, -0.02], [x[0], 0.05, -0.0143]])
    _, point, rows = remove(stock, np.vstack([low, aside, high]) @ Q.T, Q[:, 2], 6e-3, height=height)
    inside = rows[point > len(x) + 6]
    assert len(inside) > 5
    assert inside[:, :2] == pytest.approx(np.tile([2.3e-3, height], (len(inside), 1)), abs=0.05 * cell)


@pytest.mark.parametrize("turn", TURNS[:4])
def test_slice_ends_where_the_cutting_width_changes(turn: tuple[float, ...]) -> None:
    """Half of the stock above a slot was removed before."""
    Q, R, cell = Rotation.from_rotvec(turn).as_matrix(), 5e-3, 0.4e-3
    stock = build_distance_field(build_body(build_block((-0.02, -0.015, -0.015), (0.02, 0.015, 0.0), Q), cell))
    x = np.arange(-0.026, 0.0101, 1e-3)
    before = np.column_stack([x, np.full_like(x, R), np.full_like(x, -4.2e-3)])
    path = np.vstack([before, np.add(before[[-1, 0]], [0, 0, 0.03]), before - [0, R, 5.3e-3]])
    _, point, rows = remove(stock, path @ Q.T, Q[:, 2], R)
    for k in range(len(path) - 20, len(path) - 7):  # away from the round end of the previous pass
        mine = rows[point == k]
        assert (mine[0, 0], mine[0, 1], mine[-1, 1]) == pytest.approx((0.0, 5.3e-3, 9.5e-3), abs=0.2 * cell)
        assert mine[0, 2:] == pytest.approx([0.0, 180.0])
        assert mine[1:, 2:] == pytest.approx(np.tile([90.0, 180.0], (len(mine) - 1, 1)), abs=ANGLE)


@pytest.mark.parametrize("turn", TURNS[:4])
def test_contact_ends_at_the_face_of_the_block(turn: tuple[float, ...]) -> None:
    """The edge of the block crosses the outline of the cutter: the contact angle is accurate to 1.75 cells."""
    Q, R, ae, cell = Rotation.from_rotvec(turn).as_matrix(), 8.5e-3, 4.5e-3, 0.4e-3
    stock = build_distance_field(build_body(build_block((0, 0, -0.012), (0.03, 0.02, 0), Q), cell))
    x = np.arange(0.02, 0.0011, -0.5e-3)
    path = np.column_stack([x, np.full_like(x, ae - R), np.full_like(x, -6e-3)])
    path = np.vstack([np.add(path[:1], [0.03, 0, 0]), path])
    _, point, rows = remove(stock, path @ Q.T, Q[:, 2], R)
    side = 180.0 - degrees(acos(1 - ae / R))
    for k in np.flatnonzero(path[:, 0] < R):
        begin = max(side, 180.0 - degrees(np.arcsin(path[k, 0] / R)))
        mine = rows[point == k]
        assert mine[:, 2:] == pytest.approx(np.tile([begin, 180.0], (len(mine), 1)), abs=degrees(1.75 * cell / R))
