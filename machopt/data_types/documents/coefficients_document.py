"""coefficients.json of ``machopt process``."""

from __future__ import annotations

from typing import Literal

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Flag,
    Hashes,
    Known,
    Number,
    Numbers,
    Text,
)


class CuttingCoefficientEntry(DocumentModel):
    """One coefficient with its interval; ``fixed``: set to 0, as it came out negative within its interval."""

    name: Literal["Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"]
    unit: Literal["N/mm²", "N/mm"]
    value: Number
    sigma: Known
    interval: tuple[Known, Known]
    fixed: Flag


class ExcludedCutEntry(DocumentModel):
    """A measured cut that is not used, and why."""

    place: Text
    reason: Text


class ForceComponentEntry(DocumentModel):
    """How well one component of the force is explained."""

    component: Literal["travel", "normal", "axial"]
    residual_N: Known
    explained_share: Known


class RunoutSection(DocumentModel):
    """Radial run-out of a waveform; the angle is from tooth 0, the nearest one to the offset; null: not determined."""

    amplitude_mm: Number
    interval_mm: tuple[Number, Number]
    angle_deg: Known
    angle_interval_deg: tuple[Known, Known]


class WaveformCutEntry(DocumentModel):
    """One cut; the offset is the rotation of tooth 0 at the first sample, or at the zero of column angle_deg."""

    place: Text
    spindle_rpm: Number
    offset_deg: Number
    offset_sigma_deg: Number


class WaveformSection(DocumentModel):
    """What force waveforms show beyond the coefficients; run-out is null for one tooth.

    ``misfit_ratio``: mean square of the residuals that repeat with the rotation over what noise makes of it.
    """

    samples: Count
    runout: RunoutSection | None
    noise_order: Count
    misfit_ratio: Number
    misfit_significant: Flag
    cuts: tuple[WaveformCutEntry, ...]


class ProcessOptionsSection(DocumentModel):
    """Options as given."""

    material: Text
    level_percent: Number
    keep_outliers: Flag


class CoefficientsDocument(DocumentModel):
    """The whole file; ``covariance`` in N/mm² and N/mm, in the order of ``coefficients``."""

    machopt_coefficients: First
    version: Text
    cell: Text
    recording: Text
    material: Text
    cuts: Count
    used: Count
    interval_level: Number
    coefficients: tuple[CuttingCoefficientEntry, ...]
    covariance: tuple[Numbers, ...]
    components: tuple[ForceComponentEntry, ...]
    spread_percent: Number
    feed_per_tooth_mm: tuple[Number, Number]
    excluded: tuple[ExcludedCutEntry, ...]
    warnings: tuple[Text, ...]
    options: ProcessOptionsSection
    inputs: Hashes
    waveform: WaveformSection | None = None
