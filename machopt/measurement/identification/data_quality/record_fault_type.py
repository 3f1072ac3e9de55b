"""Fault of a recording, and the format of row locations in messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.estimation.load_test_equations import LoadTestExperiment

MAX_LISTED_ROWS = 6


@dataclass(frozen=True, kw_only=True)
class RecordFault:
    """One fault of a recording."""

    code: str
    severity: Literal["error", "warning"]
    message: str  # what is wrong, and what would be accepted
    rows: tuple[int, ...] = ()  # 0-based readings concerned; empty: all
    column: str = ""  # first column of the group in another unit
    factor: float = 1.0  # correction factor for its values


def format_row_locations(e: LoadTestExperiment, rows: NDArray[np.int64]) -> str:
    """Format the locations of readings: ``line 3, line 7 and 4 more``.

    Args:
        e: Load tests in base axes.
        rows: Reading indices, 0-based.

    Returns:
        Text.
    """
    listed = ", ".join(e.format_reading_location(int(r)) for r in rows[:MAX_LISTED_ROWS])
    return listed + (f" and {len(rows) - MAX_LISTED_ROWS} more" if len(rows) > MAX_LISTED_ROWS else "")
