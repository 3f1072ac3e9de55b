"""``trajectory.csv`` and ``points.csv``: SI in, mm, degrees and mm/min out, the same bytes every time.

The columns stand in one fixed order; what is added stands after ``reason``. A number that does not
exist is an empty field.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.domain.points import PointsTable
from machopt.domain.toolpath import Move
from machopt.domain.trajectory import Trajectory
from machopt.formats.celltext import as_cell

MM_PER_M = 1e3
DEG_PER_RAD = 180.0 / np.pi
MM_MIN_PER_M_S = 6e4
N_MM_PER_N_M = 1e-3

_ROWS_AT_ONCE = 4096
_SAMPLES_AT_ONCE = 16 * _ROWS_AT_ONCE


@dataclass(frozen=True)
class _Column:
    name: str
    format: str
    values: Sequence[object]
    meant: NDArray[Any] | None = None  # (rows,) the same: NaN where a field is empty, words as they are without CSV

    @property
    def array(self) -> NDArray[Any]:
        """(rows,) numbers or words, read-only."""
        out = np.array(self.values) if self.meant is None else self.meant
        out.setflags(write=False)
        return out


def write_trajectory_csv(
    path: Path,
    trajectory: Trajectory,
    operations: Sequence[str],
    external_prismatic: Sequence[bool] = (),
    tools: Sequence[str] = (),
) -> None:
    """Write ``trajectory.csv``.

    The columns q1_deg … q6_deg are what the encoders say, kinematics.yaml of the cell counted in; no other column is
    touched by it (gamma, point and feed belong to the tool where it really is).

    Joints carry nine decimals: third differences of the samples over (12 ms)³ are held against jerk limits,
    and 1e-9 deg of rounding is 5e-3 deg/s³ there.

    Args:
        path: the file.
        trajectory: S samples, SI.
        operations: labels that ``trajectory.operation`` points to; −1 gives an empty field.
        external_prismatic: (E,) True where the external axis moves along (mm), False where it turns (deg).
        tools: names that ``trajectory.tool`` points to, one where it has none; where the cell has a table of them.
    """
    decimals = _time_decimals(trajectory.time)
    rows = range(0, max(len(trajectory.time), 1), _SAMPLES_AT_ONCE)  # as fields, all rows would be ten times the arrays
    parts = (_rows_of(trajectory, slice(start, start + _SAMPLES_AT_ONCE)) for start in rows)
    with path.open("w", encoding="utf-8", newline="\n") as out:
        for n, part in enumerate(parts):
            columns = _trajectory(part, operations, external_prismatic, tools, decimals)
            if n == 0:
                out.write(",".join(c.name for c in columns) + "\n")
            out.writelines(_blocks(columns))


def _rows_of(t: Trajectory, rows: slice) -> Trajectory:
    every = ((f.name, getattr(t, f.name)) for f in fields(t))
    some: dict[str, Any] = {name: value[rows] for name, value in every if value is not None}
    return replace(t, **some)


def _tools(t: Trajectory, names: Sequence[str]) -> list[str]:
    return [names[0]] * len(t.time) if t.tool is None else [names[k] for k in t.tool.tolist()]


def trajectory_columns(
    trajectory: Trajectory,
    operations: Sequence[str],
    external_prismatic: Sequence[bool] = (),
    tools: Sequence[str] = (),
) -> dict[str, NDArray[Any]]:
    """The columns of ``trajectory.csv`` by name, (S,) each and read-only: its very numbers, NaN for an empty field."""
    return {c.name: c.array for c in _trajectory(trajectory, operations, external_prismatic, tools)}


def _trajectory(
    t: Trajectory,
    operations: Sequence[str],
    external_prismatic: Sequence[bool],
    tools: Sequence[str],
    time_decimals: int | None = None,
) -> list[_Column]:
    decimals = _time_decimals(t.time) if time_decimals is None else time_decimals
    move, operation = _words(t.move, t.operation, operations)
    return [
        _Column("time_s", f"%.{decimals}f", t.time.tolist()),
        _optional("point", t.point, 6),
        operation,
        move,
        *_joint_columns(t.q, t.external, external_prismatic),
        _optional("gamma_deg", t.gamma * DEG_PER_RAD, 6),
        _optional("feed_mm_min", t.feed * MM_MIN_PER_M_S, 3),
        *([_text("tool", _tools(t, tools))] if tools else []),
    ]


def write_points_csv(path: Path, table: PointsTable) -> None:
    """Write ``points.csv``, one row a toolpath point, numbered from 0.

    q1_deg … q6_deg and limit_margin_deg are of encoder angles, kinematics.yaml of the cell counted in; stiffness,
    clearance and singularity of where the arm really stands.
    """
    _write(path, _points(table))


def points_columns(table: PointsTable) -> dict[str, NDArray[Any]]:
    """The columns of ``points.csv`` by name, (N,) each and read-only: its very numbers, NaN for an empty field."""
    return {c.name: c.array for c in _points(table)}


def _points(table: PointsTable) -> list[_Column]:
    n = len(table)
    move, operation = _words(table.move, table.operation, table.operations)
    columns = [
        _Column("point", "%d", range(n)),
        operation,
        move,
        *(_optional(f"{c}_mm", table.position[:, i] * MM_PER_M, 6) for i, c in enumerate("xyz")),
        *(_optional(c, table.axis[:, i], 9) for i, c in enumerate("ijk")),
        _optional("gamma_deg", table.gamma * DEG_PER_RAD, 6),
        _Column(
            "branch",
            "%s",
            ["" if b < 0 else str(b) for b in table.branch.tolist()],
            np.where(table.branch < 0, np.nan, table.branch.astype(float)),
        ),
        *_joint_columns(table.q, table.external, table.external_prismatic, decimals=6),
        _optional("k_axial_N_mm", table.k_axial * N_MM_PER_N_M, 4),
        _optional("k_normal_N_mm", table.k_normal * N_MM_PER_N_M, 4),
        _optional("deflection_mm", table.deflection * MM_PER_M, 7),
        _optional("clearance_mm", table.clearance * MM_PER_M, 4),
        _optional("limit_margin_deg", table.limit_margin * DEG_PER_RAD, 5),
        _optional("singularity", table.singularity * DEG_PER_RAD, 5),
        _text("status", table.status),
        _text("reason", table.reason),
        _optional("feed_mm_min", table.feed * MM_MIN_PER_M_S, 3),
        _optional("k_jiao_x_N_mm", table.k_jiao_x * N_MM_PER_N_M, 4),
    ]
    if table.nearest_pair:
        columns.append(_text("nearest_pair", table.nearest_pair))
    if table.in_grid is not None:
        columns.append(_Column("stiffness_from", "%s", ["grid" if g else "constant" for g in table.in_grid.tolist()]))
    if table.deflection_std is not None:
        columns.append(_optional("deflection_std_mm", table.deflection_std * MM_PER_M, 7))
    if table.k_axial_std is not None:
        columns.append(_optional("k_axial_std_N_mm", table.k_axial_std * N_MM_PER_N_M, 4))
    if table.dwell is not None:
        columns.append(_optional("dwell_s", table.dwell, 3))
    if table.compensation is not None:
        shift = table.compensation * MM_PER_M
        columns += [_optional(f"comp_d{c}_mm", shift[:, i], 6) for i, c in enumerate("xyz")]
    return columns


def write_compensation_csv(path: Path, index: Array, offset: Array, force: Array) -> None:
    """Write ``compensation.csv``: the shifted path between its corners, and the force it was shifted against.

    Args:
        path: the file.
        index: (P,) fractional toolpath index of each corner of the commanded path, not falling.
        offset: (P, 3) m in workpiece, added to the toolpath there.
        force: (P, 3) N in workpiece, of the process on the tool.
    """
    columns = [_optional("point", index, 9)]
    columns += [_optional(f"d{c}_mm", offset[:, i] * MM_PER_M, 6) for i, c in enumerate("xyz")]
    columns += [_optional(f"f{c}_N", force[:, i], 6) for i, c in enumerate("xyz")]
    _write(path, columns)


def _joint_columns(q: Array, external: Array, prismatic: Sequence[bool], decimals: int = 9) -> list[_Column]:
    if external.shape[1] != len(prismatic):
        raise ValueError(f"{external.shape[1]} external axes but {len(prismatic)} kinds of them")
    columns = [_optional(f"q{i + 1}_deg", q[:, i] * DEG_PER_RAD, decimals) for i in range(q.shape[1])]
    for i, along in enumerate(prismatic):
        name, scale = (f"e{i + 1}_mm", MM_PER_M) if along else (f"e{i + 1}_deg", DEG_PER_RAD)
        columns.append(_optional(name, external[:, i] * scale, decimals))
    return columns


def _words(move: NDArray[np.int8], operation: NDArray[np.int32], labels: Sequence[str]) -> tuple[_Column, _Column]:
    """The columns ``move`` and ``operation``; −1 picks the empty label put at the end."""
    moves = [m.word for m in sorted(Move)]
    quoted = [*(_quoted(label) for label in labels), ""]
    return (
        _Column("move", "%s", [moves[m] for m in move.tolist()]),
        _Column("operation", "%s", [quoted[o] for o in operation.tolist()], np.array([*labels, ""])[operation]),
    )


def _text(name: str, words: Sequence[str]) -> _Column:
    return _Column(name, "%s", [_quoted(w) for w in words], np.array(words, dtype=np.str_))


def _optional(name: str, values: Array, decimals: int) -> _Column:
    """A column of numbers, empty where NaN, without negative zeros."""
    rounded = np.round(np.asarray(values, float), decimals) + 0.0
    fmt = f"%.{decimals}f"
    if np.isfinite(rounded).all():
        return _Column(name, fmt, rounded.tolist(), rounded)
    return _Column(name, "%s", [fmt % v if isfinite(v) else "" for v in rounded.tolist()], rounded)


def _time_decimals(time: Array) -> int:
    """Fewest decimals (3, 6 or 9) that hold every sample time to a picosecond."""
    for decimals in (3, 6):
        if np.all(np.abs(np.round(time, decimals) - time) < 1e-12 * np.maximum(1.0, time)):
            return decimals
    return 9


def _quoted(text: str) -> str:
    text = as_cell(" ".join(text.split()))
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"') else text


def _write(path: Path, columns: Sequence[_Column]) -> None:
    """One ``%`` over a block of rows: about four times as fast as csv.writer over formatted fields."""
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(c.name for c in columns) + "\n")
        out.writelines(_blocks(columns))


def _blocks(columns: Sequence[_Column]) -> Iterator[str]:
    row = ",".join(c.format for c in columns) + "\n"
    rows, width = len(columns[0].values), len(columns)
    for start in range(0, rows, _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, rows)
        flat: list[object] = [None] * ((stop - start) * width)
        for k, column in enumerate(columns):
            flat[k::width] = column.values[start:stop]
        yield row * (stop - start) % tuple(flat)
