"""``map.csv``, and the table of measured stiffness: SI inside, mm, degrees and N/mm in the files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from machopt.data_types.measurements.measured_tcp_stiffness import MeasuredStiffness
from machopt.errors import OutputFolderError
from machopt.measurement.recording.recording_table import AllowedColumns, read_table
from machopt.numerics.array_types import Array

_PLACE = ("x_mm", "y_mm", "z_mm")
_JOINTS = tuple(f"q{i}_deg" for i in range(1, 7))
_STIFFNESS = ("kx_N_mm", "ky_N_mm", "kz_N_mm")
_VOCABULARY = AllowedColumns(
    numbers=(*_PLACE, *_JOINTS, *_STIFFNESS),
    words=("label",),
    listed_names="x_mm y_mm z_mm or q1_deg … q6_deg, kx_N_mm ky_N_mm kz_N_mm, label",
    refused_names={},
)
_ROWS_AT_ONCE = 4096


@dataclass(frozen=True)
class MapColumn:
    """Column of a map's table: numbers (empty where NaN), or words."""

    name: str
    values: Array | Sequence[str]  # (M,) in the unit of the name
    digits: int | None = None  # significant digits of a number; None: ``decimals`` decides
    decimals: int = 6


def write_map_csv(path: Path, columns: Sequence[MapColumn]) -> None:
    """Write one row for each sample.

    Args:
        path: The file to write.
        columns: The columns, SI.
    """
    texts = [_format_column(column) for column in columns]
    rows = len(texts[0])
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(column.name for column in columns) + "\n")
        for start in range(0, rows, _ROWS_AT_ONCE):
            block = zip(*(t[start : start + _ROWS_AT_ONCE] for t in texts), strict=True)
            out.writelines(",".join(row) + "\n" for row in block)


def _format_column(column: MapColumn) -> Sequence[str]:
    if not isinstance(column.values, np.ndarray):
        return column.values
    if column.digits is not None:
        form = f"%.{column.digits}g"
        return [form % (v + 0.0) if isfinite(v) else "" for v in column.values.tolist()]
    form = f"%.{column.decimals}f"
    rounded = np.round(column.values, column.decimals) + 0.0  # no negative zero
    return [form % v if isfinite(v) else "" for v in rounded.tolist()]


def read_measured_stiffness(path: Path) -> MeasuredStiffness:
    """Read measured stiffness at positions or poses (CSV or Parquet).

    Columns: ``x_mm, y_mm, z_mm`` of the TCP in the map's frame, or ``q1_deg`` … ``q6_deg``, or both; and at least one
    of ``kx_N_mm, ky_N_mm, kz_N_mm`` along the map's axes.

    Args:
        path: The file to read.

    Raises:
        InputError: a column is missing or unknown, a value is no finite number, a stiffness is not above zero.
    """
    table = read_table(path, _VOCABULARY)
    there = set(table.numbers)
    for group in (_PLACE, _JOINTS):
        missing = [name for name in group if name not in there]
        if 0 < len(missing) < len(group):
            raise table.build_error(
                f"column {', '.join(missing)} is missing; it is required with {', '.join(sorted(there & set(group)))}"
            )
    if not there & {*_PLACE, *_JOINTS}:
        raise table.build_error("no place: x_mm, y_mm, z_mm or q1_deg … q6_deg would work")
    measured = [name for name in _STIFFNESS if name in there]
    if not measured:
        raise table.build_error(f"no stiffness: at least one of {', '.join(_STIFFNESS)} would work")
    if len(table) < 2:
        raise OutputFolderError("found one reading; two or more would work", file=path)
    for name in measured:
        low = np.flatnonzero(table.numbers[name] <= 0)
        if len(low):
            found = table.numbers[name][low[0]]
            raise table.build_error(f"found {found:g} N/mm, a stiffness is above 0", int(low[0]), name)
    columns = table.numbers
    return MeasuredStiffness(
        file=path,
        position=np.column_stack([columns[n] for n in _PLACE]) * 1e-3 if _PLACE[0] in there else None,
        q=np.radians(np.column_stack([columns[n] for n in _JOINTS])) if _JOINTS[0] in there else None,
        stiffness={name[1]: columns[name] * 1e3 for name in measured},
        lines=table.lines,
    )
