"""Measured forces in the axes of the cut: travel, normal, tool axis; a note on the cutter."""

from __future__ import annotations

from dataclasses import replace
from math import degrees

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.measurements.cutting_recording import CuttingRecording
from machopt.errors import RecordingError
from machopt.kinematics.urdf_loading import load_robot
from machopt.numerics.array_types import Array
from machopt.process.milling.milling_cut import MillingCutter

MOST_ALONG_AXIS = 0.5  # sine of 30°: a direction of travel closer to the tool's axis is another quantity


def compute_cut_forces(recording: CuttingRecording, cell: Cell) -> Array:
    """Return the forces on the tool in travel, normal (axis × travel) and axis from tip to shank, (N, 3) N.

    The part of the direction of travel along the axis is left out: the cut is taken as normal to the axis.

    Args:
        recording: measured cuts.
        cell: for the tool's axis where the forces are in base axes.

    Raises:
        RecordingError: a direction of travel of zero length or along the tool's axis.
    """
    if recording.frame == "feed":
        return np.array(recording.force)
    assert recording.travel is not None  # the reader demands it
    axis = np.tile([0.0, 0.0, -1.0], (len(recording), 1))
    if recording.frame == "base":
        assert recording.q is not None
        axis = -load_robot(cell).compute_fk(recording.q, cell.tool.T_flange_tcp)[:, :3, 2]
    length = np.linalg.norm(recording.travel, axis=1)
    along = np.sum(recording.travel * axis, axis=1)
    wrong = np.flatnonzero(~(np.abs(along) < MOST_ALONG_AXIS * length))
    if wrong.size:
        raise RecordingError(
            "the direction of travel has zero length or lies within 60° of the tool's axis; expected a direction "
            f"across the axis, in axes of wrench_frame: {recording.frame}",
            file=recording.files[recording.file[wrong[0]]],
            where=f"line {recording.line[wrong[0]]}, column travel_x",
        )
    travel = recording.travel - along[:, None] * axis
    travel /= np.linalg.norm(travel, axis=1, keepdims=True)
    frame = np.stack([travel, np.cross(axis, travel), axis], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", frame, recording.force))


def note_cutter_of_cell(recording: CuttingRecording, cutter: MillingCutter) -> CuttingRecording:
    """Return the recording with a note where its cutter is that of the cell.

    Args:
        recording: measured cuts.
        cutter: end mill that is used.
    """
    if recording.cutter is not None:
        return recording
    text = (
        f"recording.yaml states no cutter; that of the cell is taken: diameter {1e3 * cutter.diameter:g} mm, "
        f"{cutter.teeth} teeth, helix {degrees(cutter.helix):g}°"
    )
    return replace(recording, warnings=(*recording.warnings, text))
