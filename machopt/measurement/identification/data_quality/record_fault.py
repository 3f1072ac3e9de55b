"""One thing that is wrong with a record, and how its readings are named in a message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.measurement.estimation.load_test_equations import LoadTestExperiment

MAX_LISTED_ROWS = 6


@dataclass(frozen=True, kw_only=True)
class RecordFault:
    """One thing that is wrong with a record."""

    code: str
    severity: Literal["error", "warning"]
    message: str  # what, and what would work
    rows: tuple[int, ...] = ()  # 0-based readings it concerns; empty: all
    column: str = ""  # first column of the group that is in another unit
    factor: float = 1.0  # what its values as read have to be multiplied by


def format_row_locations(e: LoadTestExperiment, rows: NDArray[np.int64]) -> str:
    """``line 3, line 7 and 4 more``."""
    shown = ", ".join(e.format_reading_location(int(r)) for r in rows[:MAX_LISTED_ROWS])
    return shown + (f" and {len(rows) - MAX_LISTED_ROWS} more" if len(rows) > MAX_LISTED_ROWS else "")
