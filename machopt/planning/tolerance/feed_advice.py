"""Largest feed at which each point with a tolerance still passes.

The probability falls as the load grows, but for a path that is compensated, or an offset that the load counters: it
then falls on both sides of a load, and the largest load that passes is found from above, in ``STEPS`` steps. Of a hole
the load is thrust and torque, which grow with the feed as f^(1 − mc) (the chisel edge with f): the largest thrust is
found first, then its feed. Of a milled point the load is affine in the feed per tooth. A feed is searched within the
chip thickness that the coefficients hold for; where they state none, up to ``WIDEST`` times the programmed feed. Zero:
no feed suffices, because edge forces or the clamp alone are too much. Few draws find a feed. Every feed is confirmed
with all of them and its own load, and searched again with all of them where it does not pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import ProcessOperation
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.random_draws import UncertaintyDraws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.tolerance.error_sensitivities import compute_twist_columns
from machopt.planning.tolerance.hole_errors import HoleErrorModel, HoleTerms
from machopt.planning.tolerance.surface_errors import (
    BLOCK,
    SurfaceErrorModel,
    compute_load_factors,
    compute_surface_probability,
    draw_surface_errors,
    take_surface_targets,
)
from machopt.planning.tolerance.wall_force import compute_wall_forces
from machopt.process.binding.cutting_tools import build_drilling_layers, build_drilling_tool, build_milling_cutter
from machopt.process.binding.point_loads import SAME_DEPTH, PointLoads, compute_mean_wear
from machopt.process.drilling.feed_inversion import find_largest_feed
from machopt.process.drilling.stroke_phases import DrillingStroke, build_drilling_stroke, compute_stroke_maximum
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter
from machopt.process.stock.contact_load import compute_contact_load

DRAWS = 256
STEPS = 24  # of the search from above; the programmed feed is one of them
HALVINGS = 8
CORRECTED = 0.8  # least share of a feed that remains after the correction by all draws
WIDEST = 3.0  # times the programmed feed
CONFIRMED = 1e-9  # share by which a load may differ from the one that all draws have confirmed
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True)
class FeedLimits:
    """Largest feeds."""

    rows: NDArray[np.intp]  # (n,) toolpath points
    feed: Array  # (n,) m/s; 0: no feed suffices


class HoleFeedSearch:
    """Search for the largest feeds of holes at which all draws give the quantile."""

    def __init__(
        self, plan: Plan, model: HoleErrorModel, loads: PointLoads, draw_terms: Callable[[int], HoleTerms]
    ) -> None:
        """Prepare the search.

        Args:
            plan: Plan of one tool.
            model: Error model of the holes.
            loads: Loads of the toolpath.
            draw_terms: Draws the parts of the errors of a hole.
        """
        self.plan, self.model, self.loads, self.draw_terms = plan, model, loads, draw_terms
        self.depth = {hole.deepest: hole.depth for hole in loads.holes}

    def find_feeds(self, load_scales: Array) -> FeedLimits:
        """Return the largest feeds; 0 where none suffices, NaN where the load scale is not known.

        Args:
            load_scales: (H,) factors by which thrust and torque may grow, of :func:`find_load_scale`.
        """
        targets = self.model.targets
        feeds = np.where(load_scales == 0.0, 0.0, np.full(len(targets.row), np.nan))
        groups: dict[tuple[int, float], list[int]] = {}  # operation and depth: holes
        for h in np.flatnonzero(load_scales > 0.0).tolist():
            key = int(targets.operation[h]), round(self.depth[int(targets.row[h])], SAME_DEPTH)
            groups.setdefault(key, []).append(h)
        for (k, _), holes in groups.items():
            some = np.array(holes, np.intp)
            feeds[some] = self._find_group(self.model.process.operations[k], some, load_scales[some])
        return FeedLimits(targets.row, feeds)

    def _find_group(self, one: ProcessOperation, holes: NDArray[np.intp], scales: Array) -> Array:
        """Return (n,) m/s of holes of one operation and depth."""
        row = self.model.targets.row[holes]
        tool = build_drilling_tool(self.plan.setup.cell.tool.cutter, one)
        stroke = build_drilling_stroke(tool, build_drilling_layers(self.model.process, one))
        depth, bite = self.depth[int(row[0])], self.loads.bite[row]
        thrust = scales * self.model.targets.thrust[holes] / compute_mean_wear(one)
        per_turn = np.minimum(find_largest_feed(stroke, thrust, depth), WIDEST * bite)
        changes = _compute_load_changes(stroke, depth, bite, per_turn)
        for n in np.flatnonzero((np.abs(changes - scales[:, None]) > CONFIRMED * scales[:, None]).any(axis=1)).tolist():
            terms = self.draw_terms(int(holes[n]))
            if not self._check_passes(terms, changes[n : n + 1])[0]:
                per_turn[n] = self._find_lower(terms, stroke, float(bite[n]), float(per_turn[n]))
        return np.asarray(per_turn * self.loads.spindle_speed[row])

    def _check_passes(self, terms: HoleTerms, changes: Array) -> list[bool]:
        """Return whether a hole passes with all draws at each factor of thrust and torque, (n, 2)."""
        return [terms.compute_probability(f, m) >= self.model.process.quantile for f, m in changes.tolist()]

    def _find_lower(self, terms: HoleTerms, stroke: DrillingStroke, bite: float, feed: float) -> float:
        """Return the largest feed per revolution below one that passes with all draws; 0 where none does."""
        depth = self.depth[int(self.model.targets.row[terms.hole])]
        steps = feed * np.arange(STEPS - 1, 0, -1) / STEPS
        passed = np.flatnonzero(
            self._check_passes(terms, _compute_load_changes(stroke, depth, np.array([bite]), steps))
        )
        if not len(passed):
            return 0.0
        low = float(steps[passed[0]])
        high = low + feed / STEPS
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            change = _compute_load_changes(stroke, depth, np.array([bite]), np.array([middle]))
            low, high = (middle, high) if self._check_passes(terms, change)[0] else (low, middle)
        return low


def _compute_load_changes(stroke: DrillingStroke, depth: float, bite: Array, feed: Array) -> Array:
    """Return (n, 2) factors of thrust and torque from a feed per revolution to another.

    Both change by different laws, where a chisel edge cuts.
    """
    new, old = (compute_stroke_maximum(stroke, f, depth) for f in (feed, bite))
    return np.stack([new.thrust / old.thrust, new.torque / old.torque], axis=1)


def find_load_scale(every: HoleTerms) -> float:
    """Return by which factor thrust and torque of a hole may grow; 0 where the clamp alone is too much, NaN where its
    force does not follow from the feed.

    Args:
        every: Drawn parts of its errors; the first ``DRAWS`` find the factor, all of them confirm it.
    """
    model, h, terms = every.model, every.hole, every.take_first(DRAWS)
    quantile = model.process.quantile
    if not model.targets.thrust[h] > 0 or model.process.operations[model.targets.operation[h]].kind == "force":
        return float("nan")
    target = model.process.quantile

    def passes(scale: float) -> bool:
        return terms.compute_probability(scale) >= target

    scales = [WIDEST * n / STEPS for n in range(STEPS + 1)]
    n = next((n for n in range(STEPS, -1, -1) if passes(scales[n])), -1)
    if n < 0 or n == STEPS:
        low = scales[n] if n > 0 else 0.0
    else:
        low, high = scales[n], scales[n + 1]
        for _ in range(2):
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if passes(middle) else (low, middle)
            excess = terms.compute_probability(low) - every.compute_probability(low)
            if excess <= 0.0 or target > quantile:
                break
            target, high = quantile + excess, low
            low = CORRECTED * low
    return low if low == 0.0 or every.compute_probability(low) >= quantile else _find_lower_scale(every, low)


def _find_lower_scale(every: HoleTerms, scale: float) -> float:
    """Return the largest factor below one at which a hole passes with all draws; 0 where there is none."""
    quantile = every.model.process.quantile
    n = next((n for n in range(STEPS - 1, 0, -1) if every.compute_probability(scale * n / STEPS) >= quantile), 0)
    low, high = scale * n / STEPS, scale * (n + 1) / STEPS
    for _ in range(HALVINGS if n else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if every.compute_probability(middle) >= quantile else (low, middle)
    return low


def find_surface_feeds(
    plan: Plan, model: SurfaceErrorModel, loads: PointLoads, spread: StiffnessSpread, draws: UncertaintyDraws
) -> FeedLimits:
    """Return the largest feeds of milled points.

    Args:
        plan: Plan of one tool.
        model: Error model of the points.
        loads: Loads of the toolpath.
        spread: Random part of the stiffness.
        draws: Draws; the first ``DRAWS`` find a feed, all of them correct it.
    """
    rows = model.targets.row
    feeds = np.full(len(rows), np.nan)
    for k in np.unique(model.targets.operation):
        one = model.process.operations[k]
        if one.kind != "milling":
            continue
        for code, side in _SIDES.items():
            mine = np.flatnonzero((model.targets.operation == k) & (loads.side[rows] == code))
            mine = mine[model.poses.is_reached[mine] & model.targets.is_known[mine]]
            for first in range(0, len(mine), BLOCK):
                block = mine[first : first + BLOCK]
                cut = MillingCut(side, one.spindle)
                feeds[block] = _find_milling_feeds(plan, model, loads, draws, one, cut, block, spread)
    return FeedLimits(rows, feeds)


def _find_milling_feeds(
    plan: Plan,
    model: SurfaceErrorModel,
    loads: PointLoads,
    draws: UncertaintyDraws,
    one: ProcessOperation,
    cut: MillingCut,
    block: NDArray[np.intp],
    spread: StiffnessSpread,
) -> Array:
    coefficients = model.process.materials[one.material].milling
    assert coefficients is not None
    rows = model.targets.row[block]
    cutter = build_milling_cutter(plan.setup.cell.tool.cutter)
    edge, slope = (compute_mean_wear(one) * part for part in _compute_load_parts(model, loads, one, cut, cutter, rows))
    own = take_surface_targets(model, block)
    per_load = [_project_load(plan, own, spread, part) for part in (edge, slope)]
    least, largest = coefficients.h_range_m
    bite = loads.bite[rows]
    low, high = np.full(len(rows), least), np.minimum(np.full(len(rows), largest), WIDEST * bite)
    high = np.maximum(high, low)

    std = np.nan_to_num(own.scatter.std)
    few, quantile = draws.take_first(DRAWS), model.process.quantile
    factors = {id(some): compute_load_factors(own, slice(None), some) for some in (few, draws)}

    bends = _compute_tool_bends(plan, own, loads, one, (low, high))
    span = np.where(high > low, high - low, 1.0)

    def compute_probability(feed: Array, some: UncertaintyDraws, which: NDArray[np.intp]) -> Array:
        columns, tool = own.columns.copy(), own.tool.copy()
        edge, slope = (part if len(part) == 1 else part[which] for part in per_load)
        columns[which] = edge + slope * feed[:, None]
        tool[which] = bends[0][which] + (bends[1] - bends[0])[which] * (feed - low[which]) / span[which]
        factor = factors[id(some)]
        factor = factor if len(factor) == 1 else factor[which]
        errors = draw_surface_errors(replace(own, columns=columns, tool=tool), which, some, factor, position=True)
        return compute_surface_probability(errors, np.full(len(which), one.tolerance.surface), std[which])

    every = np.arange(len(rows))
    widest = compute_probability(high, few, every) >= quantile
    ok, found = widest.copy(), high.copy()
    left = np.flatnonzero(~widest)  # points with a feed to be found
    if len(left):
        search = _FeedSearch(lambda feed, which: compute_probability(feed, few, left[which]), quantile, least)
        best, good = search.find_feeds(low[left], high[left])
        excess = compute_probability(best, few, left) - compute_probability(best, draws, left)
        ok[left], found[left] = good, search.correct_feeds(best, excess)
    fails = np.flatnonzero(ok)[compute_probability(found[ok], draws, np.flatnonzero(ok)) < quantile]
    if len(fails):  # all draws, below the feed that the first ones found
        search = _FeedSearch(lambda feed, which: compute_probability(feed, draws, fails[which]), quantile, least)
        found[fails], ok[fails] = search.find_feeds(low[fails], found[fails])
    return np.where(ok, found * loads.spindle_speed[rows] * cutter.teeth, 0.0)


def _compute_tool_bends(
    plan: Plan, model: SurfaceErrorModel, loads: PointLoads, one: ProcessOperation, bites: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return (n,) m the deflection of the tool along the normal at two feeds per tooth; between them it is linear."""
    cutter, coefficients = plan.setup.cell.tool.cutter, model.process.materials[one.material].milling
    assert coefficients is not None
    if cutter is None or cutter.side_stiffness is None:
        return np.zeros(len(bites[0])), np.zeros(len(bites[0]))
    share = np.sum(model.normal * model.poses.normal, axis=1) / cutter.side_stiffness
    low, high = (
        share * compute_wall_forces(one, cutter, coefficients, loads, model.targets.row, bite) for bite in bites
    )
    return low, high


@dataclass(frozen=True)
class _FeedSearch:
    """Search for the largest feeds per tooth whose probability reaches a target."""

    compute_probability: Callable[[Array, NDArray[np.intp]], Array]  # feeds (m,) m of points (m,) → (m,)
    quantile: float
    least: float  # m

    def find_feeds(self, low: Array, high: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the largest feeds (n,) m that pass between least and largest feeds, and whether there are any."""
        every = np.arange(len(low))
        target = np.full(len(low), self.quantile)
        ok = self.compute_probability(low, every) >= self.quantile
        lower, upper, found = low.copy(), low + (high - low) / STEPS, np.zeros(len(low), bool)
        for n in range(STEPS - 1, 0, -1):  # the highest interval whose lower end passes
            left = np.flatnonzero(~found)
            if not len(left):
                break
            feed = (low + n / STEPS * (high - low))[left]
            good = self.compute_probability(feed, left) >= self.quantile
            lower[left[good]] = feed[good]
            upper[left[good]] = (low + (n + 1) / STEPS * (high - low))[left[good]]
            found[left[good]] = True
        ok |= found
        searched = np.flatnonzero(ok)
        best = lower.copy()
        best[searched] = self._halve(lower[searched], upper[searched], searched, target[searched])
        return best, ok

    def correct_feeds(self, feed: Array, excess: Array) -> Array:
        """Return smaller feeds (n,) where all draws have a probability that is lower by an excess."""
        too_large = np.flatnonzero((excess > 0.0) & (feed > self.least))
        out = feed.copy()
        begin = np.maximum(CORRECTED * feed[too_large], self.least)
        out[too_large] = self._halve(begin, feed[too_large], too_large, self.quantile + excess[too_large])
        return out

    def _halve(self, low: Array, high: Array, which: NDArray[np.intp], target: Array) -> Array:
        """Return (m,) the largest feeds that pass, by halving from feeds that pass to feeds that do not."""
        if not len(which):
            return low
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            good = self.compute_probability(middle, which) >= target
            low, high = np.where(good, middle, low), np.where(good, high, middle)
        return low


def _compute_load_parts(
    model: SurfaceErrorModel,
    loads: PointLoads,
    one: ProcessOperation,
    cut: MillingCut,
    cutter: MillingCutter,
    rows: NDArray[np.intp],
) -> tuple[Array, Array]:
    """Return the load for a feed per tooth of zero, and its change by it: (n, 4), or (1, 4) where all are equal."""
    coefficients = model.process.materials[one.material].milling
    assert coefficients is not None
    if one.takes_stock:
        assert loads.engagement is not None
        edge, slope = compute_contact_load(coefficients, cutter, cut, loads.engagement)
        return edge[rows], slope[rows]
    load = compute_mean_load(coefficients, cutter, cut, float(loads.ae[rows[0]]), float(loads.ap[rows[0]]))
    return load.edge, load.slope


def _project_load(plan: Plan, model: SurfaceErrorModel, spread: StiffnessSpread, part: Array) -> Array:
    """Return (n, 1 + R) the error along the normal by a part of the load, (n, 4) or (1, 4).

    Its columns are travel, normal, axial, torque.
    """
    poses = model.poses
    force = part[:, :1] * poses.travel + part[:, 1:2] * poses.normal + part[:, 2:3] * poses.axis
    twist = compute_twist_columns(plan, spread, poses, np.hstack([force, part[:, 3:] * poses.axis]))
    return np.asarray(np.einsum("mi,mir->mr", model.normal, twist[:, :3]))
