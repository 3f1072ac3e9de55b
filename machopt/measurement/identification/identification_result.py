"""Result of an identification, with the intermediate results that reports and tests use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from machopt.data_types.stiffness import ArmStiffness
from machopt.measurement.estimation.variance_components import NoiseScatter
from machopt.measurement.identification.assessment.coefficient_uncertainty import CoefficientUncertainty
from machopt.measurement.identification.assessment.holdout_errors import HoldoutErrorSummary
from machopt.measurement.identification.assessment.identifiability import SettledCoefficients
from machopt.measurement.identification.assessment.leverage_and_outliers import ReadingInfluence, ReadingOutlier
from machopt.measurement.identification.assessment.subset_and_monte_carlo_studies import (
    MonteCarloResult,
    SubsetStudyResult,
)
from machopt.measurement.identification.data_quality.record_fault_type import RecordFault
from machopt.measurement.identification.fitting.weighted_fit import StiffnessFit
from machopt.measurement.identification.grid_stiffness.grid_fit import GridFit
from machopt.numerics.array_types import Array


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """One joint of the constant model."""

    joint: int  # 1 … n
    k: float  # N·m/rad; the cell's value or a bound if not identified
    interval: tuple[float, float]  # N·m/rad; upper end inf if zero compliance cannot be excluded
    sigma: float  # rad/(N·m), standard error of the compliance; inf without data
    freedom: float  # degrees of freedom of sigma
    identified: bool
    reason: str  # why it is not identified; else empty
    torque: float  # N·m, largest torque in any reading
    expected: float  # relative standard error expected from the design
    inflation: float  # variance inflation factor caused by the other unknowns


@dataclass(frozen=True, kw_only=True)
class TermResult:
    """One coefficient of a fitted term."""

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
    """Measured and predicted values of every reading; base_link axes, at the TCP."""

    measured: Array  # (N, D) m, rad
    predicted: Array  # (N, D)
    uncertainty: Array  # (N, D) 1 sigma of the prediction, from the coefficients' covariance
    heldout: Array  # (N, D) cross-validated residual; NaN for a single pose
    weight: Array  # (N, D) in [0, 1]; below 0.5 an outlier

    @property
    def residual(self) -> Array:
        return np.asarray(self.measured - self.predicted)


@dataclass(frozen=True, kw_only=True)
class IdentificationResult:
    """Result of :func:`machopt.measurement.identification.identification_pipeline.identify_stiffness`."""

    model: Literal["constant", "grid"]
    why_model: str  # how the model was chosen; empty where it was requested
    readings: int
    poses: int
    stiffness: ArmStiffness  # to be written as stiffness.yaml
    joints: tuple[JointResult, ...]  # constant model
    terms: tuple[TermResult, ...]
    combinations: tuple[str, ...]  # identifiable combinations of joints
    errors: HoldoutErrorSummary  # of the selected model, on the fitted readings
    heldout: HoldoutErrorSummary | None  # cross-validated; None for a single pose
    condition_number: float  # of the weighted design matrix with columns of unit size
    condition_plain: float  # of B as in dumas2011 eq. 22
    scatter: tuple[NoiseScatter, ...]  # translation, rotation
    findings: tuple[RecordFault, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]  # origin of noise and values; information only
    table: ResidualTable
    influence: ReadingInfluence
    outliers: tuple[ReadingOutlier, ...]
    subsets: SubsetStudyResult | None
    monte_carlo: MonteCarloResult | None
    fit: StiffnessFit
    uncertainty: CoefficientUncertainty
    settled: SettledCoefficients
    grid: GridFit | None = None
    sessions: int = 1  # each with its own gain of the force sensor
    lever: float = 0.0  # m, typical distance of the TCP from the flange
    equilibrium_influence: Array | None = (
        None  # (N,) relative change of the translation by K_C, weight and finite rotations
    )
