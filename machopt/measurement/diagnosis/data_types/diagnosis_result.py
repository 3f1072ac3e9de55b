"""What a diagnosis says: data only, SI unless a field says otherwise; the page and diagnosis.json are made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from machopt.data_types.stiffness import SOFTEST, STIFFEST
from machopt.measurement.diagnosis import thresholds
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
    """A number with how sure it is."""

    value: float
    unit: str
    ci90: tuple[float, float]
    ci95: tuple[float, float]


@dataclass(frozen=True)
class LawFit:
    """A law as fitted to the recording, SI; with it the law can be predicted where nothing was measured yet."""

    coefficients: tuple[float, ...]
    shape: tuple[float, ...]  # in shares of this recording's torques where the law counts so
    correction: Correction | None = None  # the same in absolute units


@dataclass(frozen=True, kw_only=True)
class RivalExplanation:
    """Another explanation of the same mismatch, and what became of it."""

    effect: str
    location: str
    law: str
    closed: float  # share of the finding's gain on unseen groups that this one reaches alone
    standing: Literal["rejected", "not excluded"]
    p_value: float  # that it does as well, paired over held-out groups
    placebo: bool = False  # a law that must lose: the same at a wrong place, or with its driver shuffled
    fit: LawFit | None = None
    named: LawFit | None = None  # of the law it was compared with


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One effect that the nominal model leaves out."""

    effect: str
    location: str
    law: str
    equation: str
    note: str  # where it shows: "on load reversal"
    one_of: tuple[EffectLocation, ...]  # what these data cannot tell apart; the named one first
    parameters: Mapping[str, EstimatedValue]  # the first is the size
    before: float  # held-out rmse of the first family without it, the others in; report unit
    after: float
    p_value: float  # of the whole search, not of this effect alone
    rivals: tuple[RivalExplanation, ...] = ()
    correction: Correction | None = None
    curve: LawCurve | None = None
    curve_residual: Array | None = None  # (N,) in y units of the curve: what the readings leave around the law
    record: bool = False  # of the record (units, frames, outliers …), not of the robot


@dataclass(frozen=True)
class AxisInterval:
    """A part of an axis of the data, SI."""

    low: float
    high: float  # the same as ``low``: one level
    readings: float  # share of them that lies there

    @property
    def words(self) -> str:
        levels = f"{self.low:g}" if self.low == self.high else f"{self.low:.4g} … {self.high:.4g}"
        return f"{levels}: {100 * self.readings:.0f} % of the readings"


@dataclass(frozen=True)
class MismatchShare:
    """A part of the mismatch and where it lives."""

    axis: str  # "joint:3", "base", "sensor:force", or of the data: "branch", "load level", "session" …
    share: float  # of the repeatable mismatch (power)
    note: str
    kind: Literal["machine", "data"] = "machine"
    stretch: AxisInterval | None = None  # of an axis of the data, which ``note`` says in words


@dataclass(frozen=True, kw_only=True)
class DetectionLimit:
    """The least size of an effect that this recording would have shown, in nine of ten repeats."""

    effect: str
    location: str
    value: float
    unit: str
    standing: Testability = "testable"
    one_of: tuple[EffectLocation, ...] = ()  # what it could not be told from


@dataclass(frozen=True)
class BaseCoefficient:
    """A base coefficient after everything that was found is in."""

    unknown: BaseUnknown
    before: float  # base alone
    value: float
    sigma: float


def is_spring_observable(compliance: float, sigma: float) -> bool:
    """Whether readings tell a joint's compliance (rad/(N·m)); else no load moved the joint, or next to none did."""
    return 1.0 / STIFFEST < compliance < 1.0 / SOFTEST and sigma < thresholds.RESTING.certain_joint * compliance


@dataclass(frozen=True)
class HoldoutErrors:
    """Residuals of readings that no fit saw, in SI, and what they come to."""

    residual: Array  # (N, D) base alone, refitted without the reading's group
    final: Array  # (N, D) with the findings
    by_group: Array  # (G, 2) rmse of the first family before and after, report unit; NaN where all rows are out
    groups: Ints  # (G,) labels


@dataclass(frozen=True, kw_only=True)
class HoldoutProof:
    """The one evaluation on data that no step saw."""

    groups: Ints  # labels that were locked away
    before: float  # report unit
    after: float
    noise_floor: float
    wins: int  # groups that the findings predict better
    of: int
    p_value: float


@dataclass(frozen=True, kw_only=True)
class DiagnosisResult:
    """Everything that was found out."""

    channel: Channel
    predicted: str  # which channel was predicted, in words
    verdict: Verdict
    sentence: str  # how much, where, what, how sure, what is not excluded, what next
    unit: str  # of errors: "mm", "N·m", "mrad"
    heldout_before: float  # rmse per coordinate, outliers apart
    noise_floor: float
    repeatable: float  # rmse of what comes back in repeats, base refitted
    mismatch_p: float  # that there is no repeatable mismatch
    heldout_after: float
    explained: float  # share of the repeatable power that the findings close
    repeatable_after: float
    findings: tuple[Finding, ...]
    mismatch: tuple[MismatchShare, ...]
    limits: tuple[DetectionLimit, ...]
    untestable: tuple[UntestableEffect, ...]
    coefficients: tuple[BaseCoefficient, ...]
    errors: HoldoutErrors
    proof: HoldoutProof | None
    used: Flags  # (N,) False: put aside as an outlier
    outliers: Ints  # 1-based data rows
    axes: Mapping[str, Array] = field(default_factory=dict)  # (N,) labels for the report
    tried: int = 0  # hypotheses × shapes
    next_experiment: str = ""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def compute_rms(values: Array) -> float:
    """Root mean square of what is finite; NaN of nothing."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")
