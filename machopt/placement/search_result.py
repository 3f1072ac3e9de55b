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
    least_missed: int = 0  # holes and points of all jobs that no configuration has in tolerance
    outcomes: tuple[int, ...] = ()  # pass, marginal, fail, unknown of those sequences; empty: not estimated

    @property
    def is_feasible(self) -> bool:
        return not self.refused

    @property
    def outlook(self) -> tuple[float, float]:
        """Holes and points that are not in tolerance and the worst index, of the grid's best sequences."""
        missed = float(max(sum(self.outcomes[1:]), self.least_missed))
        return (missed if np.isfinite(self.worst) else np.inf, max(self.worst, self.bound))

    @property
    def limit(self) -> tuple[float, float]:
        """Bounds of both: no plan there has less."""
        return (float(self.least_missed), self.bound)


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
    outcomes: tuple[int, ...] = ()  # pass, marginal, fail, unknown of all jobs; empty: nothing has a tolerance
    tolerance_job: int = 0  # job of the hole or point with the lowest probability
    tolerance_point: int = -1  # its toolpath point; −1: there is none
    tolerance_error: float = np.nan  # its error, m; NaN where an angle decides
    tolerance_p_in: float = np.nan  # its probability to be in tolerance
    seconds: float = 0.0  # duration of planning; not written to reproducible files

    @property
    def missed(self) -> int:
        """Holes and points that are not in tolerance."""
        return sum(self.outcomes[1:])

    @property
    def rank(self) -> tuple[float, float]:
        """What places are compared by: holes and points not in tolerance, then the worst index; less is better."""
        return (float(self.missed), self.worst)


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
    open_limit: tuple[float, float]  # least limit among the places that were not planned; inf where none is left
    stopped: str  # why some were not planned, empty where none of them can be better

    @property
    def best(self) -> tuple[PlannedPlacement, ...]:
        """Places with a motion, the best first; of equal ones the nearer to the present place."""
        done = [p for p in self.planned if not p.refused]
        return tuple(sorted(done, key=lambda p: (*p.rank, p.mean, p.place.number)))

    @property
    def open_bound(self) -> float:
        """Least bound of the index among the places that were not planned and may be best; inf where none is left."""
        return self.open_limit[1]

    @property
    def is_optimal(self) -> bool:
        """Whether no unplanned place of the grid can be better than the best plan.

        The limit of holes and points out of tolerance holds at the programmed feed. A motion that is slower there may
        have fewer, so with some out of tolerance nothing is proven.
        """
        best = self.best
        return bool(best) and best[0].missed == 0 and not can_beat(self.open_limit, best[0].rank)


def can_beat(limit: tuple[float, float], rank: tuple[float, float]) -> bool:
    """Return whether a plan within a limit may be better than one of a rank.

    Args:
        limit: bounds of the holes and points that are not in tolerance, and of the worst index.
        rank: the same of a plan.
    """
    return limit[0] < rank[0] or (limit[0] == rank[0] and limit[1] < rank[1] * (1 - TIE_TOLERANCE))
