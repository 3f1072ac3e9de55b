"""Measured stiffness at positions or in postures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array


@dataclass(frozen=True)
class MeasuredStiffness:
    """Stiffness measured at P places; either the places or the postures are known, or both."""

    file: Path
    position: Array | None  # (P, 3) m, TCP in the map's frame
    q: Array | None  # (P, 6) rad
    stiffness: dict[str, Array]  # "x", "y", "z" → (P,) N/m
    lines: NDArray[np.int64]  # (P,) for messages

    def __len__(self) -> int:
        return len(self.lines)
