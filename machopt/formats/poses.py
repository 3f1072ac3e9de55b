"""``poses.csv``, what to measure in which order, and the empty recording that the measurements go into."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Ints
from machopt.domain.poses import PosesTable
from machopt.domain.recording import Recording
from machopt.errors import InputError
from machopt.formats.opener import TABLE, read_text
from machopt.formats.recording import write_recording

_DEG, _MM = np.pi / 180.0, 1e-3
_LABELS = ("order", "pose", "cycle")
_TRANSLATION, _ROTATION = ("dx_mm", "dy_mm", "dz_mm"), ("rx_mrad", "ry_mrad", "rz_mrad")
_MEASURED = (*_TRANSLATION, *_ROTATION)
_YES = {"yes": True, "no": False, "": None}


def write_poses_csv(path: Path, table: PosesTable) -> None:
    """Write ``poses.csv``; rows are numbered from 1 in ``order``."""
    columns = {**_columns(table), "load": [_quoted(v) for v in table.load]}  # in its place
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(columns) + "\n")
        out.writelines(",".join(row) + "\n" for row in zip(*columns.values(), strict=True))


def poses_columns(table: PosesTable) -> dict[str, NDArray[Any]]:
    """The columns of ``poses.csv`` by name: its very numbers, NaN for an empty field; words as they are."""
    words = ("load", "way_free")
    return {
        name: np.array(values) if name in words else np.array([float(v or "nan") for v in values])
        for name, values in _columns(table).items()
    }


def _columns(table: PosesTable) -> dict[str, list[str]]:
    D = table.displacement.shape[1]
    return {
        "order": [str(n + 1) for n in range(len(table))],
        "pose": [str(v) for v in table.pose.tolist()],
        "cycle": [str(v) for v in table.cycle.tolist()],
        **_numbers(_joints(), table.q / _DEG, 6),
        "load": list(table.load),
        **_numbers(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm"), table.wrench, 4),
        **_numbers(("x_mm", "y_mm", "z_mm"), table.position / _MM, 4),
        **_numbers(_MEASURED[:D], table.displacement / 1e-3, 6),
        **_numbers(("kci", "nu_p", "nu_r_deg"), np.stack([table.kci, table.nu_p, table.nu_r / _DEG], axis=1), 6),
        **_numbers(("clearance_mm",), table.clearance[:, None] / _MM, 3),
        "session": [str(v) for v in table.session.tolist()],
        **_numbers(("load_x_mm", "load_y_mm", "load_z_mm"), table.load_point / _MM, 4),
        "way_free": ["" if v is None else "yes" if v else "no" for v in table.way_free],
    }


def read_poses_csv(path: Path | str) -> PosesTable:
    """Read ``poses.csv`` back into SI.

    Raises:
        InputError: a column is missing or unknown, a field is no number, rows are not numbered 1, 2, 3 …
    """
    file = Path(path)
    header, rows = _rows(file)
    turned = all(name in header for name in _ROTATION)
    D = 6 if turned else 3
    expected = [
        *_LABELS,
        *_joints(),
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
        q=block(*_joints()) * _DEG,
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


def write_recording_template(folder: Path, recording: Recording) -> None:
    """Write a recording folder whose displacement columns are still to be filled in.

    Everything else stands as :func:`machopt.formats.recording.write_recording` writes it, so the reader takes the
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


def _joints() -> tuple[str, ...]:
    return tuple(f"q{i}_deg" for i in range(1, 7))


def _numbers(names: tuple[str, ...], values: Array, decimals: int) -> dict[str, list[str]]:
    """Columns of numbers, empty where NaN, without negative zeros."""
    rounded = np.round(values, decimals) + 0.0
    return {
        name: ["" if np.isnan(v) else f"{v:.{decimals}f}" for v in column]
        for name, column in zip(names, rounded.T, strict=True)
    }


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"') else text


def _rows(file: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    text = read_text(file, expected="a table of poses", most=TABLE)
    try:
        rows = list(_filled(csv.reader(io.StringIO(text, newline=""))))
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


def _filled(reader: Iterator[list[str]]) -> Iterator[tuple[int, list[str]]]:
    """Rows that are neither empty nor a comment, with their line."""
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
