"""Hole positions in rows, circles and grids. Any consistent length unit, angles in degrees."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

MOST_HOLES = 10_000


def generate_hole_row(v: Sequence[float], count: int) -> Iterator[tuple[float, float]]:
    """Generate the holes of a row (HOLES1).

    Args:
        v: Reference point, angle, distance of the first hole from it, distance between holes.
        count: Number of holes.

    Returns:
        Position of each hole.
    """
    x, y, angle, first, pitch = v[:5]
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    for k in range(count):
        d = first + k * pitch
        yield x + d * c, y + d * s


def generate_hole_circle(v: Sequence[float], count: int) -> Iterator[tuple[float, float]]:
    """Generate the holes of a circle (HOLES2).

    Args:
        v: Centre, radius, first angle, angle between holes; 0 for equal spacing on the full circle.
        count: Number of holes.

    Returns:
        Position of each hole.
    """
    x, y, radius, first, step = v[:5]
    step = step or 360.0 / count
    for k in range(count):
        angle = math.radians(first + k * step)
        yield x + radius * math.cos(angle), y + radius * math.sin(angle)


def generate_hole_grid(
    start: tuple[float, float], pitch: tuple[float, float], columns: int, rows: int, degrees: float
) -> Iterator[tuple[float, float]]:
    """Generate the holes of a grid, turned about its first hole; every second row runs back.

    Args:
        start: Position of the first hole.
        pitch: Distance of columns and of rows.
        columns: Number of columns.
        rows: Number of rows.
        degrees: Rotation of the grid, degrees.

    Returns:
        Position of each hole.
    """
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    for j in range(rows):
        for i in range(columns) if j % 2 == 0 else reversed(range(columns)):
            a, b = i * pitch[0], j * pitch[1]
            yield start[0] + a * c - b * s, start[1] + a * s + b * c
