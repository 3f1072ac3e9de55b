"""plan.json of ``machopt plan-poses``."""

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
    Number,
    Text,
)


class PoseCandidatesSection(DocumentModel):
    """Poses evaluated, and where the others failed first."""

    poses: Count
    tried: Count
    rejected: dict[Text, Count]


class LoadCasesSection(DocumentModel):
    """Pose × load pairs, and what forbids the others."""

    ways: Count
    admissible: Count
    rejected: dict[Text, Count]


class UnknownParameterEntry(DocumentModel):
    """A number to be determined, and how well this plan determines it; a share of ``scale`` where ``relative``."""

    name: Text
    unit: Text
    scale: Known
    relative: Flag
    standard_uncertainty: Known
    seen: Flag


class DesignQualitySection(DocumentModel):
    """How good the plan is."""

    condition_number: Known
    rms: Known
    worst: Known
    log_det: Known
    d_efficiency_at_least: Known
    worst_if_prior_wrong: Knowns


class UncertaintyTargetSection(DocumentModel):
    """What the wanted uncertainty takes; null where it is out of reach."""

    percent: Number
    poses: Count | None
    readings: Count | None


class UncertaintyCurveSection(DocumentModel):
    """Uncertainty over the number of poses."""

    poses: tuple[Count, ...]
    rms: Knowns


class BaselineDesignEntry(DocumentModel):
    """Another way to choose, at the same effort."""

    name: Text
    poses: Count
    rms_10_50_90: Knowns
    standard_uncertainty: Knowns
    d_efficiency: Known
    a_efficiency: Known
    e_efficiency: Known
    readings_for_the_same: Known
    curve_rms: Knowns


class WorkStepEntry(DocumentModel):
    """One step of the work, each from 1."""

    pose: Count
    cycle: Count
    session: Count


class CandidateLawEntry(DocumentModel):
    """A law that may be true."""

    effect: Text
    location: Text
    law: Text


class LawPairEntry(DocumentModel):
    """Two laws and how well the plan separates them."""

    one: CandidateLawEntry
    two: CandidateLawEntry
    words: Text
    why: Text
    noncentrality_per_cycle: Known
    noncentrality_planned: Known
    cycles_for_power: Count | None
    cycles_until_diagnose_excludes: Count | None
    random_noncentrality_per_cycle: Known
    told_apart: Flag
    otherwise: Text | None


class NoiseSection(DocumentModel):
    """1 sigma of a reading, and of what readings of a pose share."""

    own: Known
    pose: Known


class DiscriminationSection(DocumentModel):
    """Of a plan that separates explanations."""

    level: Number
    power: Number
    noncentrality_needed: Number
    noise_mm: NoiseSection
    steps: Knowns
    cycles: Count
    least_noncentrality_per_cycle: Known
    random_least_noncentrality_per_cycle: Known
    pairs: tuple[LawPairEntry, ...]


class JobJointEntry(DocumentModel):
    """One joint: torque of weight and load in the job and at the readings, and how a usual play would show."""

    joint: Count
    job_Nm: Knowns | None
    tests_Nm: Knowns
    turns_round: Flag | None
    play_noncentrality: Known
    play_shows: Flag


class JobSection(DocumentModel):
    """What the arm is measured for, and how loads were planned for it."""

    source: Text
    force_N: Knowns
    steps: Knowns
    joints: tuple[JobJointEntry, ...]


class PosesDocument(DocumentModel):
    """The whole file; without an admissible load test it ends with the warnings."""

    machopt_poses: First
    version: Text
    verdict: Literal["done", "infeasible"]
    inputs: Hashes
    options: dict[Text, Text]
    cell: Text
    characteristic_length_mm: Number
    reading_uncertainty_mm: Number
    candidates: PoseCandidatesSection
    load_cases: LoadCasesSection
    warnings: tuple[Text, ...]
    poses: Count | None = None
    readings: Count | None = None
    load_cases_chosen: Count | None = None
    unknowns: tuple[UnknownParameterEntry, ...] | None = None
    not_told_apart: tuple[tuple[Text, ...], ...] | None = None
    design: DesignQualitySection | None = None
    target: UncertaintyTargetSection | None = None
    curve: UncertaintyCurveSection | None = None
    heuristics: tuple[BaselineDesignEntry, ...] | None = None
    order: tuple[WorkStepEntry, ...] | None = None
    discriminate: DiscriminationSection | None = None
    job: JobSection | None = None
