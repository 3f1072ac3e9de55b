"""Ranking value of plans with external joints: J plus the cost of the user's requests about these joints.

J (:mod:`machopt.planning.cost.objective`) counts their travel like that of the arm's joints. An option may weigh it
differently, and prefer a place. The search, the refinement and the comparison of full plans all use this value:

    worth = J + w_travel·Σ a·b·(weight − 1)·|Δe|/π + Σ share·PREFERRED·(e − preferred)²
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.plan_options import ExternalJointOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup

PREFERRED = 0.1  # price in J per squared equivalent rad from a preferred value


@dataclass(frozen=True)
class AxisPlanRanking:
    """Ranking function of one cell's external joints and the user's options about them."""

    per: Array  # (E,) equivalent rad of a rad or m of each
    weight: Array  # (E,) of their travel
    preferred: Array  # (E,) equivalent rad, NaN where none is preferred

    @classmethod
    def build(cls, setup: PlanningSetup, axes: Sequence[ExternalJointOptions]) -> AxisPlanRanking:
        """Return the ranking function of a cell.

        Args:
            setup: planning setup of the cell.
            axes: options of each external joint.
        """
        per = setup.per_rad[6:]
        preferred = np.array([np.nan if axis.preferred is None else axis.preferred for axis in axes])
        return cls(per, np.array([axis.weight for axis in axes]), preferred * per)

    def plan(self, plan: Plan) -> float:
        """Return the value of a whole plan; less is better, infinite where a cut point is lost.

        Args:
            plan: plan to rank.
        """
        terms = ObjectiveTerms.build(plan.path, plan.setup.velocity, plan.options)
        return plan.chosen.objective.total + self.wished(plan.path.external * self.per, terms)

    def wished(self, x: Array, terms: ObjectiveTerms) -> float:
        """Return the price of external joints beyond J.

        Args:
            x: (n, E) external joints in equivalent rad.
            terms: terms of J at the n places.
        """
        more = float(terms.travel[1:] @ (np.abs(np.diff(x, axis=0)) @ (self.weight - 1.0)))
        return terms.weights.travel * more + float(terms.share @ self.liked(x))

    def liked(self, x: Array) -> Array:
        """Return the (…,) price of a deviation from the preferred place.

        Args:
            x: (…, E) external joints in equivalent rad.
        """
        return np.asarray(PREFERRED * np.nansum((x - self.preferred) ** 2, axis=-1))
