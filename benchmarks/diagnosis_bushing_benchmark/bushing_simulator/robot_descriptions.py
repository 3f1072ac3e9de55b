"""Nominal robots.

The kinematics are those of public ROS-Industrial packages (KR 120 R2500, IRB 6640-185/2.8, M-710iC/50). Masses,
springs and tools
are plausible values of this benchmark, drawn from no data sheet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bushing_simulator.rotations import compute_rpy_rotation


@dataclass(frozen=True)
class RobotDescription:
    """Nominal robot: what the cell states."""

    name: str
    origins: np.ndarray  # (6, 3) m, each joint in the previous link
    axes: np.ndarray  # (6, 3)
    flange: np.ndarray  # (3,) m, in link 6; the flange z is link x at home
    flange_sign: float  # +1: flange z along link x, −1: against it
    limits_deg: np.ndarray  # (6, 2)
    masses: np.ndarray  # (6,) kg
    centers: np.ndarray  # (6, 3) m
    springs: np.ndarray  # (6,) N·m/rad, true values
    pull: float  # N, largest test load
    payload: float  # kg, rated
    tool_mass: float  # kg
    tool_center: np.ndarray  # (3,) m, in the flange
    tcp: np.ndarray  # (3,) m, in the flange
    tcp_rpy: np.ndarray  # (3,) rad

    @property
    def flange_rotation(self) -> np.ndarray:
        """Return flange axes in link 6 (3, 3)."""
        return compute_rpy_rotation(np.array([0.0, 0.5 * np.pi * self.flange_sign, 0.0]))


def _describe(name: str, origins: list, signs: list[int], **rest: object) -> RobotDescription:
    axes = (
        np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float) * np.array(signs)[:, None]
    )
    arrays = {k: np.array(v, float) if isinstance(v, list) else v for k, v in rest.items()}
    return RobotDescription(name, np.array(origins, float), axes, **arrays)


ROBOTS = {
    "kr120": _describe(
        "kr120",
        [[0, 0, 0.675], [0.35, 0, 0], [1.15, 0, 0], [1.0, 0, -0.041], [0, 0, 0], [0, 0, 0]],
        [-1, 1, 1, -1, 1, -1],
        flange=[0.215, 0, 0],
        flange_sign=1.0,
        limits_deg=[[-180, 180], [-140, -5], [-110, 150], [-350, 350], [-120, 120], [-350, 350]],
        masses=[270, 195, 150, 85, 42, 14],
        centers=[
            [0.12, 0.02, -0.1],
            [0.52, 0.05, 0.0],
            [0.25, -0.03, 0.02],
            [-0.35, 0, 0.01],
            [0.03, 0, 0],
            [0.14, 0, 0],
        ],
        springs=[1.55e6, 2.3e6, 1.2e6, 3.1e5, 2.2e5, 1.5e5],
        pull=1300.0,
        payload=120.0,
        tool_mass=62.0,
        tool_center=[0.03, 0.0, 0.16],
        tcp=[0.14, 0.02, 0.39],
        tcp_rpy=[0.0, 0.6, 0.0],
    ),
    "irb6640": _describe(
        "irb6640",
        [[0, 0, 0.78], [0.32, 0, 0], [0, 0, 1.075], [0, 0, 0.2], [1.392, 0, 0], [0.2, 0, 0]],
        [1, 1, 1, 1, 1, 1],
        flange=[0, 0, 0],
        flange_sign=1.0,
        limits_deg=[[-170, 170], [-60, 80], [-170, 68], [-290, 290], [-115, 115], [-340, 340]],
        masses=[330, 225, 180, 120, 48, 12],
        centers=[
            [0.1, -0.03, -0.12],
            [0.02, 0.04, 0.48],
            [0.05, 0.0, 0.12],
            [0.6, 0.0, 0.0],
            [0.06, 0.0, 0.0],
            [-0.03, 0, 0],
        ],
        springs=[2.4e6, 2.9e6, 1.9e6, 5.6e5, 4.1e5, 2.6e5],
        pull=1900.0,
        payload=185.0,
        tool_mass=95.0,
        tool_center=[0.0, 0.02, 0.2],
        tcp=[0.21, 0.0, 0.44],
        tcp_rpy=[0.0, 0.7854, 0.0],
    ),
    "m710": _describe(
        "m710",
        [[0, 0, 0.565], [0.15, 0, 0], [0, 0, 0.87], [0, 0, 0.17], [1.016, 0, 0], [0.175, 0, 0]],
        [1, 1, -1, -1, -1, -1],
        flange=[0, 0, 0],
        flange_sign=1.0,
        limits_deg=[[-175, 175], [-80, 110], [-80, 150], [-300, 300], [-120, 120], [-350, 350]],
        masses=[150, 90, 75, 48, 20, 6],
        centers=[[0.05, 0.02, -0.08], [0.01, 0.06, 0.4], [0.02, 0, 0.09], [0.45, 0.01, 0], [0.05, 0, 0], [-0.02, 0, 0]],
        springs=[6.1e5, 8.4e5, 4.6e5, 9.5e4, 8.0e4, 5.2e4],
        pull=480.0,
        payload=50.0,
        tool_mass=27.0,
        tool_center=[0.01, 0.0, 0.13],
        tcp=[0.12, 0.01, 0.3],
        tcp_rpy=[0.0, 0.5, 0.0],
    ),
}
