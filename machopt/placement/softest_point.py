"""Point of a plan with the worst index, and the joints that cause it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.pipeline.plan_data_types import Plan

RIGID_FACTOR = 1e9  # times a joint's stiffness: practically rigid


def find_softest_point(plan: Plan) -> tuple[float, tuple[float, ...]]:
    """Return the toolpath index of the worst index, and the share of it that would vanish if each joint were rigid.

    Args:
        plan: plan of a job.
    """
    cost = np.where(plan.path.counted, plan.chosen.cost, -np.inf)
    at = int(np.nanargmax(cost))
    one, row = plan.at(at)
    p = np.array([row])
    q, elasticity, index = one.chosen.assignment.q[p], one.setup.elasticity, one.scores.index
    all_of_it = compute_configuration_cost(elasticity, one.directions, p, q, index)[0]
    shares = []
    for j in range(6):
        k = one.directions.k.copy()
        k[p, j] *= RIGID_FACTOR
        left = compute_configuration_cost(elasticity, replace(one.directions, k=k), p, q, index)[0]
        shares.append(float(1.0 - left / all_of_it))
    return float(plan.path.index[at]), tuple(shares)
