"""Errors that a diagnosis states: those of its written files, and of the files of each fold on readings it did not see.

The model files are written and read back before they are assessed, so that the stated error is that of the files.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from machopt.cell.kinematics_file import load_kinematics, write_kinematics
from machopt.cell.stiffness.stiffness_file import load_stiffness, write_stiffness
from machopt.data_types.cell import Cell
from machopt.data_types.kinematic_corrections import KinematicCorrection, KinematicCorrections
from machopt.data_types.measurements.recording import Recording
from machopt.data_types.stiffness import ArmStiffness
from machopt.effects.kinematic_corrections import extend_kinematics
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, FoldFit, compute_rms
from machopt.measurement.diagnosis.diagnosis_pipeline import DiagnosedRecording
from machopt.measurement.diagnosis.outputs.corrected_recording import build_corrected_recording, place_tool_where_found
from machopt.measurement.diagnosis.outputs.extended_stiffness import ExtendedStiffness, build_extended_stiffness
from machopt.measurement.diagnosis.outputs.written_model_error import WrittenModel, compute_written_residual
from machopt.numerics.array_types import Array, Ints

STIFFNESS, KINEMATICS = "stiffness.yaml", "kinematics.yaml"


@dataclass(frozen=True)
class FoldModel:
    """Model files of one fold, and the poses that they were not fitted to."""

    unseen_poses: Ints
    model: WrittenModel


@dataclass(frozen=True)
class ModelAssessment:
    """Written model with its errors, SI."""

    recording: Recording  # corrected readings
    model: WrittenModel
    folds: tuple[FoldModel, ...]
    residual: Array  # (N, 3) m, by the model of all readings
    heldout: Array  # (N, 3) m, each reading by the files of the fold that did not see it

    @property
    def errors_mm(self) -> tuple[float, float]:
        """rmse per coordinate over the used readings in mm, in sample and held out."""
        used = self.recording.used
        return 1e3 * compute_rms(self.residual[used]), 1e3 * compute_rms(self.heldout[used])


def assess_written_model(
    cell: Cell, diagnosed_recording: DiagnosedRecording, extended_stiffness: ExtendedStiffness
) -> ModelAssessment:
    """Write and read the model files of all readings and of each fold, and compute their errors.

    Args:
        cell: Robot cell as it was diagnosed.
        diagnosed_recording: Diagnosis of load tests or measured poses.
        extended_stiffness: Its extended stiffness.

    Returns:
        The assessment.
    """
    d = diagnosed_recording.diagnosis
    recording = build_corrected_recording(cell, diagnosed_recording.recording, d)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = _write_and_read(folder, extended_stiffness.after, _list_kinematics(cell, d))
        folds = tuple(_build_fold_model(cell, diagnosed_recording, fold, folder) for fold in d.folds)
    return compute_assessment(place_tool_where_found(cell, d.findings), recording, model, folds)


def compute_assessment(
    cell: Cell, recording: Recording, model: WrittenModel, folds: tuple[FoldModel, ...]
) -> ModelAssessment:
    """Compute the errors of model files that were read.

    Args:
        cell: Robot cell with the TCP of the diagnosis.
        recording: Corrected readings with ``used``.
        model: Files of all readings.
        folds: Files of each fold; empty: too few poses for a held-out error, which is then that of all readings.

    Returns:
        The assessment.
    """
    used = np.ones(len(recording), bool) if recording.used is None else recording.used
    whole = compute_written_residual(cell, model, recording, used, np.ones(len(recording), bool))
    heldout = whole.values.copy()
    for fold in folds:
        unseen, start = np.isin(recording.pose, fold.unseen_poses), whole.registration
        heldout[unseen] = compute_written_residual(cell, fold.model, recording, used & ~unseen, unseen, start).values
    return ModelAssessment(replace(recording, used=used), model, folds, whole.values, heldout)


def state_written_errors(d: DiagnosisResult, assessed: ModelAssessment) -> DiagnosisResult:
    """Return the diagnosis with the errors of the written files.

    Args:
        d: Result of the diagnosis.
        assessed: Errors of its files.

    Returns:
        The diagnosis; its verdict and sentence are not changed.
    """
    rmse, heldout = assessed.errors_mm
    final = d.errors.final.copy()
    final[:, :3] = assessed.heldout
    fitted = set(d.fitted_findings)
    findings = tuple(replace(f, after=heldout) if (f.effect, f.location) in fitted else f for f in d.findings)
    return replace(d, rmse=rmse, heldout_after=heldout, errors=replace(d.errors, final=final), findings=findings)


def _build_fold_model(cell: Cell, diagnosed_recording: DiagnosedRecording, fold: FoldFit, folder: Path) -> FoldModel:
    d = diagnosed_recording.diagnosis
    by_name = dict(zip(d.fitted_findings, fold.corrections, strict=True))
    findings = tuple(
        replace(f, correction=by_name[f.effect, f.location]) if (f.effect, f.location) in by_name else f
        for f in d.findings
    )
    coefficients = tuple(replace(c, value=v) for c, v in zip(d.coefficients, fold.coefficients, strict=True))
    d = replace(d, findings=findings, coefficients=coefficients)
    made = build_extended_stiffness(cell, d, weight_alone=diagnosed_recording.weight_alone)
    return FoldModel(fold.groups, _write_and_read(folder, made.after, _list_kinematics(cell, d)))


def _list_kinematics(cell: Cell, d: DiagnosisResult) -> KinematicCorrections | None:
    found = tuple(f.correction for f in d.findings if isinstance(f.correction, KinematicCorrection))
    return extend_kinematics(cell.kinematics, found) if found else None


def _write_and_read(
    folder: Path, stiffness: ArmStiffness | None, kinematics: KinematicCorrections | None
) -> WrittenModel:
    write_model_files(folder, WrittenModel(stiffness, kinematics))
    return read_model_files(folder)


def write_model_files(folder: Path, model: WrittenModel) -> None:
    """Write the files of a model; a file that the model does not have is removed.

    Args:
        folder: Existing folder.
        model: The model.
    """
    (folder / STIFFNESS).unlink(missing_ok=True)
    (folder / KINEMATICS).unlink(missing_ok=True)
    if model.stiffness is not None:
        write_stiffness(folder / STIFFNESS, model.stiffness)
    if model.kinematics is not None:
        write_kinematics(folder / KINEMATICS, model.kinematics)


def read_model_files(folder: Path) -> WrittenModel:
    """Read the files of a model.

    Args:
        folder: Folder with stiffness.yaml and kinematics.yaml, as far as they exist.

    Returns:
        The model.
    """
    stiffness, kinematics = folder / STIFFNESS, folder / KINEMATICS
    return WrittenModel(
        load_stiffness(stiffness) if stiffness.exists() else None,
        load_kinematics(kinematics) if kinematics.exists() else None,
    )
