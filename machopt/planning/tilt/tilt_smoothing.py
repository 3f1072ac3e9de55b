"""Smooth tilts along each run at a given rotation and branch.

With the tangents w (3-vectors normal to the CAM axis) at the stations, the sum

    w_mean Σ a_i c_i(w_i) + w_worst · smooth maximum of c_i + STIFF/L Σ |w_i+1 − w_i|²/Δs + BENT/L Σ |curvature|² Δs

is minimised inside the ranges by a projected Newton method (Bertsekas 1982): tangents at an end of their range whose
gradient points outwards are held, all others take a Newton step. c_i are parabolas of the tilt in units of c₀, a_i
shares of the length cut, s the length in the metric of the planning path, L the whole of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_diag, csc_matrix, diags, identity, kron
from scipy.sparse.linalg import splu

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools
from machopt.planning.stations.planning_path import PlanningPath
from machopt.planning.tilt.tilt_cost_parabolas import LocalCosts
from machopt.planning.tilt.tilt_limits import TiltLimits

STIFF = 0.003  # m, price of the slope of the tangents
BENT = 1e-5  # m³, price of their curvature
SHARPNESS = 60.0  # of the smooth maximum, per unit of c/c₀
SHORTEST = 1e-4  # m: a shorter step counts as one of this length
STEPS = 25  # maximum number of Newton steps
HALVINGS = 14  # of a step that does not lower the sum
CONVERGED = 1e-6  # decrease of the sum
ROUND = 1e-3  # share of the price of a station that is added to its Hessian


@dataclass(frozen=True, kw_only=True)
class _TiltProblem:
    """The sum over M stations, and its derivatives by the tangents of lead and side."""

    costs: LocalCosts
    share: Array  # (M,) of the length cut
    smooth: csc_matrix  # (2M, 2M) price of slope and curvature: xᵀ A x
    mean: float
    worst: float

    def price(self, x: Array) -> float:
        """Return the sum at tangents (M, 2)."""
        value, _, _ = self.costs.evaluate(x)
        _, maximum = self._soften(value)
        flat = x.ravel()
        return self.mean * float(self.share @ value) + self.worst * maximum + float(flat @ (self.smooth @ flat))

    def differentiate(self, x: Array) -> tuple[Array, csc_matrix]:
        """Return gradient (2M,) and an approximate positive definite Hessian (2M, 2M)."""
        value, gradient, hessian = self.costs.evaluate(x)
        soft, _ = self._soften(value)
        price = self.mean * self.share + self.worst * soft
        half = 0.5 * (hessian[:, 0, 0] + hessian[:, 1, 1])
        least = half - np.hypot(0.5 * (hessian[:, 0, 0] - hessian[:, 1, 1]), hessian[:, 0, 1])
        convex = hessian + np.maximum(-least, 0.0)[:, None, None] * np.eye(2)
        # the smooth maximum is curved by the change of its weights, too
        outer = self.worst * SHARPNESS * (soft * (1.0 - soft))[:, None, None] * gradient[:, :, None] * gradient[:, None]
        blocks = price[:, None, None] * (convex + ROUND * np.eye(2)) + outer + 1e-9 * np.eye(2)
        slope = (price[:, None] * gradient).ravel() + 2.0 * (self.smooth @ x.ravel())
        return slope, csc_matrix(block_diag(blocks) + 2.0 * self.smooth)

    def _soften(self, value: Array) -> tuple[Array, float]:
        """Weights (M,) of the smooth maximum of the stations that are cut, and its value."""
        cut = self.share > 0
        top = float(value[cut].max(initial=0.0))
        weight = np.where(cut, np.exp(SHARPNESS * np.minimum(value - top, 0.0)), 0.0)
        total = float(weight.sum())
        return (weight / total, top + np.log(total) / SHARPNESS) if total > 0 else (weight, 0.0)


def smooth_tilts(
    path: PlanningPath, costs: LocalCosts, limits: TiltLimits, options: PlanOptions, start: Array
) -> Array:
    """Return tangent vectors (P, 3) along the cuts, smooth and inside their ranges.

    Args:
        path: path of the CAM file.
        costs: index of some stations by their tilt.
        limits: permitted tilts.
        options: plan options with the weights.
        start: (P, 3) tangents to start from.
    """
    if not len(costs.rows):
        return limits.project(start)
    problem = _build_problem(path, costs, options)
    x = _minimise(problem, _get_tangents(costs, start))
    return limits.project(_spread(path, costs, np.einsum("mc,mcd->md", x, costs.frame)))


def price_tangents(path: PlanningPath, costs: LocalCosts, options: PlanOptions, tangent: Array) -> float:
    """Return the sum that is minimised, in units of c₀, at tangent vectors.

    Args:
        path: path of the CAM file.
        costs: index of some stations by their tilt.
        options: plan options with the weights.
        tangent: (P, 3).
    """
    return _build_problem(path, costs, options).price(_get_tangents(costs, tangent)) if len(costs.rows) else 0.0


def _build_problem(path: PlanningPath, costs: LocalCosts, options: PlanOptions) -> _TiltProblem:
    return _TiltProblem(
        costs=costs,
        share=_compute_length_shares(path, costs),
        smooth=_build_smoothness(path, costs),
        mean=options.weights.mean,
        worst=options.weights.worst,
    )


def _get_tangents(costs: LocalCosts, tangent: Array) -> Array:
    """Tangents (M, 2) of lead and side, inside their ranges."""
    return np.asarray(np.clip(np.einsum("mcd,md->mc", costs.frame, tangent[costs.rows]), costs.low, costs.high))


def _minimise(problem: _TiltProblem, x: Array) -> Array:
    low, high = problem.costs.low.ravel(), problem.costs.high.ravel()
    best = problem.price(x)
    for _ in range(STEPS):
        slope, hessian = problem.differentiate(x)
        step = _compute_step(x.ravel(), slope, hessian, low, high)
        for halving in range(HALVINGS):
            trial = np.clip(x.ravel() - 0.5**halving * step, low, high).reshape(x.shape)
            value = problem.price(trial)
            if value < best:
                break
        else:
            return x
        gain, x, best = best - value, trial, value
        if gain < CONVERGED:
            return x
    return x


def _compute_step(x: Array, slope: Array, hessian: csc_matrix, low: Array, high: Array) -> Array:
    """Newton step (2M,) of the tangents that are not held at an end of their range."""
    is_at_bound: Bools = ((x <= low) & (slope > 0)) | ((x >= high) & (slope < 0))
    free = np.flatnonzero(~is_at_bound)
    step = np.zeros(len(x))
    if len(free):
        step[free] = splu(csc_matrix(hessian[free][:, free])).solve(slope[free])
    return step


def _compute_length_shares(path: PlanningPath, costs: LocalCosts) -> Array:
    """(M,) share of the length cut of the stations; a coarse station has that of the stations around it."""
    weight = np.zeros(len(path.index))
    weight[path.stations] = path.station_weight * path.counted[path.stations]
    rows = costs.rows
    middle = 0.5 * (rows[1:] + rows[:-1])
    nearest = np.searchsorted(middle, np.arange(len(weight)))
    share = np.bincount(nearest, weight, len(rows))
    return np.where(path.counted[rows] | (share > 0), share, 0.0)


def _spread(path: PlanningPath, costs: LocalCosts, at: Array) -> Array:
    """Tangents (P, 3) at all planning points from those at some, evenly along each run."""
    out, rows = np.zeros((len(path.index), 3)), costs.rows
    for first, last in path.runs:
        mine = np.flatnonzero((rows >= first) & (rows <= last))
        if len(mine):
            some = slice(first, last + 1)
            for c in range(3):
                out[some, c] = np.interp(path.s[some], path.s[rows[mine]], at[mine, c])
    out[rows] = at
    return np.asarray(out - np.sum(out * path.axis, axis=1, keepdims=True) * path.axis)


def _build_smoothness(path: PlanningPath, costs: LocalCosts) -> csc_matrix:
    """(2M, 2M) matrix A of the price xᵀ A x of slope and curvature inside runs."""
    rows, m = costs.rows, len(costs.rows)
    frames = block_diag(np.swapaxes(costs.frame, 1, 2))  # (3M, 2M): tangent vectors of the tangents x
    length = max(float(path.s[-1]), SHORTEST)
    step = np.maximum(np.diff(path.s[rows]), SHORTEST)
    joined = (path.run[rows[1:]] == path.run[rows[:-1]]).astype(float)
    first = diags([-np.ones(max(m - 1, 0)), np.ones(max(m - 1, 0))], [0, 1], shape=(max(m - 1, 0), m))
    out = STIFF / length * first.T @ diags(joined / step) @ first
    if m > 2:
        slope = diags(joined / step) @ first
        middle = 0.5 * (step[1:] + step[:-1])
        both = joined[1:] * joined[:-1]
        second = diags([-np.ones(m - 2), np.ones(m - 2)], [0, 1], shape=(m - 2, m - 1)) @ slope
        out = out + BENT / length * second.T @ diags(both / middle) @ second
    return csc_matrix(frames.T @ kron(out, identity(3)) @ frames)
