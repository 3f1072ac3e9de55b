"""What the summary shows of a job's toolpath, from the job's own points.csv."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from machopt.report.svg.toolpath_thumbnail import PathPicture

_CUT_MOVE = "cut"


def build_path_picture(points: Path, name: str) -> PathPicture | None:
    """The toolpath coloured by deflection, or by stiffness where no force was given; None where nothing is to be drawn.

    Args:
        points: points.csv of a job that is finished, so what machopt itself wrote.
        name: of the job, for words that stand for the picture.
    """
    if not points.is_file():
        return None
    with points.open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    if len(rows) < 2:
        return None

    def column(key: str) -> list[float]:
        return [float(row.get(key) or "nan") for row in rows]

    bend = np.array(column("deflection_mm"))
    by_force = bool(np.isfinite(bend).any())
    position = np.stack([column(f"{c}_mm") for c in "xyz"], axis=1) * 1e-3
    if not np.isfinite(position).all():
        return None
    return PathPicture(
        position=position,
        cutting=np.array([row.get("move") == _CUT_MOVE for row in rows]),
        value=bend if by_force else np.array(column("k_axial_N_mm")),
        large_is_good=not by_force,
        words=f"{name}: toolpath coloured by predicted {'deflection' if by_force else 'stiffness'}",
    )
