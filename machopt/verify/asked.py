"""Whether the rows of points.csv keep what the user asked of the choice: rotations, joint margins, clearance.

A plan that breaks one of these is a sound motion, yet not the one that was asked for; a manifest whose options were
edited shows here, too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.steering import among, steered
from machopt.domain.toolpath import Move, Toolpath
from machopt.verify.check import Check, worst
from machopt.verify.stands import check_stands
from machopt.verify.table import Motion, Points

ROTATION_DEG = 0.25  # rotations are rounded at corners, as the path is
MARGIN_DEG = 2e-5  # five decimals
CLEARANCE_MM = 0.05  # the planner keeps it before corners are rounded (path_tolerance_mm)


def check_asked(
    cell: Cell, toolpath: Toolpath, points: Points, rows: NDArray[np.intp], options: PlanOptions, motion: Motion
) -> list[Check]:
    """How far the rows fall outside what was asked, one check for each wish.

    Args:
        rows: those that are driven (status ``ok``).
        motion: where external joints stand between the points, too.
        options: as for the plan; its rotations bind where the method chooses them.
    """
    if not len(rows):
        return []
    at = points.point[rows]

    def where(n: int) -> str:
        return f"point {at[n]}"

    margin = np.degrees(options.limit_margin) - points.numbers["limit_margin_deg"][rows]
    out = [worst("as asked: limit_margin_deg", "deg too near", np.maximum(margin, 0.0), MARGIN_DEG, where)]
    if options.collision:
        short = 1e3 * options.clearance - points.numbers["clearance_mm"][rows]
        out.append(worst("as asked: clearance_mm", "mm too near", np.maximum(short, 0.0), CLEARANCE_MM, where))
    out += check_stands(cell, toolpath, points, rows, options, motion)
    if options.method == "global":
        laid = steered(options, toolpath)
        out += _rotations(toolpath, points, rows, laid) + _wishes(points, rows, laid)
    return out


def _rotations(toolpath: Toolpath, points: Points, rows: NDArray[np.intp], options: PlanOptions) -> list[Check]:
    """The range where it cuts, and the points at which the user fixed the rotation."""
    at = points.point[rows]
    gamma = points.numbers["gamma_deg"][rows]
    out = []
    low, high = np.degrees(options.rotation_range)
    cut = toolpath.move[np.clip(at, 0, len(toolpath) - 1)] == Move.CUT
    if high - low < 360.0 - ROTATION_DEG and cut.any():
        off = np.maximum(_turned(gamma[cut] - 0.5 * (low + high)) - 0.5 * (high - low), 0.0)
        where = [f"point {n}" for n in at[cut]]
        out.append(worst("as asked: rotation_range_deg", "deg outside", off, ROTATION_DEG, where))
    wished = [(f, n) for f in options.fixed for n in np.flatnonzero(at == f.point)]
    if wished:
        off = _turned(np.array([gamma[n] - np.degrees(f.gamma) for f, n in wished]))
        where = [f"point {f.point}" for f, _ in wished]
        out.append(worst("as asked: fixed rotations", "deg off", off, ROTATION_DEG, where))
    return out


def _wishes(points: Points, rows: NDArray[np.intp], options: PlanOptions) -> list[Check]:
    """The zones that no rotation may lie in, and the branches to use."""
    at, gamma = points.point[rows], points.numbers["gamma_deg"][rows]
    out = []
    zones = [(w, n) for w in options.steer if w.forbid is not None for n in among(w, at)]
    if zones:
        deep = np.array([_depth(gamma[n], np.degrees(w.forbid)) for w, n in zones if w.forbid is not None])
        where = [f"point {at[n]}" for _, n in zones]
        out.append(worst("as asked: forbidden rotations", "deg inside", deep, ROTATION_DEG, where))
    held = [(w, n) for w in options.steer if w.branch is not None for n in among(w, at)]
    if held:
        branch = points.numbers["branch"][rows]
        off = np.array([float(branch[n] != w.branch) for w, n in held])
        out.append(worst("as asked: branch", "of another", off, 0.5, [f"point {at[n]}" for _, n in held]))
    return out


def _depth(gamma: float, zone: Array) -> float:
    """By how much a rotation lies inside a zone, degrees: to the nearer of its ends, 0 outside."""
    beyond, width = (gamma - zone[0]) % 360.0, (zone[1] - zone[0]) % 360.0
    return float(max(min(beyond, width - beyond), 0.0))


def _turned(degrees: Array) -> Array:
    """The least turn there, 0 to 180."""
    return np.abs((degrees + 180.0) % 360.0 - 180.0)
