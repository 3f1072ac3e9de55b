"""What an identification found, with every intermediate a report or a test may want to see."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.arrays import Array
from machopt.domain.stiffness import Stiffness
from machopt.estimate.components import Scatter
from machopt.identify.finding import RecordFault
from machopt.identify.fit import Fit
from machopt.identify.grid import GridFit
from machopt.identify.heldout import Errors
from machopt.identify.identifiability import Settled
from machopt.identify.influence import Influence, Outlier
from machopt.identify.study import MonteCarlo, SubsetStudy
from machopt.identify.uncertainty import Uncertainty


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """One joint of the constant model."""

    joint: int  # 1 … 6
    k: float  # N·m/rad; the cell's or a bound where not identified
    interval: tuple[float, float]  # N·m/rad; the upper end inf where zero compliance cannot be excluded
    sigma: float  # rad/(N·m), standard error of the compliance; inf where the readings say nothing
    freedom: float  # degrees of freedom of sigma
    identified: bool
    reason: str  # why not
    torque: float  # N·m, the largest that a reading puts on it
    expected: float  # share, standard error that the design promises per compliance
    inflation: float  # variance beside that with this unknown alone


@dataclass(frozen=True, kw_only=True)
class TermResult:
    """One coefficient of a term that was fitted."""

    effect: str
    location: str
    name: str
    unit: str
    value: float  # SI
    interval: tuple[float, float]
    sigma: float
    identified: bool
    reason: str


@dataclass(frozen=True)
class ResidualTable:
    """Every reading against the model; base_link axes, at the TCP."""

    measured: Array  # (N, D) m, rad
    predicted: Array  # (N, D)
    uncertainty: Array  # (N, D) 1 sigma of the prediction, from the coefficients' covariance
    heldout: Array  # (N, D) residual with the reading's pose left out; NaN with one pose
    weight: Array  # (N, D) in [0, 1]; below 0.5 an outlier

    @property
    def residual(self) -> Array:
        return np.asarray(self.measured - self.predicted)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Result of :func:`machopt.identify.pipeline.identify`."""

    model: Literal["constant", "grid"]
    why_model: str  # how the model was chosen; empty where it was asked for
    readings: int
    poses: int
    stiffness: Stiffness  # to be written as stiffness.yaml
    joints: tuple[JointResult, ...]  # constant model
    terms: tuple[TermResult, ...]
    combinations: tuple[str, ...]  # what is known of joints that are not identified by themselves
    errors: Errors  # of the model chosen, on the readings it was fitted to
    heldout: Errors | None  # on poses it did not see; None with one pose
    condition_number: float  # of the weighted design in columns of unit size
    condition_plain: float  # of B as it stands in dumas2011 eq. 22
    scatter: tuple[Scatter, ...]  # translation, rotation
    findings: tuple[RecordFault, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]  # how noise and values came about; nothing to worry about
    table: ResidualTable
    influence: Influence
    outliers: tuple[Outlier, ...]
    subsets: SubsetStudy | None
    monte_carlo: MonteCarlo | None
    fit: Fit
    uncertainty: Uncertainty
    settled: Settled
    grid: GridFit | None = None
    equilibrium_influence: Array | None = None  # (N,) share of the translation that K_C, weight and finite turning make
