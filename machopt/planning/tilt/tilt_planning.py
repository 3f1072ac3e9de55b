"""Plan of a path with the tilt of a ball cutter as a further freedom."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.compensation.shifted_path import rescore_plan
from machopt.planning.cost.objective import compute_total
from machopt.planning.pipeline.path_planner import PathVariant, plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.stations.tilt_curve import TiltCurve
from machopt.planning.tilt.step_limit import limit_steps
from machopt.planning.tilt.tilt_and_rotation_search import JointSequence, compute_tilt_bound, find_tilt_sequence
from machopt.planning.tilt.tilt_cost_parabolas import build_local_costs, price_tilts
from machopt.planning.tilt.tilt_grid import TiltGrid, build_tilt_grid
from machopt.planning.tilt.tilt_limits import TiltLimits, compute_tilt_limits, hold_outside_cuts
from machopt.planning.tilt.tilt_smoothing import price_tangents, smooth_tilts

REFINEMENTS = 1  # maximum number of times that the tilts are smoothed at the rotation found, and the path planned again
WORTH = 0.02  # decrease of the sum of the smoothing, in units of c₀, from which another plan is made
MOTION_SHARE = 2.0 / 3.0  # of the weights of travel and rotation (benchmarks/tilt_gain.py)


def plan_with_tilt(plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: StageTimings | None = None) -> Plan:
    """Return the better of a plan and one with tilted tool axes; the plan itself where no tilt is permitted.

    J is nearly flat along the trade between motion and the mean index where the tool may tilt. The search prices travel
    and rotation at :data:`MOTION_SHARE` of their weights, which changes J by some tenths of a percent and lowers the
    mean index. Plans are compared by J with the weights of the options.

    Args:
        plan: plan with the axes of the CAM file.
        toolpath: its toolpath.
        options: plan options with the ranges of the tilt.
        timings: receives the duration of the stages.

    Raises:
        InputError: ranges without 0 that no tilt keeps at a sharp corner.
    """
    if not options.tilts or plan.setup.ball_radius == 0.0:
        return plan
    path = plan.path.programmed
    limits = compute_tilt_limits(path, toolpath, options)
    if not limits.is_free.any():
        return plan
    request = _TiltRequest(plan, toolpath, resolve_steering(options, toolpath), limits, timings or StageTimings())
    best = request.plan_tangents(np.zeros_like(path.axis))
    with request.clock.stage("tilt"):
        grid = build_tilt_grid(plan, limits, request.options)
        bound = compute_tilt_bound(plan, grid)
        sequence = find_tilt_sequence(plan, grid, request.search_options)
        if sequence is not None:
            costs = build_local_costs(grid.nodes, limits, sequence.stations.astype(np.intp), sequence.cost)
            start = _spread_tangents(path, sequence)
            tangent = smooth_tilts(path, costs, limits, request.search_options, start)
    if sequence is not None:
        best = min(request.plan_tangents(tangent), best, key=_rank)
        best = request.refine(best, grid)
    return replace(best, tilt_bound=bound)


@dataclass(frozen=True)
class _TiltRequest:
    """A plan with the axes of the CAM file, and what tilted plans of the same path follow from."""

    plan: Plan
    toolpath: Toolpath
    options: PlanOptions
    limits: TiltLimits
    clock: StageTimings

    @property
    def search_options(self) -> PlanOptions:
        """The options with the prices of motion in the search."""
        w = self.options.weights
        cheaper = replace(w, travel=MOTION_SHARE * w.travel, rotation=MOTION_SHARE * w.rotation)
        return replace(self.options, weights=cheaper)

    def plan_tangents(self, tangent: Array) -> Plan:
        """Return the plan of the path tilted by tangents (P, 3) along the cuts; J has the weights of the options."""
        plan, path, setup = self.plan, self.plan.path.programmed, self.plan.setup
        even = limit_steps(path, self.limits, tangent, setup.ball_radius)
        curve = TiltCurve(path.index, _tilt_axes(path, self.limits, even), setup.ball_radius)
        if np.array_equal(curve.axis, path.axis):
            return replace(plan, path=curve.tilt_path(path))
        found = plan_path(
            setup.cell,
            self.toolpath,
            self.search_options,
            self.clock,
            variant=PathVariant(plan.path.external if setup.cell.external_joints else None, curve),
            scale=plan.scores.scale,
            before=plan,
        )
        weights, grid = self.options.weights, found.grid
        dearer = (1.0 - MOTION_SHARE) * (weights.travel * grid.travel + weights.rotation * grid.rotation)
        found = replace(
            found,
            options=self.options,
            grid=replace(grid, total=compute_total(grid, weights, found.scores.elsewhere)),
            choice=replace(found.choice, total=found.choice.total + dearer),  # its bound holds: motion costs more in J
            cam_default=plan.cam_default,
            jiao2022=plan.jiao2022,
        )
        return rescore_plan(found, found.chosen.assignment)

    def refine(self, best: Plan, grid: TiltGrid) -> Plan:
        """Return a plan whose tilts are smoothed at its own rotation, where that is worth another plan."""
        path = self.plan.path.programmed
        for _ in range(REFINEMENTS):
            with self.clock.stage("tilt"):
                a, rows = best.chosen.assignment, path.stations.astype(np.intp)
                prices = price_tilts(self.plan, grid.nodes, rows, a.phi, a.q)
                costs = build_local_costs(grid.nodes, self.limits, rows, prices)
                start, options = _measure_tangents(best), self.search_options
                tangent = smooth_tilts(path, costs, self.limits, options, start)
                tangent = limit_steps(path, self.limits, tangent, self.plan.setup.ball_radius)
                before, after = (price_tangents(path, costs, options, w) for w in (start, tangent))
            if before - after < WORTH:
                break
            refined = self.plan_tangents(tangent)
            if not _rank(refined) < _rank(best):
                break
            best = refined
        return best


def return_to_cam_axes(plan: Plan) -> Plan:
    """Return a plan along the path of the CAM file with its configurations, for errors of the surface.

    Args:
        plan: plan, tilted or not.
    """
    if plan.path.untilted is None:
        return plan
    path = plan.path.programmed
    if plan.compensation is not None:
        path = path.shift_positions(plan.compensation.offset)
    return replace(plan, path=path)


def _rank(plan: Plan) -> tuple[int, float]:
    """Return what a better plan has less of: points without a configuration and breaks, then J."""
    lost = len(plan.missing) + len(plan.breaks)
    total = plan.chosen.objective.total
    return lost, total if np.isfinite(total) else np.inf


def _tilt_axes(path: PlanningPath, limits: TiltLimits, tangent: Array) -> Array:
    """(P, 3) unit axes of tangents along the cuts, kept outside of them."""
    allowed_tangent = hold_outside_cuts(path, limits, tangent)
    return np.where(
        np.abs(allowed_tangent).max(axis=1, keepdims=True) > 0,
        normalise_vectors(path.axis + allowed_tangent),
        path.axis,
    )


def _measure_tangents(plan: Plan) -> Array:
    """(P, 3) a'/(a'·a) − a of a tilted plan."""
    path, cam = plan.path, plan.path.programmed
    along = np.sum(path.axis * cam.axis, axis=1, keepdims=True)
    return np.asarray(path.axis / along - cam.axis)


def _spread_tangents(path: PlanningPath, sequence: JointSequence) -> Array:
    """Tangents (P, 3) at all planning points, evenly between the coarse stations."""
    out = np.zeros((len(path.index), 3))
    for first, last in path.runs:
        inside = (sequence.stations >= first) & (sequence.stations <= last) & np.isfinite(sequence.phi)
        mine = np.flatnonzero(inside)
        if len(mine):
            rows, at = slice(first, last + 1), path.s[sequence.stations[mine]]
            for c in range(3):
                out[rows, c] = np.interp(path.s[rows], at, sequence.tangent[mine, c])
    return out
