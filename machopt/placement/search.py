"""Best first: every place is looked at, the promising ones are planned wholly, until none left can be better.

What is found is written to a journal as it is found, so that a run that was stopped goes on where it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from machopt.domain.cell import Cell
from machopt.domain.options import PlanOptions
from machopt.domain.reason import Reason
from machopt.domain.toolpath import Toolpath
from machopt.model.machine import load_machine
from machopt.placement.asked import HERE, Search, Shift, inside, shifts, steps
from machopt.placement.found import CLOSE, Near, Place, Planned, Siting
from machopt.placement.hands import Hands, Own
from machopt.placement.journal import Journal
from machopt.placement.moved import Carried, centre_of, moved, named
from machopt.placement.outlook import Outlook, outlook
from machopt.placement.standing import Standing
from machopt.plan.candidates import Arm
from machopt.plan.drive import motion_of
from machopt.plan.explain import all_breaks, explain_points
from machopt.plan.made import Plan
from machopt.plan.path import Path, build_path
from machopt.plan.pipeline import plan
from machopt.plan.score import configuration_cost
from machopt.plan.setup import Setup, Timings, prepare

RIGID = 1e9  # times a joint's stiffness: it gives no more
AROUND = 0.020  # m: how far the best places are moved to see how sensitive they are

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Asked:
    """A place that is to be looked at; ``why`` nothing can stand there, empty where something can."""

    number: int
    shift: Shift
    why: str = ""


@dataclass(frozen=True, eq=False)
class Site:
    """A cell and its jobs, ready to be looked at from anywhere."""

    cell: Cell
    toolpaths: tuple[Toolpath, ...]
    options: PlanOptions
    setup: Setup  # without collisions: springs and chain are the same at every place
    paths: tuple[Path, ...]
    carried: Carried
    standing: Standing

    @classmethod
    def of(cls, cell: Cell, toolpaths: tuple[Toolpath, ...], options: PlanOptions, search: Search) -> Site:
        setup = prepare(cell, replace(options, collision=False))
        standing = Standing.of(cell)
        names = named(cell, search, standing.holding(base=search.base) if search.carry is None else frozenset())
        positions = np.concatenate([t.position for t in toolpaths])
        carried = Carried(search.base, names, centre_of(cell, positions, base=search.base))
        return cls(cell, toolpaths, options, setup, tuple(build_path(t) for t in toolpaths), carried, standing)

    def outlooks(self, shift: Shift) -> tuple[Outlook, ...]:
        """One a job; none after the first that is not reached."""
        cell = moved(self.setup.driven, self.carried, shift)
        arm = Arm.of(cell, self.setup.arm.solver, load_machine(cell, self.setup.robot), self.options)
        out: list[Outlook] = []
        for path in self.paths:
            out.append(outlook(self.setup, arm, path, self.options))
            if not out[-1].reached:
                break
        return tuple(out)

    def place(self, asked: Asked) -> Place:
        """Look at a place."""
        number, shift = asked.number, asked.shift
        if asked.why:
            return Place(number, shift, asked.why)
        found = self.outlooks(shift)
        last = found[-1]
        if not last.reached:
            name = self.toolpaths[len(found) - 1].source
            return Place(number, shift, f"point {last.point} of {name}: {_REASONS[last.reason]}", point=last.point)
        job = int(np.argmax([o.bound for o in found]))
        return Place(
            number,
            shift,
            bound=found[job].bound,
            worst=max(o.worst for o in found),
            mean=float(np.mean([o.mean for o in found])),
            job=job,
            point=found[job].point,
        )

    def planned(self, place: Place) -> Planned:
        """Plan every job there, to its motion."""
        begun = time.perf_counter()
        cell = moved(self.cell, self.carried, place.shift)
        worst, mean, cycle, softest = [], [], 0.0, []
        for toolpath in self.toolpaths:
            quiet = Timings()
            one = plan(cell, toolpath, self.options, quiet)
            timeline = motion_of(one, toolpath, self.options, quiet)
            if timeline is None or timeline.trajectory is None:
                why = f"no motion for {toolpath.source}: {_lost(one)}"
                return Planned(place, why, seconds=time.perf_counter() - begun)
            worst.append(one.chosen.objective.worst * one.scores.scale)
            mean.append(one.chosen.objective.mean * one.scores.scale)
            cycle += float(timeline.trajectory.time[-1])
            softest.append(_softest(one))
        job = int(np.argmax(worst))
        return Planned(
            place,
            worst=worst[job],
            mean=float(np.mean(mean)),
            job=job,
            point=softest[job][0],
            shares=softest[job][1],
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
    grid = Siting(site.carried, tuple(places), tuple(planned.values()), {}, left, stopped)
    if grid.best and time.monotonic() - begun < search.seconds:
        progress("between the places of the grid")
        finer = _between(site, grid.best[0].place, search, len(places), work)
        if finer is not None:
            places.append(finer)
            whole(finer)
    out = Siting(site.carried, tuple(places), tuple(planned.values()), {}, left, stopped)
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
    return [known.get(k) or Place(k, shift, late) for k, shift in enumerate(every)]


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


def _softest(one: Plan) -> tuple[float, tuple[float, ...]]:
    """Where the index is worst, as a toolpath index, and the share of it that would go if each joint were rigid."""
    cost = np.where(one.path.counted, one.chosen.cost, -np.inf)
    p = np.array([int(np.nanargmax(cost))])
    q, elasticity, index = one.chosen.assignment.q[p], one.setup.elasticity, one.scores.index
    whole = configuration_cost(elasticity, one.directions, p, q, index)[0]
    shares = []
    for j in range(6):
        k = one.directions.k.copy()
        k[p, j] *= RIGID
        left = configuration_cost(elasticity, replace(one.directions, k=k), p, q, index)[0]
        shares.append(float(1.0 - left / whole))
    return float(one.path.index[p[0]]), tuple(shares)


def _lost(one: Plan) -> str:
    """The first reason why a plan is not driven."""
    points = [f"point {one.path.index[p]:g}: {sentence}" for p, sentence in explain_points(one).items()]
    breaks = [f"{b.where}: {b.text}" for b in all_breaks(one)]
    return (*points, *breaks, "it could not be driven")[0]


_REASONS = {
    Reason.UNREACHABLE: "out of reach",
    Reason.LIMIT: "beyond a joint limit",
    Reason.SINGULAR_WRIST: "too near the wrist singularity",
    Reason.SINGULAR_ELBOW: "too near the elbow singularity",
    Reason.SINGULAR_SHOULDER: "too near the shoulder singularity",
    Reason.BOUNDS: "outside the rotations that are allowed",
}
