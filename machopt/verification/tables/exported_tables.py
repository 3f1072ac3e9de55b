"""Readers of trajectory.csv, points.csv and compensation.csv for the verification.

Every column that machopt writes must be present once. Every number must be finite where the column may not be empty.
Unknown columns are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.data_types.stock import StockEngagement
from machopt.data_types.toolpath import MoveKind
from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Array
from machopt.verification.tables.csv_columns import ColumnTable, read_table

JOINT_COLUMNS = tuple(f"q{i}_deg" for i in range(1, 7))
ARC_COLUMNS = ("low_mm", "high_mm", "phi_in_deg", "phi_out_deg")
TILT_COLUMNS = ("lead_deg", "side_deg")
SHIFT_COLUMNS = ("comp_dx_mm", "comp_dy_mm", "comp_dz_mm")
MOTION_COLUMNS = ("time_s", "point", "operation", "move", *JOINT_COLUMNS, "gamma_deg", "feed_mm_min")
POINT_COLUMNS = (
    "point",
    "operation",
    "move",
    "x_mm",
    "y_mm",
    "z_mm",
    "i",
    "j",
    "k",
    "gamma_deg",
    "branch",
    *JOINT_COLUMNS,
    "k_axial_N_mm",
    "k_normal_N_mm",
    "deflection_mm",
    "clearance_mm",
    "limit_margin_deg",
    "singularity",
    "status",
    "reason",
)
OPTIONAL_COLUMNS = (
    "feed_mm_min",
    "feed_advised_mm_min",
    "k_jiao_x_N_mm",
    "nearest_pair",
    "stiffness_from",
    "deflection_std_mm",
    "k_axial_std_N_mm",
    "dwell_s",
    *("ae_mm", "ap_mm", "phi_in_deg", "phi_out_deg", "f_travel_N", "f_normal_N", "f_axial_N", "m_axial_Nm", "f_peak_N"),
    *(f"error_{name}{end}_mm" for name in ("along", "across", "normal") for end in ("", "_lo", "_hi")),
    *(f"error_axis{end}_deg" for end in ("", "_lo", "_hi")),
    *("tolerance_mm", "p_in", "p_in_deflection_only", "outcome", "cause", "f1_Hz", "a_lim_mm", "chatter"),
    "feed_max_mm_min",
)
MIN_STEP_S = 1e-6  # s from sample to sample
MAX_POINT_NUMBER = 2**31  # a point number beyond is none
MOVE_WORDS = tuple(move.word for move in MoveKind)


@dataclass(frozen=True, kw_only=True)
class ExportedMotion:
    """Content of trajectory.csv in SI; S rows."""

    time: Array  # (S,) s
    point: Array  # (S,) NaN where empty
    move: NDArray[np.int64]  # (S,) Move codes
    q: Array  # (S, 6) rad
    external: Array  # (S, E) rad or m
    operation: tuple[str, ...]  # (S,) labels, empty for none
    gamma: Array  # (S,) rad, NaN where empty
    feed: Array  # (S,) m/s
    slides: tuple[bool, ...] = ()  # (E,) which external axes are in m
    tool: tuple[str, ...] = ()  # (S,) names, empty where the cell has no table
    lead: Array | None = None  # (S,) rad, tilt of the tool, NaN where empty; None: the table has no such column
    side: Array | None = None  # (S,) rad
    lifted: NDArray[np.bool_] | None = (
        None  # (S,) called link between retract and approach at one point; ``move`` RAPID
    )

    @property
    def sample_time(self) -> float:
        """Sample period, s."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def joints(self) -> Array:
        """(S, 6 + E) rad or m, arm and external joints; the arm's own array where there are no others."""
        return np.hstack([self.q, self.external]) if self.external.shape[1] else self.q

    def describe_row(self, n: int | np.int64) -> str:
        """Return sample, time and toolpath point of a row as text.

        Args:
            n: Number of the row, from 0.
        """
        point = f", point {self.point[n]:.3f}" if np.isfinite(self.point[n]) else ""
        return f"sample {n}, {self.time[n]:.3f} s{point}"


@dataclass(frozen=True, kw_only=True)
class ExportedPoints:
    """Content of points.csv, N rows; units as in the file except for point, joints and shift."""

    point: NDArray[np.int64]  # (N,)
    q: Array  # (N, 6) rad by encoder, NaN where the point has none
    external: Array  # (N, E) rad or m, likewise
    status: tuple[str, ...]
    numbers: dict[str, Array]  # every further column of numbers, in the file's units, NaN where empty
    words: dict[str, tuple[str, ...]]  # operation, move, reason, nearest_pair, stiffness_from
    shift: Array | None = None  # (N, 3) m in workpiece, where the commanded path is shifted
    lead: Array | None = None  # (N,) rad, tilt of the tool, NaN where empty; None: the table has no such column
    side: Array | None = None  # (N,) rad

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(N,) whether the point has a configuration."""
        return np.array([s == "ok" for s in self.status], bool)

    def is_complete(self, count: int) -> bool:
        """Return whether row n is point n, and there is one row a point.

        Args:
            count: Number of toolpath points.
        """
        return np.array_equal(self.point, np.arange(count))


@dataclass(frozen=True)
class ExportedShift:
    """Content of compensation.csv: shift of the path at its corners, and the force it compensates."""

    index: Array  # (P,) fractional toolpath index, not falling
    offset: Array  # (P, 3) m in workpiece
    force: Array  # (P, 3) N in workpiece


@dataclass(frozen=True)
class ExportedTilt:
    """Content of tilt.csv: the tilt of the tool at the planning points."""

    index: Array  # (P,) fractional toolpath index, not falling
    lead: Array  # (P,) rad
    side: Array  # (P,) rad


def read_motion(file: Path, cell: Cell) -> ExportedMotion:
    """Read trajectory.csv.

    Args:
        file: Path of the file.
        cell: The robot cell.

    Raises:
        InputError: the file, a column or a number is missing, a column is unknown, or the time does not rise.
    """
    table = read_table(file)
    tilted = any(name in table for name in TILT_COLUMNS)
    needed = (*MOTION_COLUMNS, *list_external_names(cell), *(["tool"] if cell.tools else []))
    check_column_names(table, (*needed, *(TILT_COLUMNS if tilted else ())), ("tool",))
    lead, side = _read_tilt(table) if tilted else (None, None)
    if cell.tools:
        _check_tools(table, cell)
    time = table.read_numbers("time_s")
    if len(time) < 2:
        raise OutputFolderError(f"{len(time)} samples; a motion has two or more", file=file)
    repeated = np.flatnonzero(np.diff(time) < MIN_STEP_S)
    if len(repeated):
        row = int(repeated[0]) + 2
        raise OutputFolderError("the time does not rise", file=file, where=f"data row {row}, time_s")
    point, move = table.read_numbers("point", empty=True), parse_moves(table)
    lifted = find_lifted_samples(point, move)
    return ExportedMotion(
        time=time,
        point=point,
        move=np.where(lifted, int(MoveKind.RAPID), move),
        lifted=lifted,
        q=read_joints(table, empty=False),
        external=read_external(table, cell, empty=False),
        operation=tuple(table.read_words("operation")),
        gamma=np.deg2rad(table.read_numbers("gamma_deg", empty=True)),
        feed=table.read_numbers("feed_mm_min") / 6e4,
        slides=cell.external_prismatic,
        tool=tuple(table.read_words("tool")) if cell.tools else (),
        lead=lead,
        side=side,
    )


def read_points(file: Path, cell: Cell) -> ExportedPoints:
    """Read points.csv.

    Args:
        file: Path of the file.
        cell: The robot cell.

    Raises:
        InputError: the file, a column or a number is missing, or a column is unknown.
    """
    table = read_table(file)
    shifted, tilted = (any(name in table for name in names) for names in (SHIFT_COLUMNS, TILT_COLUMNS))
    axes = list_external_names(cell)
    more = (*(SHIFT_COLUMNS if shifted else ()), *(TILT_COLUMNS if tilted else ()))
    check_column_names(table, (*POINT_COLUMNS, *axes, *more), OPTIONAL_COLUMNS)
    lead, side = _read_tilt(table) if tilted else (None, None)
    number = table.read_numbers("point")
    odd = np.flatnonzero((number != np.round(number)) | (np.abs(number) > MAX_POINT_NUMBER))
    if len(odd):
        row = int(odd[0])
        raise OutputFolderError(f"{number[row]:g} is no point number", file=file, where=f"data row {row + 1}, point")
    parse_moves(table)
    skip = {"point", *JOINT_COLUMNS, *axes, *SHIFT_COLUMNS, *TILT_COLUMNS}
    shift = np.column_stack([table.read_numbers(n) for n in SHIFT_COLUMNS]) / 1e3 if shifted else None
    return ExportedPoints(
        point=number.astype(int),
        q=read_joints(table, empty=True),
        external=read_external(table, cell, empty=True),
        status=tuple(table.read_words("status")),
        numbers={
            name: table.read_numbers(name, empty=name not in POINT_COLUMNS[3:9])
            for name in table.parts
            if name not in skip
        },
        words={name: tuple(words) for name, words in table.text.items() if name != "status"},
        shift=shift,
        lead=lead,
        side=side,
    )


def read_compensation(file: Path) -> ExportedShift:
    """Read compensation.csv.

    Args:
        file: Path of the file.

    Raises:
        InputError: the file, a column or a number is missing, or the index falls.
    """
    table = read_table(file)
    index = _read_rising_index(table)
    offset, force = (
        np.column_stack([table.read_numbers(n) for n in names])
        for names in (("dx_mm", "dy_mm", "dz_mm"), ("fx_N", "fy_N", "fz_N"))
    )
    return ExportedShift(index, offset / 1e3, force)


def read_tilt(file: Path) -> ExportedTilt:
    """Read tilt.csv.

    Args:
        file: Path of the file.

    Raises:
        InputError: the file, a column or a number is missing, or the index falls.
    """
    table = read_table(file)
    check_column_names(table, ("point", *TILT_COLUMNS), ())
    index = _read_rising_index(table)
    lead, side = (np.deg2rad(table.read_numbers(name)) for name in TILT_COLUMNS)
    return ExportedTilt(index, lead, side)


def read_engagement(file: Path, points: int) -> StockEngagement:
    """Read engagement.csv; which points it is known at, and what they remove, are left empty.

    Args:
        file: Path of the file.
        points: Number of toolpath points.

    Raises:
        InputError: the file, a column or a number is missing, the points fall, or one does not exist.
    """
    table = read_table(file)
    check_column_names(table, ("point", *ARC_COLUMNS), ())
    index = _read_rising_index(table)
    if len(index) and not (index[0] >= 0 and index[-1] < points and (index == np.round(index)).all()):
        raise OutputFolderError(f"a point is no number from 0 to {points - 1}", file=table.file, where="point")
    low, high, start, end = (table.read_numbers(name) for name in ARC_COLUMNS)
    return StockEngagement(
        point=index.astype(np.int64),
        low=low / 1e3,
        high=high / 1e3,
        start=np.deg2rad(start),
        end=np.deg2rad(end),
        is_computed=np.zeros(points, bool),
        volume=np.zeros(points),
        is_end_cut=np.zeros(points, bool),
        edge_sigma=0.0,
    )


def _read_rising_index(table: ColumnTable) -> Array:
    index = table.read_numbers("point")
    if (np.diff(index) < 0).any():
        row = int(np.flatnonzero(np.diff(index) < 0)[0]) + 2
        raise OutputFolderError(
            "the index decreases; corners must be in ascending order", file=table.file, where=f"data row {row}, point"
        )
    return index


def _read_tilt(table: ColumnTable) -> tuple[Array, Array]:
    lead, side = (np.deg2rad(table.read_numbers(name, empty=True)) for name in TILT_COLUMNS)
    return lead, side


def check_column_names(table: ColumnTable, needed: Sequence[str], further: Sequence[str]) -> None:
    """Check that a table has the needed columns and no unknown one.

    Args:
        table: The table.
        needed: Names of the columns that must be there.
        further: Names of those that may be there.

    Raises:
        InputError: a column is missing or unknown.
    """
    for name in needed:
        if name not in table:
            raise OutputFolderError(
                f"column {name!r} is missing; there are {', '.join(table.column_names)}", file=table.file
            )
    for name in table.column_names:
        if name not in needed and name not in further:
            raise OutputFolderError(
                f"column {name!r} is not known; known are {', '.join((*needed, *further))}", file=table.file
            )


def _check_tools(table: ColumnTable, cell: Cell) -> None:
    """Check that every row has the tool of the toolpath, or one of the table where it has several."""
    wanted = {*cell.tools} if cell.tool_name is None else {cell.tool_name}
    for row, word in enumerate(table.read_words("tool"), start=1):
        if word not in wanted:
            known = f"the cell has {', '.join(cell.tools)}" if word not in cell.tools else "the toolpath wants another"
            raise OutputFolderError(
                f"{word!r} is not the tool {cell.tool_name or ' or '.join(cell.tools)!r}; {known}",
                file=table.file,
                where=f"data row {row}, tool",
            )


def find_lifted_samples(point: Array, move: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return (S,) rows called link behind a retract and ahead of an approach, all of them at one whole toolpath index.

    Args:
        point: (S,) fractional toolpath index, NaN where empty.
        move: (S,) move codes as printed.
    """
    linked = np.r_[False, move == MoveKind.LINK, False]
    begins, ends = (np.flatnonzero(linked[1:] & ~linked[:-1]), np.flatnonzero(~linked[1:] & linked[:-1]))
    out = np.zeros(len(move), bool)
    for a, b in zip(begins.tolist(), ends.tolist(), strict=True):  # rows a … b − 1
        if a == 0 or b == len(move) or move[a - 1] != MoveKind.RETRACT or move[b] != MoveKind.APPROACH:
            continue
        there = point[a - 1 : b + 1]
        out[a:b] = np.isfinite(there).all() and (there == np.round(there[0])).all()
    return out


def parse_moves(table: ColumnTable) -> NDArray[np.int64]:
    """Return the (S,) move codes of a table.

    Args:
        table: The table, with a column ``move``.

    Raises:
        InputError: a word that is no move.
    """
    code = {word: n for n, word in enumerate(MOVE_WORDS)}
    moves = table.read_words("move")
    if not code.keys() >= {*moves}:
        line, word = next((n, word) for n, word in enumerate(moves, start=1) if word not in code)
        raise OutputFolderError(
            f"{word!r} is no move; {', '.join(MOVE_WORDS)} are", file=table.file, where=f"data row {line}, move"
        )
    return np.array([code[word] for word in moves])


def read_joints(table: ColumnTable, *, empty: bool) -> Array:
    """Return the (rows, 6) rad of the joint columns.

    Args:
        table: The table.
        empty: Whether fields may be empty: NaN.

    Raises:
        InputError: a field is no number.
    """
    first = table.read_numbers(JOINT_COLUMNS[0], empty=empty)
    out = np.empty((len(first), len(JOINT_COLUMNS)))
    for n, name in enumerate(JOINT_COLUMNS):  # column by column: a million rows of all of them are held once
        np.deg2rad(table.read_numbers(name, empty=empty), out=out[:, n])
    return out


def list_external_names(cell: Cell) -> list[str]:
    """Return the names of the columns of the external joints.

    Args:
        cell: The robot cell.
    """
    return [f"e{n}_mm" if slides else f"e{n}_deg" for n, slides in enumerate(cell.external_prismatic, start=1)]


def read_external(table: ColumnTable, cell: Cell, *, empty: bool, first: str = JOINT_COLUMNS[0]) -> Array:
    """Return the (rows, E) rad or m of the columns of the external joints.

    Args:
        table: The table.
        cell: The robot cell.
        empty: Whether fields may be empty: NaN.
        first: A column that the table has in any case.

    Raises:
        InputError: a field is no number.
    """
    names = list_external_names(cell)
    columns = [table.read_numbers(n, empty=empty) * (1e-3 if n.endswith("mm") else np.pi / 180.0) for n in names]
    return np.array(columns).T.reshape(len(table.read_numbers(first, empty=True)), -1)
