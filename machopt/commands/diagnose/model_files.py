"""Corrected readings and fold models of ``machopt diagnose``, and the check of the written files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from machopt.data_types.cell import Cell
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
from machopt.measurement.recording.recording_writer import write_recording

READINGS, READINGS_KEYS = "readings_corrected.csv", "readings_corrected.yaml"
FOLDS, POSES = "folds", "unseen_poses.csv"
TOLERANCE = 1e-3  # relative difference between stated and recomputed error, from the contract of diagnosis.json
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
    folds = []
    for own in sorted((folder / FOLDS).iterdir(), key=lambda p: int(p.name)) if (folder / FOLDS).exists() else ():
        poses = np.loadtxt(own / POSES, dtype=np.int64, skiprows=1, ndmin=1)
        folds.append(FoldModel(poses, read_model_files(own)))
    recording = load_recording(folder / READINGS_KEYS)
    return compute_assessment(cell, recording, read_model_files(folder), tuple(folds))


def check_written_errors(folder: Path, cell: Cell, d: DiagnosisResult) -> None:
    """Compare the stated errors with those of the written files.

    Args:
        folder: Output folder with all model files.
        cell: Robot cell as it was diagnosed.
        d: Result of the diagnosis.

    Raises:
        MachoptError: They differ, which is a bug of this program.
    """
    own = read_assessment(folder, place_tool_where_found(cell, d.findings)).errors_mm
    for name, stated, again in zip(("final.rmse", "final.heldout_rmse"), (d.rmse, d.heldout_after), own, strict=True):
        if not abs(stated - again) <= TOLERANCE * stated + PRINTED_MM:
            raise MachoptError(f"internal error: {name} is {stated:.6g} mm, and the written files have {again:.6g} mm")
