"""Small cells with external axes: the arm of :mod:`small_cell` on a rail, with a turntable, or both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from small_cell import pose, small_cell, urdf_text

from machopt.data_types.cell import Cell, CollisionShape, JointLimits

_LIMIT = '<limit lower="{}" upper="{}" velocity="3" effort="1"/>'
RAIL = (
    '<link name="hall"/><link name="carriage"><collision><origin xyz="0 0 -0.1"/><geometry><box size="0.7 0.7 0.15"/>'
    '</geometry></collision></link><joint name="rail" type="prismatic"><parent link="hall"/><child link="carriage"/>'
    '<origin xyz="0.1 0 -0.2"/><axis xyz="0 1 0"/>'
    + _LIMIT.format(-2.5, 2.5)
    + '</joint><joint name="stand" type="fixed"><parent link="carriage"/><child link="base_link"/>'
    '<origin xyz="-0.1 0 0.2"/></joint>'
)
TABLE = (
    '<link name="plate"><collision><origin xyz="0 0 -0.06"/><geometry><cylinder radius="0.5" length="0.1"/></geometry>'
    '</collision></link><joint name="turn" type="revolute"><parent link="{}"/><child link="plate"/>'
    '<origin xyz="1.6 0 0.5"/><axis xyz="0 0 1"/>' + _LIMIT.format(-3.2, 3.2) + "</joint>"
)
TILT = (
    '<link name="cradle"/><joint name="tilt" type="revolute"><parent link="{}"/><child link="cradle"/>'
    '<origin xyz="0.2 0.1 0.05" rpy="0.1 0 0"/><axis xyz="0 1 0"/>' + _LIMIT.format(-1.0, 1.0) + "</joint>"
)


def external_cell(folder: Path, *, rail: bool = False, table: bool = False, tilt: bool = False) -> Cell:
    """Build a cell whose rail moves the arm along y (±2.5 m), and whose table rotates the part about z and, with
    ``tilt``, first about y.

    The order of the external axes is rail, tilt, turn. Without a table the block is 2.4 m long (y).
    """
    cell = small_cell(folder)
    root = "hall" if rail else "base_link"
    text = RAIL if rail else ""
    names: list[str] = ["rail"] if rail else []
    if tilt:
        text += TILT.format(root)
        names.append("tilt")
    if table:
        text += TABLE.format("cradle" if tilt else root)
        names.append("turn")
    cell.urdf.write_text(urdf_text().replace("</robot>", text + "</robot>"))
    slides = tuple(name == "rail" for name in names)
    own = cell.limits
    low, high = ([{"rail": b, "turn": c, "tilt": d}[n] for n in names] for b, c, d in ((-2.5, -3.2, -1), (2.5, 3.2, 1)))

    def more(values: np.ndarray, linear: float, angular: float) -> np.ndarray:
        return np.r_[values, [linear if s else angular for s in slides]]

    limits = JointLimits(
        np.r_[own.lower, low],
        np.r_[own.upper, high],
        more(own.velocity, 1.0, 1.5),
        more(own.acceleration, 2.0, 3.0),
        more(own.jerk, 15.0, 20.0),
    )
    part = cell.workpiece
    if table:
        block = (
            CollisionShape(name="block", kind="box", size=(0.4, 0.5, 0.1), mesh=None, T_parent_shape=pose(0, 0, -0.05)),
        )
        part = replace(part, link="plate", T_link_workpiece=pose(0.05, 0, 0.11), geometry=block)
    else:
        block = (
            CollisionShape(name="block", kind="box", size=(0.4, 2.4, 0.1), mesh=None, T_parent_shape=pose(0, 0, -0.05)),
        )
        part = replace(part, geometry=block)
    return replace(
        cell,
        external_joints=tuple(names),
        external_prismatic=slides,
        external_home=np.zeros(len(names)),
        limits=limits,
        workpiece=part,
        obstacles=(),
    )


def external_folder(folder: Path, *, rail: bool = False, table: bool = False, tilt: bool = False) -> Path:
    """Write the same as a cell folder with a stiffness file."""
    cell = external_cell(folder, rail=rail, table=table, tilt=tilt)
    per = np.where([False] * 6 + list(cell.external_prismatic), 1e3, 180 / np.pi)

    def row(values: np.ndarray) -> str:
        return "[" + ", ".join(f"{v:.6g}" for v in np.asarray(values) * per) + "]"

    def at(T: np.ndarray) -> str:
        return f"xyz_mm: [{', '.join(f'{1e3 * v:.6g}' for v in T[:3, 3])}]"

    block = cell.workpiece.geometry[0]
    (folder / "cell.yaml").write_text(
        f"""machopt_cell: 1
name: small cell with external axes
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  external_joints: [{", ".join(cell.external_joints)}]
  home_deg: {row(np.r_[cell.home, cell.external_home])}
  limits:
    velocity_deg_s: {row(cell.limits.velocity)}
    acceleration_deg_s2: {row(cell.limits.acceleration)}
    jerk_deg_s3: {row(cell.limits.jerk)}
tool:
  tcp: {{xyz_mm: [0, 0, 350]}}
  mass_kg: 20
  geometry: [{{name: spindle, box_mm: [120, 120, 280], xyz_mm: [0, 0, 140]}}]
  cutter: {{diameter_mm: 12, length_mm: 60}}
workpiece:
  link: {cell.workpiece.link}
  pose: {{{at(cell.workpiece.T_link_workpiece)}}}
  geometry: [{{name: block, box_mm: [{", ".join(f"{1e3 * v:g}" for v in block.size)}], {at(block.T_parent_shape)}}}]
stiffness: stiffness.yaml
plan: {{rotation_step_deg: 15, force_N: {{axial: 200, normal: 100}}}}
"""
    )
    (folder / "stiffness.yaml").write_text(
        "machopt_stiffness: 1\njoints_Nm_per_rad: [1.41e6, 1.2e6, 9.35e5, 3.60e5, 3.70e5, 3.8e5]\n"
    )
    return folder
