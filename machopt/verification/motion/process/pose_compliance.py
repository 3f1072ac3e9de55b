"""Compliance of a pose in the parts that the draws change, and errors of a hole over drawn compliances and loads."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from machopt.data_types.cell import Cell
from machopt.numerics.array_types import Array
from machopt.numerics.tall_products import multiply_tall


@dataclass(frozen=True, kw_only=True)
class PoseCompliance:
    """One pose with its joint part and the rest of the compliance; of a table of poses, each array has a row a pose."""

    axis: Array  # (3,)
    travel: Array  # (3,)
    R: Array  # (3, 3) CAM axes in base_link
    place: Array  # (3,) m, programmed position in the CAM frame
    J: Array  # (6, 6)
    joints: Array  # (6,) compliance of the joints, rad/(N·m)
    rest: Array  # (6, 6) compliance of everything else at the TCP
    offset: Array  # (3,) m, compensation in base_link

    def list_rows(self) -> list[PoseCompliance]:
        """Return the poses of a table."""
        names = [f.name for f in fields(self)]
        return [PoseCompliance(**{name: getattr(self, name)[n] for name in names}) for n in range(len(self.axis))]


@dataclass(frozen=True, kw_only=True)
class DrawnLoads:
    """Loads of one hole; D of them."""

    thrust: Array  # (D,) N
    torque: Array  # (D,) N·m
    sideways: Array  # (D,) factor on the nominal force along travel and normal
    nominal: Array  # (2,) N, along travel and normal

    def list_parts(self, pose: PoseCompliance) -> tuple[Array, Array]:
        """Return (L, 6) wrenches at the TCP in base_link, and (L, D) the factor of each.

        Args:
            pose: The pose.
        """
        zero = np.zeros(3)
        wrenches = [np.r_[pose.axis, zero], np.r_[zero, pose.axis]]
        factors = [self.thrust, self.torque]
        if self.nominal.any():
            across = self.nominal @ np.stack([pose.travel, np.cross(pose.axis, pose.travel)])
            wrenches, factors = [*wrenches, np.r_[across, zero]], [*factors, self.sideways]
        return np.array(wrenches), np.array(factors)


def compute_components(
    pose: PoseCompliance, cell: Cell, loads: DrawnLoads, compliance: Array | None, rows: Array
) -> Array:
    """Return (D, C) components of the twist of the tool relative to the part.

    Args:
        pose: The pose.
        cell: The cell, with the stiffness of the part.
        loads: The loads.
        compliance: (D, 6) of the joints, relative to nominal; None: nominal.
        rows: (C, 6) the components as rows.
    """
    out = np.zeros((len(loads.thrust), len(rows)))
    for wrench, factor in zip(*loads.list_parts(pose), strict=True):
        by_joint = (rows @ pose.J) * (pose.joints * (wrench @ pose.J))  # (C, 6)
        rest = rows @ (pose.rest @ wrench)
        if cell.workpiece.stiffness is not None:
            rest = rest + rows[:, :3] @ (pose.R @ ((wrench[:3] @ pose.R) / cell.workpiece.stiffness))
        if compliance is None:
            out += factor[:, None] * (by_joint.sum(axis=1) + rest)
        else:
            drawn = multiply_tall(compliance, by_joint.T)
            drawn += rest
            drawn *= factor[:, None]
            out += drawn
    return out


def list_hole_rows(axis: Array) -> Array:
    """Return (5, 6) two displacements across an axis, the displacement along it, and two turns of it.

    Args:
        axis: (3,) unit.
    """
    x = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    y, zero = np.cross(axis, x), np.zeros(3)
    return np.array([np.r_[x, zero], np.r_[y, zero], np.r_[axis, zero], np.r_[zero, x], np.r_[zero, y]])
