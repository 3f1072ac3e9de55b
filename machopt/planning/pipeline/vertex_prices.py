"""Prices of the search beside the stiffness index: clearance, lost feed, and rapid moves with their changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.clearance_cost import compute_grid_crowding
from machopt.planning.cost.lost_feed_time import compute_grid_price
from machopt.planning.cost.rapid_time import RapidPricing
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath


def add_vertex_prices(
    scores: CandidateScores, path: PlanningPath, setup: PlanningSetup, candidates: CandidateGrid, options: PlanOptions
) -> CandidateScores:
    """Return the scores with the prices that the objective has beside the index.

    Args:
        scores: cost of the candidates, with the scale in use.
        path: planning points.
        setup: planning setup of the cell.
        candidates: candidate grid.
        options: plan options with the weights.
    """
    return replace(
        scores,
        rapid=build_rapid_pricing(path, setup, scores.least, candidates.stable, options),
        crowded=compute_grid_crowding(path, setup.collision, candidates, options),
        feed_price=compute_grid_price(path, setup.drives, options, candidates),
    )


def build_rapid_pricing(
    path: PlanningPath, setup: PlanningSetup, least: Array, stable: bool, options: PlanOptions
) -> RapidPricing | None:
    """Return the prices of rapid moves and changes of posture; None where these have none.

    Args:
        path: planning points.
        setup: planning setup of the cell.
        least: (S,) lowest index of each station in units of c₀.
        stable: the branches have fixed numbers along the path.
        options: plan options with the weights.
    """
    limits = setup.cell.limits
    rates = np.stack([limits.velocity, limits.acceleration, limits.jerk]) * setup.per_rad
    return RapidPricing.build(path, rates, setup.driven.joints_at_home, setup.per_rad, least, stable, options)
