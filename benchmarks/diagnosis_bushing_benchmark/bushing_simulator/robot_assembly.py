"""The chain of bodies of one robot, with the compliance of links, base and tool."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bushing_simulator.bushing_bodies import Body, MultibodyChain, Strut
from bushing_simulator.equilibrium import Arm
from bushing_simulator.gear_laws import GearLaw
from bushing_simulator.robot_descriptions import RobotDescription
from bushing_simulator.rotations import compute_rotation, compute_rpy_rotation

RIGID = np.diag([2e11] * 3 + [2e11] * 3)  # N/m, N·m/rad: 10 nm under 2 kN
MODULUS, SHEAR = 1.1e11, 4.4e10  # Pa, cast iron


@dataclass
class HiddenPhysics:
    """True values and everything that the cell does not state."""

    springs: np.ndarray  # (6,) N·m/rad
    masses: np.ndarray  # (6,) kg
    tool_mass: float
    tool_center: np.ndarray  # (3,) m, in the flange
    laws: list[GearLaw] = field(default_factory=list)
    link_softness: dict[int, float] = field(default_factory=dict)  # link 1…6 → scale of its compliance
    base_softness: float = 0.0
    base_crack: float = 0.0  # share of the bolts' stiffness lost in tension
    tool_softness: float = 0.0
    taper_gap: float = 0.0  # m, loose tool taper: radial gap
    compensator: float = 0.0  # scale of a spring cylinder at joint 2
    marker_shift: dict[int, np.ndarray] = field(default_factory=dict)  # joint 1…6 → (6,) m, rad: as-built geometry
    hose: float = 0.0  # N/m, a hose from the ceiling to link 4
    growth: dict[int, np.ndarray] = field(default_factory=dict)


def _build_base_stiffness(softness: float) -> np.ndarray:
    """Return the 6×6 of a pedestal on four bolts at ±a, ±b: tilting about x is softer than about y."""
    if softness <= 0:
        return RIGID
    bolt, shear, a, b = 4e8 / softness, 3e8 / softness, 0.36, 0.2
    vertical, turn = 4 * bolt, 4 * shear * (a**2 + b**2)
    return np.diag([4 * shear, 4 * shear, vertical, 4 * bolt * b**2, 4 * bolt * a**2, turn])


def _build_crack_law(softness: float, crack: float):
    """Return wrench and tangent of four bolts whose seat opens in tension (rounded over 0.5 µm)."""
    bolt, shear = 4e8 / softness, 3e8 / softness
    corners = np.array([[sx * 0.36, sy * 0.2] for sx in (-1, 1) for sy in (-1, 1)])
    rows = np.stack([np.array([0, 0, 1, y, -x, 0.0]) for x, y in corners])
    side = np.diag([4 * shear, 4 * shear, 0, 0, 0, 4 * shear * (0.36**2 + 0.2**2)])

    def law(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lift = xi @ rows.T
        opened = 0.5 * (1.0 + lift / np.sqrt(lift**2 + (5e-7) ** 2))
        force = bolt * lift * (1.0 - crack * opened)
        slope = bolt * (1.0 - crack * opened)
        K = side + np.einsum("nb,bi,bj->nij", slope, rows, rows)
        return xi @ side + force @ rows, K

    return law


def _build_taper_law(gap: float):
    """Return wrench and tangent of a loose taper: soft in tilt until the gap closes, then hard."""
    seat = np.diag([3e9, 3e9, 3e9, 0, 0, 3e7])
    soft, hard = 2.0e5, 2.0e7  # N·m/rad

    def law(xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        tilt = xi[:, 3:5]
        size = np.linalg.norm(tilt, axis=1) + 1e-12
        closed = np.logaddexp(0, (size - gap / 0.1) / (0.1 * gap / 0.1)) * (0.1 * gap / 0.1)
        moment = soft * size + hard * closed
        grade = soft + hard / (1 + np.exp(-(size - gap / 0.1) / (0.1 * gap / 0.1)))
        F, K = xi @ seat, np.broadcast_to(seat, (len(xi), 6, 6)).copy()
        n = tilt / size[:, None]
        F[:, 3:5] += moment[:, None] * n
        across = (moment / size)[:, None, None] * (np.eye(2) - n[:, :, None] * n[:, None, :])
        K[:, 3:5, 3:5] += grade[:, None, None] * n[:, :, None] * n[:, None, :] + across
        return F, K

    return law


def _list_link_segments(robot: RobotDescription, link: int, softness: float, mass: float) -> list[Body]:
    """Return three bodies of a soft link: a tapered hollow box in four pieces, beam stiffness between them."""
    end = robot.origins[link] if link < 6 else robot.flange
    length = float(np.linalg.norm(end))
    along = end / max(length, 1e-9) if length > 1e-3 else np.array([1.0, 0, 0])
    length = max(length, 0.12)
    size = 0.16 * length**0.5 * robot.springs[1] ** 0.25 / 38.0  # m, half width, larger for stronger robots
    # Frame of the segments: x along the link.
    other = np.array([0.0, 1.0, 0.0]) if abs(along[1]) < 0.9 else np.array([0, 0, 1.0])
    z = np.cross(along, other)
    z /= np.linalg.norm(z)
    frame = np.stack([along, np.cross(z, along), z], axis=1)
    pieces, count = [], 3
    for piece in range(count):
        wide, high = size * (1.0 - 0.12 * piece), size * (1.25 - 0.2 * piece)
        wall, part = 0.1 * size, length / count * softness
        area = 4 * (wide + high) * wall
        bend_y = 4 * wall * high**2 * (wide + high / 3)
        bend_z = 4 * wall * wide**2 * (high + wide / 3)
        twist = 16 * (wide * high) ** 2 * wall / (wide + high)
        K = (
            np.diag(
                [
                    MODULUS * area,
                    0.4 * SHEAR * area,
                    0.4 * SHEAR * area,
                    SHEAR * twist,
                    MODULUS * bend_y,
                    MODULUS * bend_z,
                ]
            )
            / part
        )
        rotate = np.kron(np.eye(2), frame)
        K = rotate @ K @ rotate.T
        step = end / count
        pieces.append(
            Body(f"link_{link}_{piece}", step * (0.5 if piece == 0 else 1.0), np.eye(3), K, mass / 4, step * 0.3)
        )
    return pieces


def assemble_arm(robot: RobotDescription, hidden: HiddenPhysics) -> Arm:
    """Return the arm of a robot with its hidden physics."""
    if hidden.base_crack > 0:
        base_law, base_stiffness = _build_crack_law(hidden.base_softness, hidden.base_crack), RIGID
    else:
        base_law, base_stiffness = None, _build_base_stiffness(hidden.base_softness)
    bodies = [Body("pedestal", np.zeros(3), np.eye(3), base_stiffness, 60.0, np.array([0, 0, 0.2]), law=base_law)]
    joint_bodies: list[int] = []
    offset = robot.origins[0]
    for joint in range(6):
        shift = hidden.marker_shift.get(joint + 1, np.zeros(6))
        K = RIGID.copy()
        outer = robot.axes[joint]
        K[3:, 3:] += (hidden.springs[joint] - 2e11) * np.outer(outer, outer)
        soft = hidden.link_softness.get(joint + 1, 0.0)
        mass = hidden.masses[joint]
        bodies.append(
            Body(
                f"link_{joint + 1}",
                offset + shift[:3],
                compute_rotation(shift[3:]),
                K,
                mass / 4 if soft else mass,
                robot.centers[joint] * (0.6 if soft else 1.0),
                robot.axes[joint],
                joint,
            )
        )
        joint_bodies.append(len(bodies) - 1)
        offset = robot.origins[joint + 1] if joint < 5 else robot.flange
        if soft:
            pieces = _list_link_segments(robot, joint + 1, soft, mass)
            bodies += pieces
            offset = offset - sum(p.marker_position for p in pieces)
    bodies.append(_build_tool(robot, hidden, offset))
    struts = _list_struts(robot, hidden, joint_bodies)
    tool_rotation = compute_rpy_rotation(robot.tcp_rpy)
    return Arm(MultibodyChain(bodies, struts), hidden.laws, joint_bodies, len(bodies) - 1, robot.tcp, tool_rotation)


def _build_tool(robot: RobotDescription, hidden: HiddenPhysics, offset: np.ndarray) -> Body:
    stiffness, law = RIGID, None
    if hidden.tool_softness > 0:  # flange plate and slender shank: soft across, soft in tilt
        stiffness = np.diag([6e8, 6e8, 2e9, 9e6, 6e6, 1.1e7]) / hidden.tool_softness * (robot.springs[5] / 1.5e5)
    if hidden.taper_gap > 0:
        law = _build_taper_law(hidden.taper_gap)
    return Body("tool", offset, robot.flange_rotation, stiffness, hidden.tool_mass, hidden.tool_center, law=law)


def _list_struts(robot: RobotDescription, hidden: HiddenPhysics, joint_bodies: list[int]) -> list[Strut]:
    struts = []
    if hidden.compensator > 0:
        # cylinder from the carousel to the arm: behind joint 2, and 0.22 m up the arm
        reach = robot.origins[2] / np.linalg.norm(robot.origins[2])
        preload = 1.2e4 * min(hidden.compensator, 2.0)  # N: a stiffer cylinder has no larger preload
        foot = robot.origins[1] + np.array([-0.34, 0.0, -0.14])
        struts.append(
            Strut(joint_bodies[0], foot, joint_bodies[1], 0.24 * reach, preload, 9e4 * hidden.compensator, 0.3)
        )
    if hidden.hose > 0:
        struts.append(
            Strut(
                -1,
                np.array([0.3, 0.5, 2.9]),
                joint_bodies[3],
                np.array([0.1, 0, 0.1]),
                0.25 * hidden.hose,
                hidden.hose,
                0.6,
            )
        )
    return struts
