"""Distances within which a program may round the corners between rapid moves, from rapid_corners.csv."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.rapid_corners import RapidCorners
from machopt.numerics.array_types import Array
from machopt.programs.writing.rapid_zones import compute_rapid_zone_limits
from machopt.verification.motion.checks.rapid_corners import list_corner_triangles
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.tables.exported_tables import ExportedMotion

SAME_ROW = 0.05  # of a sample: a target nearer than this to a corner is it


@dataclass(frozen=True)
class RapidZoneTable:
    """How far before and after the corners a controller may begin to round them."""

    sample: Array  # (C,) row of the motion
    share: Array  # (C,) of the moves to and from the corner
    distance: Array  # (C,) m of the tool from the corner

    @classmethod
    def build(cls, motion: ExportedMotion, corners: RapidCorners, arm: UrdfKinematics) -> RapidZoneTable:
        """Compute the distances by the controller's own kinematics.

        Args:
            motion: The exported motion (trajectory.csv), SI.
            corners: Rounded corners (rapid_corners.csv).
            arm: Kinematics as the controller reckons.
        """
        triangles = list_corner_triangles(corners, motion.joints)
        if not triangles:
            return cls(np.zeros(0), np.zeros(0), np.zeros(0))
        distance = compute_rapid_zone_limits(
            corners.x,
            (np.array([t.start for t in triangles]), np.array([t.end for t in triangles])),
            corners.share,
            lambda x: arm.compute_tcp_in_workpiece(x[:, :6], x[:, 6:])[:, :3, 3],
        )
        return cls(corners.sample.astype(float), corners.share.min(axis=1), distance)

    def select(self, rows: Array) -> tuple[Array, Array]:
        """Return share (M,) and distance (M,) m of program targets; 0 where a target is no rounded corner.

        Args:
            rows: (M,) fractional rows of the motion at which the targets lie.
        """
        if not len(self.sample):
            return np.zeros(len(rows)), np.zeros(len(rows))
        nearest = np.abs(rows[:, None] - self.sample).argmin(axis=1)
        same = np.abs(rows - self.sample[nearest]) < SAME_ROW
        return np.where(same, self.share[nearest], 0.0), np.where(same, self.distance[nearest], 0.0)
