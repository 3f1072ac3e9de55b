"""Incremental choice of a sequence while its grid loses vertices and edges: the whole path, or the changed
stretches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.stiffness_index import CandidateScores
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, SequenceGrid
from machopt.planning.sequence_search.forbidden_transitions import ForbiddenTransitions
from machopt.planning.sequence_search.transition_windows import FREE
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.stations.planning_path import PlanningPath

Rows = NDArray[np.intp]
DETOUR = np.radians(90.0)  # of rotation: room for a detour to either side of a contact
SPARE = 8  # additional stations to either side
MANY = 0.1  # share of lost stations from which an approximate choice is sufficient
ROUGH = 0.05  # share of the objective that such a choice may miss


@dataclass(kw_only=True)
class IncrementalSequenceSearch:
    """Repeated choice on one grid; ``candidates`` may lose vertices in between."""

    path: PlanningPath
    candidates: CandidateGrid
    scores: CandidateScores
    velocity: Array  # (6,) rad/s
    options: PlanOptions
    wide: NDArray[np.bool_]  # (S,) the rotation may change there at reduced feed; extended where no other edge exists

    def __post_init__(self) -> None:
        self._grid: SequenceGrid | None = None
        self._dropped = -1  # number of stations without a vertex at its construction

    def around(self, choice: SequenceChoice, edges: ForbiddenTransitions) -> SequenceChoice | None:
        """Choose the stretches again that have lost a vertex or an edge; return None where that is not sufficient.

        Args:
            choice: previous sequence.
            edges: forbidden edges.
        """
        if choice.dropped.any() or choice.broken:
            return None
        lost = self._find_lost_stations(choice, edges)
        gap = ROUGH if len(lost) > MANY * len(self.wide) else GAP
        for first, last in self._list_stretches(lost):
            again = self._get_grid().again(choice, first, last, edges, gap)
            if again is None:
                return None
            choice = again
        return choice

    def _find_lost_stations(self, choice: SequenceChoice, e: ForbiddenTransitions) -> Rows:
        """Return the stations whose vertex, or the edge into it, has been excluded."""
        _, _, B, T = self.candidates.feasible.shape
        vertex = (choice.rotation.astype(int) * B + choice.branch) * T + choice.turn
        s = np.arange(len(vertex))
        is_lost = ~self.candidates.feasible[s, choice.rotation, choice.branch, choice.turn]
        return np.flatnonzero(is_lost | e.into(vertex, T))

    def _list_stretches(self, lost: Rows) -> list[tuple[int, int]]:
        """Return (first, last) stations that keep their vertices around changed ones, with room for a detour
        between.
        """
        S, R = self.candidates.feasible.shape[:2]
        window = self._get_grid().window
        steps = np.where(window == FREE, R // 4, np.maximum(window, 0))
        turned = np.cumsum(steps)
        room = int(DETOUR / (2 * np.pi / R)) + 1
        out: list[tuple[int, int]] = []
        for s in lost.tolist():
            first = min(int(np.searchsorted(turned, turned[s] - room)), s - SPARE) - 1
            last = max(int(np.searchsorted(turned, turned[s] + room, "right")), s + SPARE)
            if out and first <= out[-1][1]:
                out[-1] = (out[-1][0], max(last, out[-1][1]))
            else:
                out.append((first, last))
        return [(max(a, -1), min(b, S)) for a, b in out]

    def whole(self, edges: ForbiddenTransitions) -> SequenceChoice:
        """Return the best sequence of the whole path on the remaining grid.

        Args:
            edges: forbidden edges.
        """
        choice = self._get_grid().choose(edges)
        runs = self.path.run[self.path.stations]
        stuck = np.isin(runs, runs[list(choice.broken)]) & ~self.wide
        if stuck.any():  # a reduced feed is better than no plan
            self.wide |= stuck
            self._grid = None
            choice = self._get_grid().choose(edges)
        return choice

    def _get_grid(self) -> SequenceGrid:
        dropped = int((~self.candidates.feasible.reshape(len(self.wide), -1).any(axis=1)).sum())
        if self._grid is None or self._dropped != dropped:
            self._dropped = dropped
            self._grid = SequenceGrid.build(
                self.path,
                self.candidates,
                self.scores,
                self.velocity,
                self.options,
                self.wide if self.wide.any() else None,
            )
        return self._grid
