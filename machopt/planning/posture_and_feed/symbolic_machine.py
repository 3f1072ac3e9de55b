"""Kinematics and compliance of the machine as CasADi expressions, from which exact derivatives follow.

The chain is that of :mod:`machopt.kinematics.machine`: a product of exponentials of the lines of all joints, relative
to the part. All results are in the workpiece frame. Rodrigues' formula and the geometric Jacobian: Lynch & Park, Modern
Robotics (2017), sections 3.2 and 5.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from machopt.kinematics.machine import Machine
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import invert_transform


@dataclass(frozen=True)
class SymbolicMachine:
    """Functions of the joints x (6 + E,) in rad or m, in the workpiece frame."""

    pose: ca.Function  # x → p (3,) m and R (3, 3) of the TCP
    jacobian: ca.Function  # x → (6, 6 + E), linear part first
    deflection: ca.Function  # x, 1/k (6,) rad/(N·m), wrench (6,) N and N·m, n (3,) → n·(displacement) in m
    count: int  # 6 + E

    def compute_deflections(self, x: Array, compliance: Array, wrench: Array, normal: Array) -> Array:
        """Return (M,) m, the displacement of the TCP along a direction under a load.

        Args:
            x: (M, 6 + E) rad or m, joints.
            compliance: (M, 6) rad/(N·m) of the arm's joints.
            wrench: (M, 6) N and N·m, in the workpiece frame.
            normal: (M, 3) unit, in the workpiece frame.
        """
        found = self.deflection.map(len(x))(ca.DM(x.T), ca.DM(compliance.T), ca.DM(wrench.T), ca.DM(normal.T))
        return np.asarray(found).ravel()


def build_symbolic_machine(machine: Machine, T_flange_tcp: Array) -> SymbolicMachine:
    """Return the functions of a machine.

    Args:
        machine: Lines of all joints in base_link.
        T_flange_tcp: (4, 4) TCP relative to the flange.
    """
    n = len(machine.axis)
    x = ca.SX.sym("x", n)
    lines, R, p = _build_line_frames(machine, x)
    zero = machine.robot.T_base_flange_zero @ T_flange_tcp
    back = invert_transform(machine.T_base_workpiece_zero)
    tip = R @ ca.DM(zero[:3, 3]) + p
    position = ca.DM(back[:3, :3]) @ tip + ca.DM(back[:3, 3])
    rotation = ca.DM(back[:3, :3]) @ R @ ca.DM(zero[:3, :3])
    columns = [ca.SX.zeros(6, 1) for _ in range(n)]
    for i, (direction, point) in enumerate(lines):
        linear = direction if machine.slides[i] else ca.cross(direction, tip - point)
        angular = ca.SX.zeros(3, 1) if machine.slides[i] else direction
        twist = ca.vertcat(ca.DM(back[:3, :3]) @ linear, ca.DM(back[:3, :3]) @ angular)
        columns[int(machine.column[i])] = float(machine.sign[i]) * twist
    jacobian = ca.horzcat(*columns)
    if machine.robot.coupling is not None:
        jacobian = ca.horzcat(jacobian[:, :6] @ ca.DM(machine.robot.coupling), jacobian[:, 6:])
    compliance, wrench, direction = ca.SX.sym("c", 6), ca.SX.sym("w", 6), ca.SX.sym("n", 3)
    arm = jacobian[:, :6]
    bent = compliance * (arm.T @ wrench)
    along = ca.dot(direction, arm[:3, :] @ bent)
    return SymbolicMachine(
        pose=ca.Function("pose", [x], [position, rotation]),
        jacobian=ca.Function("jacobian", [x], [jacobian]),
        deflection=ca.Function("deflection", [x, compliance, wrench, direction], [along]),
        count=n,
    )


def _build_line_frames(machine: Machine, x: ca.SX) -> tuple[list[tuple[ca.SX, ca.SX]], ca.SX, ca.SX]:
    """Return direction and a point of each line as moved by those before it, and the motion R, p of the last link."""
    coupling = machine.robot.coupling
    arm = x[:6] if coupling is None else ca.DM(coupling) @ x[:6]
    moved = ca.vertcat(arm, x[6:])
    R, p = ca.SX.eye(3), ca.SX.zeros(3, 1)
    lines = []
    for i in range(len(machine.axis)):
        axis, point = ca.DM(machine.axis[i]), ca.DM(machine.point[i])
        theta = float(machine.sign[i]) * moved[int(machine.column[i])]
        lines.append((R @ axis, R @ point + p))
        if machine.slides[i]:
            p = p + R @ axis * theta
            continue
        turn = _rotate_about(machine.axis[i], theta)
        p = p + R @ (point - turn @ point)
        R = R @ turn
    return lines, R, p


def _rotate_about(axis: Array, theta: ca.SX) -> ca.SX:
    """Return the (3, 3) rotation about a unit axis."""
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return ca.SX.eye(3) + ca.sin(theta) * ca.DM(K) + (1.0 - ca.cos(theta)) * ca.DM(K @ K)
