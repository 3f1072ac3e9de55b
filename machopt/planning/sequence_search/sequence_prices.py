"""Prices of vertices and permitted steps of the sequences over a grid of candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.rapid_time import RapidPricing
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.transition_cost_table import TransitionCostTable
from machopt.planning.sequence_search.transition_windows import (
    compute_transition_windows,
    match_tcp_directions,
    vertex_price,
)
from machopt.planning.sequence_search.worst_index_across_swings import find_hidden_points
from machopt.planning.stations.planning_path import PlanningPath

Ints = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class SequencePrices:
    """Prices and permitted steps of sequences over one grid; a step is numbered by the station it leads into.

    ``candidates`` may lose vertices while it is in use: every choice uses what is feasible at that time.
    """

    candidates: CandidateGrid
    counted: NDArray[np.bool_]  # (S,) the worst index counts there
    window: Ints  # (S,) grid steps that the rotation may change, FREE or LIFT
    seconds: Array  # (S,) s
    shift: Ints  # (S,) :func:`match_tcp_directions`
    node: Array  # (S, R, B) price of a vertex
    raw: Array  # (S, R, B) index, in units of the scale, inf where there is none
    slowness: Array  # (6,) s/rad
    price_q: Array  # (S,) 1/rad
    price_r: Array  # (S,) 1/rad
    price_t: Array  # (S,) 1/s
    nudged: Array  # (S,) rad, shift of its grid relative to that of the previous station
    hidden: Bools  # (S,) further planning points lie between it and the previous station
    worst: float  # price of the worst index
    priced: TransitionCostTable  # prices of steps computed so far
    elsewhere: float = 0.0  # worst index outside this grid, in units of the scale
    rapid: RapidPricing | None = None  # prices of rapid moves beyond their travel; None: there are none

    @classmethod
    def build(
        cls,
        path: PlanningPath,
        candidates: CandidateGrid,
        scores: CandidateScores,
        velocity: Array,
        options: PlanOptions,
        wide: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Build the grid of a path.

        Args:
            path: planning points.
            candidates: candidate grid.
            scores: cost of the candidates.
            velocity: (6,) rad/s, joint velocity limits.
            options: plan options with the weights.
            wide: as for :func:`choose_sequence`.
        """
        window, seconds = compute_transition_windows(path, candidates, float(velocity.min()), wide)
        terms, w = ObjectiveTerms.at_stations(path, velocity, options), options.weights
        nudge = np.zeros(len(path.stations)) if candidates.nudge is None else candidates.nudge
        rotations, branches = candidates.feasible.shape[1:3]
        return cls(
            candidates=candidates,
            counted=path.counted[path.stations],
            window=window,
            seconds=seconds,
            shift=match_tcp_directions(path, len(candidates.phi)),
            node=vertex_price(terms, candidates, scores),
            raw=scores.raw,
            slowness=terms.slowness,
            price_q=w.travel * terms.travel,
            price_r=w.rotation * terms.rotation,
            price_t=w.feed * terms.lost,
            nudged=np.diff(nudge, prepend=nudge[:1]),
            hidden=find_hidden_points(path),
            worst=options.weights.worst,
            priced=TransitionCostTable.none_yet(window, rotations, branches, candidates.stable),
            rapid=scores.rapid,
            elsewhere=scores.elsewhere,
        )
