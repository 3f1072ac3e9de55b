"""Readings as a diagnosis corrected them: the data that the error of the written files refers to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.sensor_errors import LOAD, TcpOffset
from machopt.kinematics.urdf_loading import load_robot
from machopt.measurement.diagnosis.data_types.diagnosis_result import DiagnosisResult, Finding, RecordChange
from machopt.measurement.diagnosis.diagnosis_pipeline import read_load_test_masses
from machopt.measurement.diagnosis.static import loaded_equilibrium_terms
from machopt.measurement.estimation.load_test_equations import build_load_test_experiment
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform

MM = 1e-3  # m


def build_corrected_recording(cell: Cell, recording: Recording, d: DiagnosisResult) -> Recording:
    """Build the corrected readings, in base_link axes and about the TCP of :func:`place_tool_where_found`.

    Args:
        cell: Robot cell as it was diagnosed.
        recording: Load tests or measured poses after the corrections of columns, units and sessions.
        d: Result of the diagnosis.

    Returns:
        The readings; ``used`` marks those that count.
    """
    N = len(recording)
    change = d.record_change or RecordChange(measured=np.zeros((N, 3)), wrench=np.zeros((N, 6)))
    recording = replace(recording, used=d.used)
    if recording.kind == "absolute":
        assert recording.position is not None  # of this kind
        return replace(recording, position=recording.position - change.measured[:, :3])
    robot, T = load_robot(cell), place_tool_where_found(cell, d.findings).tool.T_flange_tcp
    tests = loaded_equilibrium_terms.convert_tool_axes_at_loaded_pose(
        build_load_test_experiment(recording, robot, T), recording, robot, T, read_load_test_masses(cell)
    )
    wrench = tests.wrench * _list_session_gains(recording, d)[:, None] + change.wrench
    return replace(
        recording,
        wrench=wrench,
        wrench_frame="base",
        wrench_point=None,
        displacement=tests.measured - change.measured[:, : tests.dimensions],
        displacement_frame="base",
    )


def place_tool_where_found(cell: Cell, findings: Sequence[Finding]) -> Cell:
    """Return the cell with the TCP that load tests show, where they show another one.

    Args:
        cell: Robot cell.
        findings: Findings of the diagnosis.

    Returns:
        The cell.
    """
    for f in findings:
        if (f.effect, f.law) == (LOAD.name, TcpOffset.name):
            offset = MM * np.array([f.parameters[f"offset_{a}"].value for a in "xyz"])
            T = cell.tool.T_flange_tcp @ build_transform(np.eye(3), offset)
            cell = replace(cell, tool=replace(cell.tool, T_flange_tcp=T))
    return cell


def _list_session_gains(recording: Recording, d: DiagnosisResult) -> Array:
    """Return the factor (N,) on the recorded loads that was fitted for each session."""
    out = np.ones(len(recording))
    _, session = np.unique(recording.session, return_inverse=True)
    for c in d.coefficients:
        if c.unknown.session is not None:
            out[session.reshape(-1) == c.unknown.session] += c.value
    return out
