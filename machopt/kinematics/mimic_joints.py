"""Mimic joints (``<mimic>``), included in the six lines of an arm.

A joint on the line of the next one in the chain, with no body between them, adds to that
joint's rotation: with q_f = m q_s + o the neighbour's line rotates by θ_n = q_n ± m q_s, o being part of the pose at
q = 0. So θ = C q with integers in C, and full turns of q remain full turns of θ.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.errors import CellError
from machopt.numerics.array_types import Array

SAME_RAD, SAME_M = 1e-6, 1e-6  # two axes are one line below: URDFs print six decimals


def check_no_mimic_joints(cell: Cell, command: str) -> None:
    """Refuse mimic joints for a command that supports only six independent joints.

    Args:
        cell: cell to check.
        command: name of the command, for the message.

    Raises:
        InputError: a joint mimics one of the arm.
    """
    for m in cell.mimics:
        if m.source in cell.arm_joints:
            raise CellError(
                f"joint {m.joint!r} mimics {m.source!r}, and {command} has no laws for such arms; "
                "optimize, verify and inspect have",
                file=cell.urdf,
            )


def compute_rest_configuration(cell: Cell, model: Any) -> Array:
    """Return the configuration of the whole URDF with every joint at zero, and mimic joints at their offset.

    Args:
        cell: cell with the mimic joints.
        model: pinocchio model of the whole URDF.
    """
    import pinocchio as pin

    q: Array = pin.neutral(model)
    for m in cell.mimics:
        if model.existJointName(m.joint):
            j = model.getJointId(m.joint)
            at = model.idx_qs[j]
            if model.nqs[j] == 2:
                q[at : at + 2] = np.cos(m.offset), np.sin(m.offset)
            else:
                q[at] = m.offset
    return q


def list_chain_joints(model: Any, last: int, base: int) -> list[int]:
    """Return the moving joints from a frame to a joint, in order.

    Args:
        model: pinocchio model.
        last: last joint.
        base: number of the frame (exclusive).
    """
    out, first = [], int(model.frames[base].parentJoint)
    while last > 0 and last != first:
        out.append(int(last))
        last = model.parents[last]
    return out[::-1]


def compute_coupling_matrix(cell: Cell, model: Any, joints: list[int], arm: list[int]) -> Array | None:
    """Return C (n, n) of θ = C q, None without a mimic joint in the chain.

    Args:
        cell: cell with the mimic joints.
        model: pinocchio model of the whole URDF.
        joints: joints of the chain from base to flange, with mimic joints.
        arm: the n driven joints.

    Raises:
        InputError: a mimic joint whose line differs from that of its neighbour.
    """
    import pinocchio as pin

    follows = {m.joint: m for m in cell.mimics}
    if not any(model.names[j] in follows for j in joints if j not in arm):
        return None
    data = model.createData()
    pin.computeJointJacobians(model, data, compute_rest_configuration(cell, model))
    lines = {j: _compute_joint_line(model, data, j) for j in joints}
    C = np.eye(len(arm))
    for n, j in enumerate(joints):
        if j in arm:
            continue
        name = model.names[j]
        m = follows.get(name)
        if m is None or m.source not in cell.arm_joints:
            raise CellError(f"joint {name!r} is in the chain and is not driven", file=cell.urdf)
        neighbour, sign = _find_driven_neighbour(lines, joints, n, arm)
        if neighbour is None:
            raise CellError(
                f"joint {name!r} mimics {m.source!r} and turns about a line of its own; one that lies on the axis of "
                "the joint of the arm next behind it would work, as at the elbow of a parallel linkage",
                file=cell.urdf,
                where="robot.arm_joints",
            )
        C[arm.index(neighbour), cell.arm_joints.index(m.source)] += sign * m.multiplier
    if abs(abs(np.linalg.det(C)) - 1.0) > 1e-9:
        raise CellError(
            "joints that mimic others undo what those do, or double it; a follower on the axis of another joint than "
            "its own source would work",
            file=cell.urdf,
            where="robot.arm_joints",
        )
    return C


def _find_driven_neighbour(
    lines: dict[int, tuple[Array, Array]], joints: list[int], n: int, arm: list[int]
) -> tuple[int | None, float]:
    """Return the driven joint after mimic joint n on the same line, and 1 or −1 for equal or opposite sense.

    Only such mimic joints may be in between. The previous joint does not qualify: its link would rotate with the mimic
    joint.
    """
    axis, point = lines[joints[n]]
    for j in joints[n + 1 :]:
        other, place = lines[j]
        line_distance = np.linalg.norm(np.cross(other, point - place))
        if np.linalg.norm(np.cross(axis, other)) > SAME_RAD or line_distance > SAME_M:
            break
        if j in arm:
            return j, float(np.sign(axis @ other))
    return None, 0.0


def _compute_joint_line(model: Any, data: Any, j: int) -> tuple[Array, Array]:
    """Axis and a point of a joint at rest, in the URDF's root."""
    import pinocchio as pin

    own = pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL)[:, model.idx_vs[j]]
    return np.asarray(data.oMi[j].rotation @ own[3:]), np.asarray(data.oMi[j].translation)
