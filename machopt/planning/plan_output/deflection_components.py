"""Deflection at one point along and across the tool axis, with the interval from the springs' covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.error_probability.model_discrepancy import NINETY, DiscrepancyModel
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.uncertainty.stiffness_uncertainty import build_compliance_covariance

Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DeflectionSplit:
    """Components of the TCP deflection under the process force; m."""

    along: float  # + towards the shank
    across: float  # length of the rest
    along90: Interval | None  # 90 % interval; None where the springs' covariance does not say it all
    across90: Interval | None


def split_deflection(plan: Plan, row: int) -> DeflectionSplit | None:
    """Return the components of the deflection at a planning point; None where no force is given.

    With e the tool axis and f the force, the deflection along is eᵀCf, and its variance gᵀΣg with g = ∂(eᵀCf)/∂c over
    the joint compliances c; across likewise, with the unit vector of the remaining component.

    Args:
        plan: plan of a job or of one tool.
        row: planning point with a configuration.
    """
    plan, row = plan.at(row)
    if not plan.options.force.given:
        return None
    d, rows = plan.directions, np.array([row])
    elastic = d.elastic(plan.setup.elasticity, plan.chosen.assignment.q[row][None], rows)
    force, axis = d.force[row], d.axial[row]
    bend = elastic.compute_deflection(force[None])[0]
    along = float(bend @ axis)
    rest = bend - along * axis
    across = float(np.linalg.norm(rest))
    spread = build_compliance_covariance(plan)
    whole = (
        spread.known
        and DiscrepancyModel.build(plan.setup.elasticity) is None
        and (d.unsure is None or not d.unsure.shape[1])
    )

    def interval(value: float, direction: Array) -> Interval | None:
        if not whole:
            return None
        by_point = np.zeros((len(plan.path.index), 6))
        by_point[row] = elastic.compute_sensitivity(force[None], direction[None])[0]
        half = NINETY * float(spread.point_std(by_point)[row])
        return (value - half, value + half) if np.isfinite(half) else None

    unit = rest / across if across > 0.0 else rest
    return DeflectionSplit(
        along=along, across=across, along90=interval(along, axis), across90=interval(across, unit) if across else None
    )
