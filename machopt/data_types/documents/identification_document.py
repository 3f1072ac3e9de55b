"""identification.json of ``machopt identify``."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from machopt.data_types.documents.document_base import (
    Count,
    DocumentModel,
    First,
    Flag,
    Hashes,
    Known,
    Knowns,
    Number,
    Numbers,
    Text,
)

MISFIT_WARNING = "joint springs alone do not explain the readings"


def describe_unidentified_joint(joint: int, reason: str) -> str:
    """Return the warning of a joint whose stiffness the readings do not determine.

    Args:
        joint: The joint, counted from 1.
        reason: Why it is not identified.
    """
    return f"joint {joint} is not identified: {reason}"


class JointStiffnessEntry(DocumentModel):
    """One joint of the constant model; where it is not identified, the cell's value or a bound."""

    joint: Count
    k_Nm_per_rad: Number
    ci90: tuple[Known, Known]
    identified: Flag
    reason: Text
    largest_torque_Nm: Number
    compliance_sigma_rad_per_Nm: Known
    interval: tuple[Known, Known]


class TermCoefficientEntry(DocumentModel):
    """One coefficient of a term that was fitted."""

    effect: Text
    location: Text
    coefficient: Text
    unit: Text
    value: Known
    ci90: tuple[Known, Known]
    identified: Flag
    reason: Text
    interval: tuple[Known, Known]


class OutlierReadingEntry(DocumentModel):
    """A reading that the fit put aside; ``reading`` counts from 1."""

    reading: Count
    place: Text
    component: Literal["dx", "dy", "dz", "rx", "ry", "rz"]
    residual: Number
    unit: Literal["mm", "mrad"]
    sigmas: Number


class NoisePartsSection(DocumentModel):
    """1 sigma of a coordinate in mm, by what shares it."""

    reading: Known
    cycle: Known
    pose: Known


class RecordingFindingEntry(DocumentModel):
    """What is odd about the record."""

    code: Text
    severity: Text
    message: Text
    rows: tuple[Count, ...]


class IdentifyOptionsSection(DocumentModel):
    """Options as given."""

    model: Text
    fit: tuple[Text, ...]
    geometric: Flag
    plain_least_squares: Flag = Field(validation_alias="plain", serialization_alias="plain")
    robust: Flag
    grid_cell_mm: Number
    seed: Count


class StiffnessGridSection(DocumentModel):
    """The stiffness grid."""

    cell_mm: Number
    origin_mm: Numbers
    shape: tuple[Count, ...]
    heldout_rmse_mm: Known
    heldout_rmse_constant_mm: Known
    spread_between_cells_percent: Knowns
    held_joints: tuple[Count, ...]
    readings_per_cell: Numbers


class RangeShareSection(DocumentModel):
    """A share, in the mean and at most."""

    mean: Number
    largest: Number


class MisfitSection(DocumentModel):
    """Whether springs alone explain the readings; ``next`` is the command that finds what they do not."""

    significant: Flag
    noise_mm: Known
    left_mm: Known
    next: Text


class InseparableSumEntry(DocumentModel):
    """A joint and a body that rotate about one axis: the sum has an interval, each part a bound to one side."""

    joint: Count
    body: Text
    sum_ci90_rad_per_Nm: tuple[Known, Known]
    joint_at_least_Nm_per_rad: Known
    body_at_most_rad_per_Nm: Known


class IdentificationDocument(DocumentModel):
    """The whole file."""

    machopt_identification: First
    version: Text
    cell: Text
    recording: Text
    model: Literal["constant", "grid"]
    readings: Count
    poses: Count
    misfit: MisfitSection
    joints: tuple[JointStiffnessEntry, ...]
    inseparable: tuple[InseparableSumEntry, ...]
    terms: tuple[TermCoefficientEntry, ...]
    known_combinations: tuple[Text, ...]
    rmse_mm: Known
    heldout_rmse_mm: Known
    rmse_mrad: Known
    heldout_rmse_mrad: Known
    explained_share: Known
    heldout_explained_share: Known
    condition_number: Known
    condition_number_dumas2011: Known
    interval_level: Number
    outliers: tuple[OutlierReadingEntry, ...]
    noise_mm: NoisePartsSection
    findings: tuple[RecordingFindingEntry, ...]
    warnings: tuple[Text, ...]
    notes: tuple[Text, ...]
    options: IdentifyOptionsSection
    inputs: Hashes
    grid: StiffnessGridSection | None = None
    equilibrium_influence_share: RangeShareSection | None = None
    monte_carlo_percent: Knowns | None = None
