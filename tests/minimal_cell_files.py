"""Minimal cell files that are read in milliseconds, for tests of refusals."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from machopt.cell.cell_reader import load_cell
from machopt.errors import InputError

CELL = """\
machopt_cell: 1
name: test cell
robot:
  urdf: robot.urdf
  base_link: base
  flange_link: flange
  home_deg: [0, -90, 90, 0, 10, 0]
  limits:
    velocity_deg_s: [100, 100, 100, 200, 200, 300]
    acceleration_deg_s2: [300, 300, 300, 600, 600, 900]
    jerk_deg_s3: [3000, 3000, 3000, 6000, 6000, 9000]
tool:
  tcp: {xyz_mm: [0, 0, 300], rpy_deg: [0, 90, 0]}
  mass_kg: 45
  com_mm: [0, 0, 150]
  geometry: [{name: spindle, mesh: spindle.stl}]
  cutter: {diameter_mm: 10, length_mm: 40}
workpiece:
  pose: {xyz_mm: [1500, 0, 800], rpy_deg: [0, 0, 90]}
  geometry: [{name: plate, box_mm: [400, 300, 50]}]
obstacles:
  - {name: post, cylinder_mm: [50, 1000], xyz_mm: [500, 900, 500]}
stiffness: stiffness.yaml
"""
STIFFNESS = "machopt_stiffness: 1\njoints_Nm_per_rad: [1.41e6, 4.01e5, 9.35e5, 3.60e5, 3.70e5, 380e3]\n"


def urdf() -> str:
    """Return a URDF with one element per line: link k starts in line 2 + 8 (k - 1), joint k in line 50 + 7 (k - 1)."""
    lines = ['<robot name="r">']
    for k in range(1, 7):
        lines += [
            f'<link name="l{k}">',
            '<inertial><origin xyz="0 0 0.1"/>',
            '<mass value="190"/>',
            '<inertia ixx="2" ixy="0" ixz="0" iyy="2" iyz="0" izz="1"/></inertial>',
            '<collision><origin xyz="0 0 0.15" rpy="0 0 0"/>',
            '<geometry><mesh filename="link.stl"/></geometry></collision>'
            if k == 6
            else '<geometry><box size="0.2 0.2 0.3"/></geometry></collision>',
            '<visual><geometry><mesh filename="picture.dae"/></geometry></visual>',
            "</link>",
        ]
    for k in range(1, 7):
        lines += [
            f'<joint name="a{k}" type="revolute">',
            f'<parent link="{"base" if k == 1 else f"l{k - 1}"}"/>',
            f'<child link="l{k}"/>',
            '<origin xyz="0 0 0.3" rpy="0 0 0"/>',
            f'<axis xyz="{"0 0 1" if k in (1, 4, 6) else "0 1 0"}"/>',
            '<limit lower="-3" upper="3" velocity="9" effort="100"/>',
            "</joint>",
        ]
    lines += [
        '<link name="base"/>',
        '<link name="flange"/>',
        '<joint name="f" type="fixed"><parent link="l6"/><child link="flange"/></joint>',
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def write_minimal_cell(root: Path) -> Path:
    root.mkdir(exist_ok=True)
    (root / "cell.yaml").write_text(CELL)
    (root / "stiffness.yaml").write_text(STIFFNESS)
    (root / "robot.urdf").write_text(urdf())
    for name in ("spindle.stl", "link.stl"):
        trimesh.creation.box((0.1, 0.1, 0.2)).export(root / name)
    return root


def replace_in_file(folder: Path, old: str, new: str, file: str = "cell.yaml", count: int = -1) -> int:
    """Replace text in a file and return the line (1-based) of the first change."""
    text = (folder / file).read_text()
    assert old in text, old
    (folder / file).write_text(text.replace(old, new, count))
    return text[: text.index(old)].count("\n") + 1


def read_refusal_message(folder: Path, *parts: str) -> str:
    """Return the message with which the cell is refused; it must contain every part."""
    with pytest.raises(InputError) as caught:
        load_cell(folder)
    message = str(caught.value)
    for part in parts:
        assert part in message, f"{part!r} is not in: {message}"
    return message
