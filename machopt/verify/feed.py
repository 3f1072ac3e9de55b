"""How fast the tool moves relative to the workpiece: never above the CAM file's feed on its feed moves, whatever the
row is called; and the feed column, which is the speed the samples really have."""

from __future__ import annotations

import numpy as np

from machopt.arrays import Array
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.verify.check import Check, Promise, worst
from machopt.verify.reference import SAME
from machopt.verify.ride import Ride
from machopt.verify.table import Motion

FEED = 1.02  # of the programmed feed
COLUMN_MM_MIN = 0.005  # three decimals, and nine of the joints' degrees over metres of reach within one sample


def check_feed(motion: Motion, toolpath: Toolpath, ride: Ride, options: PlanOptions) -> list[Check]:
    """Speed and the column that tells it."""
    speed = np.r_[0.0, np.linalg.norm(np.diff(ride.tcp[:, :3, 3], axis=0), axis=1) / motion.cycle]
    column = worst("feed column", "mm/min", 6e4 * np.abs(speed - motion.feed), COLUMN_MM_MIN, motion.at)
    return [_speed(motion, toolpath, ride, speed, options), column]


def _speed(motion: Motion, toolpath: Toolpath, ride: Ride, speed: Array, options: PlanOptions) -> Check:
    """Speed over the feed of the fastest move that a sample's way covers; a move without a feed has the approach feed.

    Where the tool is drawn straight out of a point of the file it is no faster than that either; let in, no faster than
    the file drives there or next.
    """
    rows = np.flatnonzero(ride.fed | ride.lifted)
    rows = rows[rows > 0]
    rows = rows[(ride.fed | ride.lifted)[rows - 1] | ride.fed[rows]]
    last = len(toolpath) - 1
    feed = np.where(toolpath.feed > 0, toolpath.feed, options.approach_feed)
    s = np.clip(np.nan_to_num(motion.point), 0.0, last)
    first = np.clip(np.floor(s[rows - 1] + SAME).astype(int) + 1, 0, last)
    final = np.maximum(ride.toward[rows], first)
    most = feed[first]
    for ahead in range(1, int((final - first).max(initial=0)) + 1):
        most = np.maximum(most, np.where(first + ahead <= final, feed[np.minimum(first + ahead, last)], 0.0))
    there = np.where(toolpath.feed > 0, toolpath.feed, np.inf)
    after = there[::-1]
    after = np.where(np.isfinite(after), np.arange(len(after)), -1)
    after = last - np.maximum.accumulate(after)[::-1]  # the next point with a feed
    after = there[np.minimum(after, last)][np.clip(np.round(s[rows]).astype(int), 0, last)]
    x, shank = ride.tcp[:, :3, 3], -ride.tcp[:, :3, 2]
    sinks = np.einsum("ij,ij->i", x[rows] - x[rows - 1], shank[rows]) < 0
    lift = np.where(sinks, np.minimum(options.approach_feed, after), options.approach_feed)
    most = np.where(ride.fed[rows], most, lift)
    return worst(Promise.FEED, "of the programmed feed", speed[rows] / most, FEED, lambda n: motion.at(rows[n]))
