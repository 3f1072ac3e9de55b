"""Data of the identification page in SI; plain arrays, no model is evaluated here."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True, kw_only=True)
class IdentifiedCoefficient:
    """One identified number: a joint's stiffness, or a coefficient of a further term."""

    name: str  # "joint 3", "link_compliance link:4 EI"
    unit: str  # displayed unit
    value: float  # in ``unit``
    low: float  # interval of the page's level
    high: float  # may be infinite
    prior: float  # NaN where there is none
    identified: bool
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class StiffnessGridView:
    """Stiffness per grid cell."""

    shape: tuple[int, int, int]
    centre: Array  # (G, 3) m in base_link, x fastest
    k: Array  # (G, 6) N·m/rad
    std: Array  # (G, 6) N·m/rad
    readings: Array  # (G,) effective number of readings
    constant: Array  # (6,) N·m/rad, what the cells were shrunk to


@dataclass(frozen=True)
class SubsetSpread:
    """Spread of the stiffness over random subsets of the tests (dumas2011 fig. 7)."""

    tests: Ints  # (T,)
    low: Array  # (T, 6) N·m/rad, 5 %
    median: Array  # (T, 6)
    high: Array  # (T, 6), 95 %


@dataclass(frozen=True)
class ModelComparisonRow:
    """One model among those tried."""

    name: str
    coefficients: int
    rmse: float  # m, in sample
    heldout: float  # m, poses left out
    chosen: bool


@dataclass(frozen=True, kw_only=True)
class IdentificationPageData:
    """Everything on the page; N readings with D = 3 or 6 components."""

    title: str
    cell: str
    recording: str
    version: str
    tone: str  # "good" | "warn" | "bad"
    badge: str
    sentence: str
    cautions: tuple[str, ...]
    joints: tuple[IdentifiedCoefficient, ...]
    terms: tuple[IdentifiedCoefficient, ...]
    measured: Array  # (N, D) m, rad
    predicted: Array  # (N, D)
    heldout: Array  # (N, D) predicted by fits that did not see the pose; NaN where not made
    sigma: Array  # (N, D) standard uncertainty of each number
    pose: Ints  # (N,)
    line: Ints  # (N,)
    load: Array  # (N,) N, size of the force
    outlier: NDArray[np.bool_]  # (N,)
    leverage: Array  # (N,)
    compliances: Array  # (6,) rad/(N·m)
    covariance: Array  # (6, 6) (rad/(N·m))²
    rmse: float  # m
    heldout_rmse: float  # m
    explained: float  # share of the squared displacements that the fit explains where it saw them
    displacement: float  # m, rms of what was measured
    condition_number: float
    level: float = 0.9  # of the intervals
    comparisons: tuple[ModelComparisonRow, ...] = ()
    subset: SubsetSpread | None = None
    monte_carlo: Array | None = None  # (6,) relative standard deviation of k
    grid: StiffnessGridView | None = None
    facts: tuple[tuple[str, str], ...] = field(default=())  # name, value: options, hashes, counts
