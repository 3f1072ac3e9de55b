"""Search for one value of the external joints per group of operations, by estimates at some stations.

    value g ─► candidates and scores at some stations, 15° of rotation ─► the best sequence: mean m, worst w, motion

Each value is first assessed by the least index of every station, a lower bound of every sequence. Only where it may
be the best, it is assessed by the best sequence whose poses are free of contacts
(:mod:`machopt.planning.external_axes.sampled_sequence`). The resulting values equal those of assessing all of them in
full. It saves work only where some value loses no station to contacts.

Groups are coupled by the worst index and by the travel between their values. With a cap on the worst index the cheapest
chain of values is exact, and every relevant cap is tried.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from machopt.data_types.plan_options import ExternalJointOptions, PlanOptions
from machopt.data_types.steering_rules import select_steered_rows
from machopt.numerics.array_types import Array
from machopt.numerics.parallel_map import map_in_threads
from machopt.planning.cache import compute_cached
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import CandidateScores, compute_load_directions, score_candidates
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.external_axes.plan_ranking import AxisPlanRanking
from machopt.planning.external_axes.sampled_sequence import choose_collision_free_sequence
from machopt.planning.pipeline.planning_setup import PlanningSetup, fix_external_axes
from machopt.planning.pipeline.vertex_prices import build_rapid_pricing
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice
from machopt.planning.stations.path_subset import list_run_points, select_path_runs
from machopt.planning.stations.planning_path import PlanningPath

COARSE = {1: 9, 2: 5, 3: 4}  # values of each joint in the first grid, by how many are free
FINER = 3  # number of times the grid is halved around the best value of each group
STATIONS = 160  # stations at which a value is assessed
STEP = np.radians(15.0)  # of rotation, there
LOST = 1e3  # price of J for all stations lost: a value that loses fewer is better
CAPS = 48  # maximum number of caps on the worst index
RAPID = 1.5  # factor of the travel to another value (:mod:`machopt.planning.cost.objective`, b)

LEAST, FREE = range(2)  # stage of the assessment of a value


@dataclass(frozen=True, kw_only=True)
class ValueAssessment:
    """Estimate of a value for one group, at some stations; a lower bound where it is not assessed to the end."""

    value: Array  # (E,) m or rad
    lost: float  # share of the stations without a free pose, or behind a break
    mean: float  # over the length the group cuts, in the unit of the index
    worst: float  # the same
    motion: float  # other terms of J, within the group
    by: int  # LEAST or FREE


class FixedValueSearch:
    """Search over the values of all groups; ``scale`` is c₀."""

    def __init__(
        self,
        setup: PlanningSetup,
        options: PlanOptions,
        path: PlanningPath,
        groups: list[OperationGroup],
        axes: Sequence[ExternalJointOptions],
        scale: float | None,
    ) -> None:
        self.requested_scale = scale
        self.setup, self.path, self.groups, self.axes = setup, path, groups, axes
        self.options = replace(options, rotation_step=max(options.rotation_step, STEP))
        self.home = setup.cell.external_home
        self.parts = [select_path_runs(path, g.runs, STATIONS) for g in groups]
        self.across = [compute_sideways_directions(part) for part in self.parts]
        self.assessed: list[dict[bytes, ValueAssessment]] = [{} for _ in groups]
        self.excluded: list[set[bytes]] = [set() for _ in groups]
        self.per = setup.per_rad[6:]
        self.worth = AxisPlanRanking.build(setup, axes)
        self.weight = self.worth.weight
        self.medians: list[float] = []
        self.median = 1.0  # running median of the costs; read tens of thousands of times
        self.short = np.ones(len(groups))  # least share of the stations of each that a value does not reach

    @property
    def scale(self) -> float:
        """c₀: where it is not given, the median over groups and values of the median cost over the candidates."""
        return self.requested_scale or self.median

    @property
    def out_of_reach(self) -> bool:
        """Whether some group has no value that reaches all of its stations."""
        return bool((self.short > 0).any())

    # --- which values are assessed ------------------------------------------------------------------------------------

    def assess(self) -> None:
        """Assess the coarse grid of every group, then finer ones around its best value."""
        for n, group in enumerate(self.groups):
            free = np.flatnonzero(group.high > group.low)
            count = COARSE.get(len(free), 4)
            step = (group.high - group.low) / (count - 1)
            grid = [np.linspace(a, b, count if b > a else 1) for a, b in zip(group.low, group.high, strict=True)]
            inside = group.snapped(self.home)
            self._assess_values(n, [inside, *map(np.array, itertools.product(*grid))])
            if (
                len(free) > 1
            ):  # each joint alone as finely as if the others were locked: more freedom never makes the result worse
                for k in free:
                    self._assess_single_joint(n, int(k), inside)
            for _ in range(FINER):
                step = 0.5 * step
                centre = self._find_best(n, self.assessed[n]).value
                around = [(-1.0, 0.0, 1.0) if k in free else (0.0,) for k in range(len(step))]
                sides = map(np.array, itertools.product(*around))
                self._assess_values(n, [np.clip(centre + side * step, group.low, group.high) for side in sides])

    def _assess_single_joint(self, n: int, k: int, inside: Array) -> None:
        """Assess the values of joint ``k`` with the others at home: the grid of one joint, and a finer one around
        its best.
        """
        group = self.groups[n]
        off = np.arange(len(inside)) == k
        values = np.linspace(group.low[k], group.high[k], COARSE[1])
        self._assess_values(n, [np.where(off, v, inside) for v in values])
        step = (group.high[k] - group.low[k]) / (COARSE[1] - 1)
        for _ in range(FINER):
            step = 0.5 * step
            own = [key for key, j in self.assessed[n].items() if np.array_equal(j.value[~off], inside[~off])]
            centre = self._find_best(n, own).value
            self._assess_values(n, [np.clip(centre + side * off, group.low, group.high) for side in (-step, step)])

    # --- assessment --------------------------------------------------------------------------------------------------

    def _assess_values(self, n: int, values: Sequence[Array]) -> None:
        """Assess the allowed values nearest to given ones by the least index of each station, unless already
        assessed.
        """
        allowed = [self.groups[n].snapped(v) for v in values]
        new = {v.tobytes(): v for v in allowed if v.tobytes() not in self.assessed[n]}
        every = list(new.values())

        def assess_values() -> tuple[tuple[ValueAssessment, float | None], ...]:
            return tuple(map_in_threads(lambda v: self._assess_least_index(n, v), every))

        for key, (assessed, median) in zip(
            new, compute_cached("places", lambda: self._list_dependencies(n, every), assess_values), strict=True
        ):
            self.assessed[n][key] = assessed
            self.short[n] = min(self.short[n], assessed.lost)
            if median is not None:
                self.medians.append(median)
        self.median = float(np.median(self.medians)) if self.medians else 1.0

    def _build_candidates(self, n: int, value: Array) -> tuple[PlanningPath, CandidateGrid, CandidateScores] | None:
        """Return the candidates at a value (E,), or along (n, E), and their cost; None where no pose is in reach."""
        part, setup = fix_external_axes(self.parts[n], value), self.setup
        candidates = enumerate_candidates(part, setup.arm, self.options)
        if not candidates.feasible.any():
            return None
        d = compute_load_directions(part, setup.arm, setup.elasticity, self.options.force, self.across[n])
        return part, candidates, score_candidates(part, candidates, setup.elasticity, d, self.options)

    def _assess_least_index(self, n: int, value: Array) -> tuple[ValueAssessment, float | None]:
        found = self._build_candidates(n, value)
        if found is None:
            return ValueAssessment(value=value, lost=1.0, mean=0.0, worst=0.0, motion=0.0, by=FREE), None
        part, _, scores = found
        least = np.where(np.isfinite(scores.cost), scores.cost, np.inf).min(axis=(1, 2))
        there = np.isfinite(least)
        mean = float(part.station_weight[there] @ least[there])
        worst = float(least[there & part.counted[part.stations]].max(initial=0.0))
        return ValueAssessment(
            value=value, lost=1.0 - float(there.mean()), mean=mean, worst=worst, motion=0.0, by=LEAST
        ), scores.scale

    def _list_dependencies(self, n: int, values: Sequence[Array]) -> tuple[object, ...]:
        """Return all inputs that the assessment of a group's values depends on; of the user's requests, those about
        its points.
        """
        part, options = self.parts[n], self.options
        points = set(part.index.tolist())
        fixed = tuple(f for f in options.fixed if f.point in points)
        steer = tuple(w for w in options.steer if not w.joint and len(select_steered_rows(w, part.index)))
        own = replace(options, fixed=fixed, steer=steer)
        return self.setup, own, self.across[n], tuple(getattr(part, f.name) for f in fields(part)), tuple(values)

    def _assess_further(self, n: int, key: bytes) -> None:
        """Assess a value by the next stage."""
        j = self.assessed[n][key]
        self.assessed[n][key] = compute_cached(
            "places", lambda: (*self._list_dependencies(n, [j.value]), j.by), lambda: self._assess_by_next_stage(n, j)
        )

    def _assess_by_next_stage(self, n: int, j: ValueAssessment) -> ValueAssessment:
        found = self._build_candidates(n, j.value)
        if found is None:
            raise AssertionError("points out of reach are evaluated completely")
        part, candidates, scores = found
        choice, colliding = choose_collision_free_sequence(part, candidates, scores, self.setup, self.options)
        return self._assess_choice(j.value, part, scores, choice, colliding)

    def _assess_choice(
        self, value: Array, part: PlanningPath, scores: CandidateScores, choice: SequenceChoice, colliding: int
    ) -> ValueAssessment:
        there, w = np.flatnonzero(~choice.dropped), self.options.weights
        cost = scores.cost[there, choice.rotation[there], choice.branch[there]]
        share, counted = part.station_weight[there], part.counted[part.stations[there]]
        mean, worst = float(share @ cost), float(cost[counted].max(initial=0.0))
        motion = choice.total - (w.mean * mean + w.worst * worst) / scores.scale
        lost = (int(choice.dropped.sum()) + len(choice.broken) + colliding) / len(choice.rotation)
        return ValueAssessment(value=value, lost=lost, mean=mean, worst=worst, motion=motion, by=FREE)

    def _find_best(self, n: int, keys: Iterable[bytes]) -> ValueAssessment:
        """Return the best of some values of a group by itself, assessed to the end."""
        every = list(keys)
        while True:
            key = min(every, key=lambda k: self._rank(self.assessed[n][k]))
            if self.assessed[n][key].by == FREE:
                return self.assessed[n][key]
            self._assess_further(n, key)

    def _rank(self, j: ValueAssessment) -> float:
        """J of a group by itself."""
        return self._compute_group_value(j) + self.options.weights.worst * j.worst / self.scale

    def _compute_group_value(self, j: ValueAssessment) -> float:
        return (
            LOST * j.lost
            + self.options.weights.mean * j.mean / self.scale
            + j.motion
            + self._price_preferences(j.value)
        )

    def _price_preferences(self, value: Array) -> float:
        """Return the price of a deviation from the preferred values."""
        return float(self.worth.liked(value * self.per))

    # --- of all groups -----------------------------------------------------------------------------------------------

    def at_home(self) -> list[Array]:
        """Return the home value, or the allowed one nearest to it, for every group."""
        return [g.snapped(self.home) for g in self.groups]

    def exclude(self, n: int, value: Array, share: float) -> None:
        """Exclude the values of a group near a given one.

        Args:
            n: index of the group.
            value: (E,) m or rad.
            share: half-width of the excluded range, as a share of a coarse grid step.
        """
        group = self.groups[n]
        step = (group.high - group.low) / max(COARSE.get(int((group.high > group.low).sum()), 4) - 1, 1)
        near = share * step + 1e-12
        self.excluded[n] |= {key for key, j in self.assessed[n].items() if (np.abs(j.value - value) <= near).all()}

    def estimate(self, values: Sequence[Array]) -> float:
        """Return J of assessed values, estimated at the stations.

        Args:
            values: (E,) m or rad, for each group.
        """
        chosen = [self._find_best(n, [value.tobytes()]) for n, value in enumerate(values)]
        worst = max(j.worst for j in chosen) / self.scale
        return sum(g.share * self._compute_group_value(j) for g, j in zip(self.groups, chosen, strict=True)) + (
            self.options.weights.worst * worst + self._price_travel(values)
        )

    def rate_along(self, external: Array) -> float:
        """Return a quick estimate of J of moving joints: the least index of each station, and their own travel.

        Args:
            external: (P, E) m or rad, external joints along the path.
        """
        w, worst, total = self.options.weights, 0.0, 0.0
        for n, group in enumerate(self.groups):
            j, _ = self._assess_least_index(n, external[list_run_points(self.path, group.runs)])
            total += group.share * (LOST * j.lost + w.mean * j.mean / self.scale)
            worst = max(worst, j.worst)
        terms = ObjectiveTerms.build(self.path, self.setup.velocity, self.options)
        ways = np.abs(np.diff(external * self.per, axis=0)) @ self.weight
        return total + w.worst * worst / self.scale + w.travel * float(terms.travel[1:] @ ways)

    def estimate_along(self, external: Array) -> float:
        """Return J of moving joints, estimated at the stations.

        Args:
            external: (P, E) m or rad, external joints along the path.
        """
        w, worst = self.options.weights, 0.0
        total = float(self.path.weight @ self.worth.liked(external * self.per))
        for n, group in enumerate(self.groups):
            own = external[list_run_points(self.path, group.runs)]
            found = self._build_candidates(n, own)
            if found is None:
                total += group.share * LOST
                continue
            part, candidates, scores = found
            scores = replace(scores, scale=self.scale)
            rapid = build_rapid_pricing(part, self.setup, scores.least, candidates.stable, self.options)
            scores = replace(scores, rapid=rapid)
            choice, colliding = choose_collision_free_sequence(part, candidates, scores, self.setup, self.options)
            j = self._assess_choice(own, part, scores, choice, colliding)
            total += group.share * (LOST * j.lost + w.mean * j.mean / self.scale + j.motion)
            worst = max(worst, j.worst)
        terms = ObjectiveTerms.build(self.path, self.setup.velocity, self.options)
        ways = np.abs(np.diff(external * self.per, axis=0)) @ self.weight
        return total + w.worst * worst / self.scale + w.travel * float(terms.travel[1:] @ ways)

    def _price_travel(self, values: Sequence[Array]) -> float:
        ways = np.abs(np.diff([self.home, *values, self.home], axis=0)) @ (self.weight * self.per)
        shares = np.array([g.share for g in self.groups])
        return float(self._price * np.r_[shares, shares[-1]] @ ways)

    @property
    def _price(self) -> float:
        return self.options.weights.travel * RAPID / np.pi

    def chain(self) -> list[Array] | None:
        """Return the cheapest values of all groups among the remaining ones; None where a group has none."""
        left = [[k for k in own if k not in out] for own, out in zip(self.assessed, self.excluded, strict=True)]
        if not all(left):
            return None
        while True:
            chosen = self._find_cheapest_chain(
                [[own[k] for k in keys] for own, keys in zip(self.assessed, left, strict=True)]
            )
            unknown = [n for n, j in enumerate(chosen) if j.by < FREE]
            if not unknown:
                return [j.value for j in chosen]
            for n in unknown:
                self._assess_further(n, chosen[n].value.tobytes())

    def _find_cheapest_chain(self, assessed: list[list[ValueAssessment]]) -> list[ValueAssessment]:
        worsts = np.unique([j.worst for own in assessed for j in own])
        floor = max(min(j.worst for j in own) for own in assessed)
        caps = worsts[worsts >= floor]
        caps = caps[np.unique(np.linspace(0, len(caps) - 1, min(len(caps), CAPS)).round().astype(int))]
        return min((self._find_chain_under(assessed, float(cap)) for cap in caps), key=lambda f: f[0])[1]

    def _find_chain_under(
        self, assessed: list[list[ValueAssessment]], cap: float
    ) -> tuple[float, list[ValueAssessment]]:
        """Return the cheapest chain whose worst index is at most ``cap``, and its J."""
        before, at = np.zeros(1), self.home[None]
        back = []
        for group, every in zip(self.groups, assessed, strict=True):
            allowed = [j for j in every if j.worst <= cap]
            here = np.array([j.value for j in allowed])
            ways = np.abs(here[:, None] - at[None]) @ (self.weight * self.per)
            total = before[None] + self._price * group.share * ways
            back.append((total.argmin(axis=1), allowed))
            before = total.min(axis=1) + np.array([group.share * self._compute_group_value(j) for j in allowed])
            at = here
        last = before + self._price * self.groups[-1].share * (np.abs(at - self.home) @ (self.weight * self.per))
        k, chosen = int(last.argmin()), []
        found = float(last[k]) + self.options.weights.worst * cap / self.scale
        for source, allowed in reversed(back):
            chosen.append(allowed[k])
            k = int(source[k])
        return found, chosen[::-1]
