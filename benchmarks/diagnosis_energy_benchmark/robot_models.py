"""Robots of the foreign lab: dimensions of known arms, every copy a little different, and the cell of one.

Dimensions: the shipped cells' URDFs and, marked *, descriptions by others (KUKA KR210 L150 and KR500 R2800-2 of
kroshu/kuka_robot_descriptions and ROS-Industrial, FANUC M-20iA and Staeubli RX160 of ROS-Industrial). m, kg, N·m/rad.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import dual_quaternions as dq
import numpy as np
from dual_quaternions import Array

P = np.pi
# joint origins x y z roll pitch yaw in the link before | axes | flange | home deg | masses | stiffness
CATALOGUE: dict[
    str, tuple[list[list[float]], list[list[float]], list[float], list[float], list[float], list[float]]
] = {
    "kr240": (
        [[0, 0, 0.3], [0.35, 0, 0.45], [1.25, 0, 0], [0.396, 0, -0.055], [0.704, 0, 0], [0.17, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]],
        [0.06, 0, 0, 0, P / 2, 0],
        [0, -100, 110, 0, 60, 0],
        [320, 230, 215, 95, 60, 20],
        [1.41e6, 4.01e5, 9.35e5, 3.6e5, 3.7e5, 3.8e5],
    ),
    "irb6700": (
        [[0, 0, 0.312], [0.32, 0, 0.468], [0, 0, 1.125], [0.5013, 0, 0.2], [0.8912, 0, 0], [0.14, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]],
        [0.06, 0, 0, 0, P / 2, 0],
        [0, -5, 15, 0, 45, 0],
        [330, 210, 190, 90, 45, 12],
        [2.61e6, 9.37e5, 6.58e5, 4.2e5, 1.4e5, 9.4e4],
    ),
    "kr500": (
        [[0, 0, 0.418], [0.5, 0, 0.627], [1.3, 0, 0], [0.369, 0, 0.055], [0.656, 0, 0], [0.23, 0, 0]],
        [[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]],
        [0.06, 0, 0, 0, P / 2, 0],
        [0, -75, 105, 0, -40, 20],
        [690, 430, 330, 140, 85, 25],
        [1.58e7, 6.12e6, 5.28e6, 9.7e5, 6.2e5, 5.5e5],
    ),
    "s420f": (
        [[0, 0, 0.36], [0.27, 0, 0.54], [0, 0, 0.9], [0.468, 0, 0.27], [0.832, 0, 0], [0.2, 0, 0]],
        [[0, 0, 1], [0, -1, 0], [0, -1, 0], [1, 0, 0], [0, -1, 0], [1, 0, 0]],
        [0.06, 0, 0, 0, P / 2, 0],
        [0, 10, -10, 0, -50, 0],
        [380, 240, 260, 110, 60, 15],
        [2.52e6, 2.53e6, 9.42e5, 3.6e5, 3.7e5, 3.8e5],
    ),
    "cobot": (
        [[0, 0, 0.05], [0, 0, 0.096], [0.418, 0, 0], [0.398, 0, 0], [0, 0.114, 0], [0, 0, -0.098]],
        [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0, -1], [0, -1, 0]],
        [0, -0.089, 0, P / 2, 0, 0],
        [0, -80, 85, 10, -80, 60],
        [4.8, 6.2, 3.6, 1.6, 1.6, 0.5],
        [3.68e4, 3.56e4, 2.57e4, 1.25e4, 9.55e3, 8.36e3],
    ),
    "kr210l150*": (
        [
            [0, 0, 0.331],
            [0.353, -0.0375, 0.419],
            [0, -0.1475, 1.25],
            [0.958, 0.184, -0.055],
            [0.542, 0, 0],
            [0.1925, 0, 0],
        ],
        [[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]],
        [0.0375, 0, 0, 0, P / 2, 0],
        [0, -10, 0, 0, 50, 0],
        [400, 300, 230, 100, 50, 10],
        [2.9e6, 2.1e6, 1.7e6, 3.1e5, 2.9e5, 2.2e5],
    ),
    "kr500r2800*": (
        [
            [0, 0, 0.3646, P, 0, 0],
            [0.5, 0.0755, -0.4354, P / 2, 0, 0],
            [1.25, 0, -0.1173],
            [0.7217, -0.15, 0.1928, P / 2, 0, -P / 2],
            [0, 0.1193, -0.3178, 0, P / 2, P / 2],
            [0.2052, 0, -0.1193, P / 2, 0, -P / 2],
        ],
        [[0, 0, 1]] * 6,
        [0, 0, -0.0808, P, 0, P],
        [0, -70, 80, 0, 50, 0],
        [587, 318, 288, 92, 47, 23],
        [5.2e6, 3.6e6, 2.4e6, 8.1e5, 6.2e5, 4.5e5],
    ),
    "m20ia*": (
        [[0, 0, 0.525], [0.15, 0, 0], [0, 0, 0.79], [0, 0, 0.25], [0.835, 0, 0], [0.1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, -1, 0], [-1, 0, 0]],
        [0.02, 0, 0, P, -P / 2, 0],
        [0, 10, -15, 0, -55, 0],
        [70, 45, 40, 20, 8, 3],
        [4.2e5, 3.6e5, 2.1e5, 5.5e4, 4.1e4, 2.6e4],
    ),
    "rx160*": (
        [[0, 0, 0.55], [0.15, 0, 0], [0, 0, 0.825], [0, 0, 0], [0, 0, 0.625], [0, 0, 0.11]],
        [[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]],
        [0, 0, 0.01, 0, 0, 0],
        [0, 20, 60, 0, 50, 0],
        [45, 51, 30, 15, 6, 2],
        [5.1e5, 4.1e5, 2.6e5, 6.1e4, 4.5e4, 3.1e4],
    ),
}
SPREAD = [70.0, 22.0, 28.0, 100.0, 40.0, 120.0]  # deg each side of home that a lab's poses fill


@dataclass(frozen=True)
class Robot:
    """An arm with its tool. Frames as in a URDF; masses of links 1-6; ``stiffness`` in N·m/rad."""

    name: str
    origins: Array  # (6, 6) xyz m, rpy rad of joint i in the link before
    axes: Array  # (6, 3) unit, in link i
    flange: Array  # (6,) in link 6
    tcp: Array  # (6,) in flange
    home: Array  # (6,) rad
    masses: Array  # (6,) kg
    centres: Array  # (6, 3) m, link i
    inertias: Array  # (6, 3, 3) kg·m² about the centre, link axes
    tool_mass: float  # kg
    tool_centre: Array  # (3,) m in flange
    stiffness: Array  # (6,)

    def ends(self) -> Array:
        """(6, 6) what follows link i: origin of the next joint, last the flange."""
        return np.vstack([self.origins[1:], self.flange[None]])

    def reach(self) -> float:
        """m, stretched."""
        return float(np.sum(np.linalg.norm(self.ends()[1:, :3], axis=1)))


def draw(name: str, rng: np.random.Generator) -> Robot:
    """A copy of an arm of the catalogue with lengths within 10 %, masses within 15 % and a tool of its own."""
    origins, axes, flange, home, masses, stiffness = CATALOGUE[name]
    placed = np.zeros((6, 6))
    for i, row in enumerate(origins):
        placed[i, : len(row)] = row
    placed[:, :3] *= rng.uniform(0.9, 1.1, (6, 1))
    placed[:, :3] = np.round(placed[:, :3], 4)
    end = np.array(flange, dtype=float)
    reach = float(np.sum(np.linalg.norm(placed[2:, :3], axis=1)))
    tool = np.zeros(6)
    tool[:3] = np.round(reach * np.array([rng.uniform(0.0, 0.1), rng.uniform(-0.03, 0.03), rng.uniform(0.08, 0.2)]), 4)
    tool[3:] = np.round(np.radians(rng.choice([0.0, 30.0, 45.0, -90.0])) * np.array([0, 1, 0]), 9)
    weight = np.round(np.array(masses) * rng.uniform(0.85, 1.15, 6), 1)
    nexts = np.vstack([placed[1:, :3], end[None, :3]])
    centres = np.round(nexts * rng.uniform(0.3, 0.55, (6, 1)) + rng.normal(0, 0.01, (6, 3)), 4)
    inertias = np.zeros((6, 3, 3))
    for i in range(6):
        long = float(np.linalg.norm(nexts[i])) + 0.12
        along = nexts[i] / max(float(np.linalg.norm(nexts[i])), 1e-9)
        thick = weight[i] * (0.18 * long) ** 2
        inertias[i] = np.eye(3) * (thick + weight[i] * long**2 / 12) - np.outer(along, along) * weight[i] * long**2 / 12
    return Robot(
        name=name.rstrip("*"),
        origins=placed,
        axes=np.array(axes, dtype=float),
        flange=end,
        tcp=tool,
        home=np.radians(home),
        masses=weight,
        centres=centres,
        inertias=np.round(inertias, 6),
        tool_mass=round(float(0.12 * np.sum(weight[2:]) * rng.uniform(0.5, 1.3)), 1),
        tool_centre=np.round(tool[:3] * 0.45 + rng.normal(0, 0.01, 3), 4),
        stiffness=np.array(stiffness) * np.round(rng.uniform(0.8, 1.3, 6), 3),
    )


def as_built(robot: Robot, rng: np.random.Generator, mass_spread: float = 0.0) -> Robot:
    """The same arm as it stands: springs off by a third. Nothing else: whatever else is off is a concealed effect.

    ``mass_spread`` is 1 sigma of the links' masses about those that the cell states.
    """
    built = replace(robot, stiffness=robot.stiffness * np.exp(rng.normal(0, 0.22, 6)))
    return replace(built, masses=robot.masses * rng.normal(1.0, mass_spread, 6)) if mass_spread else built


def _xyz(values: Array, scale: float = 1.0) -> str:
    return " ".join(f"{v * scale:.10g}" for v in values)


def urdf(robot: Robot) -> str:
    """Bodies without meshes: nothing here collides."""
    out = ["<?xml version='1.0'?>", f"<robot name='{robot.name}'>", "<link name='base_link'/>"]
    for i in range(6):
        I = robot.inertias[i]  # noqa: E741 - the inertia's own letter
        out += [
            f"<link name='l{i + 1}'><inertial><origin xyz='{_xyz(robot.centres[i])}' rpy='0 0 0'/>",
            f"<mass value='{robot.masses[i]}'/><inertia ixx='{I[0, 0]}' ixy='{I[0, 1]}' ixz='{I[0, 2]}'",
            f" iyy='{I[1, 1]}' iyz='{I[1, 2]}' izz='{I[2, 2]}'/></inertial></link>",
            f"<joint name='j{i + 1}' type='revolute'><parent link='{f'l{i}' if i else 'base_link'}'/>",
            f"<child link='l{i + 1}'/><origin xyz='{_xyz(robot.origins[i, :3])}' rpy='{_xyz(robot.origins[i, 3:])}'/>",
            f"<axis xyz='{_xyz(robot.axes[i])}'/>",
            "<limit lower='-6.1' upper='6.1' velocity='2.5' effort='0'/></joint>",
        ]
    out += [
        "<link name='flange'/><joint name='mount' type='fixed'><parent link='l6'/><child link='flange'/>",
        f"<origin xyz='{_xyz(robot.flange[:3])}' rpy='{_xyz(robot.flange[3:])}'/></joint>",
        "</robot>",
    ]
    return "\n".join(out) + "\n"


def _list(values: Array, digits: int = 6) -> str:
    return "[" + ", ".join(f"{v:.{digits}g}" for v in np.asarray(values).ravel()) + "]"


def write_cell(robot: Robot, folder: Path) -> None:
    """The nominal cell, all that a diagnosis may know of the robot."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(urdf(robot), encoding="utf-8")
    (folder / "stiffness.yaml").write_text(
        f"machopt_stiffness: 1\njoints_Nm_per_rad: {_list(robot.stiffness, 5)}\n", encoding="utf-8"
    )
    tcp = f"{{xyz_mm: {_list(robot.tcp[:3] * 1e3)}, rpy_deg: {_list(np.degrees(robot.tcp[3:]))}}}"
    (folder / "cell.yaml").write_text(
        f"""machopt_cell: 1
name: {robot.name}
robot:
  urdf: robot.urdf
  base_link: base_link
  flange_link: flange
  arm_joints: [j1, j2, j3, j4, j5, j6]
  external_joints: []
  home_deg: {_list(np.degrees(robot.home))}
  limits:
    velocity_deg_s: [100, 100, 100, 140, 140, 140]
    acceleration_deg_s2: [300, 300, 300, 400, 400, 400]
    jerk_deg_s3: [2000, 2000, 2000, 3000, 3000, 3000]
tool:
  tcp: {tcp}
  mass_kg: {robot.tool_mass}
  com_mm: {_list(robot.tool_centre * 1e3)}
workpiece:
  link: world
  pose: {{xyz_mm: [1500, 0, 500], rpy_deg: [0, 0, 0]}}
stiffness: stiffness.yaml
""",
        encoding="utf-8",
    )


def frames_of(robot: Robot) -> tuple[list[Array], Array, Array]:
    """Dual quaternions of the fixed parts: six joint origins, the flange, the tool."""

    def one(row: Array) -> Array:
        return dq.of(dq.fixed_axes(*row[3:]), row[:3])

    return [one(r) for r in robot.origins], one(robot.flange), one(robot.tcp)
