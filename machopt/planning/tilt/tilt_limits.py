"""Permitted tilts at each planning point.

A point lies on the move that arrives and on the move that leaves. While these cut, lead and side keep the range of
their operation in the frame (t, a × t) of each move: at a corner the tilt is one, and keeps two ranges. Where nothing
cuts, no range holds and the tilt of the neighbouring cut is kept. A run that nowhere travels across the tool axis
defines no lead; it is not tilted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.stations.planning_path import NO_MOVE, PlanningPath

ACROSS = float(np.sin(np.radians(1.0)))  # share of a move across the axis from which it has a direction of travel
MARGIN = np.radians(0.04)  # kept from the ends of a range: by this the rounded, turning axis leaves it between points
MET = 1e-7  # rad: a range is kept within this
SMOOTH_TURN = np.radians(15.0)  # of the direction of travel: a curve of short moves, not a corner
ROUNDS = 40  # alternating projections onto both ranges of a corner


@dataclass(frozen=True, kw_only=True)
class TiltLimits:
    """Ranges of the tangents (tan lead, tan side) of P planning points, for the leaving and the arriving move."""

    cuts: Bools  # (2, P) whether the leaving, the arriving move cuts, and may tilt
    frame: Array  # (2, P, 2, 3) unit directions t and a × t of the two moves in the workpiece frame
    low: Array  # (2, P, 2)
    high: Array  # (2, P, 2)

    @property
    def is_free(self) -> Bools:
        """(P,) whether the tilt at the point is limited by a cut and not zero."""
        wide = (self.low != 0.0).any(axis=2) | (self.high != 0.0).any(axis=2)
        return np.asarray((self.cuts & wide).any(axis=0))

    def find_excess(self, w: Array) -> Array:
        """Return the (P,) distance of tangent vectors (P, 3) from their ranges.

        Args:
            w: (P, 3) a'/(a'·a) − a.
        """
        parts = np.einsum("spcd,pd->spc", self.frame, w)
        out = np.maximum(np.maximum(self.low - parts, parts - self.high), 0.0).max(axis=2)
        return np.asarray((out * self.cuts).max(axis=0))

    def project(self, w: Array) -> Array:
        """Return tangent vectors (P, 3), normal to the axis, moved into their ranges.

        Args:
            w: (P, 3) a'/(a'·a) − a.
        """
        out = w
        for _ in range(ROUNDS):
            for side in (1, 0):  # the leaving move last
                parts = np.einsum("pcd,pd->pc", self.frame[side], out)
                moved = np.clip(parts, self.low[side], self.high[side]) - parts
                moved[~self.cuts[side]] = 0.0
                out = out + np.einsum("pc,pcd->pd", moved, self.frame[side])
        return out


def compute_tilt_limits(path: PlanningPath, toolpath: Toolpath, options: PlanOptions) -> TiltLimits:
    """Return the permitted tilts of a path.

    Args:
        path: path of the CAM file.
        toolpath: its toolpath.
        options: plan options with the ranges.

    Raises:
        InputError: ranges without 0 that no tilt keeps at a sharp corner.
    """
    n = len(path.index)
    joined: Bools = np.append(False, path.run[1:] == path.run[:-1])
    ranges = [options.tilt_range_of(operation.label) for operation in toolpath.operations]
    angles = np.array([[r.lead, r.side] for r in ranges]).reshape(-1, 2, 2)  # operation, lead and side, end
    room = (angles[:, :, 1] - angles[:, :, 0] > 4.0 * MARGIN)[:, :, None] & (angles != 0.0)
    tangents = np.tan(angles + np.where(room, [MARGIN, -MARGIN], 0.0))
    own = tangents[toolpath.operation[np.ceil(path.index - 1e-9).astype(int)]]  # of the move to each point
    has_travel = _has_travel(path, joined)[path.run]
    own[~has_travel | path.is_drilling] = 0.0
    into: Bools = path.counted & joined
    rows = np.arange(n)
    after, before = np.minimum(rows + 1, n - 1), np.maximum(rows - 1, 0)
    leaving = np.r_[into[1:], False]
    arriving = path.travel[before] - np.sum(path.travel[before] * path.axis, axis=1, keepdims=True) * path.axis
    arriving = np.where(joined[:, None], normalise_vectors(arriving), path.travel)
    travel = np.stack([path.travel, np.where(np.isfinite(arriving), arriving, path.travel)])
    found = TiltLimits(
        cuts=np.stack([leaving, into]),
        frame=np.stack([travel, np.cross(path.axis, travel)], axis=2),
        low=np.stack([own[after, :, 0], own[:, :, 0]]),
        high=np.stack([own[after, :, 1], own[:, :, 1]]),
    )
    return _drop_ranges_of_smooth_turns(found, path, toolpath)


def _drop_ranges_of_smooth_turns(limits: TiltLimits, path: PlanningPath, toolpath: Toolpath) -> TiltLimits:
    """Keep the range of the leaving move alone where no tilt keeps both, and the path turns by a small angle.

    On a curve of short moves the direction of travel turns at every point, and a fixed lead turns with it.
    """
    start = limits.project(np.zeros_like(path.axis))
    lost = limits.find_excess(start) > MET
    if not lost.any():
        return limits
    turn = np.arccos(np.clip(np.sum(limits.frame[0, :, 0] * limits.frame[1, :, 0], axis=1), -1.0, 1.0))
    sharp = np.flatnonzero(lost & (turn > SMOOTH_TURN))
    if len(sharp):
        p = int(sharp[0])
        raise CellError(
            f"no tilt keeps the ranges of both moves at point {path.index[p]:g}, where the direction of travel turns "
            f"by {np.degrees(turn[p]):.0f}°; ranges of lead and side that contain 0 would work",
            file=toolpath.source,
            where="tilt_deg",
        )
    cuts = limits.cuts.copy()
    cuts[1] &= ~(lost & cuts[0])
    return replace(limits, cuts=cuts)


def _has_travel(path: PlanningPath, joined: Bools) -> NDArray[np.bool_]:
    """(runs,) whether some move of a run goes across the tool axis."""
    d = np.diff(path.position, axis=0, prepend=path.position[:1])
    size = np.linalg.norm(d, axis=1)
    across = np.linalg.norm(np.cross(path.axis, d), axis=1)
    good = joined & (size > NO_MOVE) & (across > ACROSS * size)
    return np.asarray(np.bincount(path.run, weights=good) > 0)


def hold_outside_cuts(path: PlanningPath, limits: TiltLimits, w: Array) -> Array:
    """Return tangent vectors (P, 3): as given along cuts, and those of the neighbouring cut everywhere else.

    Between two cuts of a run they change evenly along the way; a run without cuts keeps those of the run before.

    Args:
        path: path of the CAM file.
        limits: permitted tilts.
        w: (P, 3) tangent vectors.
    """
    known = limits.cuts[0] | limits.cuts[1]
    out = w.copy()
    last: Array | None = None
    for first, end in path.runs:
        rows = np.arange(first, end + 1)
        own = rows[known[rows]]
        if len(own):
            for c in range(3):
                out[rows, c] = np.where(known[rows], w[rows, c], np.interp(path.s[rows], path.s[own], w[own, c]))
            last = out[own[-1]]
        else:
            out[rows] = 0.0 if last is None or end > first else last
    return np.asarray(out - np.sum(out * path.axis, axis=1, keepdims=True) * path.axis)
