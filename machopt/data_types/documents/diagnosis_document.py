"""diagnosis.json of ``machopt diagnose``."""

from __future__ import annotations

from typing import Literal

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Flag,
    Hashes,
    Known,
    Knowns,
    Numbers,
    Settings,
    Text,
)

EffectName = tuple[Text, Text]
"""Effect and location."""
ConfidenceInterval = tuple[Known, Known]


class BaselineErrorsSection(DocumentModel):
    """The nominal structure refitted; errors in ``rmse_unit``.

    ``measured_noise`` is that of replicates or the stated uncertainty; null where only residuals show noise.
    """

    heldout_rmse: Known
    noise_floor: Known
    measured_noise: Known
    repeatable_rmse: Known
    p_value: Known


class FinalErrorsSection(DocumentModel):
    """Of the written files on the corrected readings, with the registration fitted again."""

    rmse: Known
    heldout_rmse: Known
    explained_share: Known
    repeatable_rmse: Known


class MismatchShareEntry(DocumentModel):
    """A part of the mismatch and where it lives."""

    axis: Text
    share: Known
    note: Text
    kind: Literal["machine", "data"]


class EstimateSection(DocumentModel):
    """A number with how sure it is."""

    value: Known
    unit: Text
    ci95: ConfidenceInterval
    ci90: ConfidenceInterval


class CorrectionSection(DocumentModel):
    """What a model file gets, or what was wrong with the record."""

    of: Literal["stiffness", "kinematics", "record"]
    effect: Text
    location: Text
    parameters: Settings


class FittedLawSection(DocumentModel):
    """A law as fitted, SI: what plan-poses needs to predict it at poses not measured yet."""

    coefficients: Numbers
    shape: Numbers
    correction: CorrectionSection | None


class RivalEntry(DocumentModel):
    """Another explanation of the same mismatch, and what became of it."""

    effect: Text
    location: Text
    law: Text
    closed_share: Known
    standing: Literal["rejected", "not excluded"]
    p_value: Known
    placebo: Flag
    fit: FittedLawSection | None


class FindingEntry(DocumentModel):
    """One effect that the nominal model leaves out."""

    effect: Text
    location: Text
    one_of: tuple[EffectName, ...]
    parameters: dict[Text, EstimateSection]
    heldout_rmse_before: Known
    heldout_rmse_after: Known
    p_value: Known
    law: Text
    equation: Text
    note: Text
    of_the_record: Flag
    rivals: tuple[RivalEntry, ...]
    correction: CorrectionSection | None
    fit: FittedLawSection | None


class DetectionLimitEntry(DocumentModel):
    """The least size of an effect that this recording would have shown."""

    effect: Text
    location: Text
    value: Known
    unit: Text
    standing: Literal["testable", "only as a set", "not testable"]
    one_of: tuple[EffectName, ...]


class NotTestableEntry(DocumentModel):
    """An effect that this recording cannot show."""

    effect: Text
    location: Text
    reason: Text


class ScatterSection(DocumentModel):
    """Of readings around what was found, SI: a reading's own, and what a visit shares."""

    own: Known
    visit: Known


class RecordingSection(DocumentModel):
    """How it was measured, for whoever plans the next measurement."""

    kind: Text
    coordinates: Count
    wrench_frame: Text
    displacement_frame: Text
    registration: Text
    scatter_m: ScatterSection | None = None
    scatter_rad: ScatterSection | None = None


class OutlierRowsEntry(DocumentModel):
    """1-based data rows that were put aside."""

    location: Text
    rows: tuple[Count, ...]


class HoldoutValidationSection(DocumentModel):
    """The one evaluation on data that no step saw."""

    groups: tuple[Count, ...]
    heldout_rmse_before: Known
    heldout_rmse_after: Known
    noise_floor: Known
    wins: Count
    of: Count
    p_value: Known


class CoefficientKeySection(DocumentModel):
    """Which number of the model a coefficient is."""

    effect: Text
    location: Text
    coefficient: Text


class CoefficientEntry(DocumentModel):
    """A base coefficient, alone and with everything that was found."""

    name: Text
    location: Text
    unit: Text
    before: Known
    value: Known
    sigma: Known
    key: CoefficientKeySection | None


class RotationChangeSection(DocumentModel):
    """How the rotation chosen anew differs."""

    mean_change_deg: Known
    max_change_deg: Known
    changed_share: Known


class MeanAndWorstSection(DocumentModel):
    """Deflection in mm."""

    mean: Known
    worst: Known


class ModelCasesSection(DocumentModel):
    """Old choice under the old and the new model, and the new choice."""

    before: MeanAndWorstSection
    unchanged: MeanAndWorstSection
    after: MeanAndWorstSection


class CasePointsSection(DocumentModel):
    """Index of the point that bends most in each."""

    before: Known
    unchanged: Known
    after: Known


class QuantityChangeEntry(DocumentModel):
    """A quantity before and after."""

    what: Text
    before: Known
    after: Known
    unit: Text


class FindingAtJobEntry(DocumentModel):
    """What one finding changes at the job: mean change of the deflection vector without it, over the cut length."""

    effect: Text
    location: Text
    deflection_mm: Known


class JobEffectSection(DocumentModel):
    """What the findings change for one toolpath; ``reason`` alone where it cannot be computed."""

    toolpath: Text
    sentence: Text
    reason: Text | None
    force: Text | None = None
    points_compared: Count | None = None
    points_not_reached: Count | None = None
    not_reached_because: Text | None = None
    rotation: RotationChangeSection | None = None
    deflection_mm: ModelCasesSection | None = None
    worst_point: CasePointsSection | None = None
    changes: tuple[QuantityChangeEntry, ...]
    by_finding: tuple[FindingAtJobEntry, ...] = ()
    warnings: tuple[Text, ...] = ()
    point: Knowns | None = None
    gamma_before_deg: Knowns | None = None
    gamma_after_deg: Knowns | None = None
    deflection_before_mm: Knowns | None = None
    deflection_unchanged_mm: Knowns | None = None
    deflection_after_mm: Knowns | None = None


class DiagnosisDocument(DocumentModel):
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
    baseline: BaselineErrorsSection
    final: FinalErrorsSection
    mismatch: tuple[MismatchShareEntry, ...]
    findings: tuple[FindingEntry, ...]
    unnamed_corrections: tuple[CorrectionSection, ...]
    detection_limits: tuple[DetectionLimitEntry, ...]
    not_testable: tuple[NotTestableEntry, ...]
    next_experiment: Text
    model: Text | None
    kinematics: Text | None
    readings: Count
    recorded: RecordingSection
    outliers: OutlierRowsEntry | None
    proof: HoldoutValidationSection | None
    coefficients: tuple[CoefficientEntry, ...]
    tried: Count
    notes: tuple[Text, ...]
    warnings: tuple[Text, ...]
    effect_on_job: JobEffectSection | None
    options: Settings
    inputs: Hashes
