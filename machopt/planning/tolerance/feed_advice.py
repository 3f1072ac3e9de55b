"""Largest feed at which each point with a tolerance still passes.

The probability falls as the load grows, but for a path that is compensated, or an offset that the load counters: it
then falls on both sides of a load, and the largest load that passes is found from above, in ``STEPS`` steps. Of a hole
the load is thrust and torque, which grow with the feed as f^(1 − mc) (the chisel edge with f): the largest thrust is
found first, then its feed. Of a milled point the load is affine in the feed per tooth. A feed is searched within the
chip thickness that the coefficients hold for; where they state none, up to ``WIDEST`` times the programmed feed. Zero:
no feed suffices, because edge forces or the clamp alone are too much.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import ProcessOperation
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.draws import UncertaintyDraws
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.pipeline.plan import Plan
from machopt.planning.tolerance.error_columns import compute_twist_columns
from machopt.planning.tolerance.hole_errors import HoleErrorModel, compute_hole_probability, draw_hole_terms
from machopt.planning.tolerance.surface_errors import (
    BLOCK,
    SurfaceErrorModel,
    compute_load_factors,
    compute_surface_probability,
    draw_surface_errors,
    take_surface_targets,
)
from machopt.process.binding.cutting_tools import build_drilling_layers, build_drilling_tool, build_milling_cutter
from machopt.process.binding.point_loads import PointLoads, compute_mean_wear
from machopt.process.drilling.feed_inversion import find_largest_feed
from machopt.process.drilling.stroke_phases import build_drilling_stroke
from machopt.process.milling.mean_force import compute_mean_load
from machopt.process.milling.milling_cut import CutSide, MillingCut, MillingCutter
from machopt.process.stock.contact_load import compute_contact_load

DRAWS = 256
STEPS = 24  # of the search from above; the programmed feed is one of them
HALVINGS = 8
CORRECTED = 0.8  # least share of a feed that remains after the correction by all draws
WIDEST = 3.0  # times the programmed feed
_SIDES: dict[int, CutSide] = {1: "up", -1: "down", 0: "slot"}


@dataclass(frozen=True)
class FeedLimits:
    """Largest feeds."""

    rows: NDArray[np.intp]  # (n,) toolpath points
    feed: Array  # (n,) m/s; 0: no feed suffices


def find_hole_feeds(plan: Plan, model: HoleErrorModel, loads: PointLoads, draws: UncertaintyDraws) -> FeedLimits:
    """Return the largest feeds of holes.

    Args:
        plan: Plan of one tool.
        model: Error model of the holes.
        loads: Loads of the toolpath.
        draws: Draws; the first ``DRAWS`` find a feed, all of them correct it.
    """
    targets = model.targets
    feeds = np.full(len(targets.row), np.nan)
    depth_by_row = {hole.deepest: hole.depth for hole in loads.holes}
    groups: dict[tuple[int, float], list[tuple[int, float]]] = {}  # operation and depth: hole and scale of its load
    for h in range(len(targets.row)):
        if not (model.poses[0].is_reached[h] and model.poses[1].is_reached[h]) or not targets.thrust[h] > 0:
            continue
        k = int(targets.operation[h])
        if model.process.operations[k].kind == "force":
            continue
        scale = _find_load_scale(model, h, draws)
        groups.setdefault((k, depth_by_row[int(targets.row[h])]), []).append((h, scale))
    for (k, depth), found in groups.items():
        holes = np.array([h for h, _ in found], np.intp)
        scales = np.array([scale for _, scale in found])
        feeds[holes] = _find_drilling_feeds(plan, model, model.process.operations[k], depth, holes, scales, loads)
    return FeedLimits(targets.row, feeds)


def _find_load_scale(model: HoleErrorModel, h: int, draws: UncertaintyDraws) -> float:
    """Return by which factor thrust and torque may grow; 0 where the clamp alone is too much."""

    terms = draw_hole_terms(model, h, draws.take_first(DRAWS), position=True)
    target = model.process.quantile

    def passes(scale: float) -> bool:
        return compute_hole_probability(model, h, terms.compute_errors(scale)) >= target

    scales = [WIDEST * n / STEPS for n in range(STEPS + 1)]
    n = next((n for n in range(STEPS, -1, -1) if passes(scales[n])), -1)
    if n < 0 or n == STEPS:
        return scales[n] if n > 0 else 0.0
    low, high = scales[n], scales[n + 1]
    for _ in range(2):
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if passes(middle) else (low, middle)
        few = compute_hole_probability(model, h, terms.compute_errors(low))
        every = draw_hole_terms(model, h, draws, position=True).compute_errors(low)
        excess = few - compute_hole_probability(model, h, every)
        if excess <= 0.0 or target > model.process.quantile:
            return low
        target, high = model.process.quantile + excess, low
        low = CORRECTED * low
    return low


def _find_drilling_feeds(
    plan: Plan,
    model: HoleErrorModel,
    one: ProcessOperation,
    depth: float,
    holes: NDArray[np.intp],
    scales: Array,
    loads: PointLoads,
) -> Array:
    """Return (n,) m/s of holes of one operation and depth whose load may grow by a factor."""
    row = model.targets.row[holes]
    tool = build_drilling_tool(plan.setup.cell.tool.cutter, one)
    stroke = build_drilling_stroke(tool, build_drilling_layers(model.process, one))
    thrust = scales * model.targets.thrust[holes] / compute_mean_wear(one)
    per_turn = np.minimum(find_largest_feed(stroke, thrust, depth), WIDEST * loads.bite[row])
    return np.asarray(np.where(scales > 0.0, per_turn * loads.spindle_speed[row], 0.0))


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
    limit = np.full(len(rows), one.tolerance.surface)
    few, target = draws.take_first(DRAWS), np.full(len(rows), model.process.quantile)
    factors = {id(some): compute_load_factors(own, slice(None), some) for some in (few, draws)}

    def compute_probability(feed: Array, some: UncertaintyDraws) -> Array:
        columns = per_load[0] + per_load[1] * feed[:, None]
        other = replace(own, columns=columns, tool=own.tool * feed / bite)
        errors = draw_surface_errors(other, slice(None), some, factors[id(some)], position=True)
        return compute_surface_probability(errors, limit, std)

    def passes(feed: Array) -> NDArray[np.bool_]:
        return np.asarray(compute_probability(feed, few) >= target)

    ok, widest = passes(low), passes(high)
    low, high, some = _bracket_feeds(low, high, passes)
    ok |= some
    low = _halve_feeds(low, high, passes)
    excess = compute_probability(low, few) - compute_probability(low, draws)
    target = target + np.maximum(excess, 0.0)
    low = np.where(excess > 0.0, _halve_feeds(np.maximum(CORRECTED * low, least), low, passes), low)
    ok &= (low > least) | (compute_probability(low, draws) >= model.process.quantile)
    found = np.where(widest, np.minimum(np.full(len(rows), largest), WIDEST * bite), low)
    return np.where(ok, found * loads.spindle_speed[rows] * cutter.teeth, 0.0)


def _halve_feeds(low: Array, high: Array, passes: Callable[[Array], NDArray[np.bool_]]) -> Array:
    """Return (n,) the largest feeds that pass, by halving from feeds that pass to feeds that do not."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        good = passes(middle)
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


def _bracket_feeds(
    low: Array, high: Array, passes: Callable[[Array], NDArray[np.bool_]]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the highest of ``STEPS`` intervals whose lower end passes, and whether there is one; else the whole range.

    Args:
        low: (n,) m, least feed per tooth.
        high: (n,) m, largest.
        passes: Whether feeds (n,) pass.
    """
    lower, upper, found = low, high, np.zeros(len(low), bool)
    for n in range(STEPS - 1, 0, -1):
        feed = low + n / STEPS * (high - low)
        good = passes(feed) & ~found
        lower = np.where(good, feed, lower)
        upper = np.where(good, low + (n + 1) / STEPS * (high - low), upper)
        found |= good
    return lower, np.where(found, upper, low + (high - low) / STEPS), found


def _project_load(plan: Plan, model: SurfaceErrorModel, spread: StiffnessSpread, part: Array) -> Array:
    """Return (n, 1 + R) the error along the normal by a part of the load, (n, 4) or (1, 4).

    Its columns are travel, normal, axial, torque.
    """
    poses = model.poses
    force = part[:, :1] * poses.travel + part[:, 1:2] * poses.normal + part[:, 2:3] * poses.axis
    twist = compute_twist_columns(plan, spread, poses, np.hstack([force, part[:, 3:] * poses.axis]))
    return np.asarray(np.einsum("mi,mir->mr", model.normal, twist[:, :3]))
