"""Summary of a robot and its mounting for tables and JSON, in mm and degrees."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from machopt.cell.urdf import UrdfJoint, UrdfModel
from machopt.data_types.cell import Cell
from machopt.data_types.documents.inspect_documents import (
    CellJointEntry,
    InspectedRobotDocument,
    MountingSection,
    RobotJointEntry,
)
from machopt.numerics.array_types import Array

_LEVEL = math.radians(0.5)  # a robot nearer to upright counts as upright


def summarise_robot(urdf: UrdfModel) -> InspectedRobotDocument:
    """Summarise a robot description.

    Args:
        urdf: The robot: links, joints, bodies and masses.

    Returns:
        The document (mm, degrees).
    """
    return InspectedRobotDocument(
        robot=urdf.path.name,
        links=len(urdf.parts),
        collision_bodies=sum(p.collisions for p in urdf.parts),
        mass_kg=round(sum(p.mass or 0.0 for p in urdf.parts), 3),
        joints=tuple(_summarise_joint(j) for j in urdf.joints if j.moves),
        warnings=tuple(urdf.warnings),
        not_used=dict(urdf.unused_elements),
    )


def describe_mounting(cell: Cell) -> MountingSection:
    """Describe the pose of ``base_link`` in the world.

    Args:
        cell: The cell.

    Returns:
        The section of the document (mm, degrees).
    """
    R, p = cell.T_world_base[:3, :3], cell.T_world_base[:3, 3]
    tilt = math.acos(max(-1.0, min(1.0, float(R[2, 2]))))
    words = "upright" if tilt < _LEVEL else "from the ceiling" if tilt > math.pi - _LEVEL else "tilted"
    if abs(tilt - math.pi / 2) < _LEVEL:
        words = "on a wall"
    down = np.round(R.T @ np.array([0.0, 0.0, -1.0]), 6) + 0.0
    return MountingSection(
        stands=words, tilt_deg=round(math.degrees(tilt), 3), xyz_mm=_convert_to_mm(p), down_in_base=down
    )


def list_joint_limits(cell: Cell) -> tuple[CellJointEntry, ...]:
    """List the arm joints, then the external joints, with the limits that a plan must keep.

    Args:
        cell: The cell.

    Returns:
        One entry per joint (mm, degrees).
    """
    names = (*cell.arm_joints, *cell.external_joints)
    slides = (*(cell.arm_prismatic or (False,) * len(cell.arm_joints)), *cell.external_prismatic)
    home = np.concatenate([cell.home, cell.external_home])
    rows = []
    for k, (name, slide) in enumerate(zip(names, slides, strict=True)):
        unit, scale = ("mm", 1e3) if slide else ("deg", 180.0 / math.pi)
        limits = cell.limits
        values = (limits.lower[k], limits.upper[k], home[k], limits.velocity[k], limits.acceleration[k], limits.jerk[k])
        keys = ("lower", "upper", "home", "velocity", "acceleration", "jerk")
        units = (unit, unit, unit, f"{unit}_s", f"{unit}_s2", f"{unit}_s3")
        limit_values = {f"{a}_{b}": round(float(v) * scale, 3) for a, b, v in zip(keys, units, values, strict=True)}
        rows.append(CellJointEntry(name=name, **limit_values))
    return tuple(rows)


def _summarise_joint(j: UrdfJoint) -> RobotJointEntry:
    unit, scale = ("mm", 1e3) if j.kind == "prismatic" else ("deg", 180.0 / math.pi)
    ends = (round(v * scale, 3) if math.isfinite(v) else None for v in (j.lower, j.upper, j.velocity))
    row: dict[str, Any] = {"name": j.name, "kind": j.kind, "parent": j.parent, "child": j.child}
    row |= dict(zip((f"lower_{unit}", f"upper_{unit}", f"velocity_{unit}_s"), ends, strict=True))
    if j.mimic is not None:
        row |= {"mimics": j.mimic.joint, "multiplier": j.mimic.multiplier, "offset_deg": math.degrees(j.mimic.offset)}
    return RobotJointEntry(**row)


def _convert_to_mm(p: Array) -> tuple[float, ...]:
    return tuple(round(1e3 * float(v), 3) + 0.0 for v in p)
