"""COLLADA files in the URDF of a handwritten cell, read by planner and verifier.

The unit of the file applies. Its up axis does not: as in RViz and MoveIt, coordinates are those of the link frame.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from test_collada_bodies_of_a_cell import UNITS, UP, write_cell
from test_collada_variants import CUBE, cube, node

from machopt.cell.cell_reader import load_cell
from machopt.collision.bodies import triangulate_shape
from machopt.errors import InputError
from machopt.kinematics.urdf_loading import load_chain
from machopt.verification.motion.collision.bodies import build_bodies
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

COLLISION = '<collision><origin xyz="0.1 0 0.2"/><geometry><mesh filename="part.dae"{scale}/></geometry></collision>'


def write_robot_mesh(folder: Path, text: str, scale: str = "") -> Path:
    """Write a cell in which a COLLADA mesh replaces the collision body of the second link."""
    cell = write_cell(folder, text, "{name: box, box_mm: [10, 10, 10], xyz_mm: [2500, 0, 0]}")
    robot = cell / "robot.urdf"
    urdf = robot.read_text()
    name = re.findall(r'<link name="([^"]+)"', urdf)[2]
    start = urdf.index(f'<link name="{name}"')
    end = urdf.index("</link>", start)
    body = re.sub(r"<collision>.*?</collision>", "", urdf[start:end], flags=re.DOTALL)
    robot.write_text(urdf[:start] + body + COLLISION.format(scale=scale) + urdf[end:])
    return cell


def list_corners(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners (m) of the body in the frame of its collision element, as read by planner and verifier."""
    cell = load_cell(folder)
    mine = next(body.shape for body in load_chain(cell)[1] if str(body.shape.mesh).endswith("part.dae"))
    assert Path(str(mine.mesh)) in cell.files
    other = next(b for b in build_bodies(cell, UrdfKinematics(cell)) if b.name == mine.name)
    found = triangulate_shape(mine)[0], np.array(other.shape.vertices())
    return tuple(np.unique(np.round(p, 6), axis=0) for p in found)  # type: ignore[return-value]


@pytest.mark.parametrize("up", sorted(UP))
@pytest.mark.parametrize("unit", sorted(UNITS))
def test_unit_applies_and_up_axis_does_not(unit: str, up: str, tmp_path: Path) -> None:
    name, metre = UNITS[unit]
    size = 0.1 / metre  # 0.1 m in file units
    head = f'<unit name="{name}" meter="{metre}"/><up_axis>{up}</up_axis>'
    moves = f"<translate>{size} {2 * size} {3 * size}</translate><scale>{size} {size} {size}</scale>"
    folder = write_robot_mesh(tmp_path, cube(asset=head, nodes=node(moves)))
    expected = np.unique(np.round(0.1 * np.add(CUBE, (1, 2, 3)), 6), axis=0)
    for found in list_corners(folder):
        np.testing.assert_allclose(found, expected, atol=2e-6)
    assert any(up in text for text in load_cell(folder).warnings) == (up != "Z_UP")


def test_urdf_scale_multiplies_the_unit(tmp_path: Path) -> None:
    text = cube(asset='<unit name="dm" meter="0.1"/><up_axis>Z_UP</up_axis>')
    for found in list_corners(write_robot_mesh(tmp_path, text, ' scale="2 2 2"')):
        np.testing.assert_allclose(np.ptp(found, axis=0), 0.2, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new"),
    [("</COLLADA>", ""), ('count="12"', 'count="13"'), ("<p>0 1 3", "<p>0 1 99"), ('url="#g"', 'url="#h"')],
)
def test_damaged_file_is_refused_with_the_line_of_the_urdf(old: str, new: str, tmp_path: Path) -> None:
    text = cube(asset='<unit name="dm" meter="0.1"/><up_axis>Z_UP</up_axis>')
    assert old in text
    with pytest.raises(InputError) as caught:
        load_cell(write_robot_mesh(tmp_path, text.replace(old, new, 1)))
    assert "robot.urdf: line " in str(caught.value)
    assert "part.dae" in str(caught.value)
