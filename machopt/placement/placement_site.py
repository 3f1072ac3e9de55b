"""Cell and jobs of a placement search: estimate, evaluation and complete plan of one place."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.placement.moved_cell import (
    MovedBodies,
    compute_link_frames,
    compute_rotation_centre,
    select_moved_obstacles,
)
from machopt.placement.placed_outcomes import add_outcomes, summarise_outcomes
from machopt.placement.placement_estimate import PlacementEstimate
from machopt.placement.search_options import PlacementOptions, PlacementShift
from machopt.placement.search_result import PlacementCandidate, PlannedPlacement
from machopt.placement.segment_task import SegmentTask, build_single_segment, plan_at_placement
from machopt.placement.softest_point import find_softest_point
from machopt.placement.support_check import SupportModel


@dataclass(frozen=True)
class CandidateQuery:
    """A place to assess, with the reason why it is impossible, empty where it is possible."""

    number: int
    shift: PlacementShift
    refusal_reason: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacementSite:
    """A cell and its jobs, prepared for assessment in any process."""

    cell: Cell
    toolpaths: tuple[Toolpath, ...]
    options: PlanOptions
    jobs: tuple[tuple[SegmentTask, ...], ...]  # one per toolpath, each with one task per tool
    moved_bodies: MovedBodies
    supports: SupportModel

    @classmethod
    def build(
        cls,
        cell: Cell,
        toolpaths: tuple[Toolpath, ...],
        options: PlanOptions,
        search: PlacementOptions,
        segments: Sequence[Sequence[ToolSegment]] | None = None,
    ) -> PlacementSite:
        """Prepare a cell and its jobs.

        Args:
            cell: robot cell.
            toolpaths: jobs.
            options: plan options.
            search: search options.
            segments: of each toolpath, divided at tool changes; None: no tool changes.
        """
        standing = SupportModel.build(cell)
        names = select_moved_obstacles(
            cell, search, standing.find_moved_obstacles(base=search.base) if search.carry is None else frozenset()
        )
        positions = np.concatenate([t.position for t in toolpaths])
        frames = compute_link_frames(cell)
        carried = MovedBodies(
            search.base, names, compute_rotation_centre(cell, positions, base=search.base, frames=frames), frames
        )
        cut = [build_single_segment(cell, t) for t in toolpaths] if segments is None else segments
        jobs = tuple(tuple(SegmentTask.build(segment, options) for segment in job) for job in cut)
        return cls(cell=cell, toolpaths=toolpaths, options=options, jobs=jobs, moved_bodies=carried, supports=standing)

    @property
    def has_free_external_joints(self) -> bool:
        """Whether external joints are free: bounds are then over a grid of their values."""
        return any(task.has_free_external_joints for job in self.jobs for task in job)

    def estimate_jobs(self, shift: PlacementShift) -> tuple[PlacementEstimate, ...]:
        """Return one estimate per job; none after the first that is not reached.

        Args:
            shift: shift of the place.
        """
        out: list[PlacementEstimate] = []
        for job in self.jobs:
            found: list[PlacementEstimate] = []
            for task in job:
                found.append(task.estimate(self.moved_bodies, shift, self.options))
                if not found[-1].is_reachable:
                    return (*out, found[-1])
            out.append(_combine_tools(found, [task.cut_length for task in job]))
        return tuple(out)

    def evaluate_candidate(self, candidate: CandidateQuery) -> PlacementCandidate:
        """Assess a place.

        Args:
            candidate: place to assess.
        """
        number, shift = candidate.number, candidate.shift
        if candidate.refusal_reason:
            return PlacementCandidate(number=number, shift=shift, refused=candidate.refusal_reason)
        found = self.estimate_jobs(shift)
        last = found[-1]
        if not last.is_reachable:
            name = self.toolpaths[len(found) - 1].source
            return PlacementCandidate(
                number=number,
                shift=shift,
                refused=f"point {last.point} of {name}: {_REASON_TEXTS[last.reason]}",
                point=last.point,
            )
        job = int(np.argmax([o.bound for o in found]))
        return PlacementCandidate(
            number=number,
            shift=shift,
            bound=found[job].bound,
            worst=max(o.worst for o in found),
            mean=float(np.mean([o.mean for o in found])),
            job=job,
            point=found[job].point,
            least_missed=sum(o.missed for o in found),
            outcomes=add_outcomes([o.outcomes for o in found]),
        )

    def plan_candidate(self, place: PlacementCandidate) -> PlannedPlacement:
        """Plan every job at a place, including its motion.

        Args:
            place: assessed place.
        """
        start_time = time.perf_counter()
        worst, mean, cycle, softest, tolerances = [], [], 0.0, [], []
        for toolpath, job in zip(self.toolpaths, self.jobs, strict=True):
            segments = [task.segment for task in job]
            made = plan_at_placement(segments, self.moved_bodies, place.shift, self.options)
            if made.obstruction:
                return PlannedPlacement(
                    place=place,
                    refused=f"no motion for {toolpath.source}: {made.obstruction}",
                    seconds=time.perf_counter() - start_time,
                )
            one = made.plan
            worst.append(one.chosen.objective.worst * one.scores.scale)
            mean.append(one.chosen.objective.mean * one.scores.scale)
            cycle += made.seconds
            softest.append(find_softest_point(one))
            tolerances.append(made.tolerances)
        hardest = int(np.argmax(worst))
        return PlannedPlacement(
            place=place,
            worst=worst[hardest],
            mean=float(np.mean(mean)),
            job=hardest,
            point=softest[hardest][0],
            shares=softest[hardest][1],
            cycle_time=cycle,
            **summarise_outcomes(tolerances),
            seconds=time.perf_counter() - start_time,
        )


def _combine_tools(found: Sequence[PlacementEstimate], length: Sequence[float]) -> PlacementEstimate:
    """Return one job of several tools: the worst of all, the mean weighted by the cut length."""
    if len(found) == 1:
        return found[0]
    worst = max(found, key=lambda one: one.bound)
    share = np.array(length) if sum(length) > 0 else np.ones(len(found))
    mean = float(share @ [one.mean for one in found] / share.sum())
    return PlacementEstimate(
        worst.bound,
        max(one.worst for one in found),
        mean,
        worst.point,
        missed=sum(one.missed for one in found),
        outcomes=add_outcomes([one.outcomes for one in found]),
    )


_REASON_TEXTS = {
    InfeasibilityReason.UNREACHABLE: "out of reach",
    InfeasibilityReason.LIMIT: "beyond a joint limit",
    InfeasibilityReason.SINGULAR_WRIST: "too near the wrist singularity",
    InfeasibilityReason.SINGULAR_ELBOW: "too near the elbow singularity",
    InfeasibilityReason.SINGULAR_SHOULDER: "too near the shoulder singularity",
    InfeasibilityReason.UNSTABLE: "below min_stability_ratio",
    InfeasibilityReason.BOUNDS: "outside the rotations that are allowed",
}
