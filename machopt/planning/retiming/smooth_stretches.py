"""Stretches of a run whose points are samples of a smooth curve, filled up with points of that curve.

CAM systems write smooth curves as points within a chord tolerance. Between such points a spline is nearer to the curve
than the line, and it has no corners. A segment counts as smooth where, with the lengths ℓ, the slopes t and the bends
c = Δt / ℓ in the metric of :mod:`machopt.planning.retiming.path_curve`,

* neighbouring lengths differ by at most LENGTHS,
* the turn at either end is at most TURN, and the bends at both ends differ by at most BENDS of the larger one: a corner
  of a part, the end of an arc, noise, and a single point off its line are none,
* the spline leaves the line by at most the tolerance,
* at least ROW segments in a row are so,
* and the rounding that the tolerance allows is passed in less than FAST of the time of the widest rounding: at a lower
  feed the corners of the lines cost no time.

The spline is the cubic through four points (Lagrange). Rounding cuts inwards at the points and the spline is outside of
the line between them, so that both have the full tolerance. :func:`fill_smooth_stretches` adds points; the rounding of
:mod:`machopt.planning.retiming.path_curve` follows as for any other run. The result is compared with the lines of the
file there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools

LENGTHS = 3.0
TURN = float(np.cos(np.radians(15.0)))
BENDS = 0.5
ROW = 5
KERNEL = 14.0  # a curve of bend c, rounded with the half-width L, leaves itself by c·L²/14: variance of the kernel
PARTS_A_WIDTH = 6.0  # points for each half-width that the tolerance allows
FAST = 0.5  # of the widest rounding, 0.1 s at the programmed feed: benchmarks/retiming_peers.py gains below 0.05 s
MOST_PARTS = 10  # of a segment


@dataclass(frozen=True)
class FilledPolyline:
    """A polyline with further vertices."""

    u: Array  # (m,) path parameter
    pose: Array  # (m, 6) position and axis, of the vertices and of the spline
    segment: Array  # (m,) original segment and share of it, as segment + share


def fill_smooth_stretches(u: Array, pose: Array, scale: Array, cap: Array) -> FilledPolyline | None:
    """Return a polyline with points of the spline in its smooth segments; None where there are none.

    Args:
        u: (n,) path parameter of the vertices, increasing.
        pose: (n, 6) position in m and unit axis.
        scale: (6,) reciprocal tolerances of position and axis.
        cap: (n,) widest rounding of each vertex, a time at the programmed feed, in units of u.
    """
    if len(u) < 4:
        return None
    parts = _count_parts(u, pose * scale, np.minimum(cap[1:], cap[:-1]))
    if (parts <= 1).all():
        return None
    start: NDArray[np.int64] = np.repeat(np.arange(len(u) - 1), parts)
    share: Array = np.concatenate([np.arange(n) / n for n in parts.tolist()])
    rows: Array = np.append(start + share, len(u) - 1.0)
    at: Array = np.interp(rows, np.arange(len(u)), u)
    filled = np.column_stack([np.interp(rows, np.arange(len(u)), column) for column in pose.T])
    inside = np.flatnonzero(share > 0.0)
    filled[inside] = _interpolate(u, pose, start[inside], at[inside])
    return FilledPolyline(at, filled, rows)


def _count_parts(u: Array, X: Array, cap: Array) -> NDArray[np.int64]:
    """Return (n − 1,) the parts of each segment; 1 where it stays a line.

    ``X`` (n, 6) is in units of the tolerances; ``cap`` (n − 1,) is the widest rounding in each segment.
    """
    length = np.diff(u)
    slope = np.diff(X, axis=0) / length[:, None]
    bend = np.diff(slope, axis=0) / (0.5 * (length[1:] + length[:-1]))[:, None]  # (n − 2, 6)
    size = np.sqrt(np.maximum((bend[:, :3] ** 2).sum(axis=1), (bend[:, 3:] ** 2).sum(axis=1)))
    smooth = _find_smooth(length, slope, bend)
    parts = np.ones(len(length), np.int64)
    larger = np.maximum(size[1:], size[:-1])
    inner = length[1:-1]
    width = np.sqrt(KERNEL / np.maximum(larger, 1e-12))
    good = smooth & (larger * inner**2 / 8.0 <= 1.0) & (larger > 0.0) & (width <= FAST * cap[1:-1])
    ends = np.flatnonzero(np.diff(np.r_[False, good, False].astype(int))).reshape(-1, 2)
    for first, stop in ends[np.diff(ends, axis=1)[:, 0] < ROW].tolist():
        good[first:stop] = False
    parts[1:-1] = np.where(good, np.clip(np.ceil(PARTS_A_WIDTH * inner / width), 1, MOST_PARTS), 1).astype(np.int64)
    return parts


def _find_smooth(length: Array, slope: Array, bend: Array) -> Bools:
    """Return (n − 3,) whether each inner segment is one of a smooth curve."""
    ratio = np.maximum(length[1:] / length[:-1], length[:-1] / length[1:]) <= LENGTHS
    norm = np.linalg.norm(slope[:, :3], axis=1)
    turns = np.sum(slope[1:, :3] * slope[:-1, :3], axis=1) >= TURN * norm[1:] * norm[:-1]
    vertex = ratio & turns & (norm[1:] > 0.0) & (norm[:-1] > 0.0)
    change = np.linalg.norm(np.diff(bend, axis=0), axis=1)
    size = np.linalg.norm(bend, axis=1)
    return np.asarray(vertex[1:] & vertex[:-1] & (change <= BENDS * np.maximum(size[1:], size[:-1])))


def _interpolate(u: Array, pose: Array, segment: NDArray[np.int64], at: Array) -> Array:
    """Return (M, 6) places of the cubic through the four points around each segment, with unit axes."""
    known = np.stack([segment - 1, segment, segment + 1, segment + 2], axis=1)  # (M, 4)
    x = u[known]
    weight = np.ones_like(x)
    for a in range(4):
        for b in range(4):
            if a != b:
                weight[:, a] *= (at - x[:, b]) / (x[:, a] - x[:, b])
    out = np.einsum("ma,mac->mc", weight, pose[known])
    out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    return np.asarray(out)
