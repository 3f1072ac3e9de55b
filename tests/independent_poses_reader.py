"""Independent strict reader of ``poses.csv`` for round-trip tests."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from machopt.data_types.measurements.measurement_poses_table import PosesTable
from machopt.errors import InputError
from machopt.file_formats.file_reading import TABLE, read_text
from machopt.numerics.array_types import Array, Ints

_DEG, _MM = np.pi / 180.0, 1e-3
_JOINTS = tuple(f"q{i}_deg" for i in range(1, 7))
_TRANSLATION, _ROTATION = ("dx_mm", "dy_mm", "dz_mm"), ("rx_mrad", "ry_mrad", "rz_mrad")
_MEASURED = (*_TRANSLATION, *_ROTATION)
_LABELS = ("order", "pose", "cycle")


_YES = {"yes": True, "no": False, "": None}


def read_poses_csv(path: Path | str) -> PosesTable:
    """Read ``poses.csv`` in SI units.

    Raises:
        InputError: a column is missing or unknown, a field is not a number, or rows are not numbered 1, 2, 3 …
    """
    file = Path(path)
    header, rows = _rows(file)
    turned = all(name in header for name in _ROTATION)
    D = 6 if turned else 3
    expected = [
        *_LABELS,
        *_JOINTS,
        "load",
        "fx_N",
        "fy_N",
        "fz_N",
        "mx_Nm",
        "my_Nm",
        "mz_Nm",
        "x_mm",
        "y_mm",
        "z_mm",
        *_MEASURED[:D],
        "kci",
        "nu_p",
        "nu_r_deg",
        "clearance_mm",
        "session",
        "load_x_mm",
        "load_y_mm",
        "load_z_mm",
        "way_free",
    ]
    for what, names in (
        ("is missing", [n for n in expected if n not in header]),
        ("is unknown", [n for n in header if n not in expected]),
    ):
        if names:
            raise InputError(
                f"column {', '.join(names)} {what}; expected {', '.join(expected)}", file=file, where="header"
            )
    at = {name: header.index(name) for name in expected}

    def column(name: str, *, empty: bool = False) -> Array:
        return np.array([_number(file, line, name, row[at[name]], empty=empty) for line, row in rows])

    def block(*names: str) -> Array:
        return np.stack([column(n) for n in names], axis=1)

    def whole(name: str) -> Ints:
        values = column(name)
        bad = np.flatnonzero(values != np.round(values))
        if bad.size:
            raise InputError(
                f"found {values[bad[0]]:g}; expected a whole number",
                file=file,
                where=f"line {rows[bad[0]][0]}, column {name}",
            )
        return values.astype(np.int64)

    order = whole("order")
    wrong = np.flatnonzero(order != np.arange(1, len(order) + 1))
    if wrong.size:
        raise InputError(
            f"found {order[wrong[0]]}; expected {wrong[0] + 1}, rows stand in the order of work",
            file=file,
            where=f"line {rows[wrong[0]][0]}, column order",
        )
    ways = [row[at["way_free"]] for _, row in rows]
    odd = next((n for n, word in enumerate(ways) if word not in _YES), None)
    if odd is not None:
        raise InputError(
            f"found {ways[odd]!r}; expected yes, no or nothing",
            file=file,
            where=f"line {rows[odd][0]}, column way_free",
        )
    return PosesTable(
        pose=whole("pose"),
        cycle=whole("cycle"),
        session=whole("session"),
        q=block(*_JOINTS) * _DEG,
        load=tuple(row[at["load"]] for _, row in rows),
        wrench=block("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"),
        position=block("x_mm", "y_mm", "z_mm") * _MM,
        displacement=block(*_MEASURED[:D]) * 1e-3,
        kci=column("kci"),
        nu_p=column("nu_p"),
        nu_r=column("nu_r_deg") * _DEG,
        clearance=column("clearance_mm", empty=True) * _MM,
        load_point=block("load_x_mm", "load_y_mm", "load_z_mm") * _MM,
        way_free=tuple(_YES[w] for w in ways),
    )


def _rows(file: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    text = read_text(file, expected="a table of poses", most=TABLE)
    try:
        rows = list(list_data_rows(csv.reader(io.StringIO(text, newline=""))))
    except csv.Error as error:
        raise InputError(f"not a CSV table: {error}", file=file) from None
    if len(rows) < 2:
        raise InputError("found no rows, expected a header and at least one row", file=file)
    header = [name.strip() for name in rows[0][1]]
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise InputError(
                f"found {len(row)} fields, expected {len(header)} as in the header", file=file, where=f"line {line}"
            )
    return header, rows[1:]


def list_data_rows(reader: Iterator[list[str]]) -> Iterator[tuple[int, list[str]]]:
    """Yield rows that are neither empty nor a comment, with their line number."""
    for line, row in enumerate(reader, start=1):
        if row and not row[0].startswith("#"):
            yield line, row


def _number(file: Path, line: int, name: str, text: str, *, empty: bool) -> float:
    if empty and not text:
        return float("nan")
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(f"found {text!r}, expected a finite number", file=file, where=f"line {line}, column {name}")
    return value
