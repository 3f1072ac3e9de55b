"""Tilted tool axes along a path, and the path that a tilted ball cutter follows.

Between two points the axis turns evenly in the plane of both (great circle), as between two points of a CAM file. So a
tilted path is a path like any other: sampling, search, smoothing, retiming and posts use it unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_tool_rotation, interpolate_axis, normalise_vectors
from machopt.numerics.tool_tilt import compute_tilted_tip, measure_lead_and_side, rotate_with_axis
from machopt.planning.stations.planning_path import PlanningPath, compute_signed_angle

SAME = 1e-12  # of a unit vector's component: the axis is that of the CAM file


@dataclass(frozen=True)
class TiltCurve:
    """Tilted tool axes at planning points; a path with more points inside the same runs takes them in between."""

    index: Array  # (P,) fractional toolpath index
    axis: Array  # (P, 3) unit, tip to shank, in the workpiece frame
    radius: float  # m, of the ball

    def sample(self, index: Array) -> Array:
        """Return the tilted axes (n, 3) at fractional toolpath indices.

        Args:
            index: (n,) indices that are planning points, or lie inside their runs.
        """
        after = np.clip(np.searchsorted(self.index, index - 1e-12), 0, len(self.index) - 1)
        before = np.maximum(after - 1, 0)
        span = self.index[after] - self.index[before]
        f = np.where(span > 0, (index - self.index[before]) / np.where(span > 0, span, 1.0), 1.0)
        f = np.clip(f, 0.0, 1.0)
        between = interpolate_axis(self.axis[before], self.axis[after], f)
        return np.where((f >= 1.0)[:, None], self.axis[after], between)

    def tilt_path(self, path: PlanningPath) -> PlanningPath:
        """Return the path of the tilted tool; lengths, times, loads and direction of travel stay those of the CAM file.

        Args:
            path: path of the CAM file.
        """
        return tilt_path(path, self.sample(path.index), self.radius)


def tilt_path(path: PlanningPath, tilted: Array, radius: float) -> PlanningPath:
    """Return the path of a ball cutter with other tool axes; points whose axis is unchanged stay the same to the bit.

    gamma is counted from the reference of the CAM file projected on the plane normal to the tilted axis, and phi from
    the transported reference turned by the smallest rotation.

    Args:
        path: path of the CAM file.
        tilted: (P, 3) unit tilted axes.
        radius: m, of the ball.
    """
    turned = (np.abs(tilted - path.axis).max(axis=1) > SAME)[:, None]
    axis = np.where(turned, tilted, path.axis)
    natural = compute_tool_rotation(path.axis, path.reference, -path.offset)[..., 0]  # TCP x at gamma = 0
    across = normalise_vectors(natural - np.sum(natural * axis, axis=1, keepdims=True) * axis)
    reference = normalise_vectors(rotate_with_axis(path.reference, path.axis, axis))
    lead, side = measure_lead_and_side(path.axis, path.travel, axis)
    return replace(
        path,
        position=np.where(turned, compute_tilted_tip(path.position, path.axis, axis, radius), path.position),
        axis=axis,
        reference=np.where(turned, reference, path.reference),
        offset=np.where(turned[:, 0], compute_signed_angle(across, reference, -axis), path.offset),
        untilted=path,
        lead=np.where(turned[:, 0], lead, 0.0),
        side=np.where(turned[:, 0], side, 0.0),
    )


def get_tilt_curve(path: PlanningPath, radius: float) -> TiltCurve | None:
    """Return the tilt of a path; None where it has none.

    Args:
        path: planning points.
        radius: m, of the ball.
    """
    return None if path.untilted is None else TiltCurve(path.index, path.axis, radius)
