"""diagnosis.json of ``machopt diagnose``."""

from __future__ import annotations

from typing import Literal

from machopt.domain.results.base import Count, First, Flag, Hashes, Known, Knowns, Numbers, Part, Settings, Text

Name = tuple[Text, Text]
"""Effect and location."""
Interval = tuple[Known, Known]


class BaselineErrors(Part):
    """The nominal structure refitted; errors in ``rmse_unit``."""

    heldout_rmse: Known
    noise_floor: Known
    repeatable_rmse: Known
    p_value: Known


class FinalErrors(Part):
    """With what was found."""

    heldout_rmse: Known
    explained_share: Known
    repeatable_rmse: Known


class MismatchShare(Part):
    """A part of the mismatch and where it lives."""

    axis: Text
    share: Known
    note: Text
    kind: Literal["machine", "data"]


class Estimated(Part):
    """A number with how sure it is."""

    value: Known
    unit: Text
    ci95: Interval
    ci90: Interval


class CorrectionTold(Part):
    """What a model file gets, or what was wrong with the record."""

    of: Literal["stiffness", "kinematics", "record"]
    effect: Text
    location: Text
    parameters: Settings


class FittedLaw(Part):
    """A law as fitted, SI: what plan-poses needs to predict it at poses not measured yet."""

    coefficients: Numbers
    shape: Numbers
    correction: CorrectionTold | None


class RivalTold(Part):
    """Another explanation of the same mismatch, and what became of it."""

    effect: Text
    location: Text
    law: Text
    closed_share: Known
    standing: Literal["rejected", "not excluded"]
    p_value: Known
    placebo: Flag
    fit: FittedLaw | None


class FindingTold(Part):
    """One effect that the nominal model leaves out."""

    effect: Text
    location: Text
    one_of: tuple[Name, ...]
    parameters: dict[Text, Estimated]
    heldout_rmse_before: Known
    heldout_rmse_after: Known
    p_value: Known
    law: Text
    equation: Text
    note: Text
    of_the_record: Flag
    rivals: tuple[RivalTold, ...]
    correction: CorrectionTold | None
    fit: FittedLaw | None


class DetectionLimit(Part):
    """The least size of an effect that this recording would have shown."""

    effect: Text
    location: Text
    value: Known
    unit: Text
    standing: Literal["testable", "only as a set", "not testable"]
    one_of: tuple[Name, ...]


class NotTestable(Part):
    """An effect that this recording cannot show."""

    effect: Text
    location: Text
    reason: Text


class Scatter(Part):
    """Of readings around what was found, SI: a reading's own, and what a visit shares."""

    own: Known
    visit: Known


class Recorded(Part):
    """How it was measured, for whoever plans the next measurement."""

    kind: Text
    coordinates: Count
    wrench_frame: Text
    displacement_frame: Text
    registration: Text
    scatter_m: Scatter | None = None
    scatter_rad: Scatter | None = None


class OutlyingRows(Part):
    """1-based data rows that were put aside."""

    location: Text
    rows: tuple[Count, ...]


class ProofTold(Part):
    """The one evaluation on data that no step saw."""

    groups: tuple[Count, ...]
    heldout_rmse_before: Known
    heldout_rmse_after: Known
    noise_floor: Known
    wins: Count
    of: Count
    p_value: Known


class KeyTold(Part):
    """Which number of the model a coefficient is."""

    effect: Text
    location: Text
    coefficient: Text


class CoefficientTold(Part):
    """A base coefficient, alone and with everything that was found."""

    name: Text
    location: Text
    unit: Text
    before: Known
    value: Known
    sigma: Known
    key: KeyTold | None


class RotationChange(Part):
    """How the rotation chosen anew differs."""

    mean_change_deg: Known
    max_change_deg: Known
    changed_share: Known


class MeanAndWorst(Part):
    """Deflection in mm."""

    mean: Known
    worst: Known


class Cases(Part):
    """Old choice under the old and the new model, and the new choice."""

    before: MeanAndWorst
    unchanged: MeanAndWorst
    after: MeanAndWorst


class CasePoints(Part):
    """Index of the point that bends most in each."""

    before: Known
    unchanged: Known
    after: Known


class Change(Part):
    """A quantity before and after."""

    what: Text
    before: Known
    after: Known
    unit: Text


class EffectOnJob(Part):
    """What the findings change for one toolpath; where nothing can be said ``reason`` says why, without the rest."""

    toolpath: Text
    sentence: Text
    reason: Text | None
    force: Text | None = None
    points_compared: Count | None = None
    points_not_reached: Count | None = None
    not_reached_because: Text | None = None
    rotation: RotationChange | None = None
    deflection_mm: Cases | None = None
    worst_point: CasePoints | None = None
    changes: tuple[Change, ...]
    warnings: tuple[Text, ...] = ()
    point: Knowns | None = None
    gamma_before_deg: Knowns | None = None
    gamma_after_deg: Knowns | None = None
    deflection_before_mm: Knowns | None = None
    deflection_unchanged_mm: Knowns | None = None
    deflection_after_mm: Knowns | None = None


class DiagnosisResult(Part):
    """The whole file."""

    machopt_diagnosis: First
    version: Text
    cell: Text
    recording: Text
    verdict: Literal["consistent", "explained", "partly_explained", "unexplained", "insufficient"]
    sentence: Text
    channel: Literal["deflection", "position", "torque"]
    predicted: Text
    rmse_unit: Text
    baseline: BaselineErrors
    final: FinalErrors
    mismatch: tuple[MismatchShare, ...]
    findings: tuple[FindingTold, ...]
    detection_limits: tuple[DetectionLimit, ...]
    not_testable: tuple[NotTestable, ...]
    next_experiment: Text
    model: Text | None
    kinematics: Text | None
    readings: Count
    recorded: Recorded
    outliers: OutlyingRows | None
    proof: ProofTold | None
    coefficients: tuple[CoefficientTold, ...]
    tried: Count
    notes: tuple[Text, ...]
    warnings: tuple[Text, ...]
    effect_on_job: EffectOnJob | None
    options: Settings
    inputs: Hashes
