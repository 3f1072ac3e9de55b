"""Joint frames of the URDF with the calibrated geometry of the cell's kinematics.yaml.

This is a second implementation, independent of the planner. It changes joint placements in pinocchio's model; the
planner moves lines instead.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.effect_locations import parse_joint_location
from machopt.numerics.array_types import Array

GEOMETRY_EFFECT = "geometry"


def has_as_built_geometry(cell: Cell) -> bool:
    """Return whether the cell has corrections of the arm's geometry.

    Args:
        cell: The robot cell.
    """
    return cell.kinematics is not None and any(c.effect == GEOMETRY_EFFECT for c in cell.kinematics.corrections)


def apply_as_built_geometry(model: Any, cell: Cell, base: int, flange: int, rest: Array) -> None:
    """Move joint frames and flange of a model, in place.

    Args:
        model: Pinocchio's model of the cell's URDF.
        cell: The robot cell, whose kinematics file has the geometry.
        base: Number of the frame of base_link.
        flange: Number of the frame of the flange link.
        rest: Configuration with all joints at zero.
    """
    import pinocchio as pin

    entries = [
        c for c in (cell.kinematics.corrections if cell.kinematics is not None else ()) if c.effect == GEOMETRY_EFFECT
    ]
    if not entries:
        return
    data = model.createData()
    pin.framesForwardKinematics(model, data, rest)
    drawn = [data.oMi[j].copy() for j in range(model.njoints)]
    foot, hand = data.oMf[base].copy(), data.oMf[flange].copy()
    for entry in sorted(entries, key=lambda e: e.location == "base"):  # base_link's way is the outer one of two
        p = entry.parameters
        shift = np.array(p.get("xyz_mm", (0.0, 0.0, 0.0)), float) / 1000.0
        turn = np.array(p.get("turn_mrad", (0.0, 0.0, 0.0)), float) / 1000.0
        if entry.location == "tool":
            frame = model.frames[flange]
            there = foot.actInv(hand)
            seen = _turn_frame(there, there.translation, shift, turn)
            frame.placement = drawn[frame.parentJoint].actInv(foot.act(seen))
            continue
        name = cell.arm_joints[0 if entry.location == "base" else parse_joint_location(entry.location)[0]]
        j = int(model.getJointId(name))
        parent = foot.actInv(drawn[model.parents[j]])  # in base_link, as drawn
        about = np.zeros(3) if entry.location == "base" else foot.actInv(drawn[j]).translation
        model.jointPlacements[j] = parent.actInv(_turn_frame(parent.act(model.jointPlacements[j]), about, shift, turn))


def _turn_frame(frame: Any, at: Array, shift: Array, turn: Array) -> Any:
    """A frame in base_link turned about a point by a rotation vector, then shifted."""
    import pinocchio as pin

    R: Array = _compute_rotation(turn)
    return pin.SE3(R @ frame.rotation, at + R @ (frame.translation - at) + shift)


def _compute_rotation(v: Array) -> Array:
    """(3, 3) of a rotation vector, Rodrigues."""
    angle = float(np.linalg.norm(v))
    K = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + K)
    sine, rest = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + sine * K + rest * K @ K)
