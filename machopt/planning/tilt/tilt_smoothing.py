"""Smooth tilts along each run at a given rotation and branch.

At every station the index is computed for the grid of tilts and interpolated by parabolas in both tangents. With the
tangents w (P, 3), the sum

    w_mean Σ a_i c_i(w_i) + w_worst · smooth maximum of c_i + STIFF/L Σ |w_i+1 − w_i|²/Δs + BENT/L Σ |curvature|² Δs

over the stations is minimised inside the ranges (L-BFGS-B; Byrd et al. 1995). c is in units of c₀, s the length in the
metric of the planning path, L the whole of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import spsolve

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.planning.cost.stiffness_index import compute_configuration_cost
from machopt.planning.pipeline.plan import Plan
from machopt.planning.sampling.joint_path import solve_joint_path
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.stations.tilt_curve import tilt_path
from machopt.planning.tilt.tilt_grid import build_tilt_nodes
from machopt.planning.tilt.tilt_limits import TiltLimits

STIFF = 0.003  # m, price of the slope of the tangents
BENT = 1e-5  # m³, price of their curvature
FOLLOWED = 1.0  # price of the squared distance from given tangents, over the length cut
SHARPNESS = 60.0  # of the smooth maximum, per unit of c/c₀
SHORTEST = 1e-4  # m: a shorter step counts as one of this length
BLOCKED = 10.0  # index of a tilt without a configuration, in units of c₀
EVALUATIONS = 300


@dataclass(frozen=True, kw_only=True)
class _LocalCosts:
    """Parabolas of the index in (tan lead, tan side) at M stations."""

    rows: NDArray[np.intp]  # (M,) planning points
    frame: Array  # (M, 2, 3)
    low: Array  # (M, 2)
    high: Array  # (M, 2)
    values: Array  # (M, 3, 3) index at the levels of both tangents
    levels: Array  # (M, 3, 2)

    def evaluate(self, w: Array) -> tuple[Array, Array]:
        """Return the (M,) index and its gradient (M, 3) with respect to tangents (M, 3)."""
        x = np.einsum("mcd,md->mc", self.frame, w)
        basis, slope = zip(*(_interpolate(self.levels[:, :, c], x[:, c]) for c in (0, 1)), strict=True)
        value = np.einsum("mi,mij,mj->m", basis[0], self.values, basis[1])
        by_lead = np.einsum("mi,mij,mj->m", slope[0], self.values, basis[1])
        by_side = np.einsum("mi,mij,mj->m", basis[0], self.values, slope[1])
        return value, by_lead[:, None] * self.frame[:, 0] + by_side[:, None] * self.frame[:, 1]


def _interpolate(level: Array, x: Array) -> tuple[Array, Array]:
    """Lagrange polynomials (M, 3) through three levels, and their slopes; constant where the levels coincide."""
    a, b, c = level.T
    wide = c - a > 1e-9
    a, c = np.where(wide, a, b - 1.0), np.where(wide, c, b + 1.0)
    value = np.column_stack(
        [
            (x - b) * (x - c) / ((a - b) * (a - c)),
            (x - a) * (x - c) / ((b - a) * (b - c)),
            (x - a) * (x - b) / ((c - a) * (c - b)),
        ]
    )
    slope = np.column_stack(
        [
            (2 * x - b - c) / ((a - b) * (a - c)),
            (2 * x - a - c) / ((b - a) * (b - c)),
            (2 * x - a - b) / ((c - a) * (c - b)),
        ]
    )
    fixed = ~wide[:, None]
    return np.where(fixed, [0.0, 1.0, 0.0], value), np.where(fixed, 0.0, slope)


def follow_tangents(path: PlanningPath, limits: TiltLimits, tangent: Array) -> Array:
    """Return smooth tangent vectors (P, 3) along the cuts near given ones, inside their ranges.

    Args:
        path: path of the CAM file.
        limits: permitted tilts.
        tangent: (P, 3) to follow.
    """
    rows = path.stations[limits.is_free[path.stations]].astype(np.intp)
    if not len(rows):
        return limits.project(tangent)
    near = diags(FOLLOWED * np.maximum(_share(path, rows), 1e-9))
    at = spsolve(csc_matrix(near + _build_smoothness(path, rows)), near @ tangent[rows])
    return limits.project(_spread(path, rows, at.reshape(-1, 3)))


def smooth_tilts(plan: Plan, limits: TiltLimits, options: PlanOptions, phi: Array, seed: Array, start: Array) -> Array:
    """Return tangent vectors (P, 3) along the cuts, smooth and inside their ranges.

    Args:
        plan: plan with the axes of the CAM file.
        limits: permitted tilts.
        options: plan options of the path.
        phi: (P,) rad, rotation.
        seed: (P, 6) rad, joints near those of every tilt.
        start: (P, 3) tangents to start from.
    """
    path = plan.path.programmed
    costs = _compute_local_costs(plan, path, limits, phi, seed)
    w = limits.project(start)
    if not len(costs.rows):
        return w
    smooth = _build_smoothness(path, costs.rows)
    share = _share(path, costs.rows)
    weights = options.weights
    x0 = np.einsum("mcd,md->mc", costs.frame, w[costs.rows])

    def objective(x: Array) -> tuple[float, Array]:
        at = np.einsum("mc,mcd->md", x.reshape(-1, 2), costs.frame)
        value, gradient = costs.evaluate(at)
        top = value[share > 0].max(initial=0.0)
        soft = np.where(share > 0, np.exp(SHARPNESS * (value - top)), 0.0)
        maximum = top + np.log(soft.sum() + 1e-300) / SHARPNESS
        price = weights.mean * share + weights.worst * soft / (soft.sum() + 1e-300)
        bent = smooth @ at
        total = weights.mean * float(share @ value) + weights.worst * maximum + float(np.sum(at * bent))
        slope = price[:, None] * gradient + 2.0 * bent
        return total, np.einsum("mcd,md->mc", costs.frame, slope).ravel()

    bounds = list(zip(costs.low.ravel(), costs.high.ravel(), strict=True))
    found = minimize(
        objective, x0.ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": EVALUATIONS}
    )
    at = np.einsum("mc,mcd->md", found.x.reshape(-1, 2), costs.frame)
    return limits.project(_spread(path, costs.rows, at))


def _spread(path: PlanningPath, rows: NDArray[np.intp], at: Array) -> Array:
    """Tangents (P, 3) at all planning points from those at some, evenly along each run."""
    out = np.zeros((len(path.index), 3))
    for first, last in path.runs:
        mine = np.flatnonzero((rows >= first) & (rows <= last))
        if len(mine):
            some = slice(first, last + 1)
            for c in range(3):
                out[some, c] = np.interp(path.s[some], path.s[rows[mine]], at[mine, c])
    out[rows] = at
    return np.asarray(out - np.sum(out * path.axis, axis=1, keepdims=True) * path.axis)


def _share(path: PlanningPath, rows: NDArray[np.intp]) -> Array:
    """(M,) share of the length cut of each of the stations that are used."""
    at = np.searchsorted(path.stations, rows)
    return path.station_weight[at] * path.counted[rows]


def _compute_local_costs(plan: Plan, path: PlanningPath, limits: TiltLimits, phi: Array, seed: Array) -> _LocalCosts:
    known = limits.is_free[path.stations] & np.isfinite(seed[path.stations]).all(axis=1)
    rows = path.stations[known].astype(np.intp)
    own = np.full_like(seed, np.nan)
    own[rows] = seed[rows]
    side = np.where(limits.cuts[0, rows], 0, 1)
    low, high, frame = (of[side, rows] for of in (limits.low, limits.high, limits.frame))
    middle = np.where((low < 0) & (high > 0), 0.0, 0.5 * (low + high))
    levels = np.stack([low, middle, high], axis=1)
    values = np.empty((len(rows), 3, 3))
    nodes = build_tilt_nodes(path, limits)
    wide = [(low[:, c] != high[:, c]).any() for c in (0, 1)]
    grid = iter(nodes)
    for i in range(3) if wide[0] else (1,):
        for j in range(3) if wide[1] else (1,):
            values[:, i, j] = _price(plan, path, next(grid), phi, own, rows)
    for c, used in enumerate(wide):
        if not used:  # one level only: the same everywhere
            values = np.repeat(np.take(values, [1], axis=1 + c), 3, axis=1 + c)
    return _LocalCosts(rows=rows, frame=frame, low=low, high=high, values=values, levels=levels)


def _price(plan: Plan, path: PlanningPath, tangent: Array, phi: Array, seed: Array, rows: NDArray[np.intp]) -> Array:
    """(M,) index at some planning points with one tilt, in units of c₀."""
    tilted = tilt_path(path, normalise_vectors(path.axis + tangent), plan.setup.ball_radius)
    found = solve_joint_path(tilted, plan.setup.arm, plan.setup.robot, phi, seed)
    out = np.full(len(rows), BLOCKED)
    ok = np.flatnonzero(found.reason[rows] == InfeasibilityReason.OK)
    at = rows[ok]
    out[ok] = (
        compute_configuration_cost(plan.setup.elasticity, plan.directions, at, found.q[at], plan.scores.index)
        / plan.scores.scale
    )
    return out


def _build_smoothness(path: PlanningPath, rows: NDArray[np.intp]) -> csr_matrix:
    """(M, M) matrix A of the price wᵀ A w of slope and curvature inside runs."""
    m = len(rows)
    length = max(float(path.s[-1]), SHORTEST)
    step = np.maximum(np.diff(path.s[rows]), SHORTEST)
    joined = (path.run[rows[1:]] == path.run[rows[:-1]]).astype(float)
    first = diags([-np.ones(max(m - 1, 0)), np.ones(max(m - 1, 0))], [0, 1], shape=(max(m - 1, 0), m))
    slope = diags(joined / step) @ first
    out = STIFF / length * first.T @ diags(joined / step) @ first
    if m > 2:
        middle = 0.5 * (step[1:] + step[:-1])
        both = joined[1:] * joined[:-1]
        second = diags([-np.ones(m - 2), np.ones(m - 2)], [0, 1], shape=(m - 2, m - 1)) @ slope
        out = out + BENT / length * second.T @ diags(both / middle) @ second
    return csr_matrix(out)
