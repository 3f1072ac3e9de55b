"""Prices of configurations that no share of the index expresses: tolerances and stability."""

from __future__ import annotations

from dataclasses import dataclass, replace

from machopt.data_types.cell import Cell
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import LoadDirections
from machopt.planning.error_probability.tolerance_price import TolerancePricing
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stability.depth_ratio import StabilityModel
from machopt.planning.stability.stability_price import StabilityPricing
from machopt.planning.stations.planning_path import PlanningPath


@dataclass(frozen=True)
class PlacePricing:
    """Prices of one path; None: that part does not count."""

    cell: Cell
    tolerance: TolerancePricing | None
    stability: StabilityPricing | None

    @classmethod
    def build(
        cls, toolpath: Toolpath, path: PlanningPath, setup: PlanningSetup, d: LoadDirections, options: PlanOptions
    ) -> PlacePricing | None:
        """Return the prices; None where neither part counts.

        Args:
            toolpath: Toolpath of one tool.
            path: Its planning points.
            setup: Planning setup of the cell.
            d: Directions and force per planning point.
            options: Planning options.
        """
        cell, stability = setup.cell, None
        tolerance = TolerancePricing.build(cell, toolpath, path, setup.arm, setup.elasticity, d, options)
        if options.weights.stability > 0:
            model = StabilityModel.build(cell, toolpath, path, setup.arm, setup.robot, d)
            stability = None if model is None else StabilityPricing(model, path, options.weights.stability)
        return None if tolerance is None and stability is None else cls(cell, tolerance, stability)

    def price_grid(self, candidates: CandidateGrid) -> Array | None:
        """Return the (S, R, B) price of every candidate.

        Args:
            candidates: Candidate grid of the search.
        """
        parts = []
        if self.tolerance is not None:
            parts.append(self.tolerance.price_grid(self.cell, candidates))
        if self.stability is not None:
            parts.append(self.stability.price_grid(candidates))
        return sum(parts[1:], parts[0]) if parts else None

    def price_assignment(self, q: Array) -> tuple[float, float]:
        """Return the price of an assignment: of its tolerances, and of its stability.

        Args:
            q: (P, 6) rad, NaN where there is none.
        """
        return (
            0.0 if self.tolerance is None else self.tolerance.price_assignment(self.cell, q),
            0.0 if self.stability is None else self.stability.price_assignment(q),
        )

    def with_path(self, path: PlanningPath, d: LoadDirections) -> PlacePricing:
        """Return the prices for other planning points of the same toolpath.

        Args:
            path: Planning points.
            d: Directions and force per planning point.
        """
        return replace(
            self,
            tolerance=None if self.tolerance is None else self.tolerance.with_path(path, d),
            stability=None if self.stability is None else self.stability.with_path(path, d),
        )


def price_places(pricing: PlacePricing | None, q: Array) -> tuple[float, float]:
    """Return the price of an assignment, zero where nothing counts.

    Args:
        pricing: The prices, or None.
        q: (P, 6) rad, NaN where there is none.
    """
    return (0.0, 0.0) if pricing is None else pricing.price_assignment(q)
