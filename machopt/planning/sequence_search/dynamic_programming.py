"""Cheapest sequence over rotation × branch × turn for the whole path at once.

Dynamic programming over the stations. Inside a run a vertex is joined to the vertices of the previous station
whose rotation differs by at most a window, in the same branch, with the turn that continuity gives. Over a
rapid move any vertex may follow any other, at the price of the joint travel. The worst index is traded exactly, by
branch and bound over a cap on it (:mod:`machopt.planning.sequence_search.worst_value_constraint`). The lower bound of
all sequences is returned too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, compute_any_last, make_arrays_read_only
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.sequence_prices import Ints, SequencePrices
from machopt.planning.sequence_search.sequence_stretch import NO_LIMIT, SequenceStretch
from machopt.planning.sequence_search.transition_windows import LIFT
from machopt.planning.sequence_search.worst_index_across_swings import compute_worst_index
from machopt.planning.sequence_search.worst_value_constraint import GAP, WorstLimitedSequence
from machopt.planning.stations.planning_path import PlanningPath


@dataclass(frozen=True, kw_only=True)
class SequenceChoice:
    """One vertex per station."""

    rotation: Ints  # (S,) index into candidates.phi, −1 where the station has no feasible vertex
    branch: Ints  # (S,)
    turn: Ints  # (S,)
    q: Array  # (S, 6) rad, NaN where dropped
    broken: tuple[int, ...]  # stations without a continuous edge from the previous station
    total: float = np.nan  # price of the sequence on the grid
    bound: float = np.nan  # lower bound of all sequences over the grid
    reached: NDArray[np.bool_] | None = None  # (S, R·B·T) continuously reachable vertices; None: no break

    def __post_init__(self) -> None:
        make_arrays_read_only(self)

    @property
    def dropped(self) -> NDArray[np.bool_]:
        """(S,) stations without a vertex."""
        return self.rotation < 0


def choose_sequence(
    path: PlanningPath,
    candidates: CandidateGrid,
    scores: CandidateScores,
    velocity: Array,
    options: PlanOptions,
    edges: ForbiddenTransitions | None = None,
    wide: NDArray[np.bool_] | None = None,
) -> SequenceChoice:
    """Return the cheapest sequence of the whole path.

    Stations without a feasible vertex are dropped. Where no continuous edge exists, the sequence starts
    again (``broken``). Whether either is acceptable is the caller's decision. A sequence continues as far as any does,
    so the number of breaks is minimal.

    Args:
        path: planning points.
        candidates: candidate grid.
        scores: cost of the candidates.
        velocity: (6,) rad/s, joint velocity limits.
        options: plan options with the weights.
        edges: forbidden edges; default none.
        wide: (S,) stations into which the rotation may change faster than the feed permits; default none.
    """
    return SequenceGrid.build(path, candidates, scores, velocity, options, wide).choose(edges)


@dataclass(frozen=True, kw_only=True)
class SequenceGrid(SequencePrices):
    """Prices and permitted steps of sequences over one grid; a step is numbered by the station it leads into.

    ``candidates`` may lose vertices while it is in use: every choice uses what is feasible at that time.
    """

    def choose(self, edges: ForbiddenTransitions | None = None) -> SequenceChoice:
        """Return the best sequence of the whole path.

        Args:
            edges: forbidden edges; default none.
        """
        part = SequenceStretch(
            self, ForbiddenTransitions.none() if edges is None else edges, slice(0, len(self.window))
        )
        free, broken, reached = part.free(self.candidates.feasible)
        part.window[broken] = LIFT  # a cap must not add a break
        traded = part.traded(self.candidates.feasible, free)
        return self._build_choice(
            part.near_zero(traded.best.vertex),
            tuple(np.flatnonzero(broken).tolist()),
            traded.total,
            traded.bound,
            reached,
        )

    def capped(
        self, edges: ForbiddenTransitions
    ) -> tuple[WorstLimitedSequence, float, Callable[[float, float], WorstLimitedSequence | None]] | None:
        """Return the cheapest sequence and the search under caps: :meth:`SequenceStretch.capped`.

        None if the path has breaks or gaps.

        Args:
            edges: forbidden edges.
        """
        part = SequenceStretch(self, edges, slice(0, len(self.window)))
        free, broken, _ = part.free(self.candidates.feasible)
        if broken.any() or (free.vertex[:, 0] < 0).any():
            return None
        return (free, *part.capped(self.candidates.feasible, free))

    def again(
        self, choice: SequenceChoice, first: int, last: int, edges: ForbiddenTransitions, gap: float = GAP
    ) -> SequenceChoice | None:
        """Return the choice with the stations between ``first`` and ``last`` chosen again, the best that keeps the
        others.

        Args:
            choice: without breaks; the vertices that it keeps are feasible.
            first: station that keeps its vertex, −1 for none before the stretch.
            last: the same behind it; S for none.
            edges: forbidden edges.
            gap: share of the objective by which a better one may be missed.

        Returns:
            None where no continuous sequence keeps the others. ``bound`` is unchanged: removing vertices or edges
            from a grid makes no sequence cheaper.
        """
        S = len(self.window)
        rows = slice(max(first, 0), min(last, S - 1) + 1)
        part = SequenceStretch(self, edges, rows)
        old = np.stack([choice.rotation, choice.branch, choice.turn], axis=1)
        mask = self.candidates.feasible[rows]
        if first >= 0 or last < S:  # otherwise there are no other stations
            only = np.zeros_like(mask)
            has_vertex = np.flatnonzero(old[rows, 0] >= 0)
            r, b, t = old[rows][has_vertex].T
            only[has_vertex, r, b, t] = True
            _, before, stop, broken, _ = part.solve(only, NO_LIMIT, ForbiddenTransitions.none())
            mask = mask.copy()
            for end in ([0] if first >= 0 else []) + ([-1] if last < S else []):
                mask[end] = only[end]
            if stop >= 0 or broken.any():
                return None
            part.value_elsewhere = choice.total - self.worst * self._compute_worst(choice) - before
        some = compute_any_last(mask)
        found = part.below(mask, some, some, NO_LIMIT)
        if found is None or ((found[0][:, 0] >= 0) != (old[rows, 0] >= 0)).any():
            return None
        vertex, value = found
        elsewhere = np.ones(S, bool)
        elsewhere[rows] = False
        others = np.where(elsewhere, choice.rotation, -1).astype(np.int32)
        worst_elsewhere = compute_worst_index(self.raw, self.counted, self.hidden, others, choice.branch)
        part.worst_elsewhere = max(worst_elsewhere, self.elsewhere)
        traded = part.traded(mask, WorstLimitedSequence(vertex, value + part.value_elsewhere, part.most(vertex)), gap)
        old[rows] = traded.best.vertex
        return self._build_choice(old, (), traded.total, choice.bound, choice.reached)

    def _compute_worst(self, choice: SequenceChoice) -> float:
        here = compute_worst_index(self.raw, self.counted, self.hidden, choice.rotation, choice.branch)
        return max(here, self.elsewhere)

    def _build_choice(
        self, vertex: Ints, broken: tuple[int, ...], total: float, bound: float, reached: NDArray[np.bool_] | None
    ) -> SequenceChoice:
        r, b, t = vertex.T
        q = self.candidates.q[np.arange(len(r)), r, b] + self.candidates.turns[t]
        q[r < 0] = np.nan
        return SequenceChoice(
            rotation=r, branch=b, turn=t, q=q, broken=broken, total=total, bound=bound, reached=reached
        )
