"""Whether the pressure foot skids on the work, for operations that state its coefficient of friction.

The clamp force N_c moves a free tip across the hole by d = P C n N_c. A foot that sticks needs the lateral force
R = (P C P)⁻¹ d for that, P being the projection across the hole. It skids where |R| > µ (N_c − T), T the thrust.
"""

from __future__ import annotations

import numpy as np

from machopt.data_types.process import CuttingProcess, ProcessOperation
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.tolerance.error_sensitivities import TargetPoses, compute_twist_columns, locate_poses
from machopt.planning.tolerance.hole_errors import build_sideways
from machopt.process.binding.point_loads import PointLoads
from machopt.process.drilling.pressure_foot import compute_skid_margin


def list_skid_notes(process: CuttingProcess, plan: Plan, loads: PointLoads) -> list[str]:
    """Return one note for each operation whose foot skids at a hole.

    Args:
        process: Content of process.yaml.
        plan: Plan of one tool.
        loads: The loads of its points.
    """
    out = []
    for k, one in enumerate(process.operations):
        holes = [hole for hole in loads.holes if hole.operation == k]
        if not holes or one.foot_friction is None or one.clamp == 0.0:
            continue
        poses = locate_poses(plan, plan.chosen, np.array([hole.deepest for hole in holes], float))
        lateral = compute_lateral_force(plan, poses, one.clamp)[poses.is_reached]
        thrust = np.array([np.nanmax(loads.force[hole.rows, 2]) for hole in holes])[poses.is_reached]
        rows = np.array([hole.deepest for hole in holes])[poses.is_reached]
        out += _format_skid(one, rows, lateral, thrust)
    return out


def _format_skid(one: ProcessOperation, rows: Array, lateral: Array, thrust: Array) -> list[str]:
    assert one.foot_friction is not None
    if not len(rows):
        return []
    at_rest = compute_skid_margin(lateral, 0.0, one.clamp, one.foot_friction)
    cutting = compute_skid_margin(lateral, thrust, one.clamp, one.foot_friction)
    worst = int(np.argmin(cutting))
    if cutting[worst] >= 0:
        return []
    return [
        f"{one.label}: the pressure foot skids at {int((cutting < 0).sum())} of {len(rows)} holes "
        f"({int((at_rest < 0).sum())} under the clamp alone): at point {rows[worst]} the arm pushes it sideways with "
        f"{lateral[worst]:.3g} N, and friction carries {max(cutting[worst] + lateral[worst], 0.0):.3g} N"
    ]


def compute_lateral_force(plan: Plan, poses: TargetPoses, clamp: float) -> Array:
    """Return (M,) the lateral force in N that a foot which sticks must carry; NaN where there is no posture.

    Args:
        plan: Plan of one tool.
        poses: M poses of holes.
        clamp: N, clamp force.
    """
    limits = plan.setup.cell.limits
    spread = StiffnessSpread.build(plan.setup.elasticity, (limits.lower[:6], limits.upper[:6]))
    sideways = build_sideways(poses.axis)  # (M, 2, 3)
    zero = np.zeros_like(poses.axis)
    moved = [
        compute_twist_columns(plan, spread, poses, np.hstack([unit, zero]))[:, :3, 0]
        for unit in (poses.axis, sideways[:, 0], sideways[:, 1])
    ]
    drift, first, second = (np.einsum("mki,mi->mk", sideways, m) for m in moved)
    out = np.full(len(drift), np.nan)
    known = np.flatnonzero(poses.is_reached)
    compliance = np.stack([first, second], axis=2)[known]
    out[known] = np.linalg.norm(np.linalg.solve(compliance, clamp * drift[known][..., None])[..., 0], axis=1)
    return out
