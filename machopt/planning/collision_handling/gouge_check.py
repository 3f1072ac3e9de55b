"""Gouges: places where the CAM file itself drives the cutter into the finished part, at its points and between them.

The CAM file defines tip position and tool axis. Rotation about the tool axis, branch and external axes
do not change them. Gouges are therefore found on the path alone, before any robot, and no plan can remove them.
The cutter may touch the part and may penetrate it by the tolerance.
The check covers the full length of the cutter, wherever the file moves at a feed. The collision check covers the other
bodies of the tool (holder, spindle), and the cutter in rapid moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.collision.gouge_depth import build_cutter_points, build_spiral_points, compute_gouge_depth
from machopt.data_types.cell import Cell, CollisionShape, CutterGeometry
from machopt.data_types.toolpath import MoveKind
from machopt.errors import CellError
from machopt.numerics.array_types import Array, Bools, Ints
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, normalise_vectors
from machopt.planning.stations.planning_path import PlanningPath

STEP = 5e-4  # m, tip movement between two checked poses
TURN = np.radians(0.25)  # rad, rotation of the tool axis between them
# m: a depth equal to the tolerance does not exceed it. Half of the last digit of a message; meshes are in single
# precision, tables in nanometres.
ROUNDING = 5e-7
AT_ONCE = 100_000  # poses


@dataclass(frozen=True)
class GougeResult:
    """Deepest penetration of the cutter into the part on the way to each planning point, the point itself included."""

    limit: float  # m
    depth: Array  # (P,) m; 0 where it is not deeper than the limit
    place: Array  # (P, 3) m, in the workpiece frame; NaN where depth is 0
    tip: Array  # (P, 3) m, tip position at that place

    @property
    def deep(self) -> Bools:
        """(P,) whether the move to the point gouges."""
        return np.asarray(self.depth > 0.0)

    def sentences(self) -> dict[int, str]:
        """Return per planning point the message about the gouge on the way to it."""
        return {int(p): self._describe_gouge(int(p)) for p in np.flatnonzero(self.deep)}

    def _describe_gouge(self, p: int) -> str:
        x, tip = 1e3 * self.place[p], 1e3 * self.tip[p]
        return (
            f"the cutter gouges the finished part by {1e3 * self.depth[p]:.3f} mm at "
            f"({x[0]:.2f}, {x[1]:.2f}, {x[2]:.2f}) mm, with its tip at ({tip[0]:.2f}, {tip[1]:.2f}, {tip[2]:.2f}); "
            f"gouge_tolerance_mm is {1e3 * self.limit:g}"
        )


def find_gouges(path: PlanningPath, cell: Cell, limit: float) -> GougeResult:
    """Return the gouges along every move at a feed.

    Args:
        path: as programmed, without any compensation.
        cell: its cutter, and the workpiece's bodies as the finished part.
        limit: m, permitted penetration.

    Raises:
        InputError: there is no cutter or no part, or a mesh of the part is open.
    """
    cutter, part = get_cutter_and_part(cell)
    points, between = build_cutter_points(cutter), build_spiral_points(cutter)
    owner, share = _place_poses(path)
    n = len(path.index)
    out = GougeResult(limit, np.zeros(n), np.full((n, 3), np.nan), np.full((n, 3), np.nan))
    for start in range(0, len(owner), AT_ONCE):
        b, f = owner[start : start + AT_ONCE], share[start : start + AT_ONCE, None]
        a = np.maximum(b - 1, 0)
        tip, axis, reference = ((1.0 - f) * v[a] + f * v[b] for v in (path.position, path.axis, path.reference))
        R = compute_tool_rotation(normalise_vectors(axis), reference, np.zeros(len(b)))
        found = compute_gouge_depth(part, points, build_transform(R, tip), limit + ROUNDING, between)
        for m in np.flatnonzero(found.depth > 0.0):
            p = b[m]
            if found.depth[m] > out.depth[p]:
                out.depth[p], out.place[p], out.tip[p] = found.depth[m], found.place[m], tip[m]
    return out


def get_cutter_and_part(cell: Cell) -> tuple[CutterGeometry, tuple[CollisionShape, ...]]:
    """Return the cutter and the bodies of the finished part that the gouge check compares.

    Args:
        cell: cell with tool and workpiece.

    Raises:
        InputError: there is no cutter or no part.
    """
    cutter, part = cell.tool.cutter, cell.workpiece.geometry
    if cutter is None or not part:
        missing_key = "tool.cutter" if cutter is None else "workpiece.geometry"
        raise CellError(
            f"gouge_tolerance_mm needs a cutter and the finished part; this cell has no {missing_key}",
            file=cell.folder / "cell.yaml",
            where=missing_key,
        )
    return cutter, part


def _place_poses(path: PlanningPath) -> tuple[Ints, Array]:
    """Return the planning point that each pose leads to, and its share of that move, above 0 and 1 at the point."""
    fed = np.asarray(path.move != MoveKind.RAPID)
    joined = np.r_[False, path.run[1:] == path.run[:-1]]
    length = np.r_[0.0, np.linalg.norm(np.diff(path.position, axis=0), axis=1)]
    turn = np.r_[0.0, np.linalg.norm(np.diff(path.axis, axis=0), axis=1)]
    pieces = np.maximum(np.ceil(length / STEP), np.ceil(turn / TURN)).astype(int)
    pieces = np.where(fed, np.where(joined, np.maximum(pieces, 1), 1), 0)
    owner = np.repeat(np.arange(len(pieces)), pieces)
    nth = np.arange(len(owner)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 1
    return owner, np.asarray(nth / pieces[owner])
