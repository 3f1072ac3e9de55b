"""Data of the page of ``machopt identify`` with frequency responses; SI."""

from __future__ import annotations

from dataclasses import dataclass

from machopt.data_types.documents.frequency_response_document import FrequencyResponseDocument
from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.numerics.array_types import ComplexArray


@dataclass(frozen=True)
class FrequencyResponsePageData:
    """The document, and measured and fitted responses."""

    document: FrequencyResponseDocument
    recording: FrequencyResponseRecording
    predicted: ComplexArray  # (N,) m/N
