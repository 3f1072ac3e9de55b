"""Data types of a plan: the result of each step, and the parts of a job with tool changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.posture_feed_result import AdvisedFeedResult, PostureFeedResult
from machopt.data_types.reentry_result import ReentryResult
from machopt.numerics.array_types import Array
from machopt.planning.collision_handling.path_check import PathCollisions
from machopt.planning.cost.objective import PlanObjective
from machopt.planning.cost.stiffness_index import CandidateScores, LoadDirections
from machopt.planning.pipeline.collision_free_search import CollisionFreeSequence
from machopt.planning.pipeline.planning_setup import PlanningSetup, ScoredAssignment
from machopt.planning.pipeline.sequence_breaks import SequenceBreak
from machopt.planning.pipeline.tolerance_and_stability_prices import PlacePricing
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.stations.planning_path import PlanningPath

ROUND_OFF = 1e-12  # relative: of two sums of the same terms in another order


@dataclass(frozen=True)
class PathCompensation:
    """Shift of the planning points against the deflection."""

    offset: Array  # (P, 3) m in workpiece
    force: Array  # (P, 3) N in workpiece, F: the force whose deflection is compensated
    length: float  # m, ℓ
    fade: float  # m, λ
    lost: NDArray[np.bool_]  # (P,) feasible as programmed, not as shifted


@dataclass(frozen=True, kw_only=True)
class ExternalAxisBound:
    """Lower bound over all sequences that also choose the external joints
    (:mod:`machopt.planning.external_axis_optimization.external_axis_bound`); values of J.

    All of them at the stations of the bound, which may be fewer than those of the plan.
    """

    why: str = ""  # reason why there is none; the values are NaN then
    bound: float = np.nan  # no sequence over the grid of values, rotations and branches has less
    sequence: float = np.nan  # the best one found
    plan: float = np.nan  # of the plan as it was chosen
    values: int = 0  # number of external joint values in the grid, without the plan's own
    stations: int = 0
    step: float = np.nan  # rad, of rotation
    apart: tuple[tuple[str, float], ...] = ()  # external joint and m or rad, largest distance of neighbouring values

    @property
    def gap(self) -> float | None:
        """Maximum share of the plan's J that a sequence over the grid could save.

        None where the plan is below all of them: it lies between the values of the grid, and nothing is proven about
        other plans there.
        """
        if not self.plan > 0 or not self.bound <= self.plan * (1.0 + ROUND_OFF):
            return None
        return max(1.0 - self.bound / self.plan, 0.0)


@dataclass(frozen=True, kw_only=True)
class TiltBound:
    """Lower bounds over a grid of tilts, rotations and branches, point by point, without motion and contacts.

    No sequence over the grid has a lower mean or a lower worst index at its stations.
    """

    mean: float  # in units of c₀, over the length cut
    worst: float  # in units of c₀
    stations: int
    tilts: int
    step: float  # rad, of the rotation


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Plan of a path with the results of all steps."""

    setup: PlanningSetup
    options: PlanOptions
    path: PlanningPath
    directions: LoadDirections
    candidates: CandidateGrid
    scores: CandidateScores
    choice: SequenceChoice
    chosen: ScoredAssignment
    chosen_from: str  # "smooth", "jiao2022" or "cam default": the assignment with the least objective
    grid: PlanObjective  # of the grid optimum at the stations, for comparison
    cam_default: ScoredAssignment
    jiao2022: ScoredAssignment
    check: PathCollisions | None
    rounds: int
    rounding: Mapping[int, float] = field(default_factory=dict)  # run → share of the corner tolerances, where below 1
    breaks: tuple[SequenceBreak, ...] = ()  # breaks inside a run
    pricing: PlacePricing | None = None  # of tolerances and stability, where the objective counts them
    found: CollisionFreeSequence | None = None  # the search, where that was the method
    notes: dict[int, str] = field(default_factory=dict)  # planning point: reason why it was given up after the choice
    ways: dict[int, SequenceBreak] = field(
        default_factory=dict
    )  # planning point: feasible, but the way that ends there is not
    compensation: PathCompensation | None = None  # then ``path`` is the shifted one
    conflict: str = ""  # conflicting user constraints, where without them there is a plan
    begin: Array | None = None  # (6 + E,) rad or m by encoder, where the motion begins; None: at home
    end: Array | None = None  # likewise, where it ends
    parts: tuple[ToolPlanPart, ...] = ()  # one per tool of a job with tool changes; empty: one tool
    elsewhere: tuple[int, ...] = ()  # toolpath points with another rotation than chosen, because of the shift
    over_external: ExternalAxisBound | None = None  # None: no external joint was free, or not requested
    tilt_bound: TiltBound | None = None  # None: the tool axis is that of the CAM file everywhere
    posture_feed: PostureFeedResult | None = None  # with method joint
    advised_feed: AdvisedFeedResult | None = None  # with advised_feed_share
    reentry: ReentryResult | None = None  # where re-entries were permitted
    bound: float | None = None  # lower bound of J of such a job over the grids of its parts; None: not known

    def at(self, point: int) -> tuple[Plan, int]:
        """Return the plan of the tool that has a planning point, and the number of the point in that plan.

        Args:
            point: planning point of the whole job.
        """
        part = next((part for part in reversed(self.parts) if part.row <= point), None)
        return (self, point) if part is None else (part.plan, point - part.row)

    def among(self, points: NDArray[np.intp] | NDArray[np.int32]) -> Iterator[tuple[Plan, NDArray[np.intp]]]:
        """Yield each tool's plan that contains some of the planning points, and the positions of these in the argument.

        Args:
            points: (n,) planning points of the whole job.
        """
        if not self.parts:
            yield self, np.arange(len(points))
        part = self.part_of(points)
        for k, one in enumerate(self.parts):
            mine = np.flatnonzero(part == k)
            if len(mine):
                yield one.plan, mine

    def part_of(self, points: NDArray[np.intp] | NDArray[np.int32]) -> NDArray[np.intp]:
        """Return the (n,) index of the part that each planning point belongs to.

        Args:
            points: (n,) planning points of the whole job.
        """
        return np.searchsorted([one.row for one in self.parts], points, side="right") - 1

    def without_grid_joints(self) -> Plan:
        """Return the plan without the joints and prices of its candidate grids, which only the search needs."""
        parts = tuple(replace(part, plan=part.plan.without_grid_joints()) for part in self.parts)
        candidates, scores = self.candidates.without_joints(), self.scores.without_search_prices()
        return replace(self, candidates=candidates, scores=scores, parts=parts)

    @property
    def missing(self) -> NDArray[np.intp]:
        """Planning points without a feasible configuration."""
        return np.flatnonzero(self.chosen.assignment.reason != InfeasibilityReason.OK)


@dataclass(frozen=True)
class ToolPlanPart:
    """A stretch of a job with one tool on, planned by itself (:mod:`machopt.planning.job.joined_plan`)."""

    plan: Plan  # its toolpath indices are those of the whole job
    row: int  # its first planning point in the whole
    share: float  # of the length cut
