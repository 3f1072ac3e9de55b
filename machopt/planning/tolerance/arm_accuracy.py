"""Scatter of the TCP and of the part that no load causes: position of the arm, lost motion, pose of the part.

Position is isotropic and normal: ``position_error`` of the stiffness file (within its joint angles) before ``accuracy``
of the cell for an absolute tolerance, the repeatability for a relative one. Lost motion has a full width per joint.
Half of it lies to the side of the torque of gravity and process; where that is undecided, to a random side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.cell import Cell
from machopt.dynamics.gravity_torque import compute_weight_torque
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.random_draws import UncertaintyDraws
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.tolerance.error_sensitivities import TargetPoses

UNDECIDED = 0.5  # N·m; below this torque the side of arrival is not decided


@dataclass(frozen=True)
class PositionScatter:
    """Position scatter at M poses."""

    std: Array  # (M,) m, a coordinate; NaN where it is not known
    tilt_std: Array  # (M,) rad, about an axis; 0 where it does not count
    lost_motion: Array  # (M, 6, 6) twist per joint for a full step to the positive side; zero where it does not count
    sides: Array  # (M, 6) ±1 where the side is decided, else 0
    pose_root: Array  # (M, 6, 6) twist of the tool relative to the part, per standard normal number


def compute_position_scatter(
    plan: Plan, poses: TargetPoses, reference: NDArray[np.object_], wrench: Array
) -> PositionScatter:
    """Return the position scatter at the poses of targets.

    Args:
        plan: Plan of one tool.
        poses: The poses.
        reference: (M,) ``absolute`` or ``relative`` of each target's tolerance.
        wrench: (M, 6) N and N·m, nominal load on the tool in base_link.
    """
    cell, M = plan.setup.cell, len(poses.q)
    absolute = np.asarray(reference == "absolute", bool)
    std = np.where(absolute, _find_absolute_std(plan, poses), _find_repeatability(cell))
    lost, sides = np.zeros((M, 6, 6)), np.zeros((M, 6))
    accuracy = cell.accuracy
    if accuracy is not None and accuracy.lost_motion and not accuracy.includes_lost_motion:
        known = np.flatnonzero(poses.is_reached)
        state = plan.setup.robot.compute_state(poses.q[known], cell.tool.T_flange_tcp, bodies=True)
        lost[known] = state.J * (0.5 * np.array(accuracy.lost_motion))
        torque = np.einsum("mci,mc->mi", state.J, wrench[known])
        masses = plan.setup.elasticity.masses
        if masses is not None:
            torque = torque + compute_weight_torque(plan.setup.robot, masses, state)
            sides[known] = np.where(np.abs(torque) > UNDECIDED, np.sign(torque), 0.0)
    angle = 0.0 if accuracy is None or np.isnan(accuracy.absolute_angle) else accuracy.absolute_angle
    tilt = np.where(absolute, angle, 0.0)
    return PositionScatter(std, tilt, lost, sides, _compute_pose_root(cell, poses, absolute))


def has_position_draws(scatter: PositionScatter, pose: int) -> bool:
    """Return whether lost motion or the pose of the part count at one pose.

    Args:
        scatter: Position scatter of the poses.
        pose: Index of the pose.
    """
    return bool(scatter.lost_motion[pose].any() or scatter.pose_root[pose].any())


def draw_position(scatter: PositionScatter, pose: int, draws: UncertaintyDraws) -> Array:
    """Return (D, 6) the drawn twist of lost motion and pose of the part at one pose, without position noise.

    Args:
        scatter: Position scatter of the poses.
        pose: Index of the pose.
        draws: The draws.
    """
    side = np.where(scatter.sides[pose] != 0, scatter.sides[pose], draws.side)
    return np.asarray(side @ scatter.lost_motion[pose].T + draws.pose @ scatter.pose_root[pose].T)


def _find_absolute_std(plan: Plan, poses: TargetPoses) -> Array:
    """Return (M,) the position scatter of an absolute tolerance; NaN where it is not known."""
    cell, M = plan.setup.cell, len(poses.q)
    found = plan.setup.elasticity.stiffness.position
    if found is not None:
        known = plan.setup.correction
        q = poses.q if known is None else known.compute_encoder_angles(np.nan_to_num(poses.q))
        covered = found.is_in_covered_range(q).all(axis=1)
        value = found.std if cell.kinematics is not None else found.plain
        return np.where(covered, value, np.nan)
    return np.full(M, np.nan if cell.accuracy is None else cell.accuracy.absolute)


def _find_repeatability(cell: Cell) -> float:
    return float("nan") if cell.accuracy is None else cell.accuracy.repeatability


def _compute_pose_root(cell: Cell, poses: TargetPoses, absolute: NDArray[np.bool_]) -> Array:
    """Return (M, 6, 6): twist of the tool relative to the part at each pose, per number of the pose's draw."""
    M = len(poses.q)
    covariance = cell.workpiece.pose_covariance
    if covariance is None:
        return np.zeros((M, 6, 6))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))  # (6, 6) CAM axes at the CAM origin
    moved = root[None, :3] + np.cross(root[3:].T[None], poses.position[:, None, :]).transpose(0, 2, 1)
    R = poses.cam_axes
    out = -np.concatenate([R @ moved, R @ np.broadcast_to(root[3:], (M, 3, 6))], axis=1)
    return np.where(absolute[:, None, None], out, 0.0)
