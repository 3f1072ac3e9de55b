"""Milling jobs on which method joint is compared with the fixed path: two shipped toolpaths, and three made here.

All are finishing passes in the shipped milling cell. The feed of every cut is the feed cap, the same for both methods:
that of the largest chip thickness for which the cutting coefficients of the process hold.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CELL = ROOT / "cells" / "kr500_milling"
FEED_CAP = 2880.0  # mm/min: 0.12 mm per tooth, 2 teeth, 12,000 rpm
COLUMNS = ("x_mm", "y_mm", "z_mm", "i", "j", "k", "move", "feed_mm_min", "operation")
RIM_X, RIM_Y = 206.0, 81.0  # mm, middle of the rim around the deck
SAFE = 40.0  # mm above the path, where it begins and ends
Place = tuple[float, float, float, float, float]  # x, y, z in mm, inclination towards x and y in rad


@dataclass(frozen=True)
class JointMethodJob:
    """A toolpath of the benchmark."""

    name: str
    is_shipped: bool
    write: Callable[[Path], None]


def list_jobs() -> tuple[JointMethodJob, ...]:
    """Return the jobs."""
    return (
        JointMethodJob("contour_5axis", True, lambda file: copy_with_feed_cap("contour_5axis.csv", file)),
        JointMethodJob("plain", True, lambda file: copy_with_feed_cap("plain.csv", file)),
        JointMethodJob("waves", False, lambda file: write_path(file, make_waves())),
        JointMethodJob("ellipse", False, lambda file: write_path(file, make_ellipse())),
        JointMethodJob("zigzag", False, lambda file: write_path(file, make_zigzag())),
    )


def copy_with_feed_cap(name: str, file: Path) -> None:
    """Write a shipped toolpath with the feed cap as the feed of its cuts."""
    lines = (ROOT / "toolpaths" / name).read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    for row in rows:
        if row["move"] == "cut":
            row["feed_mm_min"] = f"{FEED_CAP:g}"
    write_rows(file, rows)


def write_path(file: Path, places: Iterator[Place]) -> None:
    """Write one continuous cut with a rapid move to its start and from its end."""
    cuts = [_build_row(place, "cut") for place in places]
    first, last = ({**row, "move": "rapid", "feed_mm_min": ""} for row in (cuts[0], cuts[-1]))
    for row in (first, last):
        for axis, c in zip("ijk", "xyz", strict=True):
            row[f"{c}_mm"] = f"{float(row[f'{c}_mm']) + SAFE * float(row[axis]):.4f}"
    write_rows(file, [first, *cuts, last])


def write_rows(file: Path, rows: list[dict[str, str]]) -> None:
    """Write a toolpath table."""
    with file.open("w", encoding="utf-8", newline="") as out:
        table = csv.DictWriter(out, COLUMNS, extrasaction="ignore", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def _build_row(place: Place, move: str) -> dict[str, str]:
    x, y, z, lean_x, lean_y = place
    axis = (math.tan(lean_x), math.tan(lean_y), 1.0)
    size = math.hypot(*axis)
    numbers = (x, y, z, *(a / size for a in axis))
    named = dict(zip(COLUMNS, (f"{v:.{4 if n < 3 else 7}f}" for n, v in enumerate(numbers)), strict=False))
    return {**named, "move": move, "feed_mm_min": f"{FEED_CAP:g}", "operation": "finish"}


def make_waves(count: int = 500) -> Iterator[Place]:
    """Five waves along the front of the rim, with an axis that sways."""
    for n in range(count):
        u = n / (count - 1)
        y = -RIM_Y + 5.0 * math.sin(10.0 * math.pi * u)
        lean = math.radians(7.0) * math.sin(2.0 * math.pi * u)
        yield 190.0 - 380.0 * u, y, -0.5, lean, math.radians(5.0) * math.sin(math.pi * u)


def make_ellipse(count: int = 720) -> Iterator[Place]:
    """An ellipse over the deck, once and a half round, with an upright axis."""
    for n in range(count):
        u = 3.0 * math.pi * n / (count - 1)
        yield 175.0 * math.cos(u), 70.0 * math.sin(u), -0.3, 0.0, 0.0


def make_zigzag(passes: int = 5, count: int = 110) -> Iterator[Place]:
    """Passes along the deck, joined by half circles, with an axis inclined by four degrees."""
    spacing, half = 24.0, 150.0
    radius = 0.5 * spacing
    for k in range(passes):
        y, way = spacing * (k - 0.5 * (passes - 1)), 1.0 if k % 2 == 0 else -1.0
        for n in range(count):
            yield way * half * (2.0 * n / (count - 1) - 1.0), y, -0.3, math.radians(4.0), 0.0
        for n in range(1, 24) if k + 1 < passes else ():
            angle = math.pi * (n / 24.0 - 0.5)
            yield (
                way * (half + radius * math.cos(angle)),
                y + radius * (1.0 + math.sin(angle)),
                -0.3,
                math.radians(4.0),
                0.0,
            )
