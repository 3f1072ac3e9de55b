"""Predicted errors, probabilities and outcomes of all points of a plan that have a tolerance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.process import CuttingProcess
from machopt.data_types.process_columns import ERROR_NAMES, count_outcomes
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array
from machopt.planning.error_probability.missing_inputs import find_missing_input
from machopt.planning.error_probability.random_draws import (
    HOLE_DRAWS,
    SHARE_DRAWS,
    SURFACE_DRAWS,
    UncertaintyDraws,
    build_draws,
)
from machopt.planning.error_probability.stiffness_spread import StiffnessSpread
from machopt.planning.error_probability.toleranced_points import (
    HoleTargets,
    SurfaceTargets,
    compute_tip_length,
    list_hole_targets,
    list_surface_targets,
)
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import ScoredAssignment
from machopt.planning.tolerance.error_causes import compute_contributions, name_largest
from machopt.planning.tolerance.error_sensitivities import find_stated_spread
from machopt.planning.tolerance.feed_advice import FeedLimits, HoleFeedSearch, find_load_scale, find_surface_feeds
from machopt.planning.tolerance.hole_errors import (
    ENTRY,
    EXIT,
    HoleDraws,
    HoleErrorModel,
    HoleTerms,
    LoadFactors,
    build_hole_model,
    compute_nominal_hole_errors,
    draw_hole_errors,
    draw_hole_terms,
)
from machopt.planning.tolerance.surface_errors import (
    BLOCK,
    SurfaceErrorModel,
    build_surface_model,
    compute_load_factors,
    compute_surface_probability,
    draw_surface_errors,
)
from machopt.process.binding.point_loads import PointLoads

Targets = TypeVar("Targets", HoleTargets, SurfaceTargets)
LOW, HIGH = 0.05, 0.95  # quantiles of the intervals
FAIL = 0.5  # a probability below it is a failure


@dataclass(frozen=True, kw_only=True)
class PointErrors:
    """Columns of N toolpath points; NaN or empty where there is no tolerance."""

    errors: Mapping[str, Array]
    lower: Mapping[str, Array]
    upper: Mapping[str, Array]
    tolerance: Array
    p_in: Array
    p_in_deflection_only: Array
    outcome: tuple[str, ...]
    cause: tuple[str, ...]
    variance: Mapping[str, Array] = field(default_factory=dict)  # by stiffness, force, position: (N,) of the error
    unknown_because: Mapping[int, str] = field(default_factory=dict)  # toolpath point → what is missing
    feed_max: Array  # (N,) m/s, largest feed that stays in tolerance; 0: none does; NaN: not known

    def count_outcomes(self) -> dict[str, int]:
        """Return how many points have each outcome."""
        return count_outcomes(self.outcome)


def compute_point_errors(
    plan: Plan,
    toolpath: Toolpath,
    loads: PointLoads,
    chosen: ScoredAssignment | None = None,
    *,
    wall_force: Array,
    is_full: bool = False,
    hole_draws: int = SHARE_DRAWS,
    only: int | None = None,
) -> PointErrors:
    """Return errors and probabilities of an assignment.

    Args:
        plan: Plan of one tool.
        toolpath: Its toolpath, with the operations of the process.
        loads: The loads of its points.
        chosen: An assignment along its path; None: the choice of the plan.
        wall_force: (N,) N along axis × travel at the moment the wall is made, which bends the tool.
        is_full: Also find causes, variances and the largest feed of each point.
        hole_draws: Number of draws for holes; ``HOLE_DRAWS`` where all is found.
        only: The one toolpath point that is evaluated; None: all.
    """
    table = _ErrorTable(plan, toolpath, loads, plan.chosen if chosen is None else chosen)
    table.wall_force, table.is_full = wall_force, is_full
    table.hole_draws, table.only = HOLE_DRAWS if is_full else hole_draws, only
    return table.build()


def find_outcome(probability: float, quantile: float) -> str:
    """Return ``pass``, ``marginal`` or ``fail``.

    Args:
        probability: Probability that all tolerances hold.
        quantile: What ``pass`` needs.
    """
    return "pass" if probability >= quantile else "fail" if probability < FAIL else "marginal"


class _ErrorTable:
    def __init__(self, plan: Plan, toolpath: Toolpath, loads: PointLoads, chosen: ScoredAssignment) -> None:
        cell = plan.setup.cell
        assert cell.process is not None
        n = len(toolpath)
        self.plan, self.toolpath, self.loads, self.chosen = plan, toolpath, loads, chosen
        self.process: CuttingProcess = cell.process
        limits = (cell.limits.lower[:6], cell.limits.upper[:6])
        self.spread = StiffnessSpread.build(plan.setup.elasticity, limits)
        self.errors, self.lower, self.upper = ({name: np.full(n, np.nan) for name in ERROR_NAMES} for _ in range(3))
        self.tolerance, self.p_in, self.p_deflection = (np.full(n, np.nan) for _ in range(3))
        self.outcome, self.cause = [""] * n, [""] * n
        self.variance = {name: np.full(n, np.nan) for name in ("stiffness", "force", "position")}
        self.why: dict[int, str] = {}
        self.wall_force, self.feed_max, self.is_full = np.zeros(n), np.full(n, np.nan), False
        self.hole_draws = SHARE_DRAWS
        self.only: int | None = None

    def build(self) -> PointErrors:
        cutter = self.plan.setup.cell.tool.cutter
        holes = list_hole_targets(self.process, self.toolpath, self.loads, compute_tip_length(cutter))
        surfaces = list_surface_targets(self.process, self.toolpath, self.loads, cutter)
        if self.only is not None:
            holes, surfaces = _keep_row(holes, self.only), _keep_row(surfaces, self.only)
        if len(holes.row):
            self._add_holes(holes)
        if len(surfaces.row):
            self._add_surfaces(surfaces)
        return PointErrors(
            errors=self.errors,
            lower=self.lower,
            upper=self.upper,
            tolerance=self.tolerance,
            p_in=self.p_in,
            p_in_deflection_only=self.p_deflection,
            outcome=tuple(self.outcome),
            cause=tuple(self.cause),
            variance=self.variance,
            unknown_because=self.why,
            feed_max=self.feed_max,
        )

    # --- holes ------------------------------------------------------------------------------------------------------

    def _add_holes(self, holes: HoleTargets) -> None:
        model = build_hole_model(self.plan, self.chosen, self.process, holes, self.spread)
        draws = build_draws(self.spread, self.hole_draws)
        isolated = _isolate(draws.take_first(SHARE_DRAWS), self.spread) if self.is_full else {}
        factors = {k: LoadFactors.build(self.process, k, draws) for k in np.unique(holes.operation).tolist()}

        def draw_terms(h: int, *, position: bool = True) -> HoleTerms:
            return draw_hole_terms(model, h, draws, position=position, factors=factors[int(holes.operation[h])])

        stated = np.logical_and(*(find_stated_spread(self.plan, self.spread, pose) for pose in model.poses))
        scales = np.full(len(holes.row), np.nan)  # by which the load of each hole may grow
        for h, row in enumerate(holes.row.tolist()):
            one = self.process.operations[holes.operation[h]]
            limit = min(one.tolerance.position, one.tolerance.depth)
            self.tolerance[row] = limit if np.isfinite(limit) else np.nan  # an angle alone is no length
            if not (model.poses[ENTRY].is_reached[h] and model.poses[EXIT].is_reached[h]):
                self._mark_unknown(row, "the point has no posture")
                continue
            self._write_hole(row, compute_nominal_hole_errors(model, h), self.errors)
            sigma = max(model.scatter[pose].std[h] for pose in (ENTRY, EXIT))
            is_stated = bool(stated[h])
            why = find_missing_input(self.process, one, self.spread, sigma, is_stated=is_stated)
            terms = draw_terms(h)
            if self.is_full:
                scales[h] = np.nan if why else find_load_scale(terms)
                self._write_interval(row, terms.compute_errors())
                self._add_hole_variance(model, h, row, isolated)
            if why:
                self._mark_unknown(row, why)
                bare = draw_terms(h, position=False)
                self.p_deflection[row] = bare.compute_probability()
                continue
            self.p_in[row] = terms.compute_probability()
            self.outcome[row] = find_outcome(float(self.p_in[row]), self.process.quantile)
        if self.is_full:
            self._add_hole_causes(model)
            search = HoleFeedSearch(self.plan, model, self.loads, draw_terms)
            self._write_feeds(search.find_feeds(scales))

    def _write_feeds(self, feed_limits: FeedLimits) -> None:
        """Write the feeds of points whose outcome is known."""
        known = np.array([self.outcome[row] != "unknown" for row in feed_limits.rows], bool)
        self.feed_max[feed_limits.rows[known]] = feed_limits.feed[known]

    def _write_hole(self, row: int, hole_draws: HoleDraws, columns: dict[str, Array]) -> None:
        columns["across"][row] = hole_draws.distance[0]
        columns["along"][row] = hole_draws.along[0]
        columns["axis"][row] = hole_draws.axis[0]

    def _write_interval(self, row: int, hole_draws: HoleDraws) -> None:
        for name, values in (("across", hole_draws.distance), ("along", hole_draws.along), ("axis", hole_draws.axis)):
            self.lower[name][row], self.upper[name][row] = np.quantile(values, (LOW, HIGH))

    def _add_hole_variance(
        self, model: HoleErrorModel, h: int, row: int, isolated: Mapping[str, UncertaintyDraws]
    ) -> None:
        direction = _find_hole_direction(compute_nominal_hole_errors(model, h).across[0])
        for name, some in isolated.items():
            found = draw_hole_errors(model, h, some, position=name == "position")
            self.variance[name][row] = float(np.var(found.across @ direction))

    def _add_hole_causes(self, model: HoleErrorModel) -> None:
        """Name what causes most of the error across the holes, or along them where only the depth counts."""
        targets, pose = model.targets, model.poses[ENTRY]
        depth_only = np.array([np.isinf(self.process.operations[k].tolerance.position) for k in targets.operation])
        load = np.maximum(targets.thrust, targets.clamp)[:, None] * pose.axis
        load = load + targets.force[:, :1] * pose.travel + targets.force[:, 1:] * pose.normal
        wrench = np.hstack([load, targets.torque[:, None] * pose.axis])
        twist = load_twist(model, wrench, pose.axis)
        flat = twist - np.sum(twist * pose.axis, axis=1, keepdims=True) * pose.axis
        size = np.linalg.norm(flat, axis=1)
        across = flat / np.maximum(size, 1e-300)[:, None]
        direction = np.where(depth_only[:, None], pose.axis, across)
        names, parts = compute_contributions(self.plan, pose, wrench, direction)
        total = np.where(depth_only, np.sum(twist * pose.axis, axis=1), size)
        for row, word in zip(targets.row.tolist(), name_largest(names, parts, total), strict=True):
            self.cause[row] = word

    # --- milled points ----------------------------------------------------------------------------------------------

    def _add_surfaces(self, surfaces: SurfaceTargets) -> None:
        model = build_surface_model(
            self.plan, self.chosen, self.process, surfaces, self.loads, self.spread, self.wall_force
        )
        draws = build_draws(self.spread, SURFACE_DRAWS)
        for first in range(0, len(surfaces.row), BLOCK):
            self._add_surface_block(model, slice(first, min(first + BLOCK, len(surfaces.row))), draws)
        if not self.is_full:
            return
        wrench = self._compute_surface_wrench(model)
        names, parts = compute_contributions(self.plan, model.poses, wrench, model.normal)
        words = name_largest(names, parts, model.columns[:, 0] + model.tool)
        for row, word in zip(surfaces.row.tolist(), words, strict=True):
            self.cause[row] = "" if self.loads.is_unknown[row] else word
        self._write_feeds(find_surface_feeds(self.plan, model, self.loads, self.spread, draws))

    def _add_surface_block(self, model: SurfaceErrorModel, some: slice, draws: UncertaintyDraws) -> None:
        rows = model.targets.row[some]
        operations = model.targets.operation[some]
        limit = np.array([self.process.operations[k].tolerance.surface for k in operations])
        self.tolerance[rows] = limit
        known = model.targets.is_known[some]
        nominal = model.columns[some, 0] + model.tool[some] + model.offset[some]
        self.errors["normal"][rows] = np.where(known, nominal, np.nan)
        factor = compute_load_factors(model, some, draws)
        full = draw_surface_errors(model, some, draws, factor, position=True)
        std = model.scatter.std[some]
        if self.is_full:
            noise = np.nan_to_num(std)[:, None] * draws.position[:, 0]
            low, high = np.quantile(full + noise, (LOW, HIGH), axis=1)
            self.lower["normal"][rows], self.upper["normal"][rows] = (np.where(known, v, np.nan) for v in (low, high))
        p = compute_surface_probability(full, limit, np.nan_to_num(std))
        used = [self.process.operations[k] for k in operations]
        stated = find_stated_spread(self.plan, self.spread, model.poses)[some]
        missing = [
            find_missing_input(self.process, one, self.spread, sigma, is_stated=bool(known_here))
            for one, sigma, known_here in zip(used, std, stated, strict=True)
        ]
        deflection = p
        if any(missing):
            bare = draw_surface_errors(model, some, draws, factor, position=False)
            deflection = compute_surface_probability(bare, limit, np.zeros(len(rows)))
        if self.is_full:
            self._add_surface_variance(model, some, draws, std)
        for n, row in enumerate(rows.tolist()):
            why = missing[n]
            if not model.targets.is_known[some][n]:
                why = "the surface normal is not known: columns nx, ny, nz of the toolpath"
            if self.loads.is_unknown[row]:
                why = "the force of plunges and ramps of a milling cutter is unknown"
            if not model.poses.is_reached[some][n]:
                self._mark_unknown(row, "the point has no posture")
            elif why:
                self._mark_unknown(row, why)
                self.p_deflection[row] = deflection[n] if model.targets.is_known[some][n] else np.nan
            else:
                self.p_in[row] = p[n]
                self.outcome[row] = find_outcome(float(p[n]), self.process.quantile)

    def _add_surface_variance(self, model: SurfaceErrorModel, some: slice, draws: UncertaintyDraws, std: Array) -> None:
        rows = model.targets.row[some]
        for name, isolated in _isolate(draws, self.spread).items():
            factor = compute_load_factors(model, some, isolated)
            found = draw_surface_errors(model, some, isolated, factor, position=name == "position")
            variance = np.var(found, axis=1)
            variance[self.loads.is_unknown[rows]] = np.nan
            self.variance[name][rows] = variance + (np.nan_to_num(std) ** 2 if name == "position" else 0.0)

    def _compute_surface_wrench(self, model: SurfaceErrorModel) -> Array:
        rows, poses = model.targets.row, model.poses
        f = self.loads.arm_force[rows]
        force = f[:, :1] * poses.travel + f[:, 1:2] * poses.normal + f[:, 2:] * poses.axis
        return np.hstack([force, self.loads.moment[rows, None] * poses.axis])

    def _mark_unknown(self, row: int, why: str) -> None:
        self.outcome[row] = "unknown"
        self.why[row] = why


def _keep_row(targets: Targets, row: int) -> Targets:
    """Return the one target of a toolpath point."""
    mine = np.flatnonzero(targets.row == row)
    return replace(targets, **{f.name: getattr(targets, f.name)[mine] for f in fields(targets)})


def load_twist(model: HoleErrorModel, wrench: Array, axis: Array) -> Array:
    """Return the (H, 3) nominal displacement at entry under a load.

    Args:
        model: The error model.
        wrench: (H, 6) N and N·m, load at the TCP in base_link.
        axis: (H, 3) unit, tip to shank.
    """
    axial = np.sum(wrench[:, :3] * axis, axis=1)
    turning = np.sum(wrench[:, 3:] * axis, axis=1)
    by_thrust, by_torque, across = model.nominal
    return np.asarray(axial[:, None] * by_thrust + turning[:, None] * by_torque + across)


def _find_hole_direction(across: Array) -> Array:
    size = float(np.linalg.norm(across))
    return across / size if size > 0 else np.array([1.0, 0.0])


def _isolate(draws: UncertaintyDraws, spread: StiffnessSpread) -> dict[str, UncertaintyDraws]:
    """Return the draws with only one source of scatter each."""
    D = len(draws)
    still = np.zeros((D, 1 + spread.count))
    still[:, 0] = 1.0
    zero, half = np.zeros(D), np.full(D, 0.5)
    calm_load = {"thrust": zero, "torque": zero, "scatter": zero, "wear": half}
    calm_place = {
        "side": np.zeros((D, 6)),
        "pose": np.zeros((D, 6)),
        "position": np.zeros((D, 3)),
        "tilt": np.zeros((D, 2)),
    }
    return {
        "stiffness": replace(draws, **calm_load, **calm_place),
        "force": replace(draws, stiffness=still, local=np.zeros((D, 3)), **calm_place),
        "position": replace(draws, stiffness=still, local=np.zeros((D, 3)), **calm_load),
    }


def list_tolerance_rows(point_errors: PointErrors) -> NDArray[np.intp]:
    """Return the toolpath points that have an outcome.

    Args:
        point_errors: Errors of a plan.
    """
    return np.flatnonzero(np.array([bool(word) for word in point_errors.outcome]))
