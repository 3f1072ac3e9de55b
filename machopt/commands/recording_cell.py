"""The cell that a recording belongs to: six joints, or more where only readings are diagnosed."""

from __future__ import annotations

from pathlib import Path

from machopt.cell.cell_reader import load_cell
from machopt.data_types.cell import Cell
from machopt.data_types.measurements.recording import Recording
from machopt.measurement.diagnosis.dynamic.motion_channels import check_joint_names


def load_recording_cell(path: Path, recording: Recording, *, allow_external: bool = False) -> Cell:
    """Read the cell of a recording.

    Args:
        path: Cell folder or its cell.yaml.
        recording: The recording; for a motion the arm may be any chain, else it has the recording's joints.
        allow_external: Allow the cell to use files outside its folder.

    Raises:
        InputError: a bad cell, or one with other joints than the recording.
    """
    cell = load_cell(path, allow_external=allow_external, any_chain=recording.needs_any_chain, bodies=False)
    check_joint_names(recording, cell)
    return cell
