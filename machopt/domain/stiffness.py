"""Joint stiffness: constant, or constant per cell of a grid over the TCP position (jiao2022, section 2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StiffnessGrid:
    """Piecewise constant joint stiffness over boxes of TCP positions in base_link; x fastest."""

    origin: Array  # (3,) m, lowest corner, in base_link
    cell: float  # m, edge length
    shape: tuple[int, int, int]
    joints: Array  # (nx*ny*nz, 6) N·m/rad, x fastest


@dataclass(frozen=True)
class Stiffness:
    """Joint stiffness of the arm.

    Outside ``grid`` the constant values hold (flagged in the results).
    """

    joints: Array  # (6,) N·m/rad
    covariance: Array | None = None  # (6, 6) of the joint compliances, (rad/(N·m))²
    grid: StiffnessGrid | None = None
    terms: tuple[dict[str, object], ...] = ()  # further physics as in stiffness.yaml
