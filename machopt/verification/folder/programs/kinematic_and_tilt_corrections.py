"""Corrections of targets: kinematics, and poses of a tilted tool turned back to the axes of the CAM file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.program_in_cell import ProgramInCell
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.encoder_correction import compute_true_angles
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.motion_polyline import CommandedPath, add_corrections
from machopt.verification.motion.path_geometry.tool_tilt import ToolTilt
from machopt.verification.programs.expected_cuts import ExpectedCuts
from machopt.verification.tables.exported_tables import ExportedMotion

TARGET_INDEX = 1e-3  # of an index: what the printed digits of a target leave of the place where the tool rests


def compute_corrections(cell: Cell, motion: ExportedMotion, tcp: Array) -> tuple[Array, Array]:
    """Return what brings poses by nominal kinematics to where the tool truly is, (S, 3) each.

    Args:
        cell: The robot cell.
        motion: The exported motion (trajectory.csv), SI.
        tcp: (S, 3, 4) its poses by nominal kinematics, in the workpiece frame.

    Returns:
        What is to be added to the position, m, and to the tool axis, tip to shank.
    """
    if cell.kinematics is None:
        none = np.broadcast_to(np.zeros(3), (len(tcp), 3))
        return none, none
    true = UrdfKinematics(cell).compute_tcp_in_workpiece(
        compute_true_angles(cell.kinematics, motion.q), motion.external
    )
    return true[:, :3, 3] - tcp[:, :3, 3], tcp[:, :3, 2] - true[:, :3, 2]


def tilt_commanded_path(tilt: ToolTilt | None, path: CommandedPath) -> CommandedPath:
    """Return the commanded path of the tilted tool.

    Args:
        tilt: Tilt of the tool; None: there is none.
        path: Commanded path of a tool with the axes of the CAM file.
    """
    if tilt is None:
        return path
    toolpath, index, position = tilt.tilt_corners(path.index, path.position)
    return replace(path, toolpath=toolpath, index=index, position=position)


def turn_samples_back(tilt: ToolTilt | None, tcp: Array, index: Array) -> Array:
    """Return poses of the motion (S, 3, 4) turned back to the axes of the CAM file.

    Args:
        tilt: Tilt of the tool; None: there is none.
        tcp: (S, 3, 4) poses in the workpiece frame.
        index: (S,) toolpath index, NaN for none.
    """
    return tcp if tilt is None else tilt.turn_back(tcp, index)


def turn_targets_back(
    tilt: ToolTilt | None, program: ProgramInCell, cuts: ExpectedCuts, at_index: Array
) -> tuple[ProgramInCell, ExpectedCuts]:
    """Return a program turned back to the axes of the CAM file, and the cuts that it is compared with.

    Kinematic corrections turn with the tool. They are added before, and not once more by the comparison.

    Args:
        tilt: Tilt of the tool; None: there is none.
        program: The program.
        cuts: The cuts that the CAM file requires.
        at_index: (M,) toolpath index at each move's end, NaN where there is none.
    """
    if tilt is None:
        return program, cuts
    T = tilt.turn_back(add_corrections(program.T_workpiece_tcp, cuts.offset, cuts.tilt), at_index, TARGET_INDEX)
    none = 0.0 * cuts.offset
    return replace(program, T_workpiece_tcp=T), replace(cuts, offset=none, tilt=none)
