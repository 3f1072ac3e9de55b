"""Shipped cells have the published geometry and stiffness; shipped toolpaths are on their workpieces."""

from __future__ import annotations

import csv
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh

from machopt.cell.cell_reader import load_cell
from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import Cell
from machopt.kinematics.inverse.solver import build_solver, list_whole_turns
from machopt.kinematics.robot import Robot
from machopt.kinematics.urdf_loading import load_chain
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, invert_transform
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = Path(__file__).resolve().parent.parent
CELLS = ("cutting_cobot", "irb6700_drilling", "kr240_drilling", "kr500_milling", "s420f_handling")
EXTERNAL = ("kr240_turntable", "kr500_rail")

# jiao2022, Table 2: configurations in degrees and rotation about the tool axis
TAGS = {
    1: (
        [19.552, -29.545, 83.973, 106.112, -101.226, 146.022],
        -90.0,
        [-0.123, -41.278, 127.122, -20.175, -86.098, 181.432],
        20.0,
    ),
    2: (
        [11.229, -31.906, 90.659, 99.633, -95.797, 149.242],
        -90.0,
        [1.800, -41.276, 127.102, 21.852, -86.125, 178.448],
        -20.0,
    ),
}


def cell_of(name: str) -> Cell:
    return load_cell(ROOT / "cells" / name)


def script(path: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # required by dataclasses, which look up their module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kr500() -> tuple[Cell, Robot]:
    cell = cell_of("kr500_milling")
    return cell, load_chain(cell)[0]


# --- every cell --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CELLS)
def test_cell_loads_with_seven_link_meshes_and_no_warning(name: str) -> None:
    cell = cell_of(name)
    robot, shapes = load_chain(cell)
    assert cell.warnings == ()
    assert [s.link for s in shapes] == list(range(7))
    assert cell.stiffness is not None
    assert ((cell.home > robot.lower) & (cell.home < robot.upper)).all()


@pytest.mark.parametrize("name", CELLS)
def test_no_contact_at_home_without_exclusions(name: str) -> None:
    cell = cell_of(name)
    robot, shapes = load_chain(cell)
    model = CollisionModel(cell, robot, shapes, clearance=0.002)
    assert model.suspicious == ()
    assert model.excluded == ()


@pytest.mark.parametrize("name", CELLS)
def test_meshes_are_closed_bodies_with_outward_normals(name: str) -> None:
    for path in sorted((ROOT / "cells" / name / "meshes").glob("*.stl")):
        mesh = trimesh.load(path)
        for body in mesh.split(only_watertight=False):
            assert body.is_watertight, path
            assert body.is_winding_consistent, path
            assert body.volume > 0, path


@pytest.mark.parametrize("name", CELLS)
def test_holder_ends_above_the_cutter(name: str) -> None:
    cell = cell_of(name)
    stand_off = 0.02 if cell.tool.cutter is None else cell.tool.cutter.length
    for shape in cell.tool.geometry:
        assert shape.mesh is not None
        vertices = trimesh.load(shape.mesh).vertices @ shape.T_parent_shape[:3, :3].T + shape.T_parent_shape[:3, 3]
        z_tcp = (vertices - cell.tool.T_flange_tcp[:3, 3]) @ cell.tool.T_flange_tcp[:3, 2]
        assert z_tcp.max() < -stand_off + 1e-6


def test_generator_makes_the_committed_files(tmp_path: Path) -> None:
    make = script("cells/make_cells.py")
    for build in make.CELLS.values():
        make.write_cell(build(), tmp_path)
    made = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    on_disk = (p for n in CELLS for p in (ROOT / "cells" / n).rglob("*") if p.is_file() and p.suffix != ".md")
    retained = sorted(p.relative_to(ROOT / "cells") for p in on_disk if "recordings" not in p.parts)
    assert made == retained
    for path in made:
        if path.suffix == ".stl":
            a, b = (trimesh.load(base / path, process=False) for base in (tmp_path, ROOT / "cells"))
            np.testing.assert_allclose(a.vertices, b.vertices, atol=1e-6)  # single precision in the file
        elif path.suffix != ".urdf":  # its inertias may differ in the last digit between numpy versions
            assert (tmp_path / path).read_text(encoding="utf-8") == (ROOT / "cells" / path).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", EXTERNAL)
def test_cells_with_external_axes(name: str, tmp_path: Path) -> None:
    """The generator makes the committed files; there is no contact at home."""
    more = script("cells/make_external_cells.py")
    more.write(more.CELLS[name](), tmp_path)
    made = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    on_disk = (p for p in (ROOT / "cells" / name).rglob("*") if p.is_file() and p.suffix != ".md")
    assert made == sorted(p.relative_to(ROOT / "cells") for p in on_disk)
    for path in made:
        if path.suffix == ".yaml":
            assert (tmp_path / path).read_text(encoding="utf-8") == (ROOT / "cells" / path).read_text(encoding="utf-8")
    cell = cell_of(name)
    assert cell.warnings == ()
    robot, shapes = load_chain(cell)
    assert CollisionModel(cell, robot, shapes, clearance=0.002).suspicious == ()


# --- kr500_milling: Table 2 of jiao2022 --------------------------------------------------------------------


@pytest.mark.parametrize("tag", TAGS)
def test_table_2_pair_is_one_tcp_rotated_by_the_stated_angle(kr500: tuple[Cell, Robot], tag: int) -> None:
    cell, robot = kr500
    before, gamma_before, after, gamma_after = TAGS[tag]
    A, B = (robot.compute_fk(np.radians(q), cell.tool.T_flange_tcp) for q in (before, after))
    assert np.linalg.norm(A[:3, 3] - B[:3, 3]) < 0.1e-3
    turn = A[:3, :3].T @ B[:3, :3]  # in the TCP frame: a rotation about its z axis
    angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    assert angle == pytest.approx(gamma_after - gamma_before, abs=0.01)
    assert turn[2, 2] == pytest.approx(1.0, abs=1e-9)


def test_table_2_alone_determines_the_tool_and_the_elbow_offset(kr500: tuple[Cell, Robot]) -> None:
    """Least squares over both pairs for the TCP perpendicular to the tool axis;
    −55 mm at the elbow does not fit them."""
    cell, robot = kr500

    def solve(lift: float) -> tuple[np.ndarray, float]:
        point = robot.point.copy()
        point[3:] += [0.0, 0.0, lift]  # axes 4 to 6 (forearm forward at zero) and the flange
        flange = robot.T_base_flange_zero.copy()
        flange[2, 3] += lift
        arm = Robot(
            joints=robot.joints,
            axis=robot.axis,
            point=point,
            T_base_flange_zero=flange,
            lower=robot.lower,
            upper=robot.upper,
        )
        rows, right = [], []
        for before, _, after, _ in TAGS.values():
            A, B = arm.compute_fk(np.radians(before)), arm.compute_fk(np.radians(after))
            rows.append((A - B)[:3, 1:3])  # flange y and z; x is the tool axis, unobservable
            right.append((B - A)[:3, 3])
        M, b = np.vstack(rows), np.concatenate(right)
        x, *_ = np.linalg.lstsq(M, b, rcond=None)
        return x, float(np.abs(M @ x - b).max())

    tcp, residual = solve(0.0)
    np.testing.assert_allclose(tcp, cell.tool.T_flange_tcp[1:3, 3], atol=0.05e-3)
    assert residual < 0.05e-3
    assert solve(-0.110)[1] > 10e-3


def test_tags_lie_on_the_deck_normal_to_the_tool(kr500: tuple[Cell, Robot]) -> None:
    cell, robot = kr500
    for before, _, after, _ in TAGS.values():
        for q in (before, after):
            T = (
                invert_transform(cell.workpiece.T_link_workpiece)
                @ cell.T_world_base
                @ robot.compute_fk(np.radians(q), cell.tool.T_flange_tcp)
            )
            assert abs(T[2, 3]) < 0.1e-3  # m: on the deck
            assert abs(T[1, 3]) < 0.5e-3  # on the centre line of the deck
            assert abs(T[0, 3]) < 0.2
            np.testing.assert_allclose(T[:3, 2], [0, 0, -1], atol=2e-5)


@pytest.mark.parametrize("tag", TAGS)
def test_gamma_equals_the_published_rotation_between_the_tags(kr500: tuple[Cell, Robot], tag: int) -> None:
    cell, robot = kr500
    travel = np.array([0.0, 1.0, 0.0])  # Tag 1 to Tag 2, base_link
    before, gamma_before, after, gamma_after = TAGS[tag]
    for q, gamma in ((before, gamma_before), (after, gamma_after)):
        T = robot.compute_fk(np.radians(q), cell.tool.T_flange_tcp)
        np.testing.assert_allclose(T[:3, :3], compute_tool_rotation(-T[:3, 2], travel, np.radians(gamma)), atol=1e-4)


def test_table_2_configurations_are_within_limits_and_contact_free(kr500: tuple[Cell, Robot]) -> None:
    cell, robot = kr500
    q = np.radians([row for before, _, after, _ in TAGS.values() for row in (before, after)])
    assert ((q > robot.lower) & (q < robot.upper)).all()
    model = CollisionModel(cell, robot, load_chain(cell)[1], clearance=0.002)
    assert not model.check_configurations(q, np.ones(len(q), bool)).any


def test_two_cell_stiffness_has_the_published_values_around_the_deck(tmp_path: Path) -> None:
    source = ROOT / "cells" / "kr500_milling"
    for path in source.rglob("*"):
        if path.is_file():
            (tmp_path / path.relative_to(source)).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path.relative_to(source)).write_bytes(path.read_bytes())
    text = (tmp_path / "cell.yaml").read_text(encoding="utf-8")
    (tmp_path / "cell.yaml").write_text(
        text.replace("stiffness: stiffness.yaml", "stiffness: stiffness_two_grid.yaml"), encoding="utf-8"
    )
    cell = load_cell(tmp_path)
    assert cell.stiffness is not None
    np.testing.assert_array_equal(cell.stiffness.joints, [1.58e7, 6.12e6, 5.28e6, 4.66e5, 2.19e5, 3.49e5])  # eq. 38
    grid = cell.stiffness.grid
    assert grid is not None
    np.testing.assert_array_equal(
        grid.joints,
        [
            [1.48e7, 5.57e6, 6.80e6, 3.38e5, 1.20e5, 2.17e5],  # eq. 39
            [1.50e7, 6.29e6, 4.56e6, 2.79e5, 3.28e5, 1.61e5],
        ],
    )
    T_base_workpiece = invert_transform(cell.T_world_base) @ cell.workpiece.T_link_workpiece
    corners = np.array([[x, y, z, 1.0] for x in (-0.23, 0.23) for y in (-0.095, 0.095) for z in (-0.13, 0.0)])
    inside = (corners @ T_base_workpiece.T)[:, :3]
    assert (inside > grid.origin).all()
    assert (inside < grid.origin + grid.cell * np.array(grid.shape)).all()


# --- the other arms compared with their source tables ------------------------------------------------------


def dh(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    """Standard Denavit-Hartenberg: Rz(θ) Tz(d) Tx(a) Rx(α)."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def modified_dh(theta: float, d: float, a: float, alpha: float) -> np.ndarray:
    """Modified Denavit-Hartenberg: Rx(α) Tx(a) Rz(θ) Tz(d), with a and α of the preceding link."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]])


def samples(robot: Robot) -> np.ndarray:
    return np.random.default_rng(7).uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (20, 6))


def test_kr240_matches_dumas_table_3() -> None:
    """Modified DH with d2 350, d3 1250, d4 −55, RL4 −1100, RL6 −230; axes measured from base height 750 mm."""
    robot = load_chain(cell_of("kr240_drilling"))[0]
    quarter = np.pi / 2
    for q in samples(robot):
        t = np.array([-q[0], -q[1], -q[2] + quarter, q[3], -q[4], q[5]])
        rows = [
            (0, 0, 0, 0),
            (0.350, quarter, 0, 0),
            (1.250, 0, 0, 0),
            (-0.055, -quarter, -1.100, 0),
            (0, quarter, 0, 0),
            (0, -quarter, -0.230, 0),
        ]
        T = np.eye(4)
        for (a, alpha, d, _), theta in zip(rows, t, strict=True):
            T = T @ modified_dh(theta, d, a, alpha)
        np.testing.assert_allclose(robot.compute_fk(q)[:3, 3], T[:3, 3] + [0, 0, 0.750], atol=1e-9)


def test_irb6700_matches_zhang_table_1() -> None:
    robot = load_chain(cell_of("irb6700_drilling"))[0]
    quarter = np.pi / 2
    for q in samples(robot):
        t = np.array([q[0], q[1] - quarter, q[2], q[3], q[4], q[5] + np.pi])
        T = np.eye(4)
        for theta, d, a, alpha in zip(
            t,
            (0.780, 0, 0, 1.3925, 0, 0.200),
            (0, 0.320, 1.125, 0.200, 0, 0),
            (0, -quarter, 0, -quarter, quarter, -quarter),
            strict=True,
        ):
            T = T @ modified_dh(theta, d, a, alpha)
        np.testing.assert_allclose(robot.compute_fk(q)[:3, 3], T[:3, 3], atol=1e-9)


def test_s420f_matches_gora_trela_table_1() -> None:
    cell = cell_of("s420f_handling")
    robot = load_chain(cell)[0]
    quarter = np.pi / 2
    for q in samples(robot):
        T = np.eye(4)
        for theta, d, a, alpha in zip(
            np.add(q, [0, quarter, 0, 0, 0, 0]),
            (0, 0, 0, 1.300, 0, 0.260),
            (0.270, 0.900, 0.270, 0, 0, 0),
            (quarter, 0, quarter, -quarter, quarter, 0),
            strict=True,
        ):
            T = T @ dh(theta, d, a, alpha)
        np.testing.assert_allclose(robot.compute_fk(q)[:3, 3], T[:3, 3] + [0, 0, 0.900], atol=1e-9)
    # the measured compliance 0.0059 mm/N at the paper's pose, from joints 2 and 3 alone; three digits are printed
    q = np.radians([-84.91, 65.00 - 90.0, -12.31, 0.00, 9.64, 0.00])
    J = robot.compute_fk_jacobian(q)[1]
    assert cell.stiffness is not None
    c33 = float(np.sum(J[2, :3] ** 2 / cell.stiffness.joints[:3]))
    assert c33 == pytest.approx(0.0059e-3, rel=0.01)


def test_cobot_matches_tian_table_5_and_points_down_in_table_1() -> None:
    robot = load_chain(cell_of("cutting_cobot"))[0]
    quarter = np.pi / 2
    for q in samples(robot):
        T = np.eye(4)
        for theta, d, a, alpha in zip(
            q,
            (0.096, 0, 0, 0.114, 0.098, 0.089),
            (0, 0.418, 0.398, 0, 0, 0),
            (-quarter, 0, 0, -quarter, -quarter, 0),
            strict=True,
        ):
            T = T @ dh(theta, d, a, alpha)
        F = robot.compute_fk(q)
        np.testing.assert_allclose(F[:3, 3], T[:3, 3], atol=1e-9)
        np.testing.assert_allclose(F[:3, 2], T[:3, 2], atol=1e-9)
    poses = [
        [-3.33, -102.37, 110.19, 260.95, 89.31, 221.98],
        [66.38, -93.95, 105.13, 258.52, 91.25, 286.33],
        [37.88, -82.08, 94.36, 255.22, 91.26, 259.74],
        [13.75, -77.53, 91.53, 252.95, 91.98, 234.03],
        [54.60, -79.96, 89.42, 259.31, 88.94, 272.86],
    ]
    F = robot.compute_fk(np.radians(poses))
    assert (F[:, 2, 2] < -0.99).all()
    assert (F[:, 2, 3] > 0.2).all()


# --- toolpaths ---------------------------------------------------------------------------------------------


def rows_of(name: str) -> list[dict[str, str]]:
    with (ROOT / "toolpaths" / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def tips_and_axes(name: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    rows = rows_of(name)
    return (
        np.array([[float(r[k]) for k in ("x_mm", "y_mm", "z_mm")] for r in rows]),
        np.array([[float(r[k]) for k in "ijk"] for r in rows]),
        [r["move"] for r in rows],
    )


def test_toolpath_generator_makes_the_committed_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = script("toolpaths/make_toolpaths.py")
    monkeypatch.setattr(make, "HERE", tmp_path)
    setups = script("toolpaths/make_setup_toolpaths.py")
    monkeypatch.setattr(setups, "HERE", tmp_path)
    # the second module writes through the first
    for module in (make, script("toolpaths/make_external_toolpaths.py"), setups):
        for name in vars(module):
            if name.startswith("write_"):
                getattr(module, name)()
    made = sorted(p.name for p in tmp_path.iterdir())
    assert made == sorted(
        p.name for p in (ROOT / "toolpaths").iterdir() if p.is_file() and p.suffix not in (".py", ".md")
    )
    for name in made:
        assert (tmp_path / name).read_bytes() == (ROOT / "toolpaths" / name).read_bytes(), name


def test_panel_holes_are_normal_to_the_panel_and_go_through() -> None:
    tip, axis, move = tips_and_axes("panel_holes.csv")
    centre = np.array([0.0, 0.0, -1500.0])
    radial = (tip - centre) * [1, 0, 1]
    height = np.linalg.norm(radial, axis=1) - 1500.0
    np.testing.assert_allclose(radial / np.linalg.norm(radial, axis=1)[:, None], axis, atol=1e-6)
    drilled = height < -4.0
    assert drilled.sum() == 120
    np.testing.assert_allclose(height[drilled], -7.0, atol=1e-3)
    assert all(height[k] > 1.9 for k, m in enumerate(move) if m == "rapid")
    assert all(height[k - 1] > 1.9 for k, m in enumerate(move) if m == "rapid" and k)
    assert (np.abs(tip[:, 0]) < 330).all()
    assert (np.abs(tip[:, 1]) < 500).all()


@pytest.mark.parametrize("name", ["contour_5axis.csv", "plain.csv"])
def test_milling_paths_stay_on_the_rim_of_the_head(name: str) -> None:
    tip, axis, move = tips_and_axes(name)
    cut = np.array([m == "cut" for m in move])
    x, y, z = np.abs(tip[cut]).T
    on_rim = (((x > 202) & (x < 230)) | ((y > 67) & (y < 95))) & (x < 230) & (y < 95)
    assert on_rim.all()
    assert z.max() < 2.0
    tilt = np.degrees(np.arccos(axis[:, 2]))
    assert tilt.max() < 20.0
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-6)


def test_contour_is_long_and_tilts_both_ways() -> None:
    tip, axis, _ = tips_and_axes("contour_5axis.csv")
    assert len(tip) > 2000
    assert np.degrees(np.arcsin(np.abs(axis[:, :2]).max(axis=0))).min() > 10.0
    feed = {float(r["feed_mm_min"]) for r in rows_of("contour_5axis.csv") if r["move"] == "cut"}
    assert max(feed) == 2000.0


@pytest.mark.parametrize(
    "path",
    sorted(p for p in (ROOT / "toolpaths").iterdir() if p.is_file() and p.suffix not in (".py", ".md")),
    ids=lambda p: p.name,
)
def test_every_toolpath_is_read_completely(path: Path) -> None:
    offsets = tuple(load_cell(ROOT / "cells" / "kr240_setups").offsets) if path.name == "two_plates.nc" else ()
    toolpath = read_toolpath(path, cell_offsets=offsets)
    assert toolpath.warnings == ()
    assert [w for w in toolpath.ignored if not w.understood] == []


@pytest.mark.parametrize(
    ("cam", "table"), [("panel_holes.aptsource", "panel_holes.csv"), ("contour_5axis.nc", "contour_5axis.csv")]
)
def test_cam_file_and_table_have_the_same_points(cam: str, table: str) -> None:
    a, b = read_toolpath(ROOT / "toolpaths" / cam), read_toolpath(ROOT / "toolpaths" / table)
    np.testing.assert_allclose(a.position, b.position, atol=1e-7)  # m; the table has four decimals of a mm
    np.testing.assert_allclose(a.axis, b.axis, atol=1e-6)
    np.testing.assert_array_equal(a.move, b.move)
    np.testing.assert_allclose(a.feed, b.feed, rtol=1e-12)


def test_head_face_arcs_go_round_the_corners() -> None:
    """The wrong side of an arc would deviate from the rim by two corner radii."""
    path = read_toolpath(ROOT / "toolpaths" / "cylinder_head_face.cls")
    rim = path.position[np.abs(path.position[:, 2] + 0.3e-3) < 1e-9]
    assert len(rim) > 100
    np.testing.assert_allclose(np.abs(rim[:, :2]).max(axis=0), [0.216, 0.081], atol=1e-6)
    middle = path.position[(path.operation == 0) & path.cutting & (np.abs(path.position[:, 1]) < 1e-6)]
    assert np.ptp(middle[:, 0]) > 0.36  # the pass along y = 0 contains both tags (335 mm apart)


REACH = [
    ("kr500_milling", "plain.csv", 9),
    ("kr500_milling", "contour_5axis.csv", 150),
    ("kr240_drilling", "panel_holes.csv", 17),
    ("irb6700_drilling", "plate_holes.csv", 11),
    ("s420f_handling", "castings.csv", 4),
    ("kr240_drilling", "contour_5axis.csv", 300),
]


@pytest.mark.parametrize(("name", "path", "every"), REACH)
def test_sampled_points_are_reachable_with_many_rotations(name: str, path: str, every: int) -> None:
    cell = cell_of(name)
    robot = load_chain(cell)[0]
    tip, axis, _ = (v[::every] for v in tips_and_axes(path))
    gamma = np.radians(np.arange(-180.0, 180.0, 20.0))
    T = build_transform(
        compute_tool_rotation(axis[:, None], np.array([1.0, 0.0, 0.0]), gamma),
        np.repeat(tip[:, None], len(gamma), 1) / 1e3,
    )
    T_base_flange = (
        invert_transform(cell.T_world_base)
        @ cell.workpiece.T_link_workpiece
        @ T
        @ invert_transform(cell.tool.T_flange_tcp)
    )
    q = build_solver(robot).solve(T_base_flange.reshape(-1, 4, 4)).q
    q = q[:, :, None] + list_whole_turns(cell.limits.lower, cell.limits.upper)
    fits = (
        ((q >= cell.limits.lower) & (q <= cell.limits.upper))
        .all(axis=-1)
        .any(axis=(1, 2))
        .reshape(len(tip), len(gamma))
    )
    assert fits.sum(axis=1).min() >= 10  # of 18
