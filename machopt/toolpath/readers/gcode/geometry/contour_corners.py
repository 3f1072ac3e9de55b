"""Corners of a contour: RND, CHF, CHR of Sinumerik, ``,R`` and ``,C`` of Fanuc, RND and CHF of Heidenhain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError, compute_arc_chords
from machopt.path_building.corner_rounding import ContourElement, CornerRounding, compute_chamfer, compute_rounding
from machopt.toolpath.readers.gcode.geometry.polar_coordinates import find_plane_axes

CornerKind = Literal["round", "setback", "length"]
_SAME_HEIGHT = 1e-6  # mm


@dataclass(frozen=True, kw_only=True)
class ContourSegment:
    """The contour element carried out last, in programmed coordinates (mm)."""

    start: Array  # (3,)
    end: Array  # (3,)
    first: int  # index of its first point
    feed: float  # mm/min
    centre: Array | None = None
    left: bool = True  # about the plane's axis

    def element(self, plane: Array) -> ContourElement:
        """Project the segment onto the working plane.

        Args:
            plane: Normal of the working plane (3,), unit vector.

        Returns:
            The element in plane coordinates.
        """
        u, v = find_plane_axes(plane)
        a, b = complex(self.start[u], self.start[v]), complex(self.end[u], self.end[v])
        c = None if self.centre is None else complex(self.centre[u], self.centre[v])
        return ContourElement(a, b, c, self.left)

    def flat(self, plane: Array) -> bool:
        """Return whether the segment runs in the plane; an unknown height does not change.

        Args:
            plane: Normal of the working plane (3,), unit vector.
        """
        rise = float((self.end - self.start) @ plane) if not np.isnan((self.end - self.start) @ plane) else 0.0
        return abs(rise) < _SAME_HEIGHT

    def tangent(self, plane: Array) -> Array:
        """Compute the direction at the end of the segment, in the plane.

        Args:
            plane: Normal of the working plane (3,), unit vector.

        Returns:
            Unit vector (3,).

        Raises:
            ArcError: the segment leaves the working plane.
        """
        e = self.element(plane)
        if e.centre is None and not abs(e.end - e.start) > 1e-9:
            raise ArcError("a tangential arc (CT) after a move across the working plane has no direction")
        d = e.direction(e.end)
        u, v = find_plane_axes(plane)
        found = np.zeros(3)
        found[u], found[v] = d.real, d.imag
        return found


@dataclass(frozen=True)
class ContourCorner:
    """What is put between the element before and the next one."""

    kind: CornerKind
    size: float  # mm
    line: int
    feed: float | None = None  # mm/min, None: that of the element before
    stays: bool = False  # RNDM: at every corner


@dataclass(frozen=True)
class FittedCorner:
    """A corner between two elements, in programmed coordinates (mm)."""

    before: Array  # (N, 3) chord ends of the element before, up to where the corner begins
    between: Array  # (M, 3) chord ends of the corner
    curved: bool


def fit_corner(
    corner: ContourCorner, before: ContourSegment, after: ContourSegment, plane: Array, tolerance: float
) -> FittedCorner | None:
    """Cut both elements back and put the corner between them; None where there is no corner to cut.

    Args:
        corner: rounding or chamfer.
        before, after: elements; ``after`` begins where ``before`` ends.
        plane: (3,) unit axis of the working plane.
        tolerance: mm of chords.
    Raises:
        ArcError: it does not fit, or an element leaves the plane.
    """
    if not (before.flat(plane) and after.flat(plane)):
        if corner.stays:
            return None
        raise ArcError("a rounding or chamfer next to a move that leaves the working plane is not supported")
    a, b = before.element(plane), after.element(plane)
    if corner.kind == "round":
        found: CornerRounding | None = compute_rounding(a, b, corner.size)
    elif corner.kind == "setback":
        found = compute_chamfer(a, b, setback=corner.size, length=None)
    else:
        found = compute_chamfer(a, b, setback=None, length=corner.size)
    if found is None:
        return None

    def place(z: complex) -> Array:
        u, v = find_plane_axes(plane)
        p = before.end.copy()
        p[u], p[v] = z.real, z.imag
        return p

    start, end = place(found.start), place(found.end)
    one = start[None]
    if before.centre is not None:
        one = _compute_chords(before.start, start, before.centre, before.left, plane, tolerance)
    if found.centre is None:
        return FittedCorner(one, end[None], curved=False)
    return FittedCorner(
        one, _compute_chords(start, end, place(found.centre), found.left, plane, tolerance), curved=True
    )


def _compute_chords(start: Array, end: Array, centre: Array, left: bool, plane: Array, tolerance: float) -> Array:
    unknown = np.isnan(start)
    a, b, c = (np.where(unknown, 0.0, p) for p in (start, end, centre))
    points = compute_arc_chords(a, b, c, plane if left else -plane, tolerance).points
    return np.where(unknown, math.nan, points)
