"""Plan of a path with the tilt of a ball cutter as a further freedom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.steering_rules import resolve_steering
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan import Plan, TiltBound
from machopt.planning.pipeline.planning_setup import StageTimings
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.stations.tilt_curve import TiltCurve
from machopt.planning.tilt.joint_search import JointSequence, compute_least_mean, find_tilt_sequence
from machopt.planning.tilt.tilt_grid import build_tilt_grid
from machopt.planning.tilt.tilt_limits import TiltLimits, compute_tilt_limits, hold_outside_cuts
from machopt.planning.tilt.tilt_smoothing import follow_tangents, smooth_tilts

REFINEMENTS = 2  # tilts at the rotation found, then the rotation again


def plan_with_tilt(plan: Plan, toolpath: Toolpath, options: PlanOptions, timings: StageTimings | None = None) -> Plan:
    """Return the better of a plan and one with tilted tool axes; the plan itself where no tilt is permitted.

    Args:
        plan: plan with the axes of the CAM file.
        toolpath: its toolpath.
        options: plan options with the ranges of the tilt.
        timings: receives the duration of the stages.
    """
    if not options.tilts or plan.setup.ball_radius == 0.0:
        return plan
    clock, resolved = timings or StageTimings(), resolve_steering(options, toolpath)
    path = plan.path.programmed
    with clock.stage("tilt"):
        limits = compute_tilt_limits(path, toolpath, options)
        if not limits.is_free.any():
            return plan
        grid = build_tilt_grid(plan, limits, resolved)
        least, worst = compute_least_mean(plan, grid)
        bound = TiltBound(mean=least, worst=worst, stations=len(grid.stations), tilts=len(grid.tangent), step=grid.step)
        sequence = find_tilt_sequence(plan, grid, resolved)
    flat = TiltCurve(path.index, _tilted_axes(path, limits, np.zeros_like(path.axis)), plan.setup.ball_radius)
    best = _plan_tilted(plan, toolpath, options, clock, flat)
    if sequence is not None:
        with clock.stage("tilt"):
            tangent = follow_tangents(path, limits, _spread_tangents(path, sequence))
        best = min(_plan_tangents(plan, toolpath, options, clock, limits, tangent), best, key=_rank)
    for _ in range(REFINEMENTS):
        with clock.stage("tilt"):
            a, start = best.chosen.assignment, _measure_tangents(best)
            tangent = smooth_tilts(plan, limits, resolved, a.phi, a.q, start)
        refined = _plan_tangents(plan, toolpath, options, clock, limits, tangent)
        if not _rank(refined) < _rank(best):
            break
        best = refined
    return replace(best, tilt_bound=bound)


def return_to_cam_axes(plan: Plan) -> Plan:
    """Return a plan along the path of the CAM file with its configurations, for errors of the surface.

    Args:
        plan: plan, tilted or not.
    """
    if plan.path.untilted is None:
        return plan
    path = plan.path.programmed
    if plan.compensation is not None:
        path = replace(path, position=path.position + plan.compensation.offset)
    return replace(plan, path=path)


def _plan_tilted(plan: Plan, toolpath: Toolpath, options: PlanOptions, clock: StageTimings, curve: TiltCurve) -> Plan:
    """Return the plan of a tilted path; the plan without tilt where the curve has none."""
    if np.array_equal(curve.axis, plan.path.programmed.axis):
        return replace(plan, path=curve.tilt_path(plan.path.programmed))
    external = plan.path.external if plan.setup.cell.external_joints else None
    return plan_path(
        plan.setup.cell,
        toolpath,
        options,
        clock,
        external=external,
        scale=plan.scores.scale,
        before=plan,
        tilt=curve,
    )


def _rank(plan: Plan) -> tuple[int, float]:
    """Return what a better plan has less of: points without a configuration and breaks, then J."""
    lost = len(plan.missing) + len(plan.breaks)
    total = plan.chosen.objective.total
    return lost, total if np.isfinite(total) else np.inf


def _tilted_axes(path: PlanningPath, limits: TiltLimits, tangent: Array) -> Array:
    """(P, 3) unit axes of tangents along the cuts, kept outside of them."""
    held = hold_outside_cuts(path, limits, limits.project(tangent))
    return np.where(np.abs(held).max(axis=1, keepdims=True) > 0, normalise_vectors(path.axis + held), path.axis)


def _plan_tangents(
    plan: Plan, toolpath: Toolpath, options: PlanOptions, clock: StageTimings, limits: TiltLimits, tangent: Array
) -> Plan:
    """Return the plan of the path tilted by tangents (P, 3) along the cuts."""
    path = plan.path.programmed
    curve = TiltCurve(path.index, _tilted_axes(path, limits, tangent), plan.setup.ball_radius)
    return _plan_tilted(plan, toolpath, options, clock, curve)


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
