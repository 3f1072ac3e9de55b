"""Write the cell folder of a robot: URDF with nominal masses, cell.yaml, stiffness.yaml."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bushing_simulator.robot_descriptions import RobotDescription


def write_cell(robot: RobotDescription, folder: Path, compensator: str) -> None:
    """Write the nominal robot: what the diagnosis is allowed to know."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(build_urdf(robot))
    limits = np.array([100, 90, 90, 150, 120, 190])

    def join(values: np.ndarray) -> str:
        return "[" + ", ".join(f"{v:.6g}" for v in values) + "]"

    home = np.clip(np.zeros(6), robot.limits_deg[:, 0] + 5, robot.limits_deg[:, 1] - 5)
    home[4] = 30.0
    lines = [
        "machopt_cell: 1",
        f"name: {robot.name} of the bushing benchmark",
        "robot:",
        "  urdf: robot.urdf",
        "  base_link: base_link",
        "  flange_link: flange",
        "  arm_joints: [a1, a2, a3, a4, a5, a6]",
        f"  home_deg: {join(home)}",
        f"  gravity_compensator: {compensator}",
        f"  rated_payload_kg: {robot.payload:.6g}",
        f"  limits: {{velocity_deg_s: {join(limits)}, acceleration_deg_s2: {join(3 * limits)}, "
        f"jerk_deg_s3: {join(20 * limits)}}}",
        "tool:",
        f"  tcp: {{xyz_mm: {join(1e3 * robot.tcp)}, rpy_deg: {join(np.rad2deg(robot.tcp_rpy))}}}",
        f"  mass_kg: {robot.tool_mass:.6g}",
        f"  com_mm: {join(1e3 * robot.tool_center)}",
        "  cutter: {diameter_mm: 10, length_mm: 40}",
        "workpiece: {link: world, pose: {xyz_mm: [1500, 0, 800], rpy_deg: [0, 0, 0]}}",
        "stiffness: stiffness.yaml",
    ]
    (folder / "cell.yaml").write_text("\n".join(lines) + "\n")
    (folder / "stiffness.yaml").write_text(
        f"machopt_stiffness: 1\njoints_Nm_per_rad: {join(robot.springs)}\nspread_percent: 20\nsource: nominal springs\n"
    )


def build_urdf(robot: RobotDescription) -> str:
    """Return the URDF text: six revolute joints, point-like inertias, no meshes."""

    def join(values: np.ndarray) -> str:
        return " ".join(f"{v:.9g}" for v in values)

    text = [f'<?xml version="1.0"?>\n<robot name="{robot.name}">', '  <link name="base_link"/>']
    for i in range(6):
        m, c = robot.masses[i], robot.centers[i]
        size = 0.02 * m
        text.append(
            f'  <link name="link_{i + 1}"><inertial><origin xyz="{join(c)}" rpy="0 0 0"/><mass value="{m:.9g}"/>'
            f'<inertia ixx="{size:.6g}" ixy="0" ixz="0" iyy="{size:.6g}" iyz="0" izz="{size:.6g}"/></inertial></link>'
        )
        low, high = np.deg2rad(robot.limits_deg[i])
        parent = "base_link" if i == 0 else f"link_{i}"
        text.append(
            f'  <joint name="a{i + 1}" type="revolute"><parent link="{parent}"/><child link="link_{i + 1}"/>'
            f'<origin xyz="{join(robot.origins[i])}" rpy="0 0 0"/><axis xyz="{join(robot.axes[i])}"/>'
            f'<limit lower="{low:.9g}" upper="{high:.9g}" effort="20000" velocity="2"/></joint>'
        )
    turn = 0.5 * np.pi * robot.flange_sign
    text.append('  <link name="flange"/>')
    text.append(
        f'  <joint name="a6_flange" type="fixed"><parent link="link_6"/><child link="flange"/>'
        f'<origin xyz="{join(robot.flange)}" rpy="0 {turn:.12g} 0"/></joint>\n</robot>\n'
    )
    return "\n".join(text)
