"""Writes the toolpaths of the cells with external axes. Run ``python toolpaths/make_external_toolpaths.py``.

Deterministic; the output is committed. The beam's top is z = 0, 400 × 6,000 mm; the drum is a cylinder of radius 300
and height 400 mm about the CAM frame's z axis (``cells/make_external_cells.py``).
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from make_toolpaths import Table, Vector, along

BEAM_HALF = 2900.0  # mm, of the passes
DRUM_RADIUS, DRUM_ROWS, DRUM_HOLES = 300.0, (80.0, 200.0, 320.0), 20


def write_beam() -> None:
    """kr500_rail: two weaving passes over the whole beam, there and back."""
    table, up = Table(), (0.0, 0.0, 1.0)
    for name, side in (("pass 1", -1.0), ("pass 2", 1.0)):
        points: list[Vector] = []
        for k in range(291):
            y = -BEAM_HALF + 20.0 * k
            points.append((80.0 * side + 30.0 * math.sin(y / 300.0), y * -side, -1.0))
        table.add(along(points[0], up, 60.0), up, "rapid", None, name)
        table.add(along(points[0], up, 5.0), up, "approach", 2000.0, name)
        for tip in points:
            table.add(tip, up, "cut", 3000.0, name)
        table.add(along(points[-1], up, 60.0), up, "retract", 3000.0, name)
    table.write("beam_passes.csv", "two passes along a beam of 6 m, 1 mm deep; cell kr500_rail")


def write_drum() -> None:
    """kr240_turntable: three rows of radial holes round a drum, from one end of each row to the other and back."""
    table = Table()
    for row, z in enumerate(DRUM_ROWS):
        for k in range(DRUM_HOLES):
            turn = math.radians(360.0 / DRUM_HOLES * (k if row % 2 == 0 else DRUM_HOLES - 1 - k) - 171.0)
            out = (math.cos(turn), math.sin(turn), 0.0)
            tip = (DRUM_RADIUS * out[0], DRUM_RADIUS * out[1], z)
            name = f"row {row + 1}"
            table.add(along(tip, out, 40.0), out, "rapid", None, name)
            table.add(along(tip, out, 2.0), out, "approach", 3000.0, name)
            table.add(along(tip, out, -6.0), out, "cut", 300.0, name)
            table.add(along(tip, out, 40.0), out, "retract", 3000.0, name)
    table.write("drum_holes.csv", "sixty radial holes of 6 mm round a drum; cell kr240_turntable")


if __name__ == "__main__":
    write_beam()
    write_drum()
