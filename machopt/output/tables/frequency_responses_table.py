"""``frequency_responses.csv``: every measured frequency against the fit."""

from __future__ import annotations

import csv
from pathlib import Path

from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.numerics.array_types import ComplexArray

_HEADER = (
    "response",
    "place",
    "frequency_Hz",
    "measured_re_m_per_N",
    "measured_im_m_per_N",
    "fitted_re_m_per_N",
    "fitted_im_m_per_N",
)


def write_frequency_responses_csv(path: Path, recording: FrequencyResponseRecording, predicted: ComplexArray) -> None:
    """Write the table, one row for each frequency.

    Args:
        path: The file to write.
        recording: Measured responses.
        predicted: (N,) m/N.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_HEADER)
        for n in range(len(recording)):
            H, G = recording.receptance[n], predicted[n]
            values = [f"{v:.6g}" for v in (recording.frequency[n], H.real, H.imag, G.real, G.imag)]
            writer.writerow([int(recording.group[n]) + 1, recording.format_place(n), *values])
