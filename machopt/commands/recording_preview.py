"""Preview of a recording (``--dry-run``): how each column is understood, counts, frames and the first residuals.

recording.yaml ─► columns ─► readings ─► residuals of the cell's own model, nothing fitted but a tracker's frame
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from machopt.commands.recording_cell import load_recording_cell
from machopt.data_types.measurements.recording import Recording
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.estimation.cell_residuals import compare_with_cell
from machopt.measurement.recording import load_recording, load_recordings
from machopt.measurement.recording.foreign_tables import ColumnReading
from machopt.measurement.recording.recording_reader import describe_columns
from machopt.numerics.array_types import Array, Ints

ROWS_SHOWN = 5


@dataclass(frozen=True)
class RecordingPreview:
    """What a recording says, before anything is computed from it."""

    columns: tuple[ColumnReading, ...]
    recording: Recording
    measured: Array | None  # (N, 3) m, displacement, or position in the registered frame; None: a motion
    predicted: Array | None  # (N, 3) m, by the cell's own model


def preview_recording(cell_path: Path, recordings: Sequence[Path], *, allow_external: bool = False) -> RecordingPreview:
    """Read a recording as ``identify`` and ``diagnose`` do, and compare it with the cell's own model.

    Args:
        cell_path: Cell folder or its cell.yaml.
        recordings: Recording folders.
        allow_external: Allow the cell to use files outside its folder.

    Raises:
        InputError: A bad cell or recording.
    """
    columns = tuple(column for path in recordings for column in describe_columns(path))
    recording = load_recording(recordings[0]) if len(recordings) == 1 else load_recordings(recordings)
    cell = load_recording_cell(cell_path, recording, allow_external=allow_external)
    if recording.kind == "motion" or any(recording.prismatic):
        return RecordingPreview(columns, recording, None, None)
    return RecordingPreview(columns, recording, *compare_with_cell(cell, load_robot(cell), recording))


def format_recording_preview(preview: RecordingPreview) -> list[str]:
    """Return the preview as lines for the terminal.

    Args:
        preview: The preview.
    """
    recording = preview.recording
    lines = ["columns:"]
    for column in preview.columns:
        scale = "" if column.factor == 1.0 else f"  × {column.factor:.7g}"
        name = column.name or "not used"
        lines.append(f"  {column.file}  {column.column!r} → {name}{scale}  (first value {column.first or 'empty'})")
    labels = ", ".join(sorted(recording.stated_labels)) or "none"
    visits = _count_groups(recording.session, recording.pose)
    lines += [
        f"kind {recording.kind}: {len(recording)} readings, {len(np.unique(recording.pose))} poses, {visits} poses by "
        f"session, {len(np.unique(recording.session))} sessions; labels in the file: {labels}",
        f"frames: wrench {recording.wrench_frame}, displacement {recording.displacement_frame}, registration "
        f"{recording.registration}",
        "joint ranges (deg): " + ", ".join(_format_range(np.degrees(column)) for column in recording.q.T),
    ]
    if recording.wrench is not None:
        size = np.linalg.norm(recording.wrench[:, :3], axis=1)
        lines.append(f"force (N): {_format_range(size)}")
    if recording.time is not None and len(recording) > 1:
        lines.append(f"time step (ms): {_format_range(1e3 * np.diff(recording.time))}")
    lines += _format_residuals(preview)
    return lines + [f"note: {text}" for text in recording.warnings]


def summarise_preview(preview: RecordingPreview) -> dict[str, object]:
    """Return the preview as the content of a JSON object.

    Args:
        preview: The preview.
    """
    recording, measured, predicted = preview.recording, preview.measured, preview.predicted
    known = measured is not None and predicted is not None
    return {
        "columns": [
            {"file": c.file, "column": c.column, "name": c.name or None, "factor": c.factor} for c in preview.columns
        ],
        "kind": recording.kind,
        "readings": len(recording),
        "poses": len(np.unique(recording.pose)),
        "sessions": len(np.unique(recording.session)),
        "labels": sorted(recording.stated_labels),
        "rms_mm": None if measured is None else 1e3 * _compute_rms(measured),
        "residual_rms_mm": 1e3 * _compute_rms(np.asarray(measured) - np.asarray(predicted)) if known else None,
        "warnings": list(recording.warnings),
    }


def _format_residuals(preview: RecordingPreview) -> list[str]:
    if preview.measured is None:
        return ["no residuals: the kind or the joints of this recording have no model without a fit"]
    measured = 1e3 * preview.measured
    if preview.predicted is None:
        return [f"rms measured {_compute_rms(measured):.4f} mm a coordinate; the cell has no stiffness to compare with"]
    predicted = 1e3 * preview.predicted
    gap = _compute_rms(measured - predicted)
    rms = _compute_rms(measured if preview.recording.kind == "deflection" else measured - measured.mean(axis=0))
    lines = [f"against the cell's own model: residual {gap:.4f} mm a coordinate, scatter measured {rms:.4f} mm"]
    if gap > rms:
        lines.append(
            "  the model predicts worse than no model: check units, axes and the point that moments are about "
            "(wrench_frame, displacement_frame, wrench_point_mm), or the stiffness of the cell"
        )
    lines.append("  first readings (mm): measured | predicted | difference")
    for n in range(min(ROWS_SHOWN, len(measured))):
        parts = (measured[n], predicted[n], measured[n] - predicted[n])
        lines.append(f"  {preview.recording.place(n)}: " + " | ".join(_format_vector(part) for part in parts))
    return lines


def _compute_rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _count_groups(*labels: Ints) -> int:
    return int(np.unique(np.stack(labels), axis=1).shape[1])


def _format_range(values: Array) -> str:
    return f"{np.nanmin(values):.4g} … {np.nanmax(values):.4g}"


def _format_vector(values: Array) -> str:
    return " ".join(f"{value:.3f}" for value in values)
