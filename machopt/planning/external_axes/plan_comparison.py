"""What plans with external joints are compared by: J, and what the user's wishes about these joints cost beside it.

J (:mod:`machopt.planning.cost.objective`) counts their travel as that of the arm's joints. An option may weigh it
otherwise, and prefer a place; the search, the refinement and the comparison of plans in full all ask here what that
costs:

    worth = J + w_travel·Σ a·b·(weight − 1)·|Δe|/π + Σ share·PREFERRED·(e − preferred)²
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.plan_options import ExternalJointOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.pipeline.plan import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup

PREFERRED = 0.1  # of J, price of the square of a rad (or as much as counts so) from a preferred value


@dataclass(frozen=True)
class AxisPlanRanking:
    """Of one cell's external joints and the user's options about them."""

    per: Array  # (E,) rad that a rad or m of each counts as
    weight: Array  # (E,) of their travel
    preferred: Array  # (E,) as they count, NaN where none is

    @classmethod
    def of(cls, setup: PlanningSetup, axes: Sequence[ExternalJointOptions]) -> AxisPlanRanking:
        per = setup.per_rad[6:]
        asked = np.array([np.nan if axis.preferred is None else axis.preferred for axis in axes])
        return cls(per, np.array([axis.weight for axis in axes]), asked * per)

    def plan(self, plan: Plan) -> float:
        """Of a whole plan; less is better, infinite where a cut point is lost."""
        terms = ObjectiveTerms.of(plan.path, plan.setup.velocity, plan.options)
        return plan.chosen.objective.total + self.wished(plan.path.external * self.per, terms)

    def wished(self, x: Array, terms: ObjectiveTerms) -> float:
        """Price beyond J of external joints x (n, E), as they count."""
        more = float(terms.travel[1:] @ (np.abs(np.diff(x, axis=0)) @ (self.weight - 1.0)))
        return terms.weights.travel * more + float(terms.share @ self.liked(x))

    def liked(self, x: Array) -> Array:
        """(…,) price of each place x (…, E), as it counts, for leaving the preferred one."""
        return np.asarray(PREFERRED * np.nansum((x - self.preferred) ** 2, axis=-1))
