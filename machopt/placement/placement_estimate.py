"""Estimate of a place before any planning: reach, limits and margins, a bound, and the grid's best sequence.

The worst index of a plan is the greatest cost over the cut points. At each of them it is no less than the
least cost over all feasible configurations; the greatest of those is the bound. It leaves out collisions, continuity
and every other term of the objective. Like the plan's certificate it holds over the grid of rotations.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.placement.tolerance_estimate import ToleranceEstimator
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.sequence_search.dynamic_programming import choose_sequence
from machopt.planning.stations.planning_path import PlanningPath

FIRST_STATIONS = 12  # stations checked first: most places out of reach are found by them


@dataclass(frozen=True)
class PlacementEstimate:
    """Estimate of one place and one toolpath; the index in m (deflection) or m/N (compliance)."""

    bound: float  # no plan on the grid of rotations has a worst index below; inf where a point is not reached
    worst: float  # of the best sequence without collisions; inf where there is none
    mean: float
    point: int  # toolpath point that the bound is of, or the first that cannot be reached
    reason: InfeasibilityReason = (
        InfeasibilityReason.OK
    )  # why it is not reached, for the configuration that came furthest
    _: KW_ONLY
    missed: int = 0  # holes and points that are in tolerance in no feasible configuration
    outcomes: tuple[int, ...] = ()  # pass, marginal, fail, unknown along that sequence; empty: nothing is counted

    @property
    def is_reachable(self) -> bool:
        """Whether every point is reached."""
        return bool(np.isfinite(self.bound))


def estimate_placement(
    setup: PlanningSetup,
    arm: PlanningArm,
    path: PlanningPath,
    options: PlanOptions,
    tolerances: ToleranceEstimator | None = None,
) -> PlacementEstimate:
    """Return the estimate of a place.

    Args:
        setup: of the cell, for its springs; its arm is that of another place.
        arm: with the workpiece at the place.
        path: as planned, with its stations.
        options: plan options.
        tolerances: counts holes and points in tolerance; None: nothing has a tolerance.
    """
    every = max(len(path.stations) // FIRST_STATIONS, 1)
    if every > 1:
        glance = replace(path, stations=path.stations[::every])
        lost = _find_unreached_station(glance, enumerate_candidates(glance, arm, options))
        if lost is not None:
            return lost
    candidates = enumerate_candidates(path, arm, options)
    lost = _find_unreached_station(path, candidates)
    if lost is not None:
        return lost
    d = compute_load_directions(path, arm, setup.elasticity, options.force)
    scores = score_candidates(path, candidates, setup.elasticity, d, options)
    counted = np.flatnonzero(path.counted[path.stations])
    if not len(counted):
        return PlacementEstimate(0.0, 0.0, 0.0, 0)
    least = np.nanmin(scores.cost[counted].reshape(len(counted), -1), axis=1)
    at = int(least.argmax())
    bound, point = float(least[at]), round(float(path.index[path.stations[counted[at]]]))
    missed = 0
    if tolerances is not None:
        tolerances = tolerances.move_to(arm, path, d)
        missed = tolerances.count_missed(candidates, scores)
        if options.objective == "tolerance":
            scores = replace(scores, place_price=tolerances.pricing.price_grid(setup.cell, candidates))
    choice = choose_sequence(path, candidates, scores, setup.cell.limits.velocity[:6], options)
    if choice.broken or choice.dropped.any():
        return PlacementEstimate(bound, np.inf, np.inf, point, InfeasibilityReason.NO_PATH, missed=missed)
    cost = scores.cost[counted, choice.rotation[counted], choice.branch[counted]]
    outcomes = () if tolerances is None else tolerances.count_outcomes(choice)
    return PlacementEstimate(bound, float(cost.max()), float(cost.mean()), point, missed=missed, outcomes=outcomes)


def _find_unreached_station(path: PlanningPath, candidates: CandidateGrid) -> PlacementEstimate | None:
    """Return the estimate of the first required station that is not reached; None where all are."""
    needed = path.may_touch[path.stations]
    lost = np.flatnonzero(needed & ~candidates.feasible.any(axis=(1, 2, 3)))
    if not len(lost):
        return None
    s = int(lost[0])
    return PlacementEstimate(
        np.inf, np.inf, np.inf, round(float(path.index[path.stations[s]])), find_unreachable_reason(candidates, s)
    )


def find_unreachable_reason(candidates: CandidateGrid, s: int) -> InfeasibilityReason:
    """Return why a station is not reached, for the configuration that came furthest.

    Args:
        candidates: candidate grid.
        s: station.
    """
    return InfeasibilityReason(
        int(
            np.where(
                candidates.reason[s] == InfeasibilityReason.OK, InfeasibilityReason.BOUNDS, candidates.reason[s]
            ).max()
        )
    )
