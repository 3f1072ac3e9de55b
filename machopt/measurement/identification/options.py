"""What steers one identification, in SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from machopt.data_types.stiffness import StiffnessTerm

Model = Literal["constant", "grid", "auto"]


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Everything that steers one identification."""

    model: Model = "constant"  # auto: the grid where it predicts unseen poses clearly better
    terms: tuple[StiffnessTerm, ...] = ()  # physics to be fitted beside the joints: effect, location, geometry
    geometric: bool = False  # at the loaded equilibrium: K_C, and weight where masses are known
    load_effect: bool = False  # K_C of the load alone, where it would move a joint beyond the noise
    weighted: bool = True  # False: every coordinate counts alike (dumas2011 eq. 26 with robust and bounded off)
    robust: bool = True  # put gross outliers aside
    bounded: bool = True  # compliances ≥ 0
    grid_cell: float = 0.3  # m, edge of a cell
    grid_origin: tuple[float, float, float] | None = None  # m in base_link, lowest corner; None: about the readings
    grid_shape: tuple[int, int, int] | None = None  # cells along x, y, z; None: about the readings
    level: float = 0.9  # of the intervals
    studies: bool = True  # what the number of tests and the measurement errors do
    accept: frozenset[str] = frozenset()  # codes of record errors to be taken as warnings
    seed: int = 0
