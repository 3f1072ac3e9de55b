"""Tables of an output folder that its robot programs are compared with."""

from __future__ import annotations

from pathlib import Path

from machopt.data_types.cell import Cell
from machopt.verification.motion.motion_verification import ExportedTables
from machopt.verification.tables.exported_tables import (
    ExportedMotion,
    read_compensation,
    read_motion,
    read_points,
    read_tilt,
)
from machopt.verification.tables.rapid_corner_table import read_rapid_corners


def read_program_tables(cell: Cell, out: Path, motion: ExportedMotion | None = None) -> ExportedTables:
    """Return the tables of a folder.

    Args:
        cell: The robot cell.
        out: The output folder.
        motion: trajectory.csv where it has been read already.

    Raises:
        InputError: one cannot be read.
    """
    motion = motion or read_motion(out / "trajectory.csv", cell)
    points = read_points(out / "points.csv", cell)
    return ExportedTables(
        motion,
        points,
        read_compensation(out / "compensation.csv") if points.shift is not None else None,
        read_tilt(out / "tilt.csv") if points.lead is not None else None,
        read_rapid_corners(out / "rapid_corners.csv", cell, len(motion.time)),
    )
