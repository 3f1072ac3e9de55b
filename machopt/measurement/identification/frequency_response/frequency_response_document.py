"""The document frequency_response.json."""

from __future__ import annotations

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.documents.frequency_response_document import (
    FrequencyResponseDocument,
    FrequencyResponseOptionsSection,
    JointResponseEntry,
    MeasuredResponseEntry,
    ModalDampingEntry,
)
from machopt.data_types.measurements.frequency_response_recording import FrequencyResponseRecording
from machopt.measurement.identification.frequency_response.frequency_response_result import FrequencyResponseResult
from machopt.measurement.identification.frequency_response.request import FrequencyResponseRequest
from machopt.version import __version__


def build_frequency_response_document(
    request: FrequencyResponseRequest,
    cell: Cell,
    recording: FrequencyResponseRecording,
    frequency_response_result: FrequencyResponseResult,
    inputs: dict[str, str],
) -> FrequencyResponseDocument:
    """Build the document.

    Args:
        request: Validated user request.
        cell: Robot cell.
        recording: Measured responses.
        frequency_response_result: Result of the identification.
        inputs: SHA-256 of the input files, by name.
    """
    return FrequencyResponseDocument(
        machopt_frequency_response=1,
        version=__version__,
        cell=cell.name,
        recording=recording.source,
        rows=len(recording),
        poses=len(frequency_response_result.modes.frequency),
        damping_law=frequency_response_result.law,  # type: ignore[arg-type]
        log_likelihood_gain=frequency_response_result.log_likelihood_gain,
        interval_level=frequency_response_result.level,
        joints=tuple(
            JointResponseEntry(
                joint=j.joint,
                k_Nm_per_rad=j.k,
                interval=j.interval,
                identified=j.identified,
                reason=j.reason,
                damping=j.damping,
                damping_interval=(None, None) if j.damping_interval is None else j.damping_interval,
            )
            for j in frequency_response_result.joints
        ),
        modes=_build_mode_entries(frequency_response_result),
        responses=_build_response_entries(recording, frequency_response_result),
        variance_inflation=frequency_response_result.inflation,
        warnings=(
            *cell.warnings,
            *frequency_response_result.warnings,
            *_describe_unknown_modes(cell, frequency_response_result),
        ),
        options=FrequencyResponseOptionsSection(level_percent=request.level_percent, seed=request.seed),
        inputs=inputs,
    )


def list_damping_percent(frequency_response_result: FrequencyResponseResult) -> list[float]:
    """Return ``modes.damping_percent`` of process.yaml: the determined first modes in ascending frequency.

    Args:
        frequency_response_result: Result of the identification.
    """
    return [
        float(f"{100.0 * ratio:.4g}")
        for ratio in frequency_response_result.modes.mean[: frequency_response_result.modes.known]
    ]


def _describe_unknown_modes(cell: Cell, frequency_response_result: FrequencyResponseResult) -> tuple[str, ...]:
    listed = list_damping_percent(frequency_response_result)
    if not listed:
        return ("no modal damping is determined; process.yaml is not written",)
    out = []
    if len(listed) < len(frequency_response_result.modes.mean):
        out.append(f"damping of modes beyond {len(listed)} is not determined, or their frequency was not measured")
    if cell.process is None or cell.process.file is None:
        out.append(
            "the cell has no process.yaml; chatter reads this block of it: "
            f"modes: {{damping_percent: {listed}, source: ...}}"
        )
    return tuple(out)


def _build_mode_entries(frequency_response_result: FrequencyResponseResult) -> tuple[ModalDampingEntry, ...]:
    modes = frequency_response_result.modes
    return tuple(
        ModalDampingEntry(
            mode=n + 1,
            frequency_Hz=(float(modes.frequency[:, n].min()), float(modes.frequency[:, n].max())),
            damping_percent=100.0 * float(modes.mean[n]),
            damping_range_percent=(100.0 * float(modes.ratio[:, n].min()), 100.0 * float(modes.ratio[:, n].max())),
            sigma_percent=100.0 * float(modes.sigma[n]),
            determined=n < modes.known,
        )
        for n in range(len(modes.mean))
    )


def _build_response_entries(
    recording: FrequencyResponseRecording, frequency_response_result: FrequencyResponseResult
) -> tuple[MeasuredResponseEntry, ...]:
    out = []
    for n in range(recording.responses):
        rows = np.flatnonzero(recording.group == n)
        out.append(
            MeasuredResponseEntry(
                place=recording.format_place(int(rows[0])),
                lines=len(rows),
                excitation=recording.excitation[rows[0]],
                response=recording.response[rows[0]],
                residual_m_per_N=float(frequency_response_result.noise[n]),
                explained_share=float(frequency_response_result.explained[n]),
            )
        )
    return tuple(out)
