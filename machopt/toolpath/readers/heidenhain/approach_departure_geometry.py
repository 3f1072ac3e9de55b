"""Approach and departure of Heidenhain contours (APPR, DEP).

LT runs along the tangent of the first or last contour element, LN perpendicular to it, CT on a tangent arc. LCT runs
on a tangent arc and then straight to a position. All lie in the working plane, as complex numbers in mm.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from typing import Literal

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError

Lead = Literal["LT", "LN", "CT", "LCT"]


@dataclass(frozen=True)
class LeadPath:
    """Between the contour and the auxiliary point: a straight line, or an arc about ``centre``."""

    helper: complex
    centre: complex | None = None
    left: bool = True  # the arc turns left


@dataclass(frozen=True)
class LeadIn:
    """The words of one APPR or DEP."""

    kind: Lead
    side: float  # of the tool by radius compensation: +1 left of the contour, -1 right, 0 not given
    length: float = 0.0  # mm, LEN
    radius: float = 0.0  # mm; below zero: away from the tool's side
    sweep: float = 0.0  # rad, CCA

    def compute_approach(self, at: complex, tangent: complex, outside: complex) -> LeadPath:
        """Compute the path to a contour from an outside position.

        Args:
            at: Contour point in the working plane, mm.
            tangent: Direction of the contour, unit complex number.
            outside: Position before the approach in the working plane, mm.

        Returns:
            The path to the contour point.

        Raises:
            ArcError: the side is not given, or the position lies inside the arc.
        """
        if self.kind == "LT":
            return LeadPath(at - self.length * tangent)
        if not self.side:
            raise ArcError(f"APPR or DEP {self.kind} without radius compensation (RL, RR): the side is not stated")
        if self.kind == "LN":
            return LeadPath(at + self.side * 1j * tangent * self.length)
        side = math.copysign(self.side, self.side * self.radius)
        radius = abs(self.radius)
        centre = at + side * 1j * tangent * radius
        if self.kind == "CT":
            return LeadPath(centre + (at - centre) * cmath.exp(-1j * side * self.sweep), centre, side > 0.0)
        away = outside - centre
        if abs(away) < radius:
            raise ArcError("APPR or DEP LCT: the place outside of the contour lies within the arc")
        half = math.acos(radius / abs(away))
        for turn in (half, -half):
            spoke = radius * away / abs(away) * cmath.exp(1j * turn)
            if ((centre + spoke - outside) * (side * 1j * spoke).conjugate()).real >= 0.0:
                return LeadPath(centre + spoke, centre, side > 0.0)
        raise AssertionError("one of the two tangents runs the way the arc turns")

    def compute_departure(self, at: complex, tangent: complex, outside: complex | None) -> LeadPath:
        """Compute the path away from a contour: the approach of the reversed contour, travelled backwards.

        Args:
            at: Contour point in the working plane, mm.
            tangent: Direction of the contour, unit complex number.
            outside: Position after the departure in the working plane, mm; None where not given.

        Returns:
            The path from the contour point.

        Raises:
            ArcError: the side is not given, or the position lies inside the arc.
        """
        if self.kind == "LCT" and outside is not None and ((outside - at) / tangent).imag * self.side < 0.0:
            raise ArcError("DEP LCT to a place on the other side of the contour than the tool: not supported")
        back = LeadIn(self.kind, -self.side, self.length, self.radius, self.sweep)
        path = back.compute_approach(at, -tangent, at if outside is None else outside)
        return LeadPath(path.helper, path.centre, not path.left)


@dataclass(frozen=True, kw_only=True)
class ContourApproach:
    """An APPR block, which waits for the contour element behind it. Lengths in mm, feeds in mm/min."""

    path: LeadIn
    start: tuple[float, float, float]
    place: tuple[float, float, float]  # the first contour point
    feed_before: float  # to the auxiliary point; NaN: rapid
    feed: float
    line: int


def convert_to_plane_point(p: Array) -> complex:
    """Convert a point to a complex number of the working plane.

    Args:
        p: Point (2,) or (3,), mm.
    """
    return complex(p[0], p[1])
