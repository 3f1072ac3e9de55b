"""``readings.csv``: every reading against the model, in base_link axes at the TCP; SI in, mm and mrad out."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.numerics.array_types import Array, Ints

_COMPONENTS = ("dx_mm", "dy_mm", "dz_mm", "rx_mrad", "ry_mrad", "rz_mrad")


@dataclass(frozen=True, kw_only=True)
class ReadingsTable:
    """Columns of N readings with D components each, D = 3 or 6."""

    pose: Ints  # (N,) labels
    cycle: Ints  # (N,) labels
    session: Ints  # (N,) labels
    line: Ints  # (N,) lines of the data file
    wrench: Array  # (N, 6) at the TCP, N and N·m
    measured: Array  # (N, D) displacements, m and rad
    predicted: Array  # (N, D) displacements, m and rad
    heldout: Array  # (N, D) predictions of fits without the pose; NaN where there is none
    uncertainty: Array  # (N, D) 1 sigma of the prediction from the coefficients
    weight: Array  # (N, D) 0 … 1; below 0.5 the reading is an outlier
    leverage: Array  # (N,)


def write_readings_csv(path: Path, table: ReadingsTable) -> None:
    """Write the table, one row for each reading.

    Args:
        path: The file to write.
        table: The columns.
    """
    names = _COMPONENTS[: table.measured.shape[1]]
    columns: list[tuple[str, Array | Ints, str]] = [
        ("reading", np.arange(1, len(table.pose) + 1), "d"),
        ("pose", table.pose, "d"),
        ("cycle", table.cycle, "d"),
        ("session", table.session, "d"),
        ("line", table.line, "d"),
    ]
    for c, name in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        columns.append((name, table.wrench[:, c], ".6g"))
    for kind, values in (("measured", table.measured), ("predicted", table.predicted), ("heldout", table.heldout)):
        columns += [(f"{kind}_{name}", 1e3 * values[:, c], ".5f") for c, name in enumerate(names)]
    columns += [(f"sigma_{name}", 1e3 * table.uncertainty[:, c], ".5f") for c, name in enumerate(names)]
    columns += [(f"weight_{name}", table.weight[:, c], ".3f") for c, name in enumerate(names)]
    columns.append(("leverage", table.leverage, ".4f"))
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([name for name, _, _ in columns])
        texts = [[_format_value(v, form) for v in values.tolist()] for _, values, form in columns]
        writer.writerows(zip(*texts, strict=True))


def _format_value(value: float, form: str) -> str:
    return "" if value != value else format(value, form)  # noqa: PLR0124  NaN is an empty field
