"""Data of the page of ``machopt process``; SI."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.data_types.documents.coefficients_document import CoefficientsDocument
from machopt.measurement.cutting.waveform.waveform_result import WaveformResult
from machopt.numerics.array_types import Array, Bools


@dataclass(frozen=True, kw_only=True)
class CoefficientsPageData:
    """The document, and the forces of every cut."""

    document: CoefficientsDocument
    feed_per_tooth: Array  # (N,) m
    measured: Array  # (N, 3) N, travel, normal, axial
    predicted: Array  # (N, 3) N
    used: Bools  # (N,)
    waveform: WaveformResult | None = None
