"""Diagnosis of a motion for ``machopt diagnose``."""

from __future__ import annotations

from dataclasses import replace

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.diagnosis_pipeline import (
    DiagnosedRecording,
    diagnose_motion_recording,
)
from machopt.measurement.diagnosis.model_selection import selection_pipeline
from machopt.measurement.diagnosis.outputs.extended_stiffness import (
    ExtendedStiffness,
    build_extended_stiffness,
)
from machopt.measurement.diagnosis.outputs.model_assessment import ModelAssessment
from machopt.measurement.diagnosis.outputs.model_uncertainty import add_model_uncertainty
from machopt.measurement.diagnosis.request import DiagnoseRequest


def diagnose_motion(
    request: DiagnoseRequest, cell: Cell, recording: Recording, options: selection_pipeline.DiagnosisOptions
) -> tuple[DiagnosedRecording, ExtendedStiffness, ModelAssessment | None]:
    """Return the diagnosis of a motion, its model, and the assessment of the written files, which a motion has not.

    Args:
        request: The validated request.
        cell: The robot cell.
        recording: The motion.
        options: Options of the search.
    """
    channel, has_job = request.channel, request.toolpath is not None
    found = diagnose_motion_recording(
        cell, recording, options, requested_channel=channel, seed=request.seed, toolpath=has_job
    )
    made = build_extended_stiffness(cell, found.diagnosis)
    made = replace(made, after=add_model_uncertainty(cell, found, made.after))
    # noise of a motion is what changes from sample to sample, whatever the model
    diagnosis = replace(found.diagnosis, measured_noise=found.diagnosis.noise_floor)
    return replace(found, diagnosis=diagnosis), made, None
