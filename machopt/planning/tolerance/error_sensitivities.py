"""Errors of targets as linear functions of the draws of stiffness and load.

For each target and each error channel (a component of the tip's displacement, or of the turn of the tool axis):

    error(draw) = Σ_c s_c(draw) Σ_k g_k(draw) columns[c, k]  + offset

s are the factors of the load components: of a hole thrust in N and torque in N·m, of a milled point one factor of its
nominal load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import interpolate_axis
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.stiffness.external_joint_compliance import ExternalJointCompliance
from machopt.stiffness.joint_stiffness import compute_joint_stiffness

ROWS = 4096  # poses at a time


@dataclass(frozen=True, kw_only=True)
class TargetPoses:
    """M poses of one plan, in base_link."""

    q: Array  # (M, 6) rad; NaN where the plan has none
    external: Array  # (M, E)
    axis: Array  # (M, 3) unit, tip to shank
    travel: Array  # (M, 3) sideways direction of the travel, length at most 1
    cam_axes: Array  # (M, 3, 3) CAM axes as columns
    position: Array  # (M, 3) m, in the CAM frame
    offset: Array  # (M, 3) m, shift of the commanded path against the deflection
    is_reached: NDArray[np.bool_]  # (M,)

    @property
    def normal(self) -> Array:
        """(M, 3) axis × travel."""
        return np.cross(self.axis, self.travel)


def locate_poses(plan: Plan, chosen: ScoredAssignment, index: Array) -> TargetPoses:
    """Return the poses of an assignment at fractional toolpath indices.

    Joints are interpolated between planning points. At a toolpath point the direction of travel is that of the move
    that leaves, as in the planned force.

    Args:
        plan: Plan of one tool.
        chosen: An assignment along its path.
        index: (M,) fractional toolpath indices.
    """
    path, arm, a = plan.path, plan.setup.arm, chosen.assignment
    after = np.clip(np.searchsorted(path.index, index - 1e-9), 0, len(path.index) - 1)
    before = np.maximum(after - 1, 0)
    span = path.index[after] - path.index[before]
    f = np.where(span > 0, (index - path.index[before]) / np.where(span > 0, span, 1.0), 1.0)
    f = np.where(after > before, np.clip(f, 0.0, 1.0), 1.0)[:, None]
    ok = np.where((a.reason == InfeasibilityReason.OK)[:, None], a.q, np.nan)
    q = np.where(f >= 1.0, ok[after], (1.0 - f) * ok[before] + f * ok[after])
    external = path.external[after]
    shift = np.zeros_like(path.position) if plan.compensation is None else plan.compensation.offset
    is_own = chosen is plan.chosen
    offset = (1.0 - f) * shift[before] + f * shift[after] if is_own else np.zeros((len(index), 3))
    across = compute_sideways_directions(path)
    axis = interpolate_axis(path.axis[before], path.axis[after], f[:, 0])
    travel = np.where(f >= 1.0, across[after], across[before])
    axes = np.stack([arm.directions(external, np.tile(unit, (len(index), 1))) for unit in np.eye(3)], axis=-1)
    return TargetPoses(
        q=q,
        external=external,
        axis=arm.directions(external, axis),
        travel=arm.directions(external, travel),
        cam_axes=axes,
        position=(1.0 - f) * path.position[before] + f * path.position[after] - offset,
        offset=arm.directions(external, offset),
        is_reached=np.asarray(np.isfinite(q).all(axis=1)),
    )


def find_stated_spread(plan: Plan, spread: StiffnessSpread, poses: TargetPoses) -> NDArray[np.bool_]:
    """Return (M,) whether the spread of the springs is stated at the poses.

    Args:
        plan: Plan of one tool.
        spread: Random part of the stiffness.
        poses: Poses of the plan.
    """
    return spread.find_stated(plan.setup.arm.places(poses.external, poses.position))


def compute_twist_columns(plan: Plan, spread: StiffnessSpread, poses: TargetPoses, wrench: Array) -> Array:
    """Return (M, 6, 1 + R): the twist of the tool relative to the part under a load, and its change by each error.

    The part deflects under the opposite load, where its stiffness is stated.

    Args:
        plan: Plan of one tool.
        spread: Random part of the stiffness.
        poses: Poses of the plan.
        wrench: (M, 6) N and N·m on the tool at the TCP, in base_link.
    """
    out = np.full((len(wrench), 6, 1 + spread.count), np.nan)
    known = np.flatnonzero(poses.is_reached)
    elasticity, arm = plan.setup.elasticity, plan.setup.arm
    carrier = ExternalJointCompliance.build(arm.machine, elasticity.stiffness.external)
    for first in range(0, len(known), ROWS):
        rows = known[first : first + ROWS]
        place = arm.places(poses.external[rows], poses.position[rows])
        k = compute_joint_stiffness(elasticity.stiffness, place).k
        external = None if carrier is None else carrier.compute_compliance(poses.external[rows], place)
        elastic = elasticity.evaluate(poses.q[rows], k, external)
        out[rows] = spread.compute_columns(elastic, poses.q[rows], wrench[rows], external)
    part = plan.setup.cell.workpiece.stiffness
    if part is not None:
        pressed = np.einsum("mij,mi->mj", poses.cam_axes, wrench[:, :3]) / part
        out[:, :3, 0] += np.einsum("mij,mj->mi", poses.cam_axes, pressed)
    return out
