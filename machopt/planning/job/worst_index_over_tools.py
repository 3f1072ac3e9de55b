"""Common worst index of a job with tool changes, traded over all its stretches at once.

With s_k a stretch's share of the length cut, V_k(c) the rest of its objective under a cap c on its worst index, and w
the price of the worst index, the whole costs (:mod:`machopt.planning.job.joined_plan`)

    J = Σ s_k V_k + w·max m_k = Σ s_k V_k(c) + w·c at the best common cap c.

Each V_k decreases with c, and so does their sum: the branch and bound of
:mod:`machopt.planning.sequence_search.worst_value_constraint` over one cap
is exact, and its bound holds for the whole job. Alone, a stretch is planned for V_k + w·m_k. That demands too much of a
stretch if another is softer anyway, and too little of the softest one. Stretches whose own result differs from the
common one are searched again, for V_k + (w/s_k)·max(m_k, c), on the grids that the first search has left. The better
plan of the whole job is selected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import PlanObjective
from machopt.planning.optimality_certificate import compute_external_travel_cost
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.pipeline.repeated_search import search_with_worst_price
from machopt.planning.sequence_search.dynamic_programming import SequenceGrid
from machopt.planning.sequence_search.worst_value_constraint import (
    GAP,
    WorstLimitedSequence,
    WorstTradeResult,
    trade_worst_index,
)

ROUNDS = 3  # the search of a stretch may exclude vertices of the common result
CLOSED = 2e-3  # of J: within this gap to the bound nothing is searched again
LEAST = (
    1e-3  # share of the length below which a stretch is not searched again: the worst index would dominate its price
)

Solve = Callable[[float, float], WorstLimitedSequence | None]


def plan_worst_index_over_tools(
    plans: Sequence[Plan], share: Array, timings: StageTimings
) -> tuple[list[Plan], float | None]:
    """Return the stretches planned for the common worst index, and a lower bound of all sequences over their grids.

    Args:
        plans: each for its own worst index, in units of one c₀.
        share: (K,) of the length cut.
        timings: receives the duration of the stages.

    Returns:
        The plans, those of the arguments where nothing is better; and the bound without the travel of external joints,
        None where a stretch has gaps, breaks or was not searched.
    """
    best, w = list(plans), plans[0].options.weights.worst
    cuts = [k for k in range(len(best)) if share[k] > 0]
    if not w > 0 or any(p.found is None or p.breaks or len(p.missing) for p in best):
        return best, None
    with timings.stage("together"):
        bound = None
        grids = list(best)  # with all exclusions
        ways = float(share @ [compute_external_travel_cost(p) for p in best])
        for _ in range(ROUNDS):
            common = _trade_common_cap(
                [grids[k] for k in cuts], share[cuts], w, _compute_worst_outside_cuts(best, cuts)
            )
            if common is None:
                return best, bound
            bound = common.bound
            if _sum_job_objective([p.chosen.objective for p in best], share, w) <= (bound + ways) * (1 + CLOSED):
                break
            searched = [k for n, k in enumerate(cuts) if share[k] > LEAST and common.differs(n, best[k])]
            tried = list(best)
            for k in searched:
                found = grids[k].found
                if found is None:
                    raise AssertionError("every stretch was searched")
                again = _restore_prices(
                    search_with_worst_price(grids[k], found, w / share[k], common.worst, timings), best[k]
                )
                grids[k] = again
                if not again.breaks and not len(again.missing):
                    tried[k] = again
            better = _select_better(best, tried, share, w)
            if better is best:
                break
            best = better
        return best, bound


@dataclass(frozen=True)
class _Common:
    """The best sequences over all grids under one cap."""

    bound: float
    worst: float  # the cap
    values: tuple[float, ...]  # V_k under it

    def differs(self, n: int, one: Plan) -> bool:
        """Return whether the stretch's own sequence differs from the one under the common cap.

        Args:
            n: index of the stretch.
            one: its plan.
        """
        own = _get_worst(one)
        value = one.choice.total - one.options.weights.worst * own
        return own > self.worst * (1 + GAP) or value > self.values[n] + GAP * abs(one.choice.total)


def _trade_common_cap(grids: Sequence[Plan], share: Array, w: float, worst_elsewhere: float) -> _Common | None:
    """The common cap of some stretches; ``worst_elsewhere`` is the worst index of the others."""
    some = []
    for p in grids:
        if p.found is None:
            return None
        wide = p.found.wide if p.found.wide.any() else None
        scores = replace(p.scores, elsewhere=0.0)
        grid = SequenceGrid.build(p.path, p.candidates, scores, p.setup.cell.limits.velocity[:6], p.options, wide)
        capped = grid.capped(p.found.edges)
        if capped is None:
            return None
        some.append(_Stretch(*capped))
    least = np.array([s.free.value for s in some])
    found: dict[float, tuple[float, ...]] = {}

    def whole(answers: Sequence[WorstLimitedSequence]) -> WorstLimitedSequence:
        value = float(share @ [a.value for a in answers])
        worst = max(worst_elsewhere, *(a.worst for a in answers))
        found[value] = tuple(a.value for a in answers)
        return WorstLimitedSequence(np.empty((0, 3), np.int32), value, worst)

    def under(cap: float, limit: float) -> WorstLimitedSequence | None:
        if cap < worst_elsewhere:
            return None
        answers: list[WorstLimitedSequence] = []
        left = limit - float(share @ least)
        for s, part in zip(some, share, strict=True):
            one = s.under(cap, s.free.value + left / part)
            if one is None:
                return None
            left -= part * (one.value - s.free.value)
            answers.append(one)
        return whole(answers)

    free = whole([s.free for s in some])
    done: WorstTradeResult = trade_worst_index(free, max(worst_elsewhere, *(s.floor for s in some)), w, under)
    return _Common(done.bound, done.best.worst, found[done.best.value])


@dataclass
class _Stretch:
    """Cheapest sequences of one stretch under caps, each searched once."""

    free: WorstLimitedSequence
    floor: float
    solve: Solve
    known: list[tuple[float, WorstLimitedSequence]] = field(default_factory=list)  # cap, and the cheapest under it

    def under(self, cap: float, limit: float) -> WorstLimitedSequence | None:
        """Return the cheapest sequence under a cap, None where its value is not below a limit.

        Args:
            cap: maximum worst index, in units of c₀.
            limit: value that the sequence must be below.
        """
        if self.free.worst <= cap:
            return self.free if self.free.value < limit else None
        if cap < self.floor:
            return None
        one = next((one for high, one in self.known if one.worst <= cap <= high), None)
        if one is None:
            one = self.solve(cap, limit)
            if one is None:
                return None
            self.known.append((cap, one))
        return one if one.value < limit else None


def _compute_worst_outside_cuts(plans: Sequence[Plan], cuts: Sequence[int]) -> float:
    """Return the worst index of the stretches that cut no length: they have only one result."""
    return max((p.chosen.objective.worst for k, p in enumerate(plans) if k not in cuts), default=0.0)


def _get_worst(one: Plan) -> float:
    """The worst index of a plan's sequence over the grid, in units of c₀."""
    c, path = one.choice, one.path
    there = np.flatnonzero(~c.dropped & path.counted[path.stations])
    return float(one.scores.cost[there, c.rotation[there], c.branch[there]].max(initial=0.0) / one.scores.scale)


def _restore_prices(again: Plan, before: Plan) -> Plan:
    """Return the plan with the prices of the request, and with the bound that the first search has proven."""
    dear, floor, w = again.options.weights.worst, again.scores.elsewhere, before.options.weights.worst

    def priced(o: PlanObjective) -> PlanObjective:
        return replace(o, total=o.total - dear * max(o.worst, floor) + w * o.worst)

    own = _get_worst(again)
    total = again.choice.total - dear * max(own, floor) + w * own
    return replace(
        again,
        options=before.options,
        scores=replace(again.scores, elsewhere=0.0),
        choice=replace(again.choice, total=total, bound=min(total, before.choice.bound)),
        chosen=replace(again.chosen, objective=priced(again.chosen.objective)),
        grid=priced(again.grid),
    )


def _sum_job_objective(parts: Sequence[PlanObjective], share: Array, w: float) -> float:
    """J of the whole."""
    rest = [s * (o.total - w * o.worst) for s, o in zip(share, parts, strict=True) if s > 0]
    return float(sum(rest) + w * max(o.worst for o in parts))


def _select_better(best: list[Plan], tried: list[Plan], share: Array, w: float) -> list[Plan]:
    """Return all new plans, or successively those that make the whole better; ``best`` where none does."""

    def cost(plans: Sequence[Plan]) -> float:
        return _sum_job_objective([p.chosen.objective for p in plans], share, w)

    now, least = best, cost(best)
    if cost(tried) < least:
        now, least = tried, cost(tried)
    for k, (a, b) in enumerate(zip(best, tried, strict=True)):
        for one in (a, b):
            other = [*now[:k], one, *now[k + 1 :]]
            if one is not now[k] and cost(other) < least * (1 - 1e-9):
                now, least = other, cost(other)
    return now
