"""Standard uncertainty of the mean cost of a plan and of the cost of each point, for tests."""

from __future__ import annotations

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.error_probability.model_discrepancy import compute_reported_std
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.uncertainty.stiffness_uncertainty import _compute_point_costs, build_compliance_covariance


def compute_mean_cost_std(plan: Plan) -> tuple[float, Array]:
    """Return 1 σ of the mean cost along the cut, and of the cost of each planning point (P,); NaN without a
    covariance in the file."""
    spread = build_compliance_covariance(plan)
    points = _compute_point_costs(plan, plan.chosen)
    if not spread.known:
        return float("nan"), np.full(len(plan.path.index), np.nan)
    w = plan.path.weight
    mean = float(np.hypot(spread.std(spread.gradient(w, points.by_springs)), np.linalg.norm(w @ points.by_carriers)))
    each = np.hypot(spread.point_std(points.by_springs), np.linalg.norm(points.by_carriers, axis=1))
    if points.by_doubt is None:
        return mean, each
    whole = float(compute_reported_std(w @ points.by_doubt, mean**2 + float(w @ points.own) ** 2))
    return whole, compute_reported_std(points.by_doubt, each**2 + points.own**2)
