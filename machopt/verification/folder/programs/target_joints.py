"""Joints of the targets of a robot program: those of the motion there, and those that reach the target itself."""

from __future__ import annotations

import numpy as np

from machopt.data_types.program_in_cell import ProgramInCell
from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.tables.exported_tables import ExportedMotion

BLOCK_ROWS = 20_000  # targets worked out at once
# of Newton's method to a target's own joints; m and rad; from the motion's
NEWTON_STEPS, NEWTON_TOLERANCE, MAX_JOINT_OFFSET_DEG = 5, 1e-8, 3.0


def interpolate_joints(motion: ExportedMotion, rows: Array) -> Array:
    """Return the (M, 6) joints of the motion where each move ends, rad.

    Args:
        motion: The planned motion.
        rows: (M,) fractional sample at which each move ends.
    """
    s = np.arange(len(motion.q))
    return np.column_stack([np.interp(rows, s, motion.q[:, k]) for k in range(6)])


def compute_external_joints(motion: ExportedMotion, program: ProgramInCell, rows: Array) -> Array:
    """Return the (M, E) external joints that the program states, those of the motion where it does not, rad or m.

    Args:
        motion: The planned motion.
        program: The program in the cell.
        rows: (M,) fractional sample at which each move ends.
    """
    s = np.arange(len(motion.q))
    columns = [np.interp(rows, s, e) for e in motion.external.T]
    driven = np.array(columns).T.reshape(len(program), -1)
    return np.where(np.isfinite(program.external), program.external, driven)


def find_target_joints(
    arm: UrdfKinematics, T_flange_tcp: Array, program: ProgramInCell, near: Array, external: Array, robot: Robot
) -> Array:
    """Return the (M, 6) joints of each target itself, those of the motion where none are close to them, rad.

    The motion rounds what the program says at its targets; an axis may stand on the other side of zero there.

    Args:
        arm: Kinematics of the cell as the controller reckons.
        T_flange_tcp: (4, 4) TCP in the flange, m.
        program: The program in the cell.
        near: (M, 6) joints of the motion, rad.
        external: (M, E) external joints, rad or m.
        robot: The nominal robot.
    """
    wanted = arm.T_base_workpiece(external) @ program.T_workpiece_tcp
    out = near.copy()
    for first in range(0, len(near), BLOCK_ROWS):
        some = slice(first, first + BLOCK_ROWS)
        q, error = refine_by_newton(robot, wanted[some], near[some], T_flange_tcp, NEWTON_STEPS)
        good = (error < NEWTON_TOLERANCE) & (np.abs(q - near[some]).max(axis=1) < np.radians(MAX_JOINT_OFFSET_DEG))
        out[some][good] = q[good]
    return out
