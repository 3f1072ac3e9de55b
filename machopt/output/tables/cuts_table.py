"""``cuts.csv``: every measured cut against the regression; SI in, mm out."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from machopt.numerics.array_types import Array

_FORCES = ("travel_N", "normal_N", "axial_N")


def write_cuts_csv(
    path: Path,
    *,
    places: Sequence[str],
    feed_per_tooth: Array,
    measured: Array,
    predicted: Array,
    reasons: Sequence[str],
) -> None:
    """Write the table, one row for each cut.

    Args:
        path: The file to write.
        places: (N,) file and line of each cut.
        feed_per_tooth: (N,) m.
        measured: (N, 3) N.
        predicted: (N, 3) N.
        reasons: (N,) why a cut is not used; empty where it is.
    """
    header = ["place", "feed_per_tooth_mm", *(f"measured_{n}" for n in _FORCES), *(f"predicted_{n}" for n in _FORCES)]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*header, "used", "reason"])
        for n, place in enumerate(places):
            forces = [f"{v:.6g}" for v in (*measured[n], *predicted[n])]
            writer.writerow([place, f"{1e3 * feed_per_tooth[n]:.6g}", *forces, int(not reasons[n]), reasons[n]])
