"""One thing that is wrong with a record, and how its readings are named in a message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.estimate.experiment import Experiment

SHOWN = 6


@dataclass(frozen=True, kw_only=True)
class RecordFault:
    """One thing that is wrong with a record."""

    code: str
    severity: Literal["error", "warning"]
    message: str  # what, and what would work
    rows: tuple[int, ...] = ()  # 0-based readings it concerns; empty: all
    column: str = ""  # first column of the group that is in another unit
    factor: float = 1.0  # what its values as read have to be multiplied by


def places(e: Experiment, rows: NDArray[np.int64]) -> str:
    """``line 3, line 7 and 4 more``."""
    shown = ", ".join(e.place(int(r)) for r in rows[:SHOWN])
    return shown + (f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else "")
