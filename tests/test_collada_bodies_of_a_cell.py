"""COLLADA files in cell.yaml: unit and up axis of the file apply in planner and verifier."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_cell import urdf_text
from test_collada_variants import CUBE, cube, node

from machopt.cell.cell_reader import load_cell
from machopt.cell_setup.template.init_request import InitRequest
from machopt.collision.bodies import triangulate_shape
from machopt.commands.init import run_init
from machopt.data_types.cell import CollisionShape
from machopt.errors import InputError
from machopt.verification.motion.collision.original_meshes import load_mesh

UP = {
    "X_UP": lambda p: np.stack([-p[:, 1], -p[:, 2], p[:, 0]], axis=1),
    "Y_UP": lambda p: np.stack([p[:, 0], -p[:, 2], p[:, 1]], axis=1),
    "Z_UP": lambda p: p,
}
UNITS = {"m": ("meter", 1.0), "mm": ("millimeter", 0.001), "inch": ("inch", 0.0254), "dm": ("dm", 0.1)}


def write_cell(
    folder: Path, text: str, line: str = "{mesh: part.dae, xyz_mm: [2000, 0, 0], rpy_deg: [0, 0, 0]}"
) -> Path:
    robot = folder / "robot.urdf"
    robot.write_text(urdf_text())
    run_init(InitRequest(robot=robot, out=folder / "cell", workpiece_mm=(1500.0, 0.0, 600.0)))
    (folder / "cell" / "part.dae").write_text(text)
    file = folder / "cell" / "cell.yaml"
    retained = [row for row in file.read_text().splitlines() if not row.startswith("obstacles:")]
    file.write_text("\n".join([*retained, f"obstacles: [{line}]", ""]))
    return file.parent


def compute_corners(shape: CollisionShape) -> tuple[np.ndarray, np.ndarray]:
    """Return the sorted corners in the parent frame as read by the planner and by the verifier."""
    T = shape.T_parent_shape
    mine, _ = triangulate_shape(shape)
    other = np.array(load_mesh(Path(str(shape.mesh)), np.full(3, shape.size[0])).vertices())
    return tuple(np.unique(np.round(p @ T[:3, :3].T + T[:3, 3], 6), axis=0) for p in (mine, other))  # type: ignore[return-value]


@pytest.mark.parametrize("up", sorted(UP))
@pytest.mark.parametrize("unit", sorted(UNITS))
def test_unit_and_up_axis_of_the_file_apply(unit: str, up: str, tmp_path: Path) -> None:
    name, metre = UNITS[unit]
    size = 0.5 / metre  # half a metre in file units
    head = f'<unit name="{name}" meter="{metre}"/><up_axis>{up}</up_axis>'
    moves = f"<translate>{size} {2 * size} {3 * size}</translate><scale>{size} {size} {size}</scale>"
    cell = load_cell(write_cell(tmp_path, cube(asset=head, nodes=node(moves))))
    expected = np.add(UP[up](0.5 * np.add(CUBE, (1, 2, 3))), (2.0, 0, 0))
    for found in compute_corners(cell.obstacles[0]):
        assert np.allclose(found, np.unique(np.round(expected, 6), axis=0), atol=2e-6)


def test_scale_multiplies_the_unit_of_the_file(tmp_path: Path) -> None:
    line = "{mesh: part.dae, scale: 0.5, xyz_mm: [2000, 0, 0], rpy_deg: [0, 0, 0]}"
    cell = load_cell(write_cell(tmp_path, cube(asset="<up_axis>Z_UP</up_axis>"), line))
    for found in compute_corners(cell.obstacles[0]):
        assert np.allclose(np.ptp(found, axis=0), 0.5)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("</COLLADA>", ""),
        ('count="12"', 'count="13"'),
        ("<p>0 1 3", "<p>0 1 99"),
        ('url="#g"', 'url="#h"'),
        ('meter="1"', 'meter="1e9"'),
    ],
)
def test_damaged_file_is_refused_with_its_key(old: str, new: str, tmp_path: Path) -> None:
    text = cube(asset='<unit name="m" meter="1"/>')
    assert old in text
    folder = write_cell(tmp_path, text.replace(old, new))
    with pytest.raises(InputError, match=r"obstacles\[0\].*part\.dae"):
        load_cell(folder)


def test_init_accepts_collada_for_tool_and_workpiece(tmp_path: Path) -> None:
    robot, part = tmp_path / "robot.urdf", tmp_path / "part.dae"
    robot.write_text(urdf_text())
    part.write_text(cube(asset='<unit name="dm" meter="0.1"/>'))
    place = (1500.0, 0.0, 600.0)
    done = run_init(InitRequest(robot=robot, out=tmp_path / "cell", workpiece_mm=place, workpiece_mesh=part))
    for found in compute_corners(done.cell.workpiece.geometry[0]):
        assert np.allclose(np.ptp(found, axis=0), 0.1)
    with pytest.raises(InputError, match="--mesh-unit"):
        run_init(InitRequest(robot=robot, out=tmp_path / "b", workpiece_mm=place, workpiece_mesh=part, mesh_unit="mm"))
