"""Where the external joints stand: at home, at one value for each operation, or moving along the path.

A run cannot be left to move a rail, so operations that share a run share a value. For each such group a grid of values
is laid over the ranges of its joints, coarse first and then finer around the best:

    value g ─► candidates and scores at some stations, 15° of rotation ─► the best sequence: mean m, worst w, motion

c₀, the unit of the index, is the median over the candidates of all values. Groups hang together by the worst index and
by the way between their values: with a cap on the worst the cheapest chain of values is exact, and every cap that
matters is tried. The best few are then planned in full (:func:`machopt.plan.pipeline.plan`), with home among them, and
the best plan is taken: fewest points lost, then least J. Joints that may move along the path are first held at such
values too; the way of :mod:`machopt.plan.moving`, of all of them or of some, is planned in full beside them, and never
taken where it is worse.

    J = Σ share·(m + motion) + w_worst·max w + Σ price·|Δe|
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machopt.arrays import Array, Bools
from machopt.domain.cell import Cell
from machopt.domain.options import ExternalAxis, PlanOptions
from machopt.domain.steering import kept, steered
from machopt.domain.toolpath import Toolpath
from machopt.plan.axes import axes_of
from machopt.plan.candidates import enumerate_candidates
from machopt.plan.engage import sideways
from machopt.plan.glimpse import free_choice
from machopt.plan.groups import Group, groups_of
from machopt.plan.made import Plan
from machopt.plan.moving import Range, curve
from machopt.plan.part import part_of, rows_of
from machopt.plan.path import Path, build_path
from machopt.plan.pipeline import plan
from machopt.plan.score import directions, score_candidates
from machopt.plan.setup import Setup, Timings, prepare, standing
from machopt.plan.timeline import build_timeline

COARSE = {1: 9, 2: 5, 3: 4}  # values of each joint in the first grid, by how many are free
FINER = 3  # times the grid is halved around the best value of each group
STATIONS = 160  # at which a value is judged
STEP = np.radians(15.0)  # of rotation, there
PLANNED = 3  # values planned in full where all can be driven
TRIED = 8  # where the first ones cannot
AS_GOOD = 1.15  # times the best estimate: home is planned in full below that
LOST = 1e3  # of J for all stations lost: a value that loses fewer is better
ROOM = 0.01  # of a range, kept from its ends by a joint that moves: a curve through points may pass beyond them
MOVES_TRIED = 2  # the same where the joints may move along the path
CAPS = 48  # on the worst index that are tried at most
RAPID = 1.5  # times a travel counts on the way to another value (:mod:`machopt.plan.objective`, b)
PREFERRED = 0.1  # of J, price of a rad (or LENGTH) from a preferred value


@dataclass(frozen=True)
class Judged:
    """What a value comes to for one group, at some stations."""

    value: Array  # (E,) m or rad
    lost: float  # share of the stations without a free pose, or behind a break
    mean: float  # over the length the group cuts, in the unit of the index
    worst: float  # the same
    motion: float  # what J counts beside them, within the group


def best_plan(
    cell: Cell,
    toolpath: Toolpath,
    options: PlanOptions,
    timings: Timings | None = None,
    before: Plan | None = None,
    *,
    scale: float | None = None,
) -> Plan:
    """Plan one toolpath, the external joints where they serve it best by their modes.

    Args:
        before: a plan of the same but for the user's wishes (:func:`machopt.plan.pipeline.plan`).
        scale: c₀ of a plan that this one belongs to; None: of its own.

    Raises:
        InputError: an option names no external joint or asks for what is not planned.
    """
    clock = timings or Timings()
    axes = axes_of(cell, options)
    if not cell.external_joints:
        return plan(cell, toolpath, options, clock, before=before, scale=scale)
    options = steered(options, toolpath)
    with clock.stage("prepare"):
        setup = prepare(cell, options) if before is None else before.setup
        path = build_path(toolpath, kept(options))
        groups = groups_of(cell, toolpath, path, axes)
    if all((g.low == g.high).all() for g in groups):
        at = _spread(path, groups, [g.low for g in groups])
        return plan(cell, toolpath, options, clock, setup=setup, external=at, before=before, scale=scale)
    with clock.stage("external"):
        search = _Search(setup, options, path, groups, axes, scale)
        search.judge()
    best: tuple[tuple[float, float], Plan] | None = None
    seen: list[list[Array]] = []

    def planned(values: list[Array]) -> Plan:
        nonlocal best
        seen.append(values)
        at = _spread(path, groups, values)
        found = plan(cell, toolpath, options, clock, setup=setup, external=at, scale=search.scale, before=before)
        key = _lost(found), found.chosen.objective.total + search.liking(values)
        if best is None or key < best[0]:
            best = key, found
        return found

    moves = any((g.moving & (g.high > g.low)).any() for g in groups)
    whole, tried = 0, MOVES_TRIED if moves else TRIED
    while len(seen) < tried and whole < PLANNED:
        values = search.chain()
        if values is None:
            break
        bad = [
            n for n in _lost_groups(planned(values), groups) if np.ptp([groups[n].low, groups[n].high], axis=0).any()
        ]
        whole += not bad
        for n in bad or ([0] if len(groups) == 1 else []):
            search.exclude(n, values[n], 0.5 if bad else 0.25)
        if not bad and len(groups) > 1:
            break
    home = search.at_home()
    new = not any(np.array_equal(home, values) for values in seen)
    if new and (best is None or best[0][0] or search.estimate(home) <= AS_GOOD * search.estimate(seen[0])):
        planned(home)
    if best is None:
        raise AssertionError("home has been planned")
    if not moves:
        return best[1]
    with clock.stage("external"):
        fixed = best[1].path.external
        stands = [fixed[rows_of(path, g.runs)[0]] for g in groups]
        ways = [
            _moved(setup, options, path, some, axes, stands, search.scale)
            for some in _fewer(groups, stands, cell.external_home)
        ]
    looks = replace(options, rotation_step=max(options.rotation_step, STEP)) if len(ways) > 1 else options

    def along(at: Array, options: PlanOptions = options) -> tuple[tuple[float, float], Plan]:
        found = plan(cell, toolpath, options, clock, setup=setup, external=at, scale=search.scale, before=before)
        return (_lost(found), found.chosen.objective.total + search.liking_along(at)), found

    looked = [along(at, looks) for at in ways]
    k = min(range(len(ways)), key=lambda k: looked[k][0])
    key, found = looked[k] if looks.rotation_step == options.rotation_step else along(ways[k])
    if not key < best[0]:
        return best[1]
    if best[0][0] == 0:  # there is another answer, should this one not be driven
        with clock.stage("external"):
            timeline = build_timeline(found, toolpath)
        if timeline.trajectory is None:
            return best[1]
    return found


def _fewer(groups: Sequence[Group], stands: Sequence[Array], home: Array) -> list[list[Group]]:
    """The groups with all their joints moving, and with fewer, the others at home or where they stand in the best plan.

    More joints have a coarser grid, so that by itself more freedom could end in a worse plan.
    """
    free = np.flatnonzero(np.any([g.moving & (g.high > g.low) for g in groups], axis=0))
    out = [list(groups)]
    for n in range(len(free) - 1, 0, -1):
        for some in itertools.combinations(free, n):
            rests = np.isin(np.arange(len(home)), free) & ~np.isin(np.arange(len(home)), some)
            at_home, as_best = [np.clip(home, g.low, g.high) for g in groups], list(stands)
            same = all(np.array_equal(a[rests], b[rests]) for a, b in zip(at_home, as_best, strict=True))
            for values in [at_home] if same else [at_home, as_best]:
                out.append([_resting(g, rests & g.moving, v) for g, v in zip(groups, values, strict=True)])
    return out


def _resting(group: Group, rests: Bools, value: Array) -> Group:
    """The group with some joints locked at a value."""
    low, high = (np.where(rests, value, bound) for bound in (group.low, group.high))
    return replace(group, moving=group.moving & ~rests, low=low, high=high)


def _moved(
    setup: Setup,
    options: PlanOptions,
    path: Path,
    groups: Sequence[Group],
    axes: Sequence[ExternalAxis],
    stands: Sequence[Array],
    scale: float,
) -> Array:
    """(P, E) the external joints along the path where they may move, elsewhere at the values (E,) of their group."""
    stands = [np.clip(value, g.low, g.high) for g, value in zip(groups, stands, strict=True)]
    out = _spread(path, groups, stands)
    weight = np.array([axis.weight for axis in axes])
    for g, value in zip(groups, stands, strict=True):
        if (g.moving & (g.high > g.low)).any():
            rows = rows_of(path, g.runs)
            room = ROOM * (g.high - g.low)
            low, high = (
                np.where(g.moving, bound + side * room, bound) for bound, side in ((g.low, 1.0), (g.high, -1.0))
            )
            home = np.clip(setup.cell.external_home, g.low, g.high)
            group = Range(g.runs, g.moving, value, home, low, high, g.share)
            out[rows] = curve(setup, options, path, group, scale, weight)
    return out


def _lost_groups(found: Plan, groups: Sequence[Group]) -> list[int]:
    """Groups with points that have no configuration, or with breaks."""
    path = found.path
    runs = set(path.run[found.missing[path.may_touch[found.missing]]].tolist())
    for b in found.breaks:
        if np.isfinite(b.after):
            runs.add(int(path.run[np.searchsorted(path.index, b.after - 1e-9)]))
    return [n for n, group in enumerate(groups) if runs & set(group.runs)]


def _lost(found: Plan) -> float:
    """Points that have no configuration, and breaks."""
    missing = found.missing[found.path.may_touch[found.missing]]
    return float(len(missing) + len(found.breaks))


def _spread(path: Path, groups: Sequence[Group], values: Sequence[Array]) -> Array:
    """(P, E) the values of the groups at the planning points."""
    out = np.empty((len(path.index), len(values[0])))
    for group, value in zip(groups, values, strict=True):
        out[rows_of(path, group.runs)] = value
    return out


class _Search:
    """The values of all groups; ``scale`` is c₀."""

    def __init__(
        self,
        setup: Setup,
        options: PlanOptions,
        path: Path,
        groups: list[Group],
        axes: Sequence[ExternalAxis],
        scale: float | None,
    ) -> None:
        self.asked = scale
        self.setup, self.path, self.groups, self.axes = setup, path, groups, axes
        self.options = replace(options, rotation_step=max(options.rotation_step, STEP))
        self.home = setup.cell.external_home
        self.parts = [part_of(path, g.runs, STATIONS) for g in groups]
        self.across = [sideways(part) for part in self.parts]
        self.judged: list[list[Judged]] = [[] for _ in groups]
        self.per = setup.per_rad[6:]
        self.weight = np.array([axis.weight for axis in axes])
        self.medians: list[float] = []
        self._every: list[list[Judged]] = []

    @property
    def scale(self) -> float:
        """c₀: where it is not given, the median over groups and values of the median cost over the candidates."""
        return self.asked or (float(np.median(self.medians)) if self.medians else 1.0)

    def judge(self) -> None:
        """Judge the coarse grid of every group, then finer ones around its best."""
        for n, group in enumerate(self.groups):
            free = np.flatnonzero(group.high > group.low)
            count = COARSE.get(len(free), 4)
            step = (group.high - group.low) / (count - 1)
            grid = [np.linspace(a, b, count if b > a else 1) for a, b in zip(group.low, group.high, strict=True)]
            inside = np.clip(self.home, group.low, group.high)
            for value in [inside, *map(np.array, itertools.product(*grid))]:
                self._judge(n, value)
            if len(free) > 1:  # each joint alone as finely as if the others were locked: no freedom makes it worse
                for k in free:
                    self._along_one(n, int(k), inside)
            for _ in range(FINER):
                step = 0.5 * step
                centre = min(self.judged[n], key=self._rank).value
                around = [(-1.0, 0.0, 1.0) if k in free else (0.0,) for k in range(len(step))]
                for side in itertools.product(*around):
                    self._judge(n, np.clip(centre + np.array(side) * step, group.low, group.high))
        self._every = [list(own) for own in self.judged]

    def _along_one(self, n: int, k: int, inside: Array) -> None:
        """Judge the values of joint ``k`` with the others at home: the grid of one joint, and finer around its best."""
        group = self.groups[n]
        off = np.arange(len(inside)) == k
        for v in np.linspace(group.low[k], group.high[k], COARSE[1]):
            self._judge(n, np.where(off, v, inside))
        step = (group.high[k] - group.low[k]) / (COARSE[1] - 1)
        for _ in range(FINER):
            step = 0.5 * step
            own = [j for j in self.judged[n] if np.array_equal(j.value[~off], inside[~off])]
            centre = min(own, key=self._rank).value
            for side in (-step, step):
                self._judge(n, np.clip(centre + side * off, group.low, group.high))

    def _judge(self, n: int, value: Array) -> None:
        """What a value comes to for a group; once."""
        if any(np.array_equal(j.value, value) for j in self.judged[n]):
            return
        part, setup = standing(self.parts[n], value), self.setup
        d = directions(part, setup.arm, setup.elasticity, self.options.force, self.across[n])
        candidates = enumerate_candidates(part, setup.arm, self.options)
        if not candidates.feasible.any():
            self.judged[n].append(Judged(value, 1.0, 0.0, 0.0, 0.0))
            return
        scores = score_candidates(part, candidates, setup.elasticity, d, self.options)
        self.medians.append(scores.scale)
        choice, colliding = free_choice(part, candidates, scores, setup, self.options)
        there, w = np.flatnonzero(~choice.dropped), self.options.weights
        cost = scores.cost[there, choice.rotation[there], choice.branch[there]]
        share, counted = part.station_weight[there], part.counted[part.stations[there]]
        mean, worst = float(share @ cost), float(cost[counted].max(initial=0.0))
        motion = choice.total - (w.mean * mean + w.worst * worst) / scores.scale
        lost = (int(choice.dropped.sum()) + len(choice.broken) + colliding) / len(choice.rotation)
        self.judged[n].append(Judged(value, lost, mean, worst, motion))

    def _rank(self, j: Judged) -> float:
        """J of a group by itself."""
        return self._alone(j) + self.options.weights.worst * j.worst / self.scale

    def _alone(self, j: Judged) -> float:
        return LOST * j.lost + self.options.weights.mean * j.mean / self.scale + j.motion + self._liked(j.value)

    def _liked(self, value: Array) -> float:
        """Price of leaving the preferred values: of the square of how far."""
        asked = np.array([np.nan if axis.preferred is None else axis.preferred for axis in self.axes])
        return float(PREFERRED * np.nansum(((value - asked) * self.per) ** 2))

    def liking(self, values: Sequence[Array]) -> float:
        """Σ share · price of leaving the preferred values."""
        return sum(g.share * self._liked(v) for g, v in zip(self.groups, values, strict=True))

    def liking_along(self, external: Array) -> float:
        """The same of joints (P, E) that move."""
        return float(self.path.weight @ np.array([self._liked(e) for e in external]))

    def at_home(self) -> list[Array]:
        """Home, or what is nearest to it, for every group."""
        return [np.clip(self.home, g.low, g.high) for g in self.groups]

    def exclude(self, n: int, value: Array, share: float) -> None:
        """Take values of a group away that lie within ``share`` of a coarse step of one."""
        group = self.groups[n]
        step = (group.high - group.low) / max(COARSE.get(int((group.high > group.low).sum()), 4) - 1, 1)
        self.judged[n] = [j for j in self.judged[n] if (np.abs(j.value - value) > share * step + 1e-12).any()]

    def estimate(self, values: Sequence[Array]) -> float:
        """J of values that were judged, by the stations."""
        chosen = [next(j for j in self._every[n] if np.array_equal(j.value, value)) for n, value in enumerate(values)]
        worst = max(j.worst for j in chosen) / self.scale
        return sum(g.share * self._alone(j) for g, j in zip(self.groups, chosen, strict=True)) + (
            self.options.weights.worst * worst + self._travel(values)
        )

    def _travel(self, values: Sequence[Array]) -> float:
        ways = np.abs(np.diff([self.home, *values, self.home], axis=0)) @ (self.weight * self.per)
        shares = np.array([g.share for g in self.groups])
        return float(self._price * np.r_[shares, shares[-1]] @ ways)

    @property
    def _price(self) -> float:
        return self.options.weights.travel * RAPID / np.pi

    def chain(self) -> list[Array] | None:
        """The cheapest values of all groups, of those that are left; None where a group has none."""
        if not all(self.judged):
            return None
        worsts = np.unique([j.worst for own in self.judged for j in own])
        floor = max(min(j.worst for j in own) for own in self.judged)
        caps = worsts[worsts >= floor]
        caps = caps[np.unique(np.linspace(0, len(caps) - 1, min(len(caps), CAPS)).round().astype(int))]
        found = [(total, values) for cap in caps for total, values in [self._under(float(cap))]]
        return min(found, key=lambda f: f[0])[1]

    def _under(self, cap: float) -> tuple[float, list[Array]]:
        """The cheapest chain whose worst index is at most ``cap``, and its J."""
        before, at, back = np.zeros(1), self.home[None], []
        for n, group in enumerate(self.groups):
            allowed = [j for j in self.judged[n] if j.worst <= cap]
            here = np.array([j.value for j in allowed])
            ways = np.abs(here[:, None] - at[None]) @ (self.weight * self.per)
            every = before[None] + self._price * group.share * ways
            back.append((every.argmin(axis=1), here))
            own = np.array([group.share * self._alone(j) for j in allowed])
            before, at = every.min(axis=1) + own, here
        last = before + self._price * self.groups[-1].share * (np.abs(at - self.home) @ (self.weight * self.per))
        k, values = int(last.argmin()), []
        total = float(last[k]) + self.options.weights.worst * cap / self.scale
        for source, here in reversed(back):
            values.append(here[k])
            k = int(source[k])
        return total, values[::-1]
