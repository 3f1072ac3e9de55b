"""Best first: every place is looked at, the promising ones are planned wholly, until none left can be better.

What is found is written to a journal as it is found, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.stint import Stint
from machopt.domain.toolpath import Toolpath
from machopt.placement.asked import HERE, Search, Shift, inside, shifts, steps
from machopt.placement.found import CLOSE, Near, Place, Planned, Siting
from machopt.placement.hands import Hands, Own
from machopt.placement.journal import Journal
from machopt.placement.moved import Carried, centre_of, frames_of, named
from machopt.placement.outlook import Outlook
from machopt.placement.standing import Standing
from machopt.placement.task import Task, planned_at, stints_whole
from machopt.plan.cost.score import configuration_cost
from machopt.plan.pipeline.planned import Plan

RIGID = 1e9  # times a joint's stiffness: it gives no more
AROUND = 0.020  # m: how far the best places are moved to see how sensitive they are

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Asked:
    """A place that is to be looked at; ``why`` nothing can stand there, empty where something can."""

    number: int
    shift: Shift
    why: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class Site:
    """A cell and its jobs, ready to be looked at from anywhere."""

    cell: Cell
    toolpaths: tuple[Toolpath, ...]
    options: PlanOptions
    jobs: tuple[tuple[Task, ...], ...]  # one a toolpath, each of one task a tool that is on
    carried: Carried
    standing: Standing

    @classmethod
    def of(
        cls,
        cell: Cell,
        toolpaths: tuple[Toolpath, ...],
        options: PlanOptions,
        search: Search,
        stints: Sequence[Sequence[Stint]] | None = None,
    ) -> Site:
        """Make everything ready.

        Args:
            stints: of each toolpath, cut where it changes tools; None: none does.
        """
        standing = Standing.of(cell)
        names = named(cell, search, standing.holding(base=search.base) if search.carry is None else frozenset())
        positions = np.concatenate([t.position for t in toolpaths])
        frames = frames_of(cell)
        carried = Carried(search.base, names, centre_of(cell, positions, base=search.base, frames=frames), frames)
        cut = [stints_whole(cell, t) for t in toolpaths] if stints is None else stints
        jobs = tuple(tuple(Task.of(stint, options) for stint in job) for job in cut)
        return cls(cell=cell, toolpaths=toolpaths, options=options, jobs=jobs, carried=carried, standing=standing)

    @property
    def free(self) -> bool:
        """External joints may choose where they stand: bounds are over a grid of their values."""
        return any(task.free for job in self.jobs for task in job)

    def outlooks(self, shift: Shift) -> tuple[Outlook, ...]:
        """One a job; none after the first that is not reached."""
        out: list[Outlook] = []
        for job in self.jobs:
            found: list[Outlook] = []
            for task in job:
                found.append(task.outlook(self.carried, shift, self.options))
                if not found[-1].reached:
                    return (*out, found[-1])
            out.append(_of_tools(found, [task.length for task in job]))
        return tuple(out)

    def place(self, asked: Asked) -> Place:
        """Look at a place."""
        number, shift = asked.number, asked.shift
        if asked.why:
            return Place(number=number, shift=shift, refused=asked.why)
        found = self.outlooks(shift)
        last = found[-1]
        if not last.reached:
            name = self.toolpaths[len(found) - 1].source
            return Place(
                number=number,
                shift=shift,
                refused=f"point {last.point} of {name}: {_REASONS[last.reason]}",
                point=last.point,
            )
        job = int(np.argmax([o.bound for o in found]))
        return Place(
            number=number,
            shift=shift,
            bound=found[job].bound,
            worst=max(o.worst for o in found),
            mean=float(np.mean([o.mean for o in found])),
            job=job,
            point=found[job].point,
        )

    def planned(self, place: Place) -> Planned:
        """Plan every job there, to its motion."""
        begun = time.perf_counter()
        worst, mean, cycle, softest = [], [], 0.0, []
        for toolpath, job in zip(self.toolpaths, self.jobs, strict=True):
            stints = [task.stint for task in job]
            one, seconds, why = planned_at(stints, self.carried, place.shift, self.options)
            if why:
                return Planned(
                    place=place, refused=f"no motion for {toolpath.source}: {why}", seconds=time.perf_counter() - begun
                )
            worst.append(one.chosen.objective.worst * one.scores.scale)
            mean.append(one.chosen.objective.mean * one.scores.scale)
            cycle += seconds
            softest.append(_softest(one))
        hardest = int(np.argmax(worst))
        return Planned(
            place=place,
            worst=worst[hardest],
            mean=float(np.mean(mean)),
            job=hardest,
            point=softest[hardest][0],
            shares=softest[hardest][1],
            cycle_time=cycle,
            seconds=time.perf_counter() - begun,
        )


def find(
    site: Site, search: Search, journal: Journal, progress: Progress = lambda _: None, hands: Hands | None = None
) -> Siting:
    """Look at every place, plan the promising ones.

    Args:
        site: cell and jobs.
        search: ranges and limits.
        journal: of what an earlier run found.
        progress: told what is done.
        hands: who looks and plans; None: this process. The answer is the same, but for what ``search.seconds`` cuts.
    """
    begun = time.monotonic()
    work = Own(site) if hands is None else hands
    places = _looked_at(site, search, journal, progress, begun, work)
    by_number = {p.number: p for p in places}
    planned: dict[int, Planned] = {}
    ahead: dict[int, Planned] = {}  # planned before its turn has come

    def whole(place: Place, then: Iterable[Place] = ()) -> None:
        if place.number not in ahead:
            wave = [p for p in (place, *islice(then, work.width - 1)) if p.number not in ahead]
            unknown = [p for p in wave if journal.planned(p) is None]
            ahead.update({p.number: known for p in wave if (known := journal.planned(p)) is not None})
            ahead.update({one.place.number: journal.keep(one) for one in work.each(Site.planned, unknown)})
        planned[place.number] = ahead[place.number]

    progress(f"plan 1: {HERE.words}")
    queue = sorted((p for p in places if p.open and p.number), key=lambda p: (max(p.worst, p.bound), p.bound, p.number))
    if by_number[0].open:
        whole(by_number[0])
    stopped = ""
    for turn, place in enumerate(queue):
        values = sorted(p.worst for p in planned.values() if not p.refused)
        if len(values) - (0 in planned and not planned[0].refused) >= search.best and all(
            p.bound >= values[0] * (1 - CLOSE) for p in queue if p.number not in planned
        ):
            break
        if len(planned) >= search.plans:
            stopped = f"after {search.plans} plans"
            break
        if time.monotonic() - begun > search.seconds and values:
            stopped = f"after {search.seconds / 60:.3g} min"
            break
        told = f", best so far {1e3 * values[0]:.4g}" if values else ""
        progress(f"plan {len(planned) + 1} of at most {search.plans}: {place.shift.words}{told}")
        whole(place, queue[turn + 1 :])
    left = min((p.bound for p in queue if p.number not in planned), default=np.inf)
    grid = Siting(
        carried=site.carried,
        places=tuple(places),
        planned=tuple(planned.values()),
        around={},
        open_bound=left,
        stopped=stopped,
    )
    if grid.best and time.monotonic() - begun < search.seconds:
        progress("between the places of the grid")
        finer = _between(site, grid.best[0].place, search, len(places), work)
        if finer is not None:
            places.append(finer)
            whole(finer)
    out = Siting(
        carried=site.carried,
        places=tuple(places),
        planned=tuple(planned.values()),
        around={},
        open_bound=left,
        stopped=stopped,
    )
    progress("around the best")
    return replace(out, around=_around(site, [p.place for p in out.best[: search.best]], search, work))


def _looked_at(
    site: Site, search: Search, journal: Journal, progress: Progress, begun: float, hands: Hands
) -> list[Place]:
    refusal = site.standing.refusal(site.carried.names, base=search.base)
    every = shifts(search)
    known = {k: place for k, shift in enumerate(every) if (place := journal.place(k, shift)) is not None}
    todo = [k for k in range(len(every)) if k not in known]
    size = 1  # the first alone: after an installation it compiles, and the others find that done
    while todo and not (known and time.monotonic() - begun > search.seconds):
        now, todo = todo[:size], todo[size:]
        size = 1 if hands.width == 1 else 4 * hands.width
        asked = [
            Asked(k, every[k], refusal.why(every[k], every[k].matrix(site.carried.centre)) if k else "") for k in now
        ]
        known |= {place.number: journal.keep(place) for place in hands.each(Site.place, asked)}
        if now[-1] % 10 == 0 or size > 1 or not todo:
            progress(f"place {len(known)} of {len(every)}, {sum(p.open for p in known.values())} within reach")
    late = "not looked at: the time was over"
    return [known.get(k) or Place(number=k, shift=shift, refused=late) for k, shift in enumerate(every)]


def _between(site: Site, best: Place, search: Search, number: int, hands: Hands) -> Place | None:
    """A better place near the best of the grid, by what the grid of rotations comes to there; None: there is none.

    Steps along one axis at a time, each from the best so far, of half, a quarter and an eighth of the grid's.
    """
    refusal = site.standing.refusal(site.carried.names, base=search.base)
    grid, now = steps(search), best
    for part in (0.5, 0.25, 0.125):
        for axis in ("x", "y", "z", "turn"):
            size = part * getattr(grid, axis)
            tried = [
                inside(search, replace(now.shift, **{axis: getattr(now.shift, axis) + sign * size}))
                for sign in ((-1.0, 1.0) if size else ())
            ]
            asked = [
                Asked(number, shift, refusal.why(shift, shift.matrix(site.carried.centre)))
                for shift in tried
                if shift != now.shift
            ]
            better = (p for p in hands.each(Site.place, asked) if p.open and p.worst < now.worst)
            now = next(better, now)
    return None if now is best else now


def _around(site: Site, best: list[Place], search: Search, hands: Hands) -> dict[int, tuple[Near, ...]]:
    refusal = site.standing.refusal(site.carried.names, base=search.base)
    asked, moved_by = [], []
    for place in best:
        for axis in "xyz":
            for sign in (-1.0, 1.0):
                shift = replace(place.shift, **{axis: getattr(place.shift, axis) + sign * AROUND})
                asked.append(Asked(-1, shift, refusal.why(shift, shift.matrix(site.carried.centre))))
                moved_by.append((place.number, f"{axis} {sign * 1e3 * AROUND:+.0f} mm"))
    out: dict[int, tuple[Near, ...]] = {place.number: () for place in best}
    for (number, way), found in zip(moved_by, hands.each(Site.place, asked), strict=True):
        out[number] += (Near(found.shift, way, found.refused, found.worst),)
    return out


def _of_tools(found: Sequence[Outlook], length: Sequence[float]) -> Outlook:
    """One job of several tools: the worst of all, the mean by what each cuts."""
    if len(found) == 1:
        return found[0]
    worst = max(found, key=lambda one: one.bound)
    share = np.array(length) if sum(length) > 0 else np.ones(len(found))
    mean = float(share @ [one.mean for one in found] / share.sum())
    return Outlook(worst.bound, max(one.worst for one in found), mean, worst.point)


def _softest(whole: Plan) -> tuple[float, tuple[float, ...]]:
    """Where the index is worst, as a toolpath index, and the share of it that would go if each joint were rigid."""
    cost = np.where(whole.path.counted, whole.chosen.cost, -np.inf)
    at = int(np.nanargmax(cost))
    one, row = whole.at(at)
    p = np.array([row])
    q, elasticity, index = one.chosen.assignment.q[p], one.setup.elasticity, one.scores.index
    all_of_it = configuration_cost(elasticity, one.directions, p, q, index)[0]
    shares = []
    for j in range(6):
        k = one.directions.k.copy()
        k[p, j] *= RIGID
        left = configuration_cost(elasticity, replace(one.directions, k=k), p, q, index)[0]
        shares.append(float(1.0 - left / all_of_it))
    return float(whole.path.index[at]), tuple(shares)


_REASONS = {
    Reason.UNREACHABLE: "out of reach",
    Reason.LIMIT: "beyond a joint limit",
    Reason.SINGULAR_WRIST: "too near the wrist singularity",
    Reason.SINGULAR_ELBOW: "too near the elbow singularity",
    Reason.SINGULAR_SHOULDER: "too near the shoulder singularity",
    Reason.BOUNDS: "outside the rotations that are allowed",
}
