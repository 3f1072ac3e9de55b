"""``residuals.csv``: what each reading left before and after, by fits that did not see it; SI in, report units out."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.numerics.array_types import Array, Ints

DECIMALS = 6


@dataclass(frozen=True, kw_only=True)
class ResidualsTable:
    """Columns of N readings with D coordinates each."""

    row: Ints  # (N,) data rows, counted from 1
    line: Ints  # (N,) lines of the data file
    file: Sequence[str]  # (N,) names of the data file; empty where there is only one
    pose: Ints  # (N,) labels
    session: Ints  # (N,) labels
    used: NDArray[np.bool_]  # (N,) False where the reading was excluded
    names: Sequence[str]  # (D,) coordinates with their unit, e.g. ``dx_mm``
    factors: Sequence[float]  # (D,) report unit per SI unit
    before: Array  # (N, D) held-out residuals of the base model; NaN is an empty field
    after: Array  # (N, D) held-out residuals with the findings; NaN is an empty field


def write_residuals_csv(path: Path, table: ResidualsTable) -> None:
    """Write the table, one row for each reading.

    Args:
        path: The file to write.
        table: The columns.
    """
    labels: list[tuple[str, Sequence[object]]] = [
        ("row", table.row.tolist()),
        ("line", table.line.tolist()),
        *([("file", [escape_formula_text(f) for f in table.file])] if len(table.file) else []),
        ("pose", table.pose.tolist()),
        ("session", table.session.tolist()),
        ("used", table.used.astype(int).tolist()),
    ]
    scale = np.asarray(table.factors, float)
    for kind, values in (("before", table.before), ("after", table.after)):
        for name, column in zip(table.names, (values * scale).T.tolist(), strict=True):
            labels.append((f"{kind}_{name}", [f"{v:.{DECIMALS}f}" if isfinite(v) else "" for v in column]))
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([name for name, _ in labels])
        writer.writerows(zip(*(values for _, values in labels), strict=True))
