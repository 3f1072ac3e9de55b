"""Best-first search: every place is assessed, and the best are planned fully, until no remaining place can be better.

Results are written to a journal at once, so that a stopped run continues where it ended.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from machopt.data_types.cell import Cell
from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.tool_segments import ToolSegment
from machopt.data_types.toolpath import Toolpath
from machopt.placement.journal import SearchJournal
from machopt.placement.moved_cell import (
    MovedBodies,
    compute_link_frames,
    compute_rotation_centre,
    select_moved_obstacles,
)
from machopt.placement.placed_outcomes import add_outcomes, summarise_outcomes
from machopt.placement.placement_estimate import PlacementEstimate
from machopt.placement.search_options import (
    NO_SHIFT,
    PlacementOptions,
    PlacementShift,
    build_shift_grid,
    clip_shift,
    compute_grid_steps,
)
from machopt.placement.search_result import (
    NearbyPlacement,
    PlacementCandidate,
    PlacementSearchResult,
    PlannedPlacement,
    can_beat,
)
from machopt.placement.segment_task import SegmentTask, build_single_segment, plan_at_placement
from machopt.placement.softest_point import find_softest_point
from machopt.placement.support_check import SupportModel
from machopt.placement.task_executor import InProcessExecutor, PlacementExecutor

NEIGHBOUR_DISTANCE_M = 0.020  # m: shift of the best places for the sensitivity

Progress = Callable[[str], None]


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

    def evaluate_candidate(self, asked: CandidateQuery) -> PlacementCandidate:
        """Assess a place.

        Args:
            asked: place to assess.
        """
        number, shift = asked.number, asked.shift
        if asked.refusal_reason:
            return PlacementCandidate(number=number, shift=shift, refused=asked.refusal_reason)
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


def find_best_placement(
    site: PlacementSite,
    search: PlacementOptions,
    journal: SearchJournal,
    progress: Progress = lambda _: None,
    executor: PlacementExecutor | None = None,
) -> PlacementSearchResult:
    """Assess every place and plan the best ones.

    Args:
        site: cell and jobs.
        search: ranges and limits.
        journal: with the results of an earlier run.
        progress: called with progress messages.
        executor: executor; None: this process. The result is the same, except for the time limit ``search.seconds``.
    """
    start_time = time.monotonic()
    work = InProcessExecutor(site) if executor is None else executor
    places = _evaluate_grid(site, search, journal, progress, start_time, work)
    plans = _PlannedPlaces(work, journal)
    progress(f"plan 1: {NO_SHIFT.text}")
    here = next(p for p in places if p.number == 0)
    if here.is_feasible:
        plans.plan(here)
    queue = sorted((p for p in places if p.is_feasible and p.number), key=lambda p: (*p.outlook, *p.limit, p.number))
    stopped = _plan_queue(queue, plans, search, progress, start_time)
    result = PlacementSearchResult(
        carried=site.moved_bodies,
        places=tuple(places),
        planned=tuple(plans.planned.values()),
        around={},
        open_limit=min((p.limit for p in queue if p.number not in plans.planned), default=(np.inf, np.inf)),
        stopped=stopped,
    )
    if result.best and time.monotonic() - start_time < search.seconds:
        progress("between the places of the grid")
        finer = _refine_best(site, result.best[0].place, search, len(places), work)
        if finer is not None:
            plans.plan(finer)
            result = replace(result, places=(*places, finer), planned=tuple(plans.planned.values()))
    progress("around the best")
    return replace(
        result, around=_evaluate_neighbours(site, [p.place for p in result.best[: search.best]], search, work)
    )


@dataclass
class _PlannedPlaces:
    """Complete plans by number of the place; some are made ahead of their turn, by workers that are idle."""

    work: PlacementExecutor
    journal: SearchJournal
    planned: dict[int, PlannedPlacement] = field(default_factory=dict)
    _ahead: dict[int, PlannedPlacement] = field(default_factory=dict)

    def plan(self, place: PlacementCandidate, then: Iterable[PlacementCandidate] = ()) -> None:
        """Plan a place, and with the other workers the next ones."""
        if place.number not in self._ahead:
            wave = [p for p in (place, *islice(then, self.work.worker_count - 1)) if p.number not in self._ahead]
            unknown = [p for p in wave if self.journal.find_planned(p) is None]
            self._ahead.update({p.number: known for p in wave if (known := self.journal.find_planned(p)) is not None})
            self._ahead.update(
                {
                    one.place.number: self.journal.append(one)
                    for one in self.work.map_items(PlacementSite.plan_candidate, unknown)
                }
            )
        self.planned[place.number] = self._ahead[place.number]


def _plan_queue(
    queue: Sequence[PlacementCandidate],
    plans: _PlannedPlaces,
    search: PlacementOptions,
    progress: Progress,
    start_time: float,
) -> str:
    """Plan places in their order until the best ones are proven; return why it stopped earlier, empty if not."""
    for turn, place in enumerate(queue):
        planned = plans.planned
        values = sorted(p.rank for p in planned.values() if not p.refused)
        if len(values) - (0 in planned and not planned[0].refused) >= search.best and not any(
            can_beat(p.limit, values[0]) for p in queue if p.number not in planned
        ):
            break
        if len(planned) >= search.plans:
            return f"after {search.plans} plans"
        if time.monotonic() - start_time > search.seconds and values:
            return f"after {search.seconds / 60:.3g} min"
        best_text = f", best so far {1e3 * values[0][1]:.4g}" if values else ""
        progress(f"plan {len(planned) + 1} of at most {search.plans}: {place.shift.text}{best_text}")
        plans.plan(place, queue[turn + 1 :])
    return ""


def _evaluate_grid(
    site: PlacementSite,
    search: PlacementOptions,
    journal: SearchJournal,
    progress: Progress,
    start_time: float,
    executor: PlacementExecutor,
) -> list[PlacementCandidate]:
    refusal = site.supports.build_shift_check(site.moved_bodies.names, base=search.base)
    every = build_shift_grid(search)
    known = {k: place for k, shift in enumerate(every) if (place := journal.find_candidate(k, shift)) is not None}
    todo = [k for k in range(len(every)) if k not in known]
    size = 1  # the first alone: after an installation it compiles the kernels for the others
    while todo and not (known and time.monotonic() - start_time > search.seconds):
        now, todo = todo[:size], todo[size:]
        size = 1 if executor.worker_count == 1 else 4 * executor.worker_count
        queries = [
            CandidateQuery(
                k,
                every[k],
                refusal.find_refusal_reason(every[k], every[k].build_matrix(site.moved_bodies.centre)) if k else "",
            )
            for k in now
        ]
        known |= {
            place.number: journal.append(place)
            for place in executor.map_items(PlacementSite.evaluate_candidate, queries)
        }
        if now[-1] % 10 == 0 or size > 1 or not todo:
            progress(f"place {len(known)} of {len(every)}, {sum(p.is_feasible for p in known.values())} within reach")
    late = "not evaluated: the time was over"
    return [known.get(k) or PlacementCandidate(number=k, shift=shift, refused=late) for k, shift in enumerate(every)]


def _refine_best(
    site: PlacementSite, best: PlacementCandidate, search: PlacementOptions, number: int, executor: PlacementExecutor
) -> PlacementCandidate | None:
    """Return a better place near the best of the grid, by the grid's best sequence there; None: there is none.

    Steps along one axis at a time, each from the best so far, of half, a quarter and an eighth of the grid's.
    """
    refusal = site.supports.build_shift_check(site.moved_bodies.names, base=search.base)
    grid, now = compute_grid_steps(search), best
    for part in (0.5, 0.25, 0.125):
        for axis in ("x", "y", "z", "turn"):
            size = part * getattr(grid, axis)
            tried = [
                clip_shift(search, replace(now.shift, **{axis: getattr(now.shift, axis) + sign * size}))
                for sign in ((-1.0, 1.0) if size else ())
            ]
            queries = [
                CandidateQuery(
                    number, shift, refusal.find_refusal_reason(shift, shift.build_matrix(site.moved_bodies.centre))
                )
                for shift in tried
                if shift != now.shift
            ]
            better = (
                p
                for p in executor.map_items(PlacementSite.evaluate_candidate, queries)
                if p.is_feasible and p.outlook < now.outlook
            )
            now = next(better, now)
    return None if now is best else now


def _evaluate_neighbours(
    site: PlacementSite, best: list[PlacementCandidate], search: PlacementOptions, executor: PlacementExecutor
) -> dict[int, tuple[NearbyPlacement, ...]]:
    refusal = site.supports.build_shift_check(site.moved_bodies.names, base=search.base)
    queries, moved_by = [], []
    for place in best:
        for axis in "xyz":
            for sign in (-1.0, 1.0):
                shift = replace(place.shift, **{axis: getattr(place.shift, axis) + sign * NEIGHBOUR_DISTANCE_M})
                queries.append(
                    CandidateQuery(
                        -1, shift, refusal.find_refusal_reason(shift, shift.build_matrix(site.moved_bodies.centre))
                    )
                )
                moved_by.append((place.number, f"{axis} {sign * 1e3 * NEIGHBOUR_DISTANCE_M:+.0f} mm"))
    out: dict[int, tuple[NearbyPlacement, ...]] = {place.number: () for place in best}
    for (number, way), found in zip(
        moved_by, executor.map_items(PlacementSite.evaluate_candidate, queries), strict=True
    ):
        out[number] += (NearbyPlacement(found.shift, way, found.refused, found.worst),)
    return out


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
