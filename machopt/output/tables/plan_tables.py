"""``trajectory.csv`` and ``points.csv``: SI in, mm, degrees and mm/min out, the same bytes every time.

The column order is fixed; new columns are added after ``reason``. A number that does not exist is an empty field.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_points_table import PointsTable
from machopt.data_types.process_columns import ERROR_NAMES, ProcessColumns
from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.stock import StockEngagement
from machopt.data_types.toolpath import MoveKind
from machopt.data_types.trajectory import Trajectory
from machopt.file_formats.csv_text_escaping import escape_formula_text
from machopt.numerics.array_types import Array

MM_PER_M = 1e3
DEG_PER_RAD = 180.0 / np.pi
MM_MIN_PER_M_S = 6e4
N_MM_PER_N_M = 1e-3

_ROWS_AT_ONCE = 4096
_SAMPLES_AT_ONCE = 16 * _ROWS_AT_ONCE


@dataclass(frozen=True)
class _TableColumn:
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

    Joints carry nine decimals: third differences of the samples over (12 ms)³ are compared with jerk limits,
    and 1e-9 deg of rounding is 5e-3 deg/s³ there.

    Args:
        path: the file.
        trajectory: S samples, SI.
        operations: labels that ``trajectory.operation`` points to; −1 gives an empty field.
        external_prismatic: (E,) True where the external axis moves along (mm), False where it turns (deg).
        tools: names that ``trajectory.tool`` points to, one where it has none; where the cell has a table of them.
    """
    decimals = _count_time_decimals(trajectory.time)
    rows = range(0, max(len(trajectory.time), 1), _SAMPLES_AT_ONCE)  # as fields, all rows would be ten times the arrays
    parts = (_select_rows(trajectory, slice(start, start + _SAMPLES_AT_ONCE)) for start in rows)
    with path.open("w", encoding="utf-8", newline="\n") as out:
        for n, part in enumerate(parts):
            columns = _build_trajectory_columns(part, operations, external_prismatic, tools, decimals)
            if n == 0:
                out.write(",".join(c.name for c in columns) + "\n")
            out.writelines(_format_row_blocks(columns))


def _select_rows(t: Trajectory, rows: slice) -> Trajectory:
    every = ((f.name, getattr(t, f.name)) for f in fields(t) if f.name != "corners")
    some: dict[str, Any] = {name: value[rows] for name, value in every if value is not None}
    return replace(t, **some)


def _list_tool_names(t: Trajectory, names: Sequence[str]) -> list[str]:
    return [names[0]] * len(t.time) if t.tool is None else [names[k] for k in t.tool.tolist()]


def list_trajectory_columns(
    trajectory: Trajectory,
    operations: Sequence[str],
    external_prismatic: Sequence[bool] = (),
    tools: Sequence[str] = (),
) -> dict[str, NDArray[Any]]:
    """Return the columns of ``trajectory.csv`` by name, (S,) each and read-only, NaN for an empty field.

    Args:
        trajectory: The motion samples.
        operations: Names of the operations.
        external_prismatic: Which external joints are prismatic.
        tools: Names of the tools; none without tool changes.
    """
    return {c.name: c.array for c in _build_trajectory_columns(trajectory, operations, external_prismatic, tools)}


def _build_trajectory_columns(
    t: Trajectory,
    operations: Sequence[str],
    external_prismatic: Sequence[bool],
    tools: Sequence[str],
    time_decimals: int | None = None,
) -> list[_TableColumn]:
    decimals = _count_time_decimals(t.time) if time_decimals is None else time_decimals
    moves = np.where(t.find_links(), MoveKind.LINK, t.move)
    move, operation = _build_move_and_operation_columns(moves, t.operation, operations)
    return [
        _TableColumn("time_s", f"%.{decimals}f", t.time.tolist()),
        _build_optional_column("point", t.point, 6),
        operation,
        move,
        *_build_joint_columns(t.q, t.external, external_prismatic),
        _build_optional_column("gamma_deg", t.gamma * DEG_PER_RAD, 6),
        _build_optional_column("feed_mm_min", t.feed * MM_MIN_PER_M_S, 3),
        *_build_tilt_columns(t.lead, t.side, 6),
        *([_build_text_column("tool", _list_tool_names(t, tools))] if tools else []),
    ]


def write_points_csv(path: Path, table: PointsTable) -> None:
    """Write ``points.csv``, one row for each toolpath point, numbered from 0.

    q1_deg … q6_deg and limit_margin_deg are encoder angles, corrected by the cell's kinematics.yaml. Stiffness,
    clearance and singularity refer to the true posture of the arm.

    Args:
        path: The file to write.
        table: The table of points, SI.
    """
    _write_csv(path, _build_points_columns(table))


def list_points_columns(table: PointsTable) -> dict[str, NDArray[Any]]:
    """Return the columns of ``points.csv`` by name, (N,) each and read-only, NaN for an empty field.

    Args:
        table: The table of points, SI.
    """
    return {c.name: c.array for c in _build_points_columns(table)}


def _build_points_columns(table: PointsTable) -> list[_TableColumn]:
    n = len(table)
    move, operation = _build_move_and_operation_columns(table.move, table.operation, table.operations)
    columns = [
        _TableColumn("point", "%d", range(n)),
        operation,
        move,
        *(_build_optional_column(f"{c}_mm", table.position[:, i] * MM_PER_M, 6) for i, c in enumerate("xyz")),
        *(_build_optional_column(c, table.axis[:, i], 9) for i, c in enumerate("ijk")),
        _build_optional_column("gamma_deg", table.gamma * DEG_PER_RAD, 6),
        _TableColumn(
            "branch",
            "%s",
            ["" if b < 0 else str(b) for b in table.branch.tolist()],
            np.where(table.branch < 0, np.nan, table.branch.astype(float)),
        ),
        *_build_joint_columns(table.q, table.external, table.external_prismatic, decimals=6),
        _build_optional_column("k_axial_N_mm", table.k_axial * N_MM_PER_N_M, 4),
        _build_optional_column("k_normal_N_mm", table.k_normal * N_MM_PER_N_M, 4),
        _build_optional_column("deflection_mm", table.deflection * MM_PER_M, 7),
        _build_optional_column("clearance_mm", table.clearance * MM_PER_M, 4),
        _build_optional_column("limit_margin_deg", table.limit_margin * DEG_PER_RAD, 5),
        _build_optional_column("singularity", table.singularity * DEG_PER_RAD, 5),
        _build_text_column("status", table.status),
        _build_text_column("reason", table.reason),
        _build_optional_column("feed_mm_min", table.feed * MM_MIN_PER_M_S, 3),
        _build_optional_column("k_jiao_x_N_mm", table.k_jiao_x * N_MM_PER_N_M, 4),
    ]
    if table.nearest_pair:
        columns.append(_build_text_column("nearest_pair", table.nearest_pair))
    if table.in_grid is not None:
        columns.append(
            _TableColumn("stiffness_from", "%s", ["grid" if g else "constant" for g in table.in_grid.tolist()])
        )
    if table.deflection_std is not None:
        columns.append(_build_optional_column("deflection_std_mm", table.deflection_std * MM_PER_M, 7))
    if table.k_axial_std is not None:
        columns.append(_build_optional_column("k_axial_std_N_mm", table.k_axial_std * N_MM_PER_N_M, 4))
    if table.dwell is not None:
        columns.append(_build_optional_column("dwell_s", table.dwell, 3))
    if table.compensation is not None:
        shift = table.compensation * MM_PER_M
        columns += [_build_optional_column(f"comp_d{c}_mm", shift[:, i], 6) for i, c in enumerate("xyz")]
    columns += _build_tilt_columns(table.lead, table.side, 9)
    if table.feed_advised is not None:
        columns.append(_build_optional_column("feed_advised_mm_min", table.feed_advised * MM_MIN_PER_M_S, 3))
    if table.process is not None:
        columns += _build_process_columns(table.process)
    return columns


def _build_tilt_columns(lead: Array | None, side: Array | None, decimals: int) -> list[_TableColumn]:
    if lead is None or side is None:
        return []
    return [
        _build_optional_column(name, np.where(np.abs(tilt) < 1e-12, 0.0, tilt) * DEG_PER_RAD, decimals)
        for name, tilt in (("lead_deg", lead), ("side_deg", side))
    ]


def _build_process_columns(p: ProcessColumns) -> list[_TableColumn]:
    columns = [
        _build_optional_column("ae_mm", p.ae * MM_PER_M, 4),
        _build_optional_column("ap_mm", p.ap * MM_PER_M, 4),
        _build_optional_column("phi_in_deg", p.entry_angle * DEG_PER_RAD, 4),
        _build_optional_column("phi_out_deg", p.exit_angle * DEG_PER_RAD, 4),
        *(_build_optional_column(f"f_{c}_N", p.force[:, i], 4) for i, c in enumerate(("travel", "normal", "axial"))),
        _build_optional_column("m_axial_Nm", p.moment, 6),
        _build_optional_column("f_peak_N", p.peak_force, 4),
    ]
    for name in ERROR_NAMES:
        scale, unit, decimals = (DEG_PER_RAD, "deg", 6) if name == "axis" else (MM_PER_M, "mm", 6)
        for suffix, values in (("", p.errors), ("_lo", p.lower), ("_hi", p.upper)):
            if name in values:
                columns.append(_build_optional_column(f"error_{name}{suffix}_{unit}", values[name] * scale, decimals))
    return [
        *columns,
        _build_optional_column("tolerance_mm", p.tolerance * MM_PER_M, 6),
        _build_optional_column("p_in", p.p_in, 5),
        _build_optional_column("p_in_deflection_only", p.p_in_deflection_only, 5),
        _build_text_column("outcome", p.outcome),
        _build_text_column("cause", p.cause),
        _build_optional_column("f1_Hz", p.f1, 3),
        _build_optional_column("a_lim_mm", p.depth_limit * MM_PER_M, 4),
        _build_text_column("chatter", p.chatter),
        _build_optional_column("feed_max_mm_min", p.feed_max * MM_MIN_PER_M_S, 2),
    ]


def write_compensation_csv(path: Path, index: Array, offset: Array, force: Array) -> None:
    """Write ``compensation.csv``: the shifted path between its corners, and the force it was shifted against.

    Args:
        path: the file.
        index: (P,) fractional toolpath index of each corner of the commanded path, not falling.
        offset: (P, 3) m in workpiece, added to the toolpath there.
        force: (P, 3) N in workpiece, of the process on the tool.
    """
    columns = [_build_optional_column("point", index, 9)]
    columns += [_build_optional_column(f"d{c}_mm", offset[:, i] * MM_PER_M, 6) for i, c in enumerate("xyz")]
    columns += [_build_optional_column(f"f{c}_N", force[:, i], 6) for i, c in enumerate("xyz")]
    _write_csv(path, columns)


def write_tilt_csv(path: Path, index: Array, lead: Array, side: Array) -> None:
    """Write ``tilt.csv``: the tilt at each planning point; in between the tool axis turns evenly.

    Args:
        path: the file.
        index: (P,) fractional toolpath index, not falling.
        lead: (P,) rad.
        side: (P,) rad.
    """
    _write_csv(path, [_build_optional_column("point", index, 9), *_build_tilt_columns(lead, side, 9)])


def write_rapid_corners_csv(path: Path, corners: RapidCorners, prismatic: Sequence[bool]) -> None:
    """Write ``rapid_corners.csv``: the corners between rapid moves that are rounded, one row a corner.

    Args:
        path: the file.
        corners: rounded corners of the motion.
        prismatic: which external joints slide.
    """
    columns = [
        _build_optional_column(name, values.astype(float), 0)
        for name, values in (
            ("sample", corners.sample),
            ("from_sample", corners.before),
            ("to_sample", corners.after),
        )
    ]
    columns += _build_joint_columns(corners.q, corners.external, prismatic)
    columns += [
        _build_optional_column(f"{name}_percent", 100.0 * corners.share[:, n], 9)
        for n, name in enumerate(("before", "after"))
    ]
    _write_csv(path, columns)


def write_engagement_csv(path: Path, engagement: StockEngagement) -> None:
    """Write ``engagement.csv``: arcs of contact with the stock, each of a slice of the cutter.

    Args:
        path: the file.
        engagement: contact at the points of the whole job.
    """
    degrees = 180.0 / np.pi
    columns = [_build_optional_column("point", engagement.point.astype(float), 0)]
    columns += [
        _build_optional_column("low_mm", engagement.low * MM_PER_M, 6),
        _build_optional_column("high_mm", engagement.high * MM_PER_M, 6),
        _build_optional_column("phi_in_deg", engagement.start * degrees, 6),
        _build_optional_column("phi_out_deg", engagement.end * degrees, 6),
    ]
    _write_csv(path, columns)


def _build_joint_columns(q: Array, external: Array, prismatic: Sequence[bool], decimals: int = 9) -> list[_TableColumn]:
    if external.shape[1] != len(prismatic):
        raise ValueError(f"{external.shape[1]} external axes but {len(prismatic)} kinds of them")
    columns = [_build_optional_column(f"q{i + 1}_deg", q[:, i] * DEG_PER_RAD, decimals) for i in range(q.shape[1])]
    for i, along in enumerate(prismatic):
        name, scale = (f"e{i + 1}_mm", MM_PER_M) if along else (f"e{i + 1}_deg", DEG_PER_RAD)
        columns.append(_build_optional_column(name, external[:, i] * scale, decimals))
    return columns


def _build_move_and_operation_columns(
    move: NDArray[np.int8], operation: NDArray[np.int32], labels: Sequence[str]
) -> tuple[_TableColumn, _TableColumn]:
    """The columns ``move`` and ``operation``; −1 picks the empty label put at the end."""
    moves = [m.word for m in sorted(MoveKind)]
    quoted = [*(_quote_cell(label) for label in labels), ""]
    return (
        _TableColumn("move", "%s", [moves[m] for m in move.tolist()]),
        _TableColumn("operation", "%s", [quoted[o] for o in operation.tolist()], np.array([*labels, ""])[operation]),
    )


def _build_text_column(name: str, words: Sequence[str]) -> _TableColumn:
    return _TableColumn(name, "%s", [_quote_cell(w) for w in words], np.array(words, dtype=np.str_))


def _build_optional_column(name: str, values: Array, decimals: int) -> _TableColumn:
    """A column of numbers, empty where NaN, without negative zeros."""
    rounded = np.round(np.asarray(values, float), decimals) + 0.0
    fmt = f"%.{decimals}f"
    if np.isfinite(rounded).all():
        return _TableColumn(name, fmt, rounded.tolist(), rounded)
    return _TableColumn(name, "%s", [fmt % v if isfinite(v) else "" for v in rounded.tolist()], rounded)


def _count_time_decimals(time: Array) -> int:
    """Fewest decimals (3, 6 or 9) that hold every sample time to a picosecond."""
    for decimals in (3, 6):
        if np.all(np.abs(np.round(time, decimals) - time) < 1e-12 * np.maximum(1.0, time)):
            return decimals
    return 9


def _quote_cell(text: str) -> str:
    text = escape_formula_text(" ".join(text.split()))
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"') else text


def _write_csv(path: Path, columns: Sequence[_TableColumn]) -> None:
    """One ``%`` over a block of rows: about four times as fast as csv.writer over formatted fields."""
    with path.open("w", encoding="utf-8", newline="\n") as out:
        out.write(",".join(c.name for c in columns) + "\n")
        out.writelines(_format_row_blocks(columns))


def _format_row_blocks(columns: Sequence[_TableColumn]) -> Iterator[str]:
    row = ",".join(c.format for c in columns) + "\n"
    rows, width = len(columns[0].values), len(columns)
    for start in range(0, rows, _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, rows)
        flat: list[object] = [None] * ((stop - start) * width)
        for k, column in enumerate(columns):
            flat[k::width] = column.values[start:stop]
        yield row * (stop - start) % tuple(flat)
