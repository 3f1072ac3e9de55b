"""Rapid moves above the cuts, for cells without workpiece geometry.

Without ``workpiece.geometry`` there is no collision check with the part. Still, below a cut, seen
along its tool axis, there was material. A free tip therefore stays above every cut that it passes within the cutter's
radius. It may be below one cut where another one near by is as deep.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import interpolate_axis

BELOW = 1.5e-4  # m, permitted depth of a rapid move below a cut; the limit of the verification is 0.2 mm
SAME_SIDE = float(np.cos(np.radians(30.0)))  # the level of a cut is undefined for a tool inclined more than this
THINNEST = 1e-3  # m, radius of an unspecified cutter
MOST = 20  # maximum number of checked places per cutting move


class CutSurface:
    """The cuts of a toolpath, as places and axes.

    Attributes:
        place: (M, 3) m, in the workpiece frame, on the cuts, a cutter's radius apart where MOST a cut allows it.
        axis: (M, 3) the tool's axis there, from tip to shank.
    """

    def __init__(self, toolpath: Toolpath, radius: float) -> None:
        ends = 1 + np.flatnonzero(toolpath.cutting[1:])
        a, b = toolpath.position[ends - 1], toolpath.position[ends]
        count = np.clip(np.ceil(np.linalg.norm(b - a, axis=1) / radius), 1, MOST).astype(int)
        of = np.repeat(np.arange(len(ends)), count + 1)
        part = (np.arange(len(of)) - np.repeat(np.cumsum(count + 1) - count - 1, count + 1)) / count[of]
        share = part[:, None]
        self.radius = radius
        self.place = np.ascontiguousarray(a[of] + share * (b - a)[of])
        before, after = toolpath.axis[ends - 1], toolpath.axis[ends]
        self.axis = np.ascontiguousarray(interpolate_axis(before[of], after[of], part))

    @classmethod
    def build(cls, cell: Cell, toolpath: Toolpath) -> CutSurface | None:
        """Return the cuts of a toolpath; None where the workpiece geometry describes the material, or nothing is cut.

        Args:
            cell: robot cell with tool and workpiece.
            toolpath: toolpath in the workpiece frame.
        """
        if cell.workpiece.geometry or not toolpath.cutting[1:].any():
            return None
        cutter = cell.tool.cutter
        return cls(toolpath, max(cutter.diameter / 2.0 if cutter is not None else THINNEST, THINNEST))

    @classmethod
    def list_near(cls, cell: Cell, toolpath: Toolpath, distance: float) -> CutSurface | None:
        """Return the cuts of a toolpath, each within a cutter's radius and a distance; None where there are none.

        Args:
            cell: robot cell with its tool.
            toolpath: toolpath in the workpiece frame.
            distance: m, beyond the radius.
        """
        if not toolpath.cutting[1:].any():
            return None
        cutter = cell.tool.cutter
        return cls(toolpath, max(cutter.diameter / 2.0 if cutter is not None else THINNEST, THINNEST) + distance)

    def is_below(self, tcp: Array) -> bool:
        """Return whether no cut near some poses, seen along its axis, is above them.

        Args:
            tcp: (S, 4, 4) TCP poses in the workpiece frame.
        """
        return not _find_higher(np.array(tcp, float, order="C"), self.place, self.axis, self.radius)

    def under(self, tcp: Array) -> float:
        """Return the greatest depth in m of some free poses below a cut; 0: all are above.

        Args:
            tcp: (S, 4, 4) TCP poses in the workpiece frame.
        """
        return float(_find_deepest(np.array(tcp, float, order="C"), self.place, self.axis, self.radius, SAME_SIDE))


@jit_compile
def _find_deepest(tcp: Array, place: Array, axis: Array, radius: float, side: float) -> float:
    deepest = 0.0
    for n in range(len(tcp)):
        over, seen = -np.inf, False
        for m in range(len(place)):
            facing, height, square = 0.0, 0.0, 0.0
            for c in range(3):
                up = tcp[n, c, 3] - place[m, c]
                facing -= axis[m, c] * tcp[n, c, 2]
                height += axis[m, c] * up
                square += up * up
            if facing > side and square - height * height <= radius * radius:
                over, seen = max(over, height), True
                if over >= 0.0:
                    break
        if seen and -over > deepest:
            deepest = -over
    return deepest


@jit_compile
def _find_higher(tcp: Array, place: Array, axis: Array, radius: float) -> bool:
    for n in range(len(tcp)):
        for m in range(len(place)):
            facing, height, square = 0.0, 0.0, 0.0
            for c in range(3):
                up = tcp[n, c, 3] - place[m, c]
                facing -= axis[m, c] * tcp[n, c, 2]
                height += axis[m, c] * up
                square += up * up
            if facing > 0.0 and height < -BELOW and square - height * height <= radius * radius:
                return True
    return False
