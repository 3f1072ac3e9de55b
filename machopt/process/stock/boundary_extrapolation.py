"""A straight boundary in polar coordinates about the cutter axis, compiled."""

from __future__ import annotations

from math import acos, atan2, cos, floor, pi, sin, sqrt

from machopt.numerics.compiled_functions import jit_compile


@jit_compile
def measure_line(phi: float, reach: float, far: float, outer: float) -> float:
    """Distance from the centre of the straight line through two places in polar coordinates, m.

    Args:
        phi: rad, angle of the first place.
        reach: m, its radius.
        far: rad, angle of the second place.
        outer: m, its radius.
    """
    x, y = reach * cos(phi), reach * sin(phi)
    dx, dy = outer * cos(far) - x, outer * sin(far) - y
    return abs(x * dy - y * dx) / sqrt(dx * dx + dy * dy)


@jit_compile
def extrapolate_boundary(phi: float, reach: float, far: float, outer: float, radius: float) -> float:
    """Angle at which the straight line through two places meets a circle, near the first place, rad.

    Args:
        phi: rad, angle of the first place.
        reach: m, its radius.
        far: rad, angle of the second place.
        outer: m, its radius.
        radius: m, of the circle.
    """
    x, y = reach * cos(phi), reach * sin(phi)
    dx, dy = outer * cos(far) - x, outer * sin(far) - y
    length = sqrt(dx * dx + dy * dy)
    nx, ny = -dy / length, dx / length  # normal of the line, away from the centre
    distance = nx * x + ny * y
    if distance < 0.0:
        nx, ny, distance = -nx, -ny, -distance
    middle = atan2(ny, nx)
    half = acos(min(distance / radius, 1.0))
    a, b = _turn_near(middle - half, phi), _turn_near(middle + half, phi)
    return a if abs(a - phi) < abs(b - phi) else b


@jit_compile
def _turn_near(angle: float, phi: float) -> float:
    """The angle, whole turns away, that lies within half a turn of another."""
    return angle - 2.0 * pi * floor((angle - phi) / (2.0 * pi) + 0.5)
