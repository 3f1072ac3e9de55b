"""Best-first search: every place is assessed, and the best are planned fully, until no remaining place can be better.

Results are written to a journal at once, so that a stopped run continues where it ended.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from machopt.placement.journal import SearchJournal
from machopt.placement.placement_site import CandidateQuery, PlacementSite
from machopt.placement.search_options import (
    NO_SHIFT,
    PlacementOptions,
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
from machopt.placement.task_executor import InProcessExecutor, PlacementExecutor

NEIGHBOUR_DISTANCE_M = 0.020  # m: shift of the best places for the sensitivity

Progress = Callable[[str], None]


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
