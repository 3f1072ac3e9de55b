"""Stock removal and contact against closed forms and sampled points."""

from __future__ import annotations

from itertools import pairwise
from math import acos, degrees, pi, sqrt

import numpy as np
import pytest
import trimesh

from machopt.data_types.stock import StockBody, StockComparison
from machopt.errors import CuttingInputError
from machopt.process.stock.end_cutting import measure_map_end
from machopt.process.stock.height_map import HeightMap, build_height_map
from machopt.process.stock.height_map_comparison import compare_with_finished_part
from machopt.process.stock.path_removal import remove_path

CELL = 0.25e-3
UP = np.array([0.0, 0.0, 1.0])
VOLUME, ANGLE = 1e-3, 2.5  # relative to the volume; degrees


def build_body(mesh: trimesh.Trimesh, cell: float = CELL) -> StockBody:
    return StockBody(vertices=np.array(mesh.vertices), faces=np.array(mesh.faces, np.int64), cell_size=cell)


def build_block(low: tuple[float, ...], high: tuple[float, ...]) -> StockBody:
    mesh = trimesh.creation.box(np.subtract(high, low))
    mesh.apply_translation(np.add(low, high) / 2)
    return build_body(mesh)


def remove(
    stock: HeightMap, points: np.ndarray, radius: float, corner: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the volume of each move, the point index of each arc, and low, high (m), start, end (deg) of each arc."""
    wanted = np.ones(len(points), bool)
    volume, point, rows = remove_path(stock, stock.convert_points(points), wanted, (radius, corner, 0.0), 0.05)
    return volume, point, np.column_stack([rows[:, :2], np.degrees(rows[:, 2:])])


def build_line(start: tuple[float, float, float], end: tuple[float, float, float], step: float = 0.5e-3) -> np.ndarray:
    n = max(int(np.ceil(np.linalg.norm(np.subtract(end, start)) / step)), 1)
    return np.array(start) + np.linspace(0, 1, n + 1)[:, None] * np.subtract(end, start)


@pytest.mark.parametrize("ae", [1e-3, 3e-3, 10e-3])
@pytest.mark.parametrize(("radius", "step"), [(10e-3, 0.5e-3), (10e-3, 0.06e-3), (6e-3, 0.5e-3)])
@pytest.mark.parametrize("side", ["up", "down"])
def test_arc_of_a_straight_pass_follows_from_its_radial_depth(ae: float, radius: float, step: float, side: str) -> None:
    stock = build_height_map(build_block((0, 0, 0), (0.06, 0.04, 0.02)), UP)
    y = ae - radius
    path = build_line((-0.02, y, 0.014), (0.08, y, 0.014), step)
    # the material is to the left of the travel direction, then to the right
    path = path if side == "up" else path[::-1]
    volume, point, rows = remove(stock, path, radius)
    inside = np.abs(path[point, 0] - 0.03) < 0.01
    theta = degrees(acos(1 - ae / radius))
    wanted = (0.0, theta) if side == "up" else (180 - theta, 180.0)
    assert np.abs(rows[inside, 2] - wanted[0]).max() < ANGLE
    assert np.abs(rows[inside, 3] - wanted[1]).max() < ANGLE
    assert rows[inside, 1] - rows[inside, 0] == pytest.approx(0.006, abs=1e-7)
    assert inside.sum() == (np.abs(path[:, 0] - 0.03) < 0.01).sum()  # one arc at every point
    assert volume.sum() == pytest.approx(0.06 * 0.006 * ae, rel=VOLUME)


@pytest.mark.parametrize("angle", [0.0, 17.0, 45.0, 71.0])
@pytest.mark.parametrize("corner", [0.0, 2e-3, 6e-3])
def test_volume_of_a_slot_is_exact(angle: float, corner: float) -> None:
    stock = build_height_map(build_block((-0.06, -0.06, 0), (0.06, 0.06, 0.02)), UP)
    before, R, depth, length = stock.volume, 6e-3, 8e-3, 0.06
    t = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
    middle = np.array([0.13e-3, -0.07e-3, 0.012])
    volume, _, _ = remove(
        stock, build_line(tuple(middle - 0.5 * length * t), tuple(middle + 0.5 * length * t)), R, corner
    )
    flat = R - corner
    section = 2 * R * (depth - corner) + 2 * flat * corner + pi * corner**2 / 2
    ends = pi * R**2 * (depth - corner) + pi * (flat**2 * corner + flat * pi * corner**2 / 2 + 2 / 3 * corner**3)
    assert volume.sum() == pytest.approx(section * length + ends, rel=VOLUME)
    assert before - stock.volume == pytest.approx(volume.sum(), rel=1e-5)


def test_volume_of_a_turned_cylinder_and_a_ring_is_exact() -> None:
    mesh = trimesh.creation.cylinder(radius=0.025, height=0.03, sections=720)
    stock = build_height_map(build_body(mesh), UP)
    assert stock.volume == pytest.approx(mesh.volume, rel=VOLUME)
    turn = np.linspace(0, 2 * pi, 1441)
    around = np.column_stack([0.026 * np.cos(turn), 0.026 * np.sin(turn), np.full_like(turn, 0.005)])
    volume, _, _ = remove(stock, around, 0.006)  # leaves a pin of radius 20 mm
    assert volume.sum() == pytest.approx(pi * (0.025**2 - 0.020**2) * 0.01, rel=2 * VOLUME)
    ring = np.column_stack([0.01 * np.cos(turn), 0.01 * np.sin(turn), np.full_like(turn, 0.005)])
    volume, _, _ = remove(stock, ring, 0.004)
    assert volume.sum() == pytest.approx(pi * (0.014**2 - 0.006**2) * 0.01, rel=VOLUME)


def test_entering_a_flat_face_opens_the_arc_around_the_feed_direction() -> None:
    stock = build_height_map(build_block((0, -0.03, 0), (0.06, 0.03, 0.02)), UP)
    path, R = build_line((-0.02, 0, 0.01), (0.02, 0, 0.01)), 8e-3
    _, point, rows = remove(stock, path, R)
    for x in (-0.0065, -0.005, -0.002):
        n = int(np.argmin(np.abs(path[:, 0] - x)))
        half = degrees(acos(-path[n, 0] / R))
        mine = rows[point == n]
        assert len(mine) == 1
        assert mine[0, 2:] == pytest.approx([90 - half, 90 + half], abs=ANGLE)
    assert not (path[point, 0] < -R - CELL).any()


def test_pocket_corner_increases_the_arc_as_its_geometry_requires() -> None:
    """A cutter moves along a wall towards a perpendicular wall: both are in contact from one radius before the
    corner."""
    stock = build_height_map(build_block((-0.05, -0.05, 0), (0.05, 0.05, 0.02)), UP)
    R, ae, z = 6e-3, 2e-3, 0.01
    clear = np.concatenate([build_line((-0.03, y, z), (0.02, y, z)) for y in np.arange(-0.03, 0.0001, 4e-3)])
    remove(stock, clear, R)  # leaves material from y = 4 mm + … and from x = 26 mm on
    wall = clear[:, 1].max() + R
    path = build_line((-0.02, wall + ae - R, z), (0.02 + 3e-3, wall + ae - R, z))
    _, point, rows = remove(stock, path, R)
    n = len(path) - 1
    mine = rows[point == n]
    beyond = 0.026 - path[n, 0]  # distance to the perpendicular wall
    assert mine[:, 2].min() == pytest.approx(0.0, abs=ANGLE)
    # where the perpendicular wall crosses the circle
    exit_angle = degrees(pi - acos(1.0) - (0.5 * pi - acos(beyond / R)))
    assert mine[:, 3].max() == pytest.approx(exit_angle, abs=2 * ANGLE)
    along = rows[(point > 20) & (path[point, 0] < 0.0)]
    assert along[:, 3] == pytest.approx(degrees(acos(1 - ae / R)), abs=ANGLE)


def test_arc_on_a_circle_inside_a_round_pocket_follows_from_two_circles() -> None:
    mesh = trimesh.creation.annulus(r_min=0.020, r_max=0.045, height=0.02, sections=1440)
    stock = build_height_map(build_body(mesh), UP)
    R, ae = 8e-3, 1.5e-3
    rho = 0.020 + ae - R
    turn = np.linspace(0, 2 * pi, 721)
    path = np.column_stack([rho * np.cos(turn), rho * np.sin(turn), np.full_like(turn, -0.005)])
    volume, point, rows = remove(stock, path, R)
    # angle at the cutter centre between the radius and the intersection
    cosine = (0.020**2 - rho**2 - R**2) / (2 * rho * R)
    theta = degrees(acos(cosine))
    some = (point > 60) & (point < 600)  # later the cutter reaches the start of the cut
    start, end = rows[some, 2], rows[some, 3]  # counter-clockwise travel: the wall is to the right
    assert np.abs(start - (180 - theta)).max() < ANGLE
    assert np.abs(end - 180).max() < 1.0
    assert volume.sum() == pytest.approx(pi * ((0.020 + ae) ** 2 - 0.020**2) * 0.015, rel=2 * VOLUME)


def test_repeated_pass_cuts_air() -> None:
    stock = build_height_map(build_block((0, 0, 0), (0.06, 0.04, 0.02)), UP)
    path = build_line((-0.02, -0.004, 0.014), (0.08, -0.004, 0.014))
    remove(stock, path, 6e-3)
    volume, point, _ = remove(stock, path, 6e-3)
    assert volume.sum() < 1e-12
    assert not len(point)


@pytest.mark.parametrize("corner", [0.0, 1.5e-3, 4e-3])
def test_random_path_leaves_the_stock_of_sampled_columns(corner: float) -> None:
    """Columns of the block compared with every pose at intervals of 0.2 mm."""
    R = 4e-3
    rng = np.random.default_rng(5)
    corners = np.column_stack(
        [rng.uniform(-0.02, 0.02, 12), rng.uniform(-0.02, 0.02, 12), rng.uniform(0.008, 0.016, 12)]
    )
    stock = build_height_map(build_block((-0.02, -0.02, 0), (0.02, 0.02, 0.02)), UP)
    volume, _, _ = remove(stock, corners, R, corner)
    place = rng.uniform(-0.02, 0.02, (40_000, 2))
    height = np.full(len(place), 0.02)
    for a, b in pairwise(corners):
        for pose in build_line(tuple(a), tuple(b), 0.2e-3):
            d = np.hypot(*(place - pose[:2]).T)
            beyond = np.clip(d - R + corner, 0, corner)
            lowest = pose[2] + corner - np.sqrt(corner**2 - beyond**2)
            height = np.where(d <= R, np.minimum(height, lowest), height)
    sampled = (0.02 - height).mean() * 0.04**2
    error = (0.02 - height).std() * 0.04**2 / sqrt(len(place))
    assert volume.sum() == pytest.approx(sampled, abs=4 * error)
    i, j = ((place + 0.02) / CELL).astype(int).clip(0, 159).T
    mean = (1 - stock.share) * stock.high + stock.share * stock.low
    assert np.median(np.abs(mean[j, i] - height)) < 2e-5


def test_tilted_constant_axis_equals_an_upright_axis() -> None:
    R = trimesh.transformations.rotation_matrix(0.6, [1, 2, 0.5])[:3, :3]
    mesh = trimesh.creation.box((0.06, 0.04, 0.02))
    path = build_line((-0.05, -0.021, 0.002), (0.05, -0.021, 0.002))
    turned = StockBody(vertices=mesh.vertices @ R.T, faces=np.array(mesh.faces, np.int64), cell_size=CELL)
    stock = build_height_map(turned, R[:, 2])
    assert stock.volume == pytest.approx(0.06 * 0.04 * 0.02, rel=VOLUME)
    volume, point, rows = remove(stock, path @ R.T, 6e-3)
    assert volume.sum() == pytest.approx(0.06 * 5e-3 * 8e-3, rel=VOLUME)
    inside = np.abs(path[point, 0]) < 0.02
    assert rows[inside, 3] == pytest.approx(degrees(acos(1 - 5 / 6)), abs=ANGLE)


def test_cutter_through_a_plate_contacts_only_the_plate() -> None:
    stock = build_height_map(build_block((0, 0, 0.01), (0.06, 0.04, 0.014)), UP)
    path = build_line((-0.02, 0.02, 0.0), (0.05, 0.02, 0.0))
    volume, point, rows = remove(stock, path, 5e-3)
    inside = rows[(path[point, 0] > 0.01) & (path[point, 0] < 0.04)]
    assert inside[:, :2] == pytest.approx(np.tile([0.01, 0.014], (len(inside), 1)), abs=1e-6)
    assert volume.sum() == pytest.approx((0.05 * 0.01 + pi * 5e-3**2 / 2) * 0.004, rel=VOLUME)


def test_steps_of_the_stock_give_separate_slices() -> None:
    stock = build_height_map(build_block((0, -0.02, 0), (0.06, 0.02, 0.02)), UP)
    remove(stock, build_line((-0.02, -0.010, 0.016), (0.08, -0.010, 0.016)), 10e-3)  # lower for y < 0
    path = build_line((-0.02, 0.0, 0.012), (0.05, 0.0, 0.012))
    _, point, rows = remove(stock, path, 6e-3)
    mine = rows[point == int(np.argmin(np.abs(path[:, 0] - 0.03)))]
    assert mine[:, :2] == pytest.approx(np.array([[0.0, 0.004], [0.004, 0.008]]), abs=1e-6)
    assert mine[0, 2:] == pytest.approx([0, 180], abs=ANGLE)
    assert mine[1, 2:] == pytest.approx([0, 90], abs=ANGLE)  # left of the travel direction: y > 0


@pytest.mark.parametrize(("cell", "word"), [(1e-7, "at most"), (6e-3, "at least")])
def test_number_of_cells_out_of_range_is_refused_with_a_suitable_one(cell: float, word: str) -> None:
    mesh = trimesh.creation.box((0.06, 0.04, 0.02))
    with pytest.raises(CuttingInputError, match=word):
        build_height_map(build_body(mesh, cell), UP)


def compare(depth: float, wanted: float) -> StockComparison:
    stock = build_height_map(build_block((0, 0, 0), (0.06, 0.04, 0.02)), UP)
    path = np.concatenate(
        [build_line((-0.01, y, 0.02 - depth), (0.07, y, 0.02 - depth)) for y in np.arange(0, 0.041, 8e-3)]
    )
    remove(stock, path, 6e-3)
    part = build_block((0, 0, 0), (0.06, 0.04, 0.02 - wanted))
    return compare_with_finished_part(stock, part)


def test_gouges_and_remaining_material_have_correct_depth_and_volume() -> None:
    gouged, left = compare(0.005, 0.0047), compare(0.0046, 0.005)
    assert gouged.gouge_depth == pytest.approx(0.0003, abs=1e-6)
    assert gouged.gouge_volume == pytest.approx(0.06 * 0.04 * 0.0003, rel=1e-3)
    assert gouged.left_volume == pytest.approx(0.0, abs=1e-12)
    assert left.left_depth == pytest.approx(0.0004, abs=1e-6)
    assert left.left_volume == pytest.approx(0.06 * 0.04 * 0.0004, rel=1e-3)
    assert left.gouge_depth == 0


@pytest.mark.parametrize(("radius", "offset"), [(8.5e-3, 1e-3), (6e-3, 1e-3), (8e-3, 2.3e-3)])
@pytest.mark.parametrize("step", [0.5e-3, 3.7e-3])
def test_slot_end_crossing_the_outline_at_a_small_angle_ends_the_arc(radius: float, offset: float, step: float) -> None:
    """The round end of the previous slot and the cutter are two circles of equal radius, ``offset`` apart."""
    stock = build_height_map(build_block((-0.03, -0.02, 0), (0.03, 0.02, 0.02)), UP)
    remove(stock, build_line((-0.012, 0.0, 0.01), (0.02, 0.0, 0.01)), radius)
    path = build_line((0.015, offset, 0.01), (-0.012, offset, 0.01), step)
    _, point, rows = remove(stock, path, radius)
    mine = rows[point == len(path) - 1]
    crossing = degrees(acos(0.5 * offset / radius))  # angle from the left of the travel direction
    assert len(mine) == 1
    assert mine[0, 2] == pytest.approx(crossing, abs=2 * ANGLE)
    assert mine[0, 3] == pytest.approx(180.0, abs=ANGLE)


@pytest.mark.parametrize("ahead", [2.5e-3, 3.8e-3, 5e-3])
def test_cusp_against_a_wall_tangent_to_the_cutter_is_in_contact(ahead: float) -> None:
    """The cutter moves along its own wall towards an area that it cut before: a cusp remains next to the wall."""
    stock = build_height_map(build_block((-0.03, -0.03, 0), (0.03, 0.03, 0.02)), UP)
    radius = 8.5e-3
    remove(stock, build_line((0.02, -0.01, 0.01), (0.0, -0.01, 0.01)), radius)
    path = build_line((0.0, 0.02, 0.01), (0.0, ahead - 0.01, 0.01), 4e-3)
    _, point, rows = remove(stock, path, radius)
    mine = rows[point == len(path) - 1]
    begin = 90.0 + degrees(acos(0.5 * ahead / radius))  # both circles and the wall enclose the cusp
    assert mine[-1, 2] == pytest.approx(begin, abs=2 * ANGLE)
    assert mine[-1, 3] == pytest.approx(180.0, abs=ANGLE)


def test_volume_below_the_end_face_equals_a_disc_segment() -> None:
    """The end face of a cutter descends over the side of a block, at random distances."""
    stock, radius, depth = build_height_map(build_block((0, 0, 0), (0.06, 0.04, 0.02)), UP), 5e-3, 1e-3
    rng, off = np.random.default_rng(3), []
    for d in rng.uniform(-0.95, 0.95, 200):
        start = np.array([0.03 + rng.uniform(-1e-3, 1e-3), d * radius, 0.02])
        found = measure_map_end(stock.grid, stock.origin, stock.cell, start, start - [0.0, 0.0, depth], radius)
        off.append(found / (depth * radius**2) / pi - 1.0 + (acos(d) - d * sqrt(1.0 - d * d)) / pi)
    assert np.std(off) < 0.01
    assert np.abs(off).max() < 0.04
