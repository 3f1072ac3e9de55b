"""Holes and points in tolerance at a place before any planning.

Each hole or milled point is evaluated at its nearest station and at the programmed feed, as by ``objective:
tolerance``. The bound counts the points that pass in at least one feasible configuration; at that feed no plan on the
grid of rotations has more. Configurations with a low cost are tried first: most points pass in one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.process import ProcessOperation
from machopt.data_types.process_columns import OUTCOMES
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import CandidateScores, LoadDirections
from machopt.planning.error_probability.missing_inputs import find_missing_input, find_stated_std
from machopt.planning.error_probability.tolerance_price import TolerancePricing
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sampling.planning_arm import PlanningArm
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.tolerance.point_errors import find_outcome

BOUND_DRAWS = 128  # of the bound; their sampling error is left to the quantile
SAMPLING_SIGMAS = 3.0  # of a share of independent draws, left to the quantile in the bound
ROUNDS = (4, 16, 64, 100_000)  # configurations of a point that are tried by one round, the cheapest first


@dataclass(frozen=True, eq=False)
class ToleranceEstimator:
    """Holes and milled points of one tool's toolpath; T of them, the holes first."""

    pricing: TolerancePricing
    setup: PlanningSetup
    is_unknown: NDArray[np.bool_]  # (T,) an input is missing, anywhere or at this place

    @classmethod
    def build(
        cls, setup: PlanningSetup, toolpath: Toolpath, path: PlanningPath, d: LoadDirections, options: PlanOptions
    ) -> ToleranceEstimator | None:
        """Return the estimator; None where nothing has a tolerance.

        Args:
            setup: Planning setup of the cell.
            toolpath: Toolpath of one tool.
            path: Its planning points.
            d: Directions and force per planning point.
            options: Planning options.
        """
        wanted = replace(options, objective="tolerance")
        pricing = TolerancePricing.build(setup.cell, toolpath, path, setup.arm, setup.elasticity, d, wanted)
        if pricing is None:
            return None
        operations = pricing.process.operations
        missing = np.array([_is_unknown(setup, pricing, one) for one in operations], bool)
        holes, surfaces = pricing.holes, pricing.surfaces
        unknown = np.concatenate([missing[holes.operation], missing[surfaces.operation] | ~surfaces.is_known])
        return cls(pricing, setup, unknown)

    def move_to(self, arm: PlanningArm, path: PlanningPath, d: LoadDirections) -> ToleranceEstimator:
        """Return the estimator of another place.

        Args:
            arm: Arm model with the workpiece at the place.
            path: Planning points.
            d: Directions and force per planning point there.
        """
        pricing = replace(self.pricing, arm=arm).with_path(path, d)
        return replace(self, pricing=pricing, is_unknown=self.is_unknown | ~_find_stated_targets(pricing))

    def count_missed(self, candidates: CandidateGrid, scores: CandidateScores) -> int:
        """Return how many holes and points pass in no feasible configuration of the grid.

        Args:
            candidates: Candidate grid of the place.
            scores: Their cost.
        """
        quantile = self.pricing.process.quantile
        least = quantile - SAMPLING_SIGMAS * float(np.sqrt(quantile * (1.0 - quantile) / BOUND_DRAWS))
        fewer = replace(self, pricing=replace(self.pricing, draws=self.pricing.draws.take_first(BOUND_DRAWS)))
        missed = int(self.is_unknown.sum())
        first = 0
        for is_hole, rows in self._list_kinds():
            open_targets = np.flatnonzero(~self.is_unknown[first : first + len(rows)])
            first += len(rows)
            stations = self.pricing.find_nearest_stations(rows)
            order = _order_candidates(candidates, scores, np.unique(stations[open_targets]))
            begin = 0
            for size in ROUNDS:
                open_targets = fewer._drop_passing(
                    is_hole, open_targets, stations, order, (begin, begin + size), candidates, least
                )
                begin += size
            missed += len(open_targets)
        return missed

    def count_outcomes(self, choice: SequenceChoice) -> tuple[int, ...]:
        """Return how many holes and points have each outcome along a sequence, in the order of ``OUTCOMES``.

        Args:
            choice: One configuration per station.
        """
        counts = dict.fromkeys(OUTCOMES, 0)
        counts["unknown"] = int(self.is_unknown.sum())
        first = 0
        for is_hole, rows in self._list_kinds():
            known = np.flatnonzero(~self.is_unknown[first : first + len(rows)])
            first += len(rows)
            stations = self.pricing.find_nearest_stations(rows[known])
            p = self._compute_probability(is_hole, known, stations, choice.q[stations])
            for value in p.tolist():
                counts[find_outcome(value, self.pricing.process.quantile)] += 1
        return tuple(counts[word] for word in OUTCOMES)

    def _list_kinds(self) -> tuple[tuple[bool, NDArray[np.intp]], ...]:
        return (True, self.pricing.holes.row), (False, self.pricing.surfaces.row)

    def _compute_probability(
        self, is_hole: bool, targets: NDArray[np.intp], stations: NDArray[np.intp], q: Array
    ) -> Array:
        points = self.pricing.path.stations[stations].astype(np.intp)
        return self.pricing.compute_probability(self.setup.cell, is_hole, targets, points, q)

    def _drop_passing(
        self,
        is_hole: bool,
        targets: NDArray[np.intp],
        stations: NDArray[np.intp],
        order: dict[int, NDArray[np.intp]],
        span: tuple[int, int],
        candidates: CandidateGrid,
        least: float,
    ) -> NDArray[np.intp]:
        """Return the targets that do not pass in any of the next configurations."""
        some = [order[int(stations[t])][span[0] : span[1]] for t in targets]
        lengths = [len(one) for one in some]
        if not sum(lengths):
            return targets
        flat = np.concatenate(some)
        who = np.repeat(np.arange(len(targets)), lengths)
        station = stations[targets[who]]
        S, R, B, n = candidates.q.shape
        q = candidates.q.reshape(S, R * B, n)[station, flat]
        p = self._compute_probability(is_hole, targets[who], station, q)
        passing = np.zeros(len(targets), bool)
        passing[who[p >= least]] = True
        return targets[~passing]


def _is_unknown(setup: PlanningSetup, pricing: TolerancePricing, one: ProcessOperation) -> bool:
    if not one.tolerance.is_given:
        return False
    std = find_stated_std(setup.cell, setup.elasticity.stiffness, one.tolerance.reference)
    return bool(find_missing_input(pricing.process, one, pricing.spread, std))


def _find_stated_targets(pricing: TolerancePricing) -> NDArray[np.bool_]:
    """Return (T,) whether the file states the spread of the springs where the tool cuts: a hole at entry and bottom."""
    path, holes = pricing.path, pricing.holes

    def locate(index: Array) -> NDArray[np.bool_]:
        position = np.column_stack([np.interp(index, path.index, column) for column in path.position.T])
        nearest = np.clip(np.searchsorted(path.index, index - 1e-9), 0, len(path.index) - 1)
        return pricing.spread.find_stated(pricing.arm.places(path.external[nearest], position))

    of_holes = locate(holes.entry) & locate(holes.exit)
    return np.concatenate([of_holes, locate(pricing.surfaces.row.astype(float))])


def _order_candidates(
    candidates: CandidateGrid, scores: CandidateScores, stations: NDArray[np.intp]
) -> dict[int, NDArray[np.intp]]:
    """Return the usable configurations of each station as flat numbers, the lowest cost first."""
    out = {}
    for s in stations.tolist():
        usable = np.flatnonzero(candidates.usable[s])
        cost = np.nan_to_num(scores.cost[s].ravel()[usable], nan=np.inf)
        out[s] = usable[np.argsort(cost, kind="stable")]
    return out
