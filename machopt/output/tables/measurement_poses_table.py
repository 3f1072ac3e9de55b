"""``poses.csv`` with the poses to measure in order, and the empty recording for the measurements."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.measurement_poses_table import PosesTable
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.recording import write_recording
from machopt.numerics.array_types import Array

_DEG, _MM = np.pi / 180.0, 1e-3
_TRANSLATION, _ROTATION = ("dx_mm", "dy_mm", "dz_mm"), ("rx_mrad", "ry_mrad", "rz_mrad")
_MEASURED = (*_TRANSLATION, *_ROTATION)


def write_poses_csv(path: Path, table: PosesTable) -> None:
    """Write ``poses.csv``; rows are numbered from 1 in ``order``.

    Args:
        path: The file to write.
        table: The table of poses, SI.
    """
    columns = {**_format_columns(table), "load": [_quote_cell(v) for v in table.load]}  # in its place
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(columns) + "\n")
        out.writelines(",".join(row) + "\n" for row in zip(*columns.values(), strict=True))


def list_poses_columns(table: PosesTable) -> dict[str, NDArray[Any]]:
    """Return the columns of ``poses.csv`` by name, NaN for an empty field; words as text.

    Args:
        table: The table of poses, SI.
    """
    words = ("load", "way_free")
    return {
        name: np.array(values) if name in words else np.array([float(v or "nan") for v in values])
        for name, values in _format_columns(table).items()
    }


def _format_columns(table: PosesTable) -> dict[str, list[str]]:
    D = table.displacement.shape[1]
    return {
        "order": [str(n + 1) for n in range(len(table))],
        "pose": [str(v) for v in table.pose.tolist()],
        "cycle": [str(v) for v in table.cycle.tolist()],
        **_format_numbers(_list_joint_columns(), table.q / _DEG, 6),
        "load": list(table.load),
        **_format_numbers(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"), table.wrench, 4),
        **_format_numbers(("x_mm", "y_mm", "z_mm"), table.position / _MM, 4),
        **_format_numbers(_MEASURED[:D], table.displacement / 1e-3, 6),
        **_format_numbers(("kci", "nu_p", "nu_r_deg"), np.stack([table.kci, table.nu_p, table.nu_r / _DEG], axis=1), 6),
        **_format_numbers(("clearance_mm",), table.clearance[:, None] / _MM, 3),
        "session": [str(v) for v in table.session.tolist()],
        **_format_numbers(("load_x_mm", "load_y_mm", "load_z_mm"), table.load_point / _MM, 4),
        "way_free": ["" if v is None else "yes" if v else "no" for v in table.way_free],
    }


def write_recording_template(folder: Path, recording: Recording) -> None:
    """Write a recording folder whose displacement columns are still to be filled in.

    Everything else is as :func:`machopt.measurement.recording.write_recording` writes it, so the reader takes the
    folder once the empty cells hold numbers.

    Args:
        folder: made where it does not exist.
        recording: of kind deflection; its displacements only say how many columns there are.
    """
    write_recording(folder, recording)
    data = folder / "data.csv"
    with data.open(encoding="utf-8", newline="") as text:
        header, *rows = csv.reader(text)
    blank = [name in _MEASURED for name in header]
    with data.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(header) + "\n")
        out.writelines(",".join("" if b else v for b, v in zip(blank, row, strict=True)) + "\n" for row in rows)


def _list_joint_columns() -> tuple[str, ...]:
    return tuple(f"q{i}_deg" for i in range(1, 7))


def _format_numbers(names: tuple[str, ...], values: Array, decimals: int) -> dict[str, list[str]]:
    """Columns of numbers, empty where NaN, without negative zeros."""
    rounded = np.round(values, decimals) + 0.0
    return {
        name: ["" if np.isnan(v) else f"{v:.{decimals}f}" for v in column]
        for name, column in zip(names, rounded.T, strict=True)
    }


def _quote_cell(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"') else text
