"""Reader of rapid_corners.csv for the verification."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.rapid_corners import RapidCorners
from machopt.errors import OutputFolderError
from machopt.numerics.array_types import Bools
from machopt.verification.tables.csv_columns import ColumnTable, read_table
from machopt.verification.tables.exported_tables import (
    JOINT_COLUMNS,
    check_column_names,
    list_external_names,
    read_external,
    read_joints,
)

CORNER_COLUMNS = ("sample", "from_sample", "to_sample", "before_percent", "after_percent")
MAX_SHARE = 0.5  # of a move, from either end
PRINTED_SHARE = 1e-6  # what the decimals of joints and shares leave of a share
JOINT_TOLERANCE = 1e-8  # rad or m beyond a limit: the joints have nine decimals


def read_rapid_corners(file: Path, cell: Cell, samples: int | None = None) -> RapidCorners | None:
    """Read rapid_corners.csv.

    Args:
        file: Path of the file.
        cell: The robot cell.
        samples: Number of rows of trajectory.csv; None: a check of the motion compares them.

    Returns:
        None where there is no such file.

    Raises:
        InputError: a column or a number is missing, the samples are no rows of the motion in order, a share is not
            above 0 and at most 50 %, or a joint is beyond its limits.
    """
    if not file.exists():
        return None
    table = read_table(file)
    names = list_external_names(cell)
    check_column_names(table, (*CORNER_COLUMNS, *JOINT_COLUMNS, *names), ())
    sample, before, after = (table.read_numbers(name) for name in CORNER_COLUMNS[:3])
    last = np.iinfo(np.int64).max if samples is None else samples - 1
    in_order = (before >= 0) & (before < sample) & (sample < after) & (after <= last)
    for values in (sample, before, after):
        in_order &= values == np.round(values)
    _require_rows(table, "sample", in_order, "0 <= from_sample < sample < to_sample < rows of trajectory.csv")
    _require_rows(table, "sample", np.diff(sample, prepend=-1.0) > 0, "samples that rise")
    share = np.column_stack([table.read_numbers(name) for name in CORNER_COLUMNS[3:]]) / 100.0
    for name, values in zip(CORNER_COLUMNS[3:], share.T, strict=True):
        _require_rows(table, name, (values > 0) & (values <= MAX_SHARE + PRINTED_SHARE), "more than 0 and at most 50")
    q = read_joints(table, empty=False)
    external = read_external(table, cell, empty=False, first=CORNER_COLUMNS[0])
    x = np.hstack([q, external])
    beyond = np.maximum(cell.limits.lower - x, x - cell.limits.upper)
    for name, values in zip((*JOINT_COLUMNS, *names), beyond.T, strict=True):
        _require_rows(table, name, values <= JOINT_TOLERANCE, "a position within the limits of the joint")
    return RapidCorners(
        sample=sample.astype(np.int64),
        before=before.astype(np.int64),
        after=after.astype(np.int64),
        q=q,
        external=external,
        share=share,
    )


def _require_rows(table: ColumnTable, name: str, is_selected: Bools, expected: str) -> None:
    wrong = np.flatnonzero(~is_selected)
    if len(wrong):
        row = int(wrong[0])
        found = table.read_numbers(name)[row]
        raise OutputFolderError(
            f"found {found:g}; expected {expected}", file=table.file, where=f"data row {row + 1}, {name}"
        )
