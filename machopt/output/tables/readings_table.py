"""``readings.csv``: every reading against the model, in base_link axes at the TCP; SI in, mm and mrad out."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from machopt.numerics.array_types import Array, Ints

_COMPONENTS = ("dx_mm", "dy_mm", "dz_mm", "rx_mrad", "ry_mrad", "rz_mrad")


def write_readings_csv(
    path: Path,
    *,
    pose: Ints,
    cycle: Ints,
    session: Ints,
    line: Ints,
    wrench: Array,
    measured: Array,
    predicted: Array,
    heldout: Array,
    uncertainty: Array,
    weight: Array,
    leverage: Array,
) -> None:
    """Write the table, one row for each reading.

    Args:
        path: The file to write.
        pose: (N,) pose labels.
        cycle: (N,) cycle labels.
        session: (N,) session labels.
        line: (N,) lines of the data file.
        wrench: (N, 6) wrenches at the TCP, N and N·m.
        measured: (N, D) measured displacements, m and rad; D = 3 or 6.
        predicted: (N, D) predicted displacements, m and rad.
        heldout: (N, D) predictions of fits without the pose; NaN where there is none.
        uncertainty: (N, D) 1 sigma of the prediction from the coefficients.
        weight: (N, D) weights 0 … 1; below 0.5 the reading is an outlier.
        leverage: (N,) leverages.
    """
    names = _COMPONENTS[: measured.shape[1]]
    columns: list[tuple[str, Array | Ints, str]] = [
        ("reading", np.arange(1, len(pose) + 1), "d"),
        ("pose", pose, "d"),
        ("cycle", cycle, "d"),
        ("session", session, "d"),
        ("line", line, "d"),
    ]
    for c, name in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        columns.append((name, wrench[:, c], ".6g"))
    for kind, values in (("measured", measured), ("predicted", predicted), ("heldout", heldout)):
        columns += [(f"{kind}_{name}", 1e3 * values[:, c], ".5f") for c, name in enumerate(names)]
    columns += [(f"sigma_{name}", 1e3 * uncertainty[:, c], ".5f") for c, name in enumerate(names)]
    columns += [(f"weight_{name}", weight[:, c], ".3f") for c, name in enumerate(names)]
    columns.append(("leverage", leverage, ".4f"))
    with path.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([name for name, _, _ in columns])
        texts = [[_format_value(v, form) for v in values.tolist()] for _, values, form in columns]
        writer.writerows(zip(*texts, strict=True))


def _format_value(value: float, form: str) -> str:
    return "" if value != value else format(value, form)  # noqa: PLR0124  NaN is an empty field
