"""Corrected readings and fold models of ``machopt diagnose``, and the check of the written files."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.errors import MachoptError
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult
from machopt.measurement.diagnosis.outputs.corrected_recording import place_tool_where_found
from machopt.measurement.diagnosis.outputs.model_assessment import (
    FoldModel,
    ModelAssessment,
    compute_assessment,
    read_model_files,
    write_model_files,
)
from machopt.measurement.recording import load_recording
from machopt.measurement.recording.recording_columns import CHANNELS
from machopt.measurement.recording.recording_writer import write_recording
from machopt.numerics.array_types import Array
from machopt.numerics.content_cache import NoContentKeyError, build_content_key

READINGS, READINGS_KEYS = "readings_corrected.csv", "readings_corrected.yaml"
FOLDS, POSES = "folds", "unseen_poses.csv"
TOLERANCE = 1e-3  # relative difference between stated and recomputed error, from the contract of diagnosis.json
FRAMES = ("kind", "wrench_frame", "displacement_frame", "registration", "prismatic")  # of a recording
ROWS = ("pose", "cycle", "session", "used", "branch", "target", "frame")  # of a recording: labels of each reading
PRINTED_MM = 1e-6  # mm, largest change of an error by the printed digits of the readings


def write_assessed_files(folder: Path, assessed: ModelAssessment) -> None:
    """Write the corrected readings, and model files and unseen poses of every fold.

    Args:
        folder: Output folder.
        assessed: Written model with its errors.
    """
    write_recording(folder, assessed.recording, data_name=READINGS, yaml_name=READINGS_KEYS)
    for n, fold in enumerate(assessed.folds, start=1):
        own = folder / FOLDS / str(n)
        own.mkdir(parents=True)
        write_model_files(own, fold.model)
        lines = ["pose", *(str(p) for p in fold.unseen_poses.tolist())]
        (own / POSES).write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def read_assessment(folder: Path, cell: Cell) -> ModelAssessment:
    """Compute the errors of an output folder from its files.

    Args:
        folder: Output folder of ``machopt diagnose``.
        cell: Robot cell with the TCP of the diagnosis.

    Returns:
        The assessment.
    """
    return compute_assessment(
        cell, load_recording(folder / READINGS_KEYS), read_model_files(folder), _read_folds(folder)
    )


def _read_folds(folder: Path) -> tuple[FoldModel, ...]:
    """Return the fold models of an output folder."""
    folds = []
    for own in sorted((folder / FOLDS).iterdir(), key=lambda p: int(p.name)) if (folder / FOLDS).exists() else ():
        poses = np.loadtxt(own / POSES, dtype=np.int64, skiprows=1, ndmin=1)
        folds.append(FoldModel(poses, read_model_files(own)))
    return tuple(folds)


def check_written_errors(folder: Path, cell: Cell, d: DiagnosisResult, assessed: ModelAssessment | None = None) -> None:
    """Compare the stated errors with those of the written files.

    The held-out error needs a fit of every fold. It is not computed again where readings and fold models that are
    read from the files are those that it was computed from.

    Args:
        folder: Output folder with all model files.
        cell: Robot cell as it was diagnosed.
        d: Result of the diagnosis.
        assessed: Errors that were computed before the files were written; None: compute both from the files.

    Raises:
        MachoptError: They differ, which is a bug of this program.
    """
    cell, recording = place_tool_where_found(cell, d.findings), load_recording(folder / READINGS_KEYS)
    if assessed is not None and _are_inputs_equal(recording, _read_folds(folder), assessed):
        in_sample = compute_assessment(cell, recording, read_model_files(folder), ())
        own = in_sample.errors_mm[0], assessed.errors_mm[1]
    else:
        own = read_assessment(folder, cell).errors_mm
    for name, stated, again in zip(("final.rmse", "final.heldout_rmse"), (d.rmse, d.heldout_after), own, strict=True):
        if not abs(stated - again) <= TOLERANCE * stated + PRINTED_MM:
            raise MachoptError(f"internal error: {name} is {stated:.6g} mm, and the written files have {again:.6g} mm")


def _are_inputs_equal(recording: Recording, folds: tuple[FoldModel, ...], assessed: ModelAssessment) -> bool:
    """Return whether readings agree to their printed digits, and fold models and unseen poses exactly."""
    stated = assessed.recording
    if len(recording) != len(stated) or any(getattr(recording, f) != getattr(stated, f) for f in FRAMES):
        return False
    for name in ROWS:
        a, b = getattr(stated, name), getattr(recording, name)
        if (a is None) != (b is None) or not (a is None or np.array_equal(a, b)):
            return False
    slides = recording.prismatic or (False,) * recording.q.shape[1]
    for channel in CHANNELS:
        a, b = getattr(stated, channel.field), getattr(recording, channel.field)
        digit = 10.0**-channel.decimals * max(channel.units(slides if channel.turns else ()))
        if (a is None) != (b is None) or not (a is None or np.allclose(a, b, 1e-12, digit, equal_nan=True)):
            return False
    a, b = _list_points(stated), _list_points(recording)
    same_points = len(a) == len(b) and np.allclose(a, b, rtol=1e-11, atol=0.0)
    try:
        return same_points and _build_fold_key(folds) == _build_fold_key(assessed.folds)
    except NoContentKeyError:  # laws of the user's own cannot be compared
        return False


def _list_points(recording: Recording) -> Array:
    """Return the places (K, 3) m of reflectors and of the wrench's reference, in flange."""
    wrench = () if recording.wrench_point is None else (recording.wrench_point,)
    return np.array([*(t.place for t in recording.targets), *wrench]).reshape(-1, 3)


def _build_fold_key(folds: tuple[FoldModel, ...]) -> Hashable:
    """Return a key of all that a fold's error depends on, whatever the names of its files."""
    each = []
    for fold in folds:
        stiffness, kinematics = fold.model.stiffness, fold.model.kinematics
        springs = None if stiffness is None else (stiffness.joints, stiffness.terms)
        each.append((fold.unseen_poses, springs, None if kinematics is None else kinematics.corrections))
    return build_content_key(each)
