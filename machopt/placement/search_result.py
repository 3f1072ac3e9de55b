"""What a search for a place has found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machopt.placement.moved_cell import MovedBodies
from machopt.placement.search_options import PlacementShift

TIE_TOLERANCE = 1e-9  # relative; a bound nearer than this to the best plan cannot be told from it


@dataclass(frozen=True, kw_only=True)
class PlacementCandidate:
    """One place; indices in m or m/N, of the worst of all jobs."""

    number: int
    shift: PlacementShift
    refused: str = ""  # why nothing can stand or be reached there; empty where it can
    bound: float = np.inf  # no plan there has a worst index below
    worst: float = np.inf  # of the grid's best sequences, collisions not looked at
    mean: float = np.inf
    job: int = 0  # that the bound is of
    point: int = 0  # its toolpath point

    @property
    def is_feasible(self) -> bool:
        return not self.refused


@dataclass(frozen=True, kw_only=True)
class PlannedPlacement:
    """A whole plan of every job at a place: collisions, continuity, motion."""

    place: PlacementCandidate
    refused: str = ""  # why no motion came of it
    worst: float = np.inf
    mean: float = np.inf  # over the jobs, each by its own weighting
    job: int = 0  # with the worst index
    point: float = np.nan  # fractional index along its toolpath
    shares: tuple[float, ...] = ()  # (6,) of the index there that would go if joint 1…6 were rigid
    cycle_time: float = np.nan  # s, of all jobs together
    seconds: float = 0.0  # that planning took; not in any file that must be the same again


@dataclass(frozen=True)
class NearbyPlacement:
    """What a small move makes of a place, collisions not looked at."""

    shift: PlacementShift  # from where the cell has it
    moved: str  # "x +20 mm"
    refused: str
    worst: float


@dataclass(frozen=True, kw_only=True)
class PlacementSearchResult:
    """Everything that was found."""

    carried: MovedBodies
    places: tuple[PlacementCandidate, ...]  # in the order of the grid; the cell's own first
    planned: tuple[PlannedPlacement, ...]  # in the order in which they were planned; the cell's own first
    around: Mapping[int, tuple[NearbyPlacement, ...]]  # of the best, by number
    open_bound: float  # least bound among the places that were not planned; inf where none is left
    stopped: str  # why some were left, empty where nothing left can be better

    @property
    def best(self) -> tuple[PlannedPlacement, ...]:
        """Those with a motion, the best first; of two alike the one nearer to where the cell has it."""
        done = [p for p in self.planned if not p.refused]
        return tuple(sorted(done, key=lambda p: (p.worst, p.mean, p.place.number)))

    @property
    def is_optimal(self) -> bool:
        """No place of the grid that was not planned can be better than the best plan."""
        best = self.best
        return bool(best) and self.open_bound >= best[0].worst * (1 - TIE_TOLERANCE)
