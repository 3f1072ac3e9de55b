"""Feed checks: tool speed relative to the workpiece against the CAM feed, and against the feed column."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import CheckName, VerificationCheck, build_worst_value_check
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis
from machopt.verification.motion.path_geometry.reference_direction import INDEX_TOLERANCE
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.motion.path_geometry.tool_tilt import get_ball_radius
from machopt.verification.tables.exported_tables import ExportedMotion

FEED_FACTOR = 1.02  # of the programmed feed
FEED_COLUMN_TOLERANCE = 0.005  # three decimals, and nine of the joints' degrees over metres of reach within one sample


def check_feed(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations, options: PlanOptions, cell: Cell
) -> list[VerificationCheck]:
    """Check the tool speed against the CAM file's feed, and the feed column against the speed.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        locations: Position of each motion sample relative to the toolpath.
        options: The planning options in force.
        cell: The robot cell.
    """
    speed, driven = (
        np.r_[0.0, np.linalg.norm(np.diff(of, axis=0), axis=1) / motion.sample_time]
        for of in (locations.tcp[:, :3, 3], locations.tool[:, :3, 3])
    )
    tolerance = FEED_COLUMN_TOLERANCE
    if motion.lead is not None:  # the column is the feed of the programmed point
        driven = _compute_point_speed(motion, toolpath, locations, driven, cell)
        turn = np.linalg.norm(np.diff(toolpath.axis, axis=0), axis=1).max(initial=0.0)  # per toolpath index
        tolerance += 6e4 * INDEX_TOLERANCE * turn * get_ball_radius(cell) / motion.sample_time
    column = build_worst_value_check(
        "feed column", "mm/min", 6e4 * np.abs(driven - motion.feed), tolerance, motion.describe_row
    )
    return [_check_speed(motion, toolpath, locations, speed, options), column]


def _compute_point_speed(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations, driven: Array, cell: Cell
) -> Array:
    """(S,) m/s of the point p = tip − r (a − a') of a tilted ball, of the tip where a rapid move is involved."""
    last = len(toolpath) - 1
    fed = np.isfinite(motion.point) & (motion.move != MoveKind.RAPID)
    s = np.clip(np.nan_to_num(motion.point), 0.0, last)
    low = np.minimum(s.astype(int), max(last - 1, 0))
    axis = interpolate_axis(toolpath.axis[low], toolpath.axis[np.minimum(low + 1, last)], s - low)
    place = locations.tool[:, :3, 3] - get_ball_radius(cell) * (axis + locations.tool[:, :3, 2])
    speed = np.r_[0.0, np.linalg.norm(np.diff(place, axis=0), axis=1) / motion.sample_time]
    return np.where(np.r_[False, fed[1:] & fed[:-1]], speed, driven)


def _check_speed(
    motion: ExportedMotion, toolpath: Toolpath, locations: SampleLocations, speed: Array, options: PlanOptions
) -> VerificationCheck:
    """Speed over the feed of the fastest move that a sample's way covers; a move without a feed has the approach feed.

    Where the tool is drawn straight out of a point of the file it is no faster than that either; let in, no faster than
    the file drives there or next.
    """
    rows = np.flatnonzero(locations.on_feed_move | locations.on_retract_move)
    rows = rows[rows > 0]
    rows = rows[(locations.on_feed_move | locations.on_retract_move)[rows - 1] | locations.on_feed_move[rows]]
    last = len(toolpath) - 1
    feed = np.where(toolpath.feed > 0, toolpath.feed, options.approach_feed)
    s = np.clip(np.nan_to_num(motion.point), 0.0, last)
    first = np.clip(np.floor(s[rows - 1] + INDEX_TOLERANCE).astype(int) + 1, 0, last)
    final = np.maximum(locations.next_point[rows], first)
    most = feed[first]
    for ahead in range(1, int((final - first).max(initial=0)) + 1):
        most = np.maximum(most, np.where(first + ahead <= final, feed[np.minimum(first + ahead, last)], 0.0))
    there = np.where(toolpath.feed > 0, toolpath.feed, np.inf)
    after = there[::-1]
    after = np.where(np.isfinite(after), np.arange(len(after)), -1)
    after = last - np.maximum.accumulate(after)[::-1]  # the next point with a feed
    after = there[np.minimum(after, last)][np.clip(np.round(s[rows]).astype(int), 0, last)]
    x, shank = locations.tcp[:, :3, 3], -locations.tcp[:, :3, 2]
    sinks = np.einsum("ij,ij->i", x[rows] - x[rows - 1], shank[rows]) < 0
    lift = np.where(sinks, np.minimum(options.approach_feed, after), options.approach_feed)
    most = np.where(locations.on_feed_move[rows], most, lift)
    return build_worst_value_check(
        CheckName.FEED,
        "of the programmed feed",
        speed[rows] / most,
        FEED_FACTOR,
        lambda n: motion.describe_row(rows[n]),
    )
