"""Writes a cell's URDF, meshes, cell.yaml and stiffness.yaml. The output is deterministic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from making.arms import Arm
from making.cellfiles import CellFiles, as_list

ACCELERATION_TIME = 0.35  # s from standstill to the velocity limit; our assumption for all joints
JERK_TIME = 0.14  # s from zero to full acceleration; our assumption
LINKS = ("base_link", "link_1", "link_2", "link_3", "link_4", "link_5", "link_6")


def write_urdf(folder: Path, arm: Arm, name: str) -> None:
    lines = ['<?xml version="1.0"?>', f'<robot name="{name}">', "  <!-- made by cells/make_cells.py -->"]
    for i, (link, mesh, mass) in enumerate(zip(LINKS, arm.meshes, arm.masses, strict=True)):
        uniform = mesh.copy()
        uniform.density = mass / uniform.volume
        com, inertia = uniform.center_mass, uniform.moment_inertia
        geometry = f'<geometry><mesh filename="meshes/link{i}.stl"/></geometry>'
        lines += [
            f'  <link name="{link}">',
            f'    <inertial><origin xyz="{com[0]:.4f} {com[1]:.4f} {com[2]:.4f}" rpy="0 0 0"/><mass value="{mass:g}"/>',
            "      <inertia "
            + " ".join(
                f'{k}="{inertia[a, b]:.5g}"'
                for k, a, b in (
                    ("ixx", 0, 0),
                    ("ixy", 0, 1),
                    ("ixz", 0, 2),
                    ("iyy", 1, 1),
                    ("iyz", 1, 2),
                    ("izz", 2, 2),
                )
            )
            + "/></inertial>",
            f"    <visual>{geometry}</visual>",
            f"    <collision>{geometry}</collision>",
            "  </link>",
        ]
    lines += ['  <link name="flange"/>']
    for i, j in enumerate(arm.joints):
        low, high, speed = (f"{np.radians(v):.10f}" for v in (*j.limits_deg, j.velocity_deg_s))
        lines += [
            f'  <joint name="a{i + 1}" type="revolute">',
            f'    <parent link="{LINKS[i]}"/><child link="{LINKS[i + 1]}"/>',
            f'    <origin xyz="{" ".join(f"{v:.6g}" for v in j.origin)}" rpy="0 0 0"/>',
            f'    <axis xyz="{" ".join(str(v) for v in j.axis)}"/>',
            f'    <limit lower="{low}" upper="{high}" velocity="{speed}" effort="0"/>',
            "  </joint>",
        ]
    lines += [
        '  <joint name="flange_fixed" type="fixed">',
        '    <parent link="link_6"/><child link="flange"/>',
        f'    <origin xyz="{" ".join(f"{v:g}" for v in arm.flange_xyz)}" rpy="{" ".join(arm.flange_rpy)}"/>',
        "  </joint>",
        "</robot>",
        "",
    ]
    (folder / "robot.urdf").write_text("\n".join(lines), encoding="utf-8")


def write_cell(cell: CellFiles, cells: Path) -> None:
    """A cell into its folder among ``cells``."""
    folder = cells / cell.folder
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    named = {f"link{i}": m for i, m in enumerate(cell.arm.meshes)}
    for name, mesh in {**named, "tool": cell.tool_mesh, "workpiece": cell.workpiece_mesh}.items():
        (folder / "meshes" / f"{name}.stl").write_bytes(trimesh.exchange.stl.export_stl(mesh))
    write_urdf(folder, cell.arm, cell.folder)
    speed = np.array([j.velocity_deg_s for j in cell.arm.joints])
    rows = {
        "velocity_deg_s": speed,
        "acceleration_deg_s2": speed / ACCELERATION_TIME,
        "jerk_deg_s3": speed / ACCELERATION_TIME / JERK_TIME,
    }
    limits = "\n".join(f"    {k}: [{', '.join(f'{v:.4g}' for v in row)}]" for k, row in rows.items())
    tool_head, _, tool_rest = cell.tool.partition("  cutter:")
    obstacles = "\n".join(f"  - {o}" for o in cell.obstacles)
    text = f"""\
# made by cells/make_cells.py; sources of the numbers: README.md
machopt_cell: 1
name: {cell.title}
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  pose: {{xyz_mm: {as_list(cell.base_mm)}, rpy_deg: [0, 0, 0]}}
  arm_joints: [a1, a2, a3, a4, a5, a6]
  external_joints: []
  home_deg: {as_list(cell.home_deg)}
  limits:
{limits}
tool:
{tool_head.rstrip()}
  geometry: [{{name: tool, mesh: meshes/tool.stl}}]
{"  cutter:" + tool_rest if tool_rest else "  # no cutter"}
workpiece:
  link: world
  pose: {{xyz_mm: {as_list(cell.workpiece_mm)}, rpy_deg: {as_list(cell.workpiece_rpy)}}}
  geometry: [{{name: workpiece, mesh: meshes/workpiece.stl}}]
obstacles:
{obstacles}
stiffness: stiffness.yaml
controller:
{cell.controller}
"""
    if cell.accuracy:
        text = text.replace("stiffness: stiffness.yaml\n", f"stiffness: stiffness.yaml\naccuracy: {cell.accuracy}\n")
    if cell.force:
        text += f"plan:\n  force_N: {cell.force}  # an assumption: README.md\n"
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    *source, values = cell.stiffness
    head = "".join(f"# {line}\n" for line in source)
    (folder / "stiffness.yaml").write_text(
        f"{head}machopt_stiffness: 1\njoints_Nm_per_rad: {values}\n{cell.spread}", encoding="utf-8"
    )
    for name, content in cell.extra.items():
        (folder / name).write_text(content, encoding="utf-8")
