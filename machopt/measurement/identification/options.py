"""Options of an identification, in SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from machopt.data_types.stiffness import StiffnessTerm

Model = Literal["constant", "grid", "auto"]


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of an identification."""

    model: Model = "constant"  # auto: the grid if its cross-validated error is clearly smaller
    terms: tuple[StiffnessTerm, ...] = ()  # terms to fit together with the joints: effect, location, geometry
    geometric: bool = False  # at the loaded equilibrium: K_C, and weight where masses are known
    load_effect: bool = False  # K_C of the load alone, if it changes a joint beyond the noise
    weighted: bool = True  # False: equal weights (dumas2011 eq. 26 with robust and bounded off)
    robust: bool = True  # reject gross outliers
    bounded: bool = True  # compliances ≥ 0
    grid_cell: float = 0.3  # m, edge of a cell
    grid_origin: tuple[float, float, float] | None = None  # m in base_link, lowest corner; None: about the readings
    grid_shape: tuple[int, int, int] | None = None  # cells along x, y, z; None: about the readings
    level: float = 0.9  # confidence level of the intervals
    studies: bool = True  # study the effect of the number of tests and of measurement errors
    accept: frozenset[str] = frozenset()  # codes of recording errors that become warnings
    seed: int = 0
