"""``residuals.csv``: what each reading left before and after, by fits that did not see it; SI in, report units out."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.numerics.array_types import Array, Ints

DECIMALS = 6


def write_residuals_csv(
    path: Path,
    *,
    row: Ints,
    line: Ints,
    file: Sequence[str],
    pose: Ints,
    session: Ints,
    used: NDArray[np.bool_],
    names: Sequence[str],
    factors: Sequence[float],
    before: Array,
    after: Array,
) -> None:
    """Write the table, one row a reading.

    Args:
        path: the file.
        row, line: (N,) 1-based data row, and line of the data file.
        file: (N,) name of the data file; empty where there is only one.
        pose, session: (N,) labels.
        used: (N,) False where the reading was put aside.
        names: (D,) coordinates with their unit, e.g. ``dx_mm``.
        factors: (D,) report unit per SI unit.
        before, after: (N, D) held-out residuals of the base alone and with the findings; NaN is an empty field.
    """
    labels: list[tuple[str, Sequence[object]]] = [
        ("row", row.tolist()),
        ("line", line.tolist()),
        *([("file", [escape_formula_text(f) for f in file])] if len(file) else []),
        ("pose", pose.tolist()),
        ("session", session.tolist()),
        ("used", used.astype(int).tolist()),
    ]
    scale = np.asarray(factors, float)
    for kind, values in (("before", before), ("after", after)):
        for name, column in zip(names, (values * scale).T.tolist(), strict=True):
            labels.append((f"{kind}_{name}", [f"{v:.{DECIMALS}f}" if isfinite(v) else "" for v in column]))
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([name for name, _ in labels])
        writer.writerows(zip(*(values for _, values in labels), strict=True))
