"""Process force for the check of a compensated path, recomputed piece by piece along the toolpath.

The law is the one that machopt states for its compensation. A mean over 2ℓ of the force along the run (outside the cuts
that of the nearest one), times a share that fades over λ away from the cuts and at ends of a run that is only come from
or gone to. Between two cuts no more than 2λ apart the share is 1. The sideways direction of the force is that of the
travel across the tool axis, and within 10° of the axis it is blended into that of the next place that travels across
(else the last; else the workpiece x axis).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import ProcessForce
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.identity_cache import IdentityCache
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis

MIN_ACROSS_SINE = 0.17364817766693033  # sin 10°
_SIDEWAYS: IdentityCache[Toolpath, Array] = IdentityCache()
WINDOW_PIECES = 200  # of a window
MIN_PARALLEL_COSINE = 0.9998476951563913  # cos 1°


@dataclass(frozen=True, kw_only=True)
class RunPieces:
    """Straight moves of a run that have a length, in order."""

    start: Array  # (M,) m along the run
    end: Array  # (M,)
    direction: Array  # (M, 3)
    axis_start: Array  # (M, 3)
    axis_end: Array  # (M, 3)
    cut: NDArray[np.bool_]  # (M,)
    force: Array | None = None  # (M, 3) N along travel, normal, axis; NaN: that of the options; None: all

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(M,) cuts with a force: on the way out of a hole there is none."""
        return self.cut if self.force is None else self.cut & (self.force != 0.0).any(axis=1)


def compute_mean_force(toolpath: Toolpath, index: Array, force: ProcessForce, length: float) -> Array:
    """Return the (P, 3) mean of the force over ± a length of path in the workpiece frame, N; zero in runs without one.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        index: (P,) fractional toolpath points.
        force: The force of the cut: along, across and axial components, N.
        length: Path length over which the force turns, m.
    """
    out = np.zeros((len(index), 3))
    for first, last in list_runs(toolpath):
        rows = np.flatnonzero((index >= first - 1e-9) & (index <= last + 1e-9))
        pieces, at = list_run_pieces(toolpath, first, last)
        if not pieces.loaded.any():
            continue
        table = _RunForce(pieces, force)
        places = np.interp(index[rows], np.arange(first, last + 1), at)
        for row, s in zip(rows.tolist(), places.tolist(), strict=True):
            window = s + length * ((np.arange(WINDOW_PIECES) + 0.5) / WINDOW_PIECES * 2 - 1)
            out[row] = table.compute_force(window).mean(axis=0)
    return out


def compute_engaged_share(toolpath: Toolpath, index: Array, length: float) -> Array:
    """Return the (P,) share of the force that is left away from the cuts, 0 to 1.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        index: (P,) fractional toolpath points.
        length: Path length over which the force fades, m.
    """
    out = np.zeros(len(index))
    for first, last in list_runs(toolpath):
        rows = np.flatnonzero((index >= first - 1e-9) & (index <= last + 1e-9))
        pieces, at = list_run_pieces(toolpath, first, last)
        if pieces.cut.any():
            places = np.interp(index[rows], np.arange(first, last + 1), at)
            out[rows] = [_compute_share(pieces, s, length) for s in places.tolist()]
    return out


def compute_sideways_directions(toolpath: Toolpath) -> Array:
    """Return the (N, 3) sideways force direction of the move that leaves each point; at a run's end of the move to
    it.

    Its length is 1 across the axis and along it; in the blend between both it may be shorter.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.

    Returns:
        An array that must not be written: it is kept with the toolpath.
    """
    return _SIDEWAYS.get(toolpath, _compute_sideways)


def _compute_sideways(toolpath: Toolpath) -> Array:
    out = np.zeros((len(toolpath), 3))
    for first, last in list_runs(toolpath):
        pieces, at = list_run_pieces(toolpath, first, last)
        rows = np.arange(first, last + 1)
        leaves = np.maximum(np.minimum(rows, last - 1), first)  # the point that the move begins at
        step = toolpath.position[np.minimum(leaves + 1, last)] - toolpath.position[leaves]
        size, axis = np.linalg.norm(step, axis=1), toolpath.axis[rows]
        lead = np.zeros_like(axis)
        if len(pieces.end):
            n = np.searchsorted(pieces.end, at[leaves - first], side="right")
            lead = _compute_lead_directions(pieces)[np.minimum(n, len(pieces.end) - 1)]
        side, moves = _project_lead(lead, axis), size > 0
        out[rows] = side
        out[rows[moves]] = _blend_directions(step[moves] / size[moves, None], axis[moves], side[moves])
    out.setflags(write=False)
    return out


def list_runs(toolpath: Toolpath) -> list[tuple[int, int]]:
    """Return first and last point of each stretch that begins where a rapid move ends.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    begins = np.union1d(0, np.flatnonzero(toolpath.move == MoveKind.RAPID)).tolist()
    return [(a, b - 1) for a, b in zip(begins, [*begins[1:], len(toolpath)], strict=True)]


def list_run_pieces(toolpath: Toolpath, first: int, last: int) -> tuple[RunPieces, Array]:
    """Return the moves of a run, and the length along it at each of its points, m.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        first: First point of the run.
        last: Last point of the run.
    """
    step = np.diff(toolpath.position[first : last + 1], axis=0)
    size = np.linalg.norm(step, axis=1)
    at = np.append(0.0, np.cumsum(size))
    moves = np.flatnonzero(size > 0)
    ends = first + moves + 1
    return RunPieces(
        start=at[moves],
        end=at[moves + 1],
        direction=step[moves] / size[moves, None],
        axis_start=toolpath.axis[ends - 1],
        axis_end=toolpath.axis[ends],
        cut=np.asarray(toolpath.move[ends] == MoveKind.CUT),
        force=None if toolpath.force is None else toolpath.force[ends],
    ), at


def _compute_share(pieces: RunPieces, s: float, length: float) -> float:
    starts, ends = pieces.start[pieces.cut], pieces.end[pieces.cut]
    away = float(np.maximum(np.maximum(starts - s, s - ends), 0.0).min())
    between = (ends[:-1] <= s) & (s <= starts[1:]) & (starts[1:] - ends[:-1] <= 2.0 * length)
    share = 1.0 if between.any() else 1.0 - away / length
    last = float(pieces.end[-1])
    if not pieces.cut[0] and float(starts[0]) >= length:  # a shorter way in has no room for a ramp
        share = min(share, s / length)
    if not pieces.cut[-1] and last - float(ends[-1]) >= length:
        share = min(share, (last - s) / length)
    return min(max(share, 0.0), 1.0)


class _RunForce:
    """The force at places along a run."""

    def __init__(self, pieces: RunPieces, force: ProcessForce) -> None:
        cut = pieces.loaded
        self.force = force
        self.starts, self.ends, self.direction = pieces.start[cut], pieces.end[cut], pieces.direction[cut]
        self.axes = pieces.axis_start[cut], pieces.axis_end[cut]
        self.lead = _compute_lead_directions(pieces)[cut]
        self.own = None if pieces.force is None else pieces.force[cut]

    def compute_force(self, s: Array) -> Array:
        """Return the (n, 3) force at places of the run, N; outside the cuts with a force that of the nearest one.

        Args:
            s: (n,) places along the run, m.
        """
        away = np.maximum(np.maximum(self.starts - s[:, None], s[:, None] - self.ends), 0.0)
        n = away.argmin(axis=1)
        f = (np.clip(s, self.starts[n], self.ends[n]) - self.starts[n]) / (self.ends[n] - self.starts[n])
        axis = interpolate_axis(self.axes[0][n], self.axes[1][n], f)
        side = _blend_directions(self.direction[n], axis, _project_lead(self.lead[n], axis))
        travel, normal, axial = self.force.resolve_components(None if self.own is None else self.own[n])
        return np.asarray(travel * side + normal * np.cross(axis, side) + axial * axis)


def _blend_directions(direction: Array, axis: Array, lead: Array) -> Array:
    """(n, 3) the travel across the axis where there is enough of it, the lead where there is none."""
    flat = _project_across_axis(direction, axis)
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    x = np.minimum(size / MIN_ACROSS_SINE, 1.0)
    w = x**2 * (3 - 2 * x)
    return np.asarray(w * flat / np.where(size > 0, size, 1.0) + (1 - w) * lead)


def _compute_lead_directions(pieces: RunPieces) -> Array:
    """(M, 3) of each piece the sideways direction that a plunge there takes: of the next across, else of the last.

    Zero where no piece of the run goes across.
    """
    middle = pieces.axis_start + pieces.axis_end
    flat = _project_across_axis(pieces.direction, middle / np.linalg.norm(middle, axis=1, keepdims=True))
    size = np.linalg.norm(flat, axis=1)
    across = np.flatnonzero(size >= MIN_ACROSS_SINE)
    if not len(across):
        return np.zeros_like(flat)
    n = across[np.minimum(np.searchsorted(across, np.arange(len(size))), len(across) - 1)]
    return np.asarray(flat[n] / size[n, None])


def _project_lead(lead: Array, axis: Array) -> Array:
    """(n, 3) unit vectors across the axes: the leads, or the workpiece x axis (y where x is parallel to the axis)."""
    x = np.where(np.abs(axis[:, :1]) <= MIN_PARALLEL_COSINE, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    flat, bare = _project_across_axis(lead, axis), _project_across_axis(x, axis)
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    bare /= np.linalg.norm(bare, axis=1, keepdims=True)
    return np.where(size > 1e-9, flat / np.where(size > 1e-9, size, 1.0), bare)


def _project_across_axis(v: Array, axis: Array) -> Array:
    return np.asarray(v - np.sum(v * axis, axis=1, keepdims=True) * axis)
