"""Price of instability in the choice: ``weights.stability``.

J gets w · mean over the length cut of max(0, 1 − a_lim / (s · a)). a is the planned depth of cut, a_lim its limit, s
the safety factor SAFETY. The term is 0 where every cut has that reserve.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stability.depth_ratio import StabilityModel
from machopt.planning.stations.planning_path import PlanningPath

SAFETY = 1.2  # reserve of the depth of cut


@dataclass(frozen=True)
class StabilityPricing:
    """Weighted price of the stability of configurations."""

    model: StabilityModel
    path: PlanningPath
    weight: float

    def price_grid(self, candidates: CandidateGrid) -> Array:
        """Return the (S, R, B) price of every candidate, its share of the length cut in it.

        Args:
            candidates: Candidate grid of the search.
        """
        out = np.zeros(candidates.usable.shape)
        s, r, b = np.nonzero(candidates.usable)
        points = self.path.stations[s].astype(np.intp)
        milled = np.flatnonzero(self.model.is_milled[points])
        s, r, b, points = s[milled], r[milled], b[milled], points[milled]
        short = compute_shortfall(self.model.compute_ratios(points, candidates.q[s, r, b]))
        out[s, r, b] = self.weight * self.path.station_weight[s] * short
        return out

    def price_assignment(self, q: Array) -> float:
        """Return the price of an assignment.

        Args:
            q: (P, 6) rad, NaN where there is none.
        """
        known = np.flatnonzero(np.isfinite(q).all(axis=1) & self.model.is_milled)
        short = compute_shortfall(self.model.compute_ratios(known, q[known]))
        return float(self.weight * (self.path.weight[known] @ short))

    def with_path(self, path: PlanningPath, directions: LoadDirections) -> StabilityPricing:
        """Return the pricing with other external joints or directions at the same planning points.

        Args:
            path: Planning points.
            directions: Directions and force per planning point.
        """
        return replace(self, path=path, model=self.model.with_path(path, directions))


def compute_shortfall(ratio: Array) -> Array:
    """Return max(0, 1 − ratio / SAFETY).

    Args:
        ratio: (M,) limit of the depth of cut over the planned depth.
    """
    return np.maximum(0.0, 1.0 - ratio / SAFETY)
