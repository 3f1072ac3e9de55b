"""Motion of a tilted ball cutter: feed of its tip, rounding of corners, and the tilt that the samples have.

The programmed feed is that of the CAM file's point p. While the tilt changes, the tip of the tilted tool moves by r·dθ
more or less than p; it is driven faster or slower by the same share. The feed of a sample is that of p, found from the
pose of the tool: p = tip − r (a − a').
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions, TiltRange
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_tool_rotation, interpolate_axis, normalise_vectors
from machopt.numerics.tool_tilt import measure_lead_and_side
from machopt.planning.stations.planning_path import NO_MOVE, PlanningPath, compute_signed_angle

ACROSS = float(np.sin(np.radians(1.0)))  # share of a move across the axis from which it has a direction of travel
SAME_DIRECTION = 1e-9  # of unit vectors
BALL_SHARE = 0.15  # of the corner tolerance: what the rounding of the axis may move the programmed point


def compute_tip_speed_share(path: PlanningPath, rows: NDArray[np.int32], radius: float) -> Array:
    """Return the (n,) share of the programmed feed at which the tip of the tilted tool moves into each point.

    Args:
        path: planning points.
        rows: (n,) planning points of one run.
        radius: m, of the ball.
    """
    if path.untilted is None:
        return np.ones(len(rows))
    tips = path.position[rows]
    points = tips - radius * (path.untilted.axis[rows] - path.axis[rows])
    tip, point = (np.r_[0.0, np.linalg.norm(np.diff(of, axis=0), axis=1)] for of in (tips, points))
    share = np.where(point > NO_MOVE, tip / np.maximum(point, NO_MOVE), 1.0)
    return np.where(share > 0.0, share, 1.0)


def limit_tilted_rounding(options: PlanOptions, path: PlanningPath, radius: float) -> tuple[float, float]:
    """Return the corner tolerances in m and rad, so that the point of the CAM file keeps the first one.

    A deviation of the axis by an angle moves that point by the angle times the radius of the ball.

    Args:
        options: plan options with the tolerances.
        path: planning points.
        radius: m, of the ball; 0 where the cutter is none.
    """
    if path.untilted is None:
        return options.path_tolerance, options.axis_tolerance
    axis = min(options.axis_tolerance, BALL_SHARE * options.path_tolerance / max(radius, 1e-6))
    return options.path_tolerance - axis * radius, axis


@dataclass(frozen=True)
class SampleTilts:
    """Tilt, rotation and programmed point of S samples."""

    lead: Array  # (S,) rad, NaN in rapid moves
    side: Array  # (S,) rad
    gamma: Array  # (S,) rad
    away: Array  # (S, 3) m in the workpiece, from the point of the CAM file to the tip of the tool; 0 in rapid moves


def measure_sample_tilts(
    path: PlanningPath, index: Array, move: NDArray[np.int8], rotation: Array, radius: float
) -> SampleTilts:
    """Return tilt and rotation that the poses of a motion have.

    Args:
        path: tilted planning points.
        index: (S,) fractional toolpath index, NaN from and to home.
        move: (S,) Move codes.
        rotation: (S, 3, 3) of the TCP in the workpiece frame.
        radius: m, of the ball.
    """
    cam = path.programmed
    x, shank = rotation[:, :, 0], -rotation[:, :, 2]
    driven = np.isfinite(index) & (move != MoveKind.RAPID)
    s = np.where(driven, index, 0.0)
    low = np.clip(np.searchsorted(path.index, s + 1e-9, side="right") - 1, 0, len(path.index) - 1)
    after = np.minimum(low + 1, len(path.index) - 1)
    ends_cut = (move == MoveKind.CUT) & (path.move[after] != MoveKind.CUT) & (path.move[low] == MoveKind.CUT)
    low = np.where(ends_cut, np.maximum(low - 1, 0), low)  # the last place of a cut has the travel of that cut
    high = np.minimum(low + 1, len(path.index) - 1)
    span = path.index[high] - path.index[low]
    f = np.clip((s - path.index[low]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    axis = interpolate_axis(cam.axis[low], cam.axis[high], f)
    travel = _compute_travel(cam, low, high, axis)
    lead, side = measure_lead_and_side(axis, travel, shank)
    natural = compute_tool_rotation(cam.axis, cam.reference, -cam.offset)[..., 0]  # TCP x at gamma = 0
    by_travel = np.abs(natural - cam.travel).max(axis=1) < SAME_DIRECTION
    zero = np.where(by_travel[low][:, None], travel, _project(natural[low], axis))
    gamma = compute_signed_angle(_project(zero, shank), x, -shank)
    return SampleTilts(
        lead=np.where(driven, lead, np.nan),
        side=np.where(driven, side, np.nan),
        gamma=gamma,
        away=np.where(driven[:, None], radius * (axis - shank), 0.0),
    )


def _compute_travel(cam: PlanningPath, low: NDArray[np.intp], high: NDArray[np.intp], axis: Array) -> Array:
    """Direction of travel (S, 3) normal to the axis: of the move itself, else that of the planning point before it."""
    move = np.where((cam.run[low] == cam.run[high])[:, None], cam.position[high] - cam.position[low], 0.0)
    size = np.linalg.norm(move, axis=1)
    across = np.linalg.norm(np.cross(axis, move), axis=1)
    own = (size > NO_MOVE) & (across > ACROSS * size)
    return _project(np.where(own[:, None], move, cam.travel[low]), axis)


def _project(v: Array, axis: Array) -> Array:
    """Unit vectors (S, 3) projected on the plane normal to the axis."""
    return normalise_vectors(v - np.sum(v * axis, axis=1, keepdims=True) * axis)


def limit_cut_tilts(
    tilts: tuple[Array, Array], move: NDArray[np.int8], operation: NDArray[np.int32], ranges: Sequence[TiltRange]
) -> tuple[Array, Array]:
    """Return the tilts with those of cuts inside their range, which rounding of the axis may leave by its tolerance.

    Args:
        tilts: (S,) lead and (S,) side, rad.
        move: (S,) Move codes.
        operation: (S,) index of the operation, −1 for none.
        ranges: of each operation.
    """
    cut = np.flatnonzero((move == MoveKind.CUT) & (operation >= 0))
    out = []
    for name, tilt in zip(("lead", "side"), tilts, strict=True):
        limits = np.array([getattr(r, name) for r in ranges]).reshape(-1, 2)[operation[cut]]
        limited = tilt.copy()
        limited[cut] = np.clip(tilt[cut], limits[:, 0], limits[:, 1])
        out.append(limited)
    return out[0], out[1]
