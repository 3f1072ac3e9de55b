"""Motion of a tilted ball cutter: feed of its tip, rounding of corners, and the tilt that the samples have.

The programmed feed is that of the CAM file's point. While the tilt changes, the tip of the tilted tool moves by r·dθ
more or less than that point; where it moves less, it is driven slower by the same share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions, TiltRange
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import interpolate_axis, normalise_vectors
from machopt.numerics.tool_tilt import measure_lead_and_side
from machopt.planning.stations.planning_path import NO_MOVE, PlanningPath

BALL_SHARE = 0.3  # of the corner tolerance: what the rounding of the axis may move the programmed point


def compute_tip_speed_share(path: PlanningPath, rows: NDArray[np.int32]) -> Array:
    """Return the (n,) share of the programmed feed at which the tip of the tilted tool moves into each point.

    Args:
        path: planning points.
        rows: (n,) planning points of one run.
    """
    if path.untilted is None:
        return np.ones(len(rows))
    tip, point = (
        np.r_[0.0, np.linalg.norm(np.diff(of.position[rows], axis=0), axis=1)] for of in (path, path.untilted)
    )
    return np.where(point > NO_MOVE, np.minimum(tip / np.maximum(point, NO_MOVE), 1.0), 1.0)


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


def measure_sample_tilts(path: PlanningPath, index: Array, move: NDArray[np.int8], shank: Array) -> tuple[Array, Array]:
    """Return lead and side (S,) in rad of the samples of a motion; NaN in rapid moves.

    Args:
        path: tilted planning points.
        index: (S,) fractional toolpath index, NaN from and to home.
        move: (S,) Move codes.
        shank: (S, 3) unit, tool axis in the workpiece frame, tip to shank.
    """
    cam = path.programmed
    known = np.isfinite(index)
    s = np.where(known, index, 0.0)
    low = np.clip(np.searchsorted(path.index, s + 1e-9, side="right") - 1, 0, len(path.index) - 1)
    high = np.minimum(low + 1, len(path.index) - 1)
    span = path.index[high] - path.index[low]
    f = np.clip((s - path.index[low]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
    axis = interpolate_axis(cam.axis[low], cam.axis[high], f)
    travel = normalise_vectors(cam.travel[low] - np.sum(cam.travel[low] * axis, axis=1, keepdims=True) * axis)
    lead, side = measure_lead_and_side(axis, travel, shank)
    told = known & (move != MoveKind.RAPID)
    return np.where(told, lead, np.nan), np.where(told, side, np.nan)


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
