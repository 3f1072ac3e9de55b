"""Result of a diagnosis: data only, SI unless a field states otherwise. Report and diagnosis.json are built from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from machopt.data_types.effect_locations import parse_location
from machopt.data_types.stiffness import SOFTEST, STIFFEST
from machopt.measurement import thresholds
from machopt.measurement.diagnosis.data_types.diagnosis_problem import (
    BaseUnknown,
    Channel,
    Correction,
    Flags,
    Ints,
    LawCurve,
    UntestableEffect,
)
from machopt.numerics.array_types import Array

Verdict = Literal["consistent", "explained", "partly_explained", "unexplained", "insufficient"]
EffectLocation = tuple[str, str]  # effect, location
Testability = Literal["testable", "only as a set", "not testable"]  # of an effect's detection limit


@dataclass(frozen=True)
class EstimatedValue:
    """Number with its confidence intervals."""

    value: float
    unit: str
    ci90: tuple[float, float]
    ci95: tuple[float, float]


@dataclass(frozen=True)
class LawFit:
    """Fitted law, SI. With it the law can be predicted at poses that were not measured."""

    coefficients: tuple[float, ...]
    shape: tuple[float, ...]  # relative to this recording's torques if the law is defined so
    correction: Correction | None = None  # the same in absolute units


@dataclass(frozen=True, kw_only=True)
class RivalExplanation:
    """Competing explanation of the same mismatch, and whether it is rejected."""

    effect: str
    location: str
    law: str
    closed: float  # its cross-validated gain relative to that of the finding
    standing: Literal["rejected", "not excluded"]
    p_value: float  # of being equally good, paired over held-out groups
    placebo: bool = False  # the same effect at another place, which should be rejected
    fit: LawFit | None = None
    named: LawFit | None = None  # fit of the law it was compared with


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One effect that the nominal model lacks."""

    effect: str
    location: str
    law: str
    equation: str
    note: str  # where it is visible: "on load reversal"
    one_of: tuple[EffectLocation, ...]  # effects that these data cannot distinguish; the reported one first
    parameters: Mapping[str, EstimatedValue]  # the first is the size
    before: float  # cross-validated rmse of the first family with all other findings; report unit
    after: float
    p_value: float  # corrected for the whole search (max-T)
    rivals: tuple[RivalExplanation, ...] = ()
    correction: Correction | None = None
    curve: LawCurve | None = None
    curve_residual: Array | None = None  # (N,) residuals about the law, in y units of the curve
    record: bool = False  # of the record (units, frames, outliers …), not of the robot


@dataclass(frozen=True)
class AxisInterval:
    """Interval on an axis of the data, SI."""

    low: float
    high: float  # equal to ``low`` for a single level
    readings: float  # share of the readings inside the interval

    @property
    def words(self) -> str:
        levels = f"{self.low:g}" if self.low == self.high else f"{self.low:.4g} … {self.high:.4g}"
        return f"{levels}: {100 * self.readings:.0f} % of the readings"


@dataclass(frozen=True)
class MismatchShare:
    """Part of the mismatch and its location in the machine or in the data."""

    axis: str  # "joint:3", "base", "sensor:force", or of the data: "branch", "load level", "session" …
    share: float  # of the repeatable mismatch (power)
    note: str
    kind: Literal["machine", "data"] = "machine"
    stretch: AxisInterval | None = None  # interval on an axis of the data, described in ``note``


@dataclass(frozen=True, kw_only=True)
class DetectionLimit:
    """Smallest effect that this recording would have detected with 90 % probability."""

    effect: str
    location: str
    value: float
    unit: str
    standing: Testability = "testable"
    one_of: tuple[EffectLocation, ...] = ()  # effects that it could not be distinguished from


@dataclass(frozen=True)
class BaseCoefficient:
    """Coefficient of the base model after all findings are included."""

    unknown: BaseUnknown
    before: float  # fitted with the base alone
    value: float
    sigma: float


def is_spring_observable(compliance: float, sigma: float) -> bool:
    """Return whether the readings determine a joint's compliance; otherwise no load deflected the joint noticeably.

    Args:
        compliance: Joint compliance, rad/(N·m).
        sigma: Its standard deviation, rad/(N·m).

    Returns:
        True if compliance and uncertainty are within plausible bounds.
    """
    return 1.0 / STIFFEST < compliance < 1.0 / SOFTEST and sigma < thresholds.SHARES.max_relative_error * compliance


@dataclass(frozen=True)
class HoldoutErrors:
    """Cross-validated residuals, SI, and their summary."""

    residual: Array  # (N, D) base alone, fitted without the reading's group
    final: Array  # (N, D) with the findings
    by_group: Array  # (G, 2) rmse of the first family before and after, report unit; NaN if all rows are excluded
    groups: Ints  # (G,) labels


@dataclass(frozen=True, kw_only=True)
class HoldoutProof:
    """Validation on groups that no step of the selection used."""

    groups: Ints  # labels of the held-out groups
    before: float  # report unit
    after: float
    noise_floor: float
    wins: int  # number of groups that the findings predict better
    of: int
    p_value: float


@dataclass(frozen=True, kw_only=True)
class RecordChange:
    """Part of the readings that the diagnosis attributes to the recording and not to the arm's model.

    The corrected reading is the recorded displacement or position minus ``measured``, under the recorded wrench plus
    ``wrench``.
    """

    measured: Array  # (N, D) m, rad in base_link axes
    wrench: Array  # (N, 6) N, N·m at the TCP in base_link axes


@dataclass(frozen=True, kw_only=True)
class FoldFit:
    """Fit of the same model without one fold of the readings."""

    groups: Ints  # labels of the groups that this fit did not use
    rows: Ints  # (M,) readings of these groups that are used, 0-based
    coefficients: tuple[float, ...]  # of the base, in the order of DiagnosisResult.coefficients
    corrections: tuple[Correction | None, ...]  # of the findings with coefficients, in their order


@dataclass(frozen=True, kw_only=True)
class DiagnosisResult:
    """Complete result of a diagnosis."""

    channel: Channel
    predicted: str  # which channel was predicted, in words
    verdict: Verdict
    sentence: str  # summary: size, place, cause, certainty, open alternatives, next step
    unit: str  # of errors: "mm", "N·m", "mrad"
    heldout_before: float  # rmse per coordinate, outliers apart
    noise_floor: float
    repeatable: float  # rmse of the repeatable mismatch, base refitted
    mismatch_p: float  # p-value of no repeatable mismatch
    heldout_after: float
    explained: float  # share of the repeatable power that the findings explain
    repeatable_after: float
    findings: tuple[Finding, ...]
    mismatch: tuple[MismatchShare, ...]
    limits: tuple[DetectionLimit, ...]
    untestable: tuple[UntestableEffect, ...]
    coefficients: tuple[BaseCoefficient, ...]
    errors: HoldoutErrors
    proof: HoldoutProof | None
    used: Flags  # (N,) False: excluded as an outlier
    outliers: Ints  # 1-based data rows
    axes: Mapping[str, Array] = field(default_factory=dict)  # (N,) labels for the report
    tried: int = 0  # hypotheses × shapes
    is_ordered: bool = False  # the mismatch is shared by successive readings of other poses, not by repeats of a pose
    measured_noise: float = float("nan")  # noise by replicates or as stated, report unit; NaN: only from residuals
    unnamed: tuple[Finding, ...] = ()  # kinematic corrections that are written, and too uncertain to be named
    rmse: float = float("nan")  # rmse per coordinate of the used readings with the findings, fitted to all of them
    record_change: RecordChange | None = None  # None: no channel of readings at rest
    folds: tuple[FoldFit, ...] = ()
    unwritten: tuple[EffectLocation, ...] = ()  # findings that no model file can state
    fitted_findings: tuple[EffectLocation, ...] = ()  # the findings that ``FoldFit.corrections`` belong to
    next_experiment: str = ""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def joint_count(self) -> int:
        """Number of joints of the arm: at least six, and all that anything was looked for at."""
        places = [*(x.location for x in self.limits), *(x.location for x in self.untestable)]
        return max((n for place in places for n in parse_location(place).numbers), default=6)


def compute_rms(values: Array) -> float:
    """Compute the root mean square of the finite values.

    Args:
        values: Array of any shape.

    Returns:
        The rms; NaN without finite values.
    """
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")
