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
    """Write the table, one row for each reading.

    Args:
        path: The file to write.
        row: (N,) data rows, counted from 1.
        line: (N,) lines of the data file.
        file: (N,) names of the data file; empty where there is only one.
        pose: (N,) pose labels.
        session: (N,) session labels.
        used: (N,) False where the reading was excluded.
        names: (D,) coordinates with their unit, e.g. ``dx_mm``.
        factors: (D,) report unit per SI unit.
        before: (N, D) held-out residuals of the base model; NaN is an empty field.
        after: (N, D) held-out residuals with the findings; NaN is an empty field.
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
