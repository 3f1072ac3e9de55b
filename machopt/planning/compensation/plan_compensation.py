"""Additional planning points for a finished plan: the choice is unchanged, the path is followed more closely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.steering_rules import list_constrained_points
from machopt.data_types.toolpath import Toolpath
from machopt.planning.compensation.shifted_path import LENGTHS, STEEPEST, compute_offset_slope, rescore_plan, shift_path
from machopt.planning.cost.process_force_direction import compute_engaged_share
from machopt.planning.cost.stiffness_index import compute_load_directions
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.planning.stations.tilt_curve import get_tilt_curve


def compensate_plan(plan: Plan, toolpath: Toolpath) -> Plan:
    """Return the plan for the path shifted against its deflection, with the same rotation.

    Points that cannot be shifted carry a reason. The shift turns and fades over the shortest of LENGTHS. While its
    slope is above STEEPEST somewhere, the next length is taken: to fade where the steepest step fades, else to turn.

    Args:
        plan: finished plan without compensation.
        toolpath: toolpath the plan was made for.
    """
    turn = fade = 0
    while True:
        fine = add_corner_points(plan, toolpath, LENGTHS[turn])
        found = shift_path(fine, LENGTHS[turn], LENGTHS[fade])
        if found.compensation is None:
            return found
        slope = compute_offset_slope(fine.path, found.compensation.offset)
        steepest = int(slope.argmax())
        if slope[steepest] <= STEEPEST:
            return found
        share = compute_engaged_share(fine.path, LENGTHS[fade])
        if fade < len(LENGTHS) - 1 and min(share[steepest - 1], share[steepest]) < 1.0:
            fade += 1
        elif turn < len(LENGTHS) - 1:
            turn += 1
        else:
            return found


def add_corner_points(plan: Plan, toolpath: Toolpath, length: float) -> Plan:
    """Return the plan with more planning points around corners, starts and ends of cuts.

    The rotation at the added points is interpolated linearly. At these places a shift against the deflection changes.

    Args:
        plan: finished plan.
        toolpath: toolpath the plan was made for.
        length: m, distance to either side of a corner over which the shift changes.
    """
    old = plan.path
    path = build_planning_path(toolpath, list_constrained_points(plan.options), corners=length)
    if len(path.index) == len(old.index):
        return plan
    tilt = get_tilt_curve(old, plan.setup.ball_radius)
    path = path if tilt is None else tilt.tilt_path(path)
    rows = np.searchsorted(path.index, old.index)
    columns = [np.interp(path.index, old.index, column) for column in old.external.T]  # added points lie inside runs
    external = np.array(columns).T.reshape(len(path.index), -1)
    path = replace(path, stations=rows[old.stations].astype(np.int32), external=external)
    setup = plan.setup
    refined = replace(
        plan,
        path=path,
        check=None,
        directions=compute_load_directions(path, setup.arm, setup.elasticity, plan.options.force),
    )

    def carried(scored: ScoredAssignment) -> ScoredAssignment:
        assignment = _interpolate_assignment(plan, path, rows, scored.assignment)
        return rescore_plan(replace(refined, chosen=scored), assignment).chosen

    return replace(
        refined, chosen=carried(plan.chosen), jiao2022=carried(plan.jiao2022), cam_default=carried(plan.cam_default)
    )


def _interpolate_assignment(
    plan: Plan, path: PlanningPath, rows: NDArray[np.intp], a: JointAssignment
) -> JointAssignment:
    """Return the assignment at more points; at the old ones (``rows``) unchanged to the last bit."""
    index = plan.path.index
    phi = np.interp(path.index, index, a.phi)
    seed = np.column_stack([np.interp(path.index, index, a.q[:, j]) for j in range(6)])
    found = solve_joint_path(path, plan.setup.arm, plan.setup.robot, phi, seed)
    whole = np.interp(path.index, index, (a.reason != InfeasibilityReason.OK).astype(float)) == 0  # both neighbours are
    values = {name: value.copy() for name, value in vars(found).items()}
    values["reason"][~whole] = InfeasibilityReason.NO_PATH
    for name, value in vars(a).items():
        values[name][rows] = value
    return JointAssignment(**values)
