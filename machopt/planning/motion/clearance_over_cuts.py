"""Rapid moves where nobody says where the part's material is: over what is cut, not through it.

Without ``workpiece.geometry`` no contact with the part is looked for. What is known all the same: below a cut, seen
along its tool axis, there was material. So a free tip stays over every cut that it passes within the cutter's radius;
it may be below one cut where another one near by goes as deep.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import interpolate_axis

BELOW = 1.5e-4  # m, a rapid move's graze that is let pass: the verifier's own limit is 0.2 mm
SAME_SIDE = float(np.cos(np.radians(30.0)))  # a tool more oblique to a cut than this says nothing about its level
THINNEST = 1e-3  # m, half of a cutter that nobody gave
MOST = 20  # places a move of a cut is looked at


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
    def of(cls, cell: Cell, toolpath: Toolpath) -> CutSurface | None:
        """None where the workpiece's geometry tells where material is, or nothing is cut."""
        if cell.workpiece.geometry or not toolpath.cutting[1:].any():
            return None
        cutter = cell.tool.cutter
        return cls(toolpath, max(cutter.diameter / 2.0 if cutter is not None else THINNEST, THINNEST))

    def under(self, tcp: Array) -> float:
        """m, how deep the deepest of some free poses (S, 4, 4) in the workpiece frame lies under a cut; 0: over all."""
        return float(_deepest(np.array(tcp, float, order="C"), self.place, self.axis, self.radius, SAME_SIDE))


@jit_compile
def _deepest(tcp: Array, place: Array, axis: Array, radius: float, side: float) -> float:
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
