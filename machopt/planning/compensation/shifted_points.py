"""Shift of some points of a compensated path, for another rotation there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.planning.compensation.shifted_path import PASSES
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.joint_path import JointAssignment, solve_joint_path


def shift_points(plan: Plan, rows: NDArray[np.intp], phi: Array, seeds: Array) -> tuple[Plan, JointAssignment]:
    """Return a compensated plan whose shift at some points is that of another rotation, and the joints there.

    The engaged force does not depend on the rotation. The shift is −d of the posture, in as many passes as that of a
    plan; what keeps a shift small and smooth along the path is not checked.

    Args:
        plan: Compensated plan.
        rows: (n,) planning points.
        phi: (P,) rad, rotation of these points; NaN elsewhere.
        seeds: (P, 6) rad, postures near those of these points; NaN where there is none.
    """
    found, setup = plan.compensation, plan.setup
    assert found is not None
    bare = plan.path.without_shift
    offset, moved = found.offset.copy(), bare
    turned = solve_joint_path(bare, setup.arm, setup.robot, phi, seeds)
    for _ in range(PASSES):
        known = rows[turned.reason[rows] == InfeasibilityReason.OK]
        if not len(known):
            break
        push = setup.arm.directions(bare.external[known], found.force[known])
        elastic = plan.directions.elastic(setup.elasticity, turned.q[known], known)
        offset[known] = -setup.arm.back(bare.external[known], elastic.compute_deflection(push))
        moved = bare.shift_positions(offset)
        turned = solve_joint_path(moved, setup.arm, setup.robot, phi, seeds)
    moved = bare.shift_positions(offset)
    return replace(plan, path=moved, compensation=replace(found, offset=offset)), turned
