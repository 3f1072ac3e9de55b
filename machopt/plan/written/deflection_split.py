"""The deflection at one point along and across the tool axis, with the interval that the springs' covariance gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.plan.certainty.discrepancy import NINETY, doubt_of
from machopt.plan.certainty.uncertainty import spread_of
from machopt.plan.pipeline.planned import Plan

Interval = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class DeflectionSplit:
    """The deflection of the TCP under the process force; m."""

    along: float  # + towards the shank
    across: float  # length of the rest
    along90: Interval | None  # 90 % interval; None where the springs' covariance does not say it all
    across90: Interval | None


def split_deflection(plan: Plan, row: int) -> DeflectionSplit | None:
    """Split the deflection at a planning point with a configuration; None where no force is given.

    With e the tool axis and f the force, the deflection along is eᵀCf, and its variance gᵀΣg with g = ∂(eᵀCf)/∂c over
    the joint compliances c; across likewise, with the unit vector of what is left.
    """
    plan, row = plan.at(row)
    if not plan.options.force.given:
        return None
    d, rows = plan.directions, np.array([row])
    elastic = d.elastic(plan.setup.elasticity, plan.chosen.assignment.q[row][None], rows)
    force, axis = d.force[row], d.axial[row]
    bend = elastic.deflection(force[None])[0]
    along = float(bend @ axis)
    rest = bend - along * axis
    across = float(np.linalg.norm(rest))
    spread = spread_of(plan)
    whole = spread.known and doubt_of(plan.setup) is None and (d.unsure is None or not d.unsure.shape[1])

    def interval(value: float, direction: Array) -> Interval | None:
        if not whole:
            return None
        by_point = np.zeros((len(plan.path.index), 6))
        by_point[row] = elastic.sensitivity(force[None], direction[None])[0]
        half = NINETY * float(spread.point_std(by_point)[row])
        return (value - half, value + half) if np.isfinite(half) else None

    unit = rest / across if across > 0.0 else rest
    return DeflectionSplit(
        along=along, across=across, along90=interval(along, axis), across90=interval(across, unit) if across else None
    )
