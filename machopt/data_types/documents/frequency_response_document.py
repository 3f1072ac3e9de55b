"""frequency_response.json of ``machopt identify`` with a recording of kind ``frf``."""

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


class JointResponseEntry(DocumentModel):
    """One joint; the upper end of an interval is null where only a lower bound is known.

    ``damping``: viscous in N·m·s/rad, structural as loss factor; its interval is null where it is not determined.
    """

    joint: Count
    k_Nm_per_rad: Number
    interval: tuple[Known, Known]
    identified: Flag
    reason: Text
    damping: Number
    damping_interval: tuple[Known, Known]


class ModalDampingEntry(DocumentModel):
    """One mode over the measured poses; not determined: not written into process.yaml."""

    mode: Count
    frequency_Hz: tuple[Number, Number]
    damping_percent: Number
    damping_range_percent: tuple[Number, Number]
    sigma_percent: Known
    determined: Flag


class MeasuredResponseEntry(DocumentModel):
    """One measured response; directions in axes of ``direction_frame``."""

    place: Text
    lines: Count
    excitation: Numbers
    response: Numbers
    residual_m_per_N: Number
    explained_share: Number


class FrequencyResponseOptionsSection(DocumentModel):
    """Options as given."""

    level_percent: Number
    seed: Count


class FrequencyResponseDocument(DocumentModel):
    """The whole file."""

    machopt_frequency_response: First
    version: Text
    cell: Text
    recording: Text
    rows: Count
    poses: Count
    damping_law: Literal["viscous", "structural"]
    log_likelihood_gain: Number
    interval_level: Number
    joints: tuple[JointResponseEntry, ...]
    modes: tuple[ModalDampingEntry, ...]
    responses: tuple[MeasuredResponseEntry, ...]
    variance_inflation: Number
    warnings: tuple[Text, ...]
    options: FrequencyResponseOptionsSection
    inputs: Hashes
