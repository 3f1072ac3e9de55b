"""Reference direction of the rotation angle gamma, as docs/conventions.md defines it, from the CAM file's points.

gamma turns the TCP about its own z (which points out of the tool, so −z is the CAM axis), right-handed. gamma = 0 is,
projected on the plane normal to the tool axis: the file's own reference direction where it gives one; workpiece x for
point operations (y where x is within 1° of the axis); else the direction of travel. The direction of travel at a point
is that of the move that leaves it, at the end of a run that of the move that ends there. Where that move runs along
the tool axis (within 1°) it is that of the next move of the run that does not, else of the one before, else workpiece
x or y. A run begins at each rapid move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.path_geometry.axis_interpolation import interpolate_axis

MIN_MOVE_M = 1e-10  # m, far below the decimals of any file
MIN_AXIS_ANGLE_RAD = np.radians(1.0)  # a move this near the tool axis has no direction across it


@dataclass(frozen=True, kw_only=True)
class PathDirections:
    """Reference direction and direction of travel at M places of the path, both normal to the axis there.

    ``other`` is the direction of travel of a later move, where that may be used too; ``second`` is the reference by
    it. Along a plunge the axis may turn, so the same move exceeds the 1° on its way. NaN where there is only one.
    """

    axis: Array  # (M, 3) unit, tip to shank
    travel: Array  # (M, 3) unit
    other: Array  # (M, 3)
    move: Array  # (M, 3) m, the move that the direction of travel is taken from
    zero: Array  # (M, 3) unit, TCP x at gamma = 0
    second: Array  # (M, 3)

    def compute_rotation_angle(self, tcp: Array) -> Array:
        """Return the (M, 2) rotation about the TCP's own z from either reference, projected across z, rad.

        Args:
            tcp: (M, 4, 4) or (M, 3, 4) poses of the TCP in the workpiece frame.
        """
        x, z = tcp[:, :3, 0], tcp[:, :3, 2]
        out = np.full((len(x), 2), np.nan)
        for c, zero in enumerate((self.zero, self.second)):
            out[:, c] = np.arctan2(np.einsum("ij,ij->i", np.cross(zero, x), z), np.einsum("ij,ij->i", zero, x))
        return out


def compute_directions_at_points(toolpath: Toolpath) -> PathDirections:
    """Return the directions at every point of the toolpath.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    n = len(toolpath)
    joined = is_joined_to_next(toolpath)
    step = _remove_noise(np.diff(toolpath.position, axis=0))
    move = np.zeros((n, 3))
    move[:-1][joined] = step[joined]
    ends = np.r_[False, joined] & ~np.r_[joined, False]
    move[1:][ends[1:]] = step[ends[1:]]
    travel, used = _compute_travel(move, toolpath.axis, np.r_[False, joined])
    later = np.vstack([toolpath.axis[1:], toolpath.axis[-1:]])
    turning = (
        np.r_[joined, False]
        & ~_project_across_axis(move, toolpath.axis)[1]
        & (np.abs(later - toolpath.axis).max(axis=1) > 0)
    )
    other = np.where(
        turning[:, None], _project_and_normalise(_project_and_normalise(move, later), toolpath.axis), np.nan
    )
    return _build_directions(toolpath, np.arange(n), toolpath.axis, travel, used, other)


def interpolate_directions(toolpath: Toolpath, known: PathDirections, index: Array, *, leaving: bool) -> PathDirections:
    """Return the directions at fractional indices inside moves that are not rapid.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        known: Directions at the points.
        index: (M,) fractional toolpath indices.
        leaving: At a whole index, take the move that leaves the point instead of the one that leads to it.
    """
    last = len(toolpath) - 1
    if leaving:
        low = np.clip(np.floor(index + INDEX_TOLERANCE).astype(int), 0, last)
        low = np.where(is_joined_to_next(toolpath, padded=True)[low], low, np.maximum(low - 1, 0))
    else:
        low = np.clip(np.ceil(index - INDEX_TOLERANCE).astype(int) - 1, 0, last)
    high = np.minimum(low + 1, last)
    axis = interpolate_axis(toolpath.axis[low], toolpath.axis[high], np.clip(index - low, 0.0, 1.0))
    move = _remove_noise(toolpath.position[high] - toolpath.position[low])
    good: NDArray[np.bool_] = _project_across_axis(move, axis)[1]
    # the axis turns without travel, or the tool travels along it: the move that gives the direction at the point
    used = np.where(good[:, None], move, known.move[low])
    clear: NDArray[np.bool_] = _project_across_axis(used, axis)[1]
    travel = np.where(
        clear[:, None], _project_and_normalise(used, axis), _project_and_normalise(known.travel[low], axis)
    )
    nowhere = np.asarray(~used.any(axis=1))  # no move of the run has a direction
    travel = np.where(nowhere[:, None], _project_and_normalise(_project_workpiece_x(axis), axis), travel)
    # inside a plunge whose axis turns: what the same move says farther on
    there = toolpath.axis[high]
    turning = ~good & _project_across_axis(move, there)[1]
    other = np.where(turning[:, None], _project_and_normalise(_project_and_normalise(move, there), axis), np.nan)
    # what the file gives at a point holds for the move that leaves it, as the direction of travel does
    return _build_directions(toolpath, low, axis, travel, used, other)


INDEX_TOLERANCE = 1e-6  # of an index, which is printed with six decimals


def is_joined_to_next(toolpath: Toolpath, *, padded: bool = False) -> NDArray[np.bool_]:
    """Return (N − 1,) whether the move from each point to the next is not rapid.

    Args:
        toolpath: The toolpath, points in the workpiece frame, SI.
        padded: Append False, so that the result has shape (N,).
    """
    joined = np.asarray(toolpath.move[1:] != MoveKind.RAPID)
    return np.r_[joined, False] if padded else joined


def _remove_noise(move: Array) -> Array:
    """Moves (M, 3) m, zero where they are shorter than NO_MOVE and so have no direction."""
    return np.where(np.linalg.norm(move, axis=1, keepdims=True) > MIN_MOVE_M, move, 0.0)


def _compute_travel(move: Array, axis: Array, joined: NDArray[np.bool_]) -> tuple[Array, Array]:
    """(N, 3) direction of travel, and (N, 3) the move it is from: the next of the run, else the last."""
    flat, good = _project_and_normalise(move, axis), _project_across_axis(move, axis)[1]
    n = len(move)
    run = np.cumsum(~joined)
    rows = np.arange(n)
    after = np.minimum.accumulate(np.where(good, rows, n)[::-1])[::-1]  # nearest good one at or after
    before = np.maximum.accumulate(np.where(good, rows, -1))
    use_after = (after < n) & (run[np.minimum(after, n - 1)] == run)
    use_before = (before >= 0) & (run[np.maximum(before, 0)] == run)
    source = np.where(use_after, np.minimum(after, n - 1), np.maximum(before, 0))
    here, clear = _project_and_normalise(move[source], axis), _project_across_axis(move[source], axis)[1]
    lent = np.where(clear[:, None], here, flat[source])
    out = np.where((use_after | use_before)[:, None], lent, _project_workpiece_x(axis))
    used = np.where((use_after | use_before)[:, None], move[source], 0.0)
    return _project_and_normalise(out, axis), used  # it may come from a place where the axis was another


def _build_directions(
    toolpath: Toolpath, of: NDArray[np.intp], axis: Array, travel: Array, move: Array, other: Array
) -> PathDirections:
    """``of``: (M,) the point whose move, operation and reference direction count at each place."""
    drilling = np.array([o.kind == "point" for o in toolpath.operations])[toolpath.operation[of]]
    given = toolpath.reference[of]
    with np.errstate(invalid="ignore"):
        size, useful = _project_across_axis(given, axis)
    del size
    own = np.where(useful[:, None], _project_and_normalise(np.nan_to_num(given), axis), 0.0)

    def zero(across: Array) -> Array:
        out = np.where(drilling[:, None] & ~np.isnan(across), _normalise(_project_workpiece_x(axis)), across)
        return np.where(useful[:, None] & ~np.isnan(across), own, _project_and_normalise(out, axis))

    return PathDirections(axis=axis, travel=travel, other=other, move=move, zero=zero(travel), second=zero(other))


def _project_across_axis(v: Array, axis: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Length of v (M, 3) across the axis, and whether it says a direction there."""
    size = np.linalg.norm(np.cross(axis, v), axis=1)
    return size, (size > np.sin(MIN_AXIS_ANGLE_RAD) * np.linalg.norm(v, axis=1)) & (size > 0)


def _project_and_normalise(v: Array, axis: Array) -> Array:
    """Unit vectors of v (M, 3) projected on the plane normal to the axis; zero where nothing is left."""
    return _normalise(v - np.einsum("ij,ij->i", v, axis)[:, None] * axis)


def _project_workpiece_x(axis: Array) -> Array:
    """Workpiece x projected on the plane normal to the axis; y where x is along the axis."""
    x = np.where((np.abs(axis[:, 0]) > np.cos(MIN_AXIS_ANGLE_RAD))[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    return np.asarray(x - np.einsum("ij,ij->i", x, axis)[:, None] * axis)


def _normalise(v: Array) -> Array:
    size = np.linalg.norm(v, axis=1, keepdims=True)
    return np.asarray(v / np.where(size > 0, size, 1.0))
