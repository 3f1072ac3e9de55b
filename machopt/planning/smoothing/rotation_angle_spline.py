"""Rotation of one run as a cubic B-spline: candidate curves and their value."""

from __future__ import annotations

from typing import Any

import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.smoothing.corridor import Merit, SmoothingStretch, StretchEnds
from machopt.planning.smoothing.cost_interpolation import CostInterpolation
from machopt.planning.smoothing.cubic_curves import CubicSpline, build_design_matrix, interpolate_monotone
from machopt.planning.smoothing.newton_solver import SplineBasis, SplineObjective
from machopt.planning.stations.planning_path import PlanningPath

KNOTS = 160  # most spline intervals in a run
KNOT_SPACING = 0.15  # s at the programmed feed, least distance of knots
OUTSIDE = 0.02  # permitted violation of the corridor, in steps
PINNED = 1e-6  # rad: tolerance of a fixed rotation
CURVATURE = 2e-2  # price of the mean square angular acceleration of phi, per (rad/s²)²


def build_spline_solutions(
    path: PlanningPath, part: SmoothingStretch, elsewhere: float, ends: StretchEnds
) -> tuple[tuple[CubicSpline, ...], Merit]:
    """Return phi over turning length as cubic B-splines (C², bounded third derivative), and a function for their value.

    If the optimisation stops early, its last iterate is one of the solutions and is assessed like the others.

    Args:
        path: planning points.
        part: stretch of stations.
        elsewhere: the worst cost of the other stretches, in units of c₀.
        ends: joints before and after the rapid moves at its ends.
    """
    band, terms, w = part.band, part.terms, part.terms.weights
    length = float(part.x[-1])
    duration = max(float(path.time[part.points[-1]] - path.time[part.points[0]]), 1e-3)
    intervals = int(np.clip(duration / KNOT_SPACING, 1, min(KNOTS, max(len(part.rows) // 2, 1))))
    knots = np.r_[[0.0] * 3, np.linspace(0, length, intervals + 1), [length] * 3]
    B = build_design_matrix(knots, np.clip(part.x, 0, length))
    start = _fit_least_squares(B, band.phi)
    treads = _fit_least_squares(B, _fit_plateaus(part.x, band.phi))
    low, high = part.bounds()
    table, m = CostInterpolation(band.cost, band.step), len(start)
    bending = CURVATURE * part.weight * (intervals / duration) ** 4 / intervals  # the mean square of d²phi/dt²
    tight = int((high - low < 1e-9).sum()) >= m  # no room: the corridor is the solution
    slack = np.full(len(part.rows), OUTSIDE * band.step)
    slack[list(part.pins)] = PINNED
    nlp = SplineObjective(part, table, SplineBasis(knots, np.clip(part.x, 0, length)), bending, ends, elsewhere)
    found = np.full(m, np.nan) if tight else nlp.solve(start)

    def merit(answer: CubicSpline, ends: StretchEnds, elsewhere: float) -> float:
        """The objective with true absolute values; infinite outside the corridor."""
        phi = B @ answer.c
        off = phi - band.phi
        if not ((off >= low - slack) & (off <= high + slack)).all():
            return float("inf")
        values = table.at(off)[0]
        first, last = part.joints_at(off[[0, -1]], [0, -1])
        worst = max(values[terms.counted].max(initial=0.0), elsewhere)
        return float(part.price(values, off) + w.worst * worst + part.price_of_flights(first, last, ends))

    still = np.full(len(start), float(np.median(band.phi)))
    tries = [start, treads, still]
    if np.isfinite(found).all():  # between the simple solutions and the optimised one
        tries = [found, *(base + f * (found - base) for base in (treads, still) for f in (0.75, 0.5, 0.25)), *tries]
    tries = [_fit_pins(B, t, part) for t in tries] if part.pins else tries
    return tuple(CubicSpline(knots, t) for t in tries), merit


def _fit_pins(B: Any, coefficients: Array, part: SmoothingStretch) -> Array:
    """Move the spline by the smallest change of its coefficients that meets the user's fixed rotations.

    A finite penalty leaves a residual at a pin. Where the pins are more than the spline can meet, a residual remains
    and
    is assessed.
    """
    rows = list(part.pins)
    pinned = part.band.phi[rows] + np.array(list(part.pins.values()))
    at = B[rows].toarray()
    return np.asarray(coefficients + np.linalg.lstsq(at, pinned - at @ coefficients, rcond=None)[0])


def _fit_plateaus(x: Array, phi: Array) -> Array:
    """Return the grid's step function as a monotone curve through the middle of every step: the same rotation,
    smooth.
    """
    edge = np.flatnonzero(np.diff(phi) != 0)
    if not len(edge) or x[-1] <= 0:
        return phi
    first, last = np.r_[0, edge + 1], np.r_[edge, len(phi) - 1]
    middle, value = 0.5 * (x[first] + x[last]), phi[first]
    middle[0], middle[-1] = x[0], x[-1]
    keep = np.r_[True, np.diff(middle) > 1e-9]
    if keep.sum() < 2:
        return phi
    return interpolate_monotone(middle[keep], value[keep], x)


def _fit_least_squares(B: Any, values: Array) -> Array:
    """Return spline coefficients that follow the grid choice, slightly smoothed where stations are fewer than knots."""
    from scipy.sparse import diags, identity
    from scipy.sparse.linalg import spsolve

    n = B.shape[1]
    D = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n)) if n > 2 else identity(n)
    return np.asarray(spsolve((B.T @ B + 1e-3 * D.T @ D + 1e-12 * identity(n)).tocsc(), B.T @ values))
