"""Roundings and chamfers between two contour elements of one plane. Any length unit; points are complex numbers."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from machopt.path_building.arc_chords import ArcError

_STRAIGHT = 1e-9  # sine of the angle between two elements below which there is no corner
_INSIDE = 1e-9  # share of an element its tangent point may lie beyond its end, by rounding


@dataclass(frozen=True)
class ContourElement:
    """A line, or an arc about ``centre``."""

    start: complex
    end: complex
    centre: complex | None = None
    left: bool = True  # the arc turns left (counterclockwise)

    @property
    def radius(self) -> float:
        assert self.centre is not None
        return abs(self.start - self.centre)

    def direction(self, at: complex) -> complex:
        """Compute the unit tangent at a point of the element, in the direction of travel.

        Args:
            at: Point of the element.

        Returns:
            Unit complex number.

        Raises:
            ArcError: the element has no length.
        """
        turned = 1j if self.left else -1j
        d = self.end - self.start if self.centre is None else (at - self.centre) * turned
        if not abs(d) > 1e-12:
            raise ArcError("a contour element of no length has no direction")
        return d / abs(d)

    def share(self, at: complex) -> float:
        """Compute the relative position of a point of the element.

        Args:
            at: Point of the element.

        Returns:
            0 at the start, 1 at the end.
        """
        if self.centre is None:
            d = self.end - self.start
            return ((at - self.start) * d.conjugate()).real / abs(d) ** 2
        sense = 1.0 if self.left else -1.0
        whole = (sense * cmath.phase((self.end - self.centre) / (self.start - self.centre))) % math.tau or math.tau
        so_far = (sense * cmath.phase((at - self.centre) / (self.start - self.centre))) % math.tau
        return so_far / whole

    def nearest(self, to: complex) -> complex:
        """Project a point perpendicularly onto the line or circle of the element.

        Args:
            to: The point.

        Returns:
            Foot of the perpendicular.

        Raises:
            ArcError: the point is the centre of the circle.
        """
        if self.centre is None:
            d = self.direction(self.start)
            return self.start + ((to - self.start) * d.conjugate()).real * d
        away = to - self.centre
        if not abs(away) > 1e-12:
            raise ArcError("the centre of the rounding is that of the adjacent arc")
        return self.centre + self.radius * away / abs(away)


@dataclass(frozen=True)
class CornerRounding:
    """Replaces the corner: the first element ends at ``start``, the next one begins at ``end``."""

    start: complex
    end: complex
    centre: complex | None = None  # None: a chamfer
    left: bool = True


def compute_rounding(before: ContourElement, after: ContourElement, radius: float) -> CornerRounding | None:
    """Compute the arc of a radius that touches both elements.

    Its centre is ``radius`` away from both, on the side to which they turn. Of the intersections of the two offset
    curves, the one nearest to the corner whose tangent points lie on the elements is taken.

    Args:
        before: Element before the corner.
        after: Element behind the corner.
        radius: Radius of the rounding.

    Returns:
        The rounding, None where the elements meet without a corner.

    Raises:
        ArcError: the elements turn back, or are too short for that radius.
    """
    side = _find_turn_side(before, after)
    if side == 0.0:
        return None
    corner = before.end
    found: list[tuple[float, CornerRounding]] = []
    for centre in _find_offset_crossings(before, after, radius * side):
        start, end = before.nearest(centre), after.nearest(centre)
        if all(abs(one - 0.5) <= 0.5 + _INSIDE for one in (before.share(start), after.share(end))):
            found.append((abs(centre - corner), CornerRounding(start, end, centre, side > 0.0)))
    if not found:
        raise ArcError(f"a rounding of {radius:g} mm does not fit between the adjacent contour elements")
    return min(found, key=lambda f: f[0])[1]


def compute_chamfer(
    before: ContourElement, after: ContourElement, *, setback: float | None, length: float | None
) -> CornerRounding | None:
    """Compute a straight chamfer at a corner of two lines, by its setback or its own length.

    length = 2 setback sin(θ/2), θ the angle between the lines inside the corner.

    Args:
        before: Element before the corner.
        after: Element behind the corner.
        setback: Distance of its ends from the corner, None where the length is given.
        length: Length of the chamfer, None where the setback is given.

    Returns:
        The chamfer, None where the lines meet without a corner.

    Raises:
        ArcError: an element is an arc, or the lines turn back or are too short.
    """
    if before.centre is not None or after.centre is not None:
        raise ArcError("a chamfer next to an arc is not supported; export its points")
    if _find_turn_side(before, after) == 0.0:
        return None
    first, then = before.direction(before.end), after.direction(after.start)
    if setback is None:
        inside = math.pi - abs(cmath.phase(then / first))
        setback = (length or 0.0) / (2.0 * math.sin(inside / 2.0))
    if setback > min(abs(before.end - before.start), abs(after.end - after.start)) + _INSIDE:
        raise ArcError(f"a chamfer {setback:g} mm from the corner does not fit between the adjacent lines")
    return CornerRounding(before.end - setback * first, after.start + setback * then)


def _find_turn_side(before: ContourElement, after: ContourElement) -> float:
    """+1: they turn left, −1: right, 0: no corner."""
    turn = after.direction(after.start) / before.direction(before.end)
    if abs(turn.imag) < _STRAIGHT:
        if turn.real < 0.0:
            raise ArcError("a corner where the contour turns back on itself can be neither rounded nor chamfered")
        return 0.0
    return math.copysign(1.0, turn.imag)


def _find_offset_crossings(a: ContourElement, b: ContourElement, offset: float) -> list[complex]:
    """Where the curves ``offset`` to the left of both cross."""
    if a.centre is None and b.centre is None:
        d, e = a.direction(a.start), b.direction(b.start)
        p, q = a.start + 1j * offset * d, b.start + 1j * offset * e
        return [p + d * _compute_cross(q - p, e) / _compute_cross(d, e)]
    if a.centre is None or b.centre is None:
        line, circle = (a, b) if a.centre is None else (b, a)
        assert circle.centre is not None
        d = line.direction(line.start)
        p = line.start + 1j * offset * d
        foot = p + ((circle.centre - p) * d.conjugate()).real * d
        square = _compute_offset_radius(circle, offset) ** 2 - abs(foot - circle.centre) ** 2
        half = math.sqrt(square) if square > 0.0 else 0.0
        return [] if square < 0.0 else [foot - half * d, foot + half * d]
    r, s = _compute_offset_radius(a, offset), _compute_offset_radius(b, offset)
    between = b.centre - a.centre
    distance = abs(between)
    if not distance > 1e-12:
        return []
    along = (distance**2 + r**2 - s**2) / (2.0 * distance)
    square = r**2 - along**2
    if square < 0.0:
        return []
    u = between / distance
    return [a.centre + u * complex(along, h) for h in (math.sqrt(square), -math.sqrt(square))]


def _compute_offset_radius(arc: ContourElement, offset: float) -> float:
    """Radius of the circle ``offset`` to the left of an arc."""
    return abs(arc.radius - offset if arc.left else arc.radius + offset)


def _compute_cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag
