"""Result types of a placement search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.placement.moved_cell import MovedBodies
from machopt.placement.search_options import PlacementShift

TIE_TOLERANCE = 1e-9  # relative; a bound nearer than this to the best plan counts as equal


@dataclass(frozen=True, kw_only=True)
class PlacementCandidate:
    """One assessed place; indices in m or m/N, of the worst of all jobs."""

    number: int
    shift: PlacementShift
    refused: str = ""  # why the place is impossible; empty where it is possible
    bound: float = np.inf  # no plan there has a worst index below
    worst: float = np.inf  # worst index of the grid's best sequences, without collision checks
    mean: float = np.inf
    job: int = 0  # job of the bound
    point: int = 0  # its toolpath point

    @property
    def is_feasible(self) -> bool:
        return not self.refused


@dataclass(frozen=True, kw_only=True)
class PlannedPlacement:
    """A whole plan of every job at a place: collisions, continuity, motion."""

    place: PlacementCandidate
    refused: str = ""  # why there is no motion
    worst: float = np.inf
    mean: float = np.inf  # over the jobs, each by its own weighting
    job: int = 0  # with the worst index
    point: float = np.nan  # fractional index along its toolpath
    shares: tuple[float, ...] = ()  # (6,) share of the index there that would vanish if joint 1…6 were rigid
    cycle_time: float = np.nan  # s, of all jobs together
    seconds: float = 0.0  # duration of planning; not written to reproducible files


@dataclass(frozen=True)
class NearbyPlacement:
    """Effect of a small shift of a place, without collision checks."""

    shift: PlacementShift  # from the present place
    moved: str  # "x +20 mm"
    refused: str
    worst: float


@dataclass(frozen=True, kw_only=True)
class PlacementSearchResult:
    """Result of a search."""

    carried: MovedBodies
    places: tuple[PlacementCandidate, ...]  # in the order of the grid; the cell's own first
    planned: tuple[PlannedPlacement, ...]  # in the order in which they were planned; the cell's own first
    around: Mapping[int, tuple[NearbyPlacement, ...]]  # of the best, by number
    open_bound: float  # least bound among the places that were not planned; inf where none is left
    stopped: str  # why some were not planned, empty where none of them can be better

    @property
    def best(self) -> tuple[PlannedPlacement, ...]:
        """Places with a motion, the best first; of equal ones the nearer to the present place."""
        done = [p for p in self.planned if not p.refused]
        return tuple(sorted(done, key=lambda p: (p.worst, p.mean, p.place.number)))

    @property
    def is_optimal(self) -> bool:
        """Whether no unplanned place of the grid can be better than the best plan."""
        best = self.best
        return bool(best) and self.open_bound >= best[0].worst * (1 - TIE_TOLERANCE)
