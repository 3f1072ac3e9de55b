"""Errors of milled points along the surface normal and the probability that their tolerance holds.

The error of one draw of stiffness, load and lost motion has the mean m over the position noise σ, so that

    p_in = mean over draws of Φ((t − m)/σ) − Φ((−t − m)/σ)
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingProcess
from machopt.numerics.array_types import Array
from machopt.numerics.normal_interval_probability import compute_interval_shares
from machopt.numerics.tall_products import multiply_tall
from machopt.planning.error_probability.random_draws import UncertaintyDraws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.toleranced_points import SurfaceTargets
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.tolerance.arm_accuracy import PositionScatter, compute_position_scatter
from machopt.planning.tolerance.error_sensitivities import TargetPoses, compute_twist_columns, locate_poses
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear

BLOCK = 512  # points at a time


@dataclass(frozen=True, kw_only=True)
class SurfaceErrorModel:
    """Linear error model of S milled points along their surface normals."""

    targets: SurfaceTargets
    poses: TargetPoses
    normal: Array  # (S, 3) unit, away from the material, in base_link
    twist: Array  # (S, 6, 1 + R) of the nominal load
    columns: Array  # (S, 1 + R) m, along the normal
    tool: Array  # (S,) m, deflection of the tool along the normal at nominal load
    offset: Array  # (S,) m, compensation along the normal
    scatter: PositionScatter
    local: Array  # (S,) m, 1 sigma from the compliance of the pose alone
    process: CuttingProcess
    contact_sigma: Array  # (S,) 1 sigma of the logarithm of the load from the stock's cells


def build_surface_model(
    plan: Plan,
    chosen: ScoredAssignment,
    process: CuttingProcess,
    targets: SurfaceTargets,
    loads: PointLoads,
    spread: StiffnessSpread,
    tool_force: Array,
) -> SurfaceErrorModel:
    """Return the error model of the milled points of a plan.

    Args:
        plan: Plan of one tool.
        chosen: An assignment along its path.
        process: Content of process.yaml.
        targets: The milled points.
        loads: Loads of the toolpath.
        spread: Random part of the stiffness.
        tool_force: (N,) N, force along axis × travel at the moment the surface is made, nominal; zero where the tool
            counts as rigid.
    """
    rows = targets.row
    poses = locate_poses(plan, chosen, rows.astype(float))
    f = loads.arm_force[rows]
    force = f[:, :1] * poses.travel + f[:, 1:2] * poses.normal + f[:, 2:] * poses.axis
    wrench = np.hstack([force, loads.moment[rows, None] * poses.axis])
    twist = compute_twist_columns(plan, spread, poses, wrench)
    normal = targets.choose_normal(slice(None), poses.cam_axes, poses.axis, poses.normal)
    reference = np.array([process.operations[k].tolerance.reference for k in targets.operation], dtype=object)
    cutter = plan.setup.cell.tool.cutter
    side = None if cutter is None else cutter.side_stiffness
    bent = np.zeros(len(rows)) if side is None else np.sum(normal * poses.normal, axis=1) * tool_force[rows] / side
    discrepancy = plan.setup.elasticity.stiffness.discrepancy
    local = 0.0 if discrepancy is None else discrepancy.local
    return SurfaceErrorModel(
        targets=targets,
        poses=poses,
        normal=normal,
        twist=twist,
        columns=np.einsum("mi,mir->mr", normal, twist[:, :3]),
        tool=bent,
        offset=np.einsum("mi,mi->m", normal, poses.offset),
        scatter=compute_position_scatter(plan, poses, reference, wrench),
        local=local * np.linalg.norm(force, axis=1),
        process=process,
        contact_sigma=loads.contact_sigma[rows],
    )


def draw_surface_errors(
    model: SurfaceErrorModel,
    rows: slice | NDArray[np.intp],
    draws: UncertaintyDraws,
    factor: Array,
    *,
    position: bool,
) -> Array:
    """Return (n, D) the errors of some points, without position noise.

    Args:
        model: The error model.
        rows: The points.
        draws: The draws.
        factor: (n, D) or (1, D) factor of the load relative to nominal.
        position: Include lost motion and pose of the part.
    """
    out = multiply_tall(model.columns[rows], draws.stiffness.T)
    if model.tool[rows].any():
        out += model.tool[rows, None]
    out *= factor
    if model.offset[rows].any():
        out += model.offset[rows, None]
    if model.local[rows].any():
        out += model.local[rows, None] * draws.local[:, 0]
    normal, scatter = model.normal[rows], model.scatter
    if not position or not (scatter.lost_motion[rows].any() or scatter.pose_root[rows].any()):
        return np.asarray(out)
    lost = np.einsum("mi,mij->mj", normal, scatter.lost_motion[rows, :3])
    pose = np.einsum("mi,mij->mj", normal, scatter.pose_root[rows, :3])
    decided = np.sum(lost * scatter.sides[rows], axis=1)
    open_sides = np.where(scatter.sides[rows] == 0, lost, 0.0)
    return np.asarray(out + decided[:, None] + open_sides @ draws.side.T + pose @ draws.pose.T)


def compute_load_factors(model: SurfaceErrorModel, rows: slice, draws: UncertaintyDraws) -> Array:
    """Return (n, D) the factor of the load of some points relative to nominal; (1, D) where it is that of all.

    Args:
        model: The error model.
        rows: The points.
        draws: The draws.
    """
    operation, contact = model.targets.operation[rows], model.contact_sigma[rows, None]
    own = np.exp(contact * draws.scatter) if contact.any() else np.ones((1, 1))
    if len(operation) and (operation == operation[0]).all():
        one = model.process.operations[operation[0]]
        return (draws.compute_load_factor(model.process, one) / compute_mean_wear(one))[None] * own
    out = np.ones((len(operation), len(draws)))
    for k in np.unique(operation):
        one = model.process.operations[k]
        out[operation == k] = draws.compute_load_factor(model.process, one) / compute_mean_wear(one)
    return out * own


def compute_surface_probability(errors: Array, limit: Array, std: Array) -> Array:
    """Return (n,) the probability that the errors stay within their limits.

    Args:
        errors: (n, D) m, errors over the draws, without position noise.
        limit: (n,) m.
        std: (n,) m, position noise.
    """
    return compute_interval_shares(errors, limit, std)


def take_surface_targets(model: SurfaceErrorModel, rows: NDArray[np.intp]) -> SurfaceErrorModel:
    """Return the error model of some of the points.

    Args:
        model: The error model.
        rows: (n,) which of its points.
    """
    parts = {name: _take(getattr(model, name), rows) for name in ("targets", "poses", "scatter")}
    arrays = {
        name: getattr(model, name)[rows]
        for name in ("normal", "twist", "columns", "tool", "offset", "local", "contact_sigma")
    }
    return replace(model, **parts, **arrays)


def _take(part: Any, rows: NDArray[np.intp]) -> Any:
    """Return a dataclass of arrays with some of their rows."""
    arrays = {f.name: getattr(part, f.name) for f in fields(part)}
    return replace(part, **{name: a[rows] for name, a in arrays.items() if isinstance(a, np.ndarray)})
