"""Rotation as a smooth curve along the path, between and beyond the grid.

In each run phi(s) is a cubic B-spline over path length (plunges excluded: there it stays constant). CasADi
and IPOPT minimise the objective of :mod:`machopt.plan.score` with the cost of the chosen branch interpolated
from the grid, inside the corridor of rotations that are feasible around the grid optimum, with joint speeds held to
what the programmed feed leaves. Runs without travel (drilling) have one rotation: the vertex of a parabola.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from machopt.domain.options import PlanOptions
from machopt.plan.candidates import Candidates
from machopt.plan.choose import Choice
from machopt.plan.path import Path
from machopt.plan.score import Scores, cutting_runs
from machopt.se3 import wrap

Array = NDArray[np.float64]
REACH = 16  # grid steps to either side of the chosen rotation that the corridor may span
SIDE_STEP = np.radians(30.0)  # largest joint step between neighbouring rotations of one branch
KNOTS = 80  # most spline intervals in a run
KNOT_SPACING = 0.01  # m, least distance of knots
SPEED_SHARE = 0.6  # of the joint velocity limits that rotation may use up at the programmed feed
STIFFNESS = 3e-3  # price of curvature of phi, relative to the other terms, on the run's own length


@dataclass(frozen=True)
class Corridor:
    """What the grid knows around the chosen rotation, per station (n of them) and step j = −REACH … REACH."""

    phi: Array  # (n,) rad, chosen rotation, unwrapped inside the run
    low: Array  # (n,) rad ≤ 0, feasible side below
    high: Array  # (n,) rad ≥ 0
    cost: Array  # (n, 2·REACH+1), dimensionless, edge values repeated beyond the corridor
    slope: Array  # (n, 6) dq/dphi at the chosen rotation
    step: float  # rad, of the grid
    q: Array  # (n, 6) rad at the chosen rotation


@dataclass(frozen=True)
class Smoothed:
    """Rotation at every planning point; a seed for the joints there."""

    phi: Array  # (P,) rad
    seed: Array  # (P, 6) rad


def corridor(candidates: Candidates, scores: Scores, choice: Choice, rows: NDArray[np.intp]) -> Corridor:
    """Walk from the chosen vertex to both sides while the same branch and turn stay feasible."""
    R = len(candidates.phi)
    grid = 2 * np.pi / R
    r, b, t = choice.rotation[rows], choice.branch[rows], choice.turn[rows]
    phi = np.unwrap(candidates.phi[r])
    n = len(rows)
    cost = np.empty((n, 2 * REACH + 1))
    cost[:, REACH] = scores.cost[rows, r, b]
    limit, reached = np.zeros((n, 2)), np.zeros((n, 2))
    neighbour = np.stack([choice.q[rows], choice.q[rows]])
    for side, sign in ((0, -1), (1, 1)):
        alive, previous = np.ones(n, bool), choice.q[rows]
        for j in range(1, REACH + 1):
            rj = (r + sign * j) % R
            base = candidates.q[rows, rj, b]
            q = previous + wrap(base - previous)
            turn = (np.round((q - base)[:, None] / (2 * np.pi)) == np.round(candidates.turns / (2 * np.pi))).all(axis=2)
            alive &= (candidates.feasible[rows, rj, b] & turn).any(axis=1)
            alive &= np.abs(q - previous).max(axis=1) < SIDE_STEP
            limit[alive, side] = sign * j * grid
            column = REACH + sign * j
            cost[:, column] = np.where(alive, scores.cost[rows, rj, b], cost[:, column - sign])
            previous = np.where(alive[:, None], q, previous)
            if j == 1:
                neighbour[side], reached[:, side] = previous, alive * grid
    span = np.maximum(reached.sum(axis=1), 1e-12)[:, None]
    return Corridor(phi=phi, low=limit[:, 0], high=limit[:, 1], cost=cost / scores.scale,
                    slope=(neighbour[1] - neighbour[0]) / span, step=grid, q=choice.q[rows])  # fmt: skip


def smooth(path: Path, candidates: Candidates, scores: Scores, choice: Choice, velocity: Array, options: PlanOptions) -> Smoothed:
    """Smooth every run of the choice. Stations without a vertex stay NaN, and so do the points around them.

    Args:
        velocity: (6,) rad/s, joint velocity limits.
    """
    P = len(path.index)
    phi, seed = np.full(P, np.nan), np.full((P, 6), np.nan)
    st = path.stations
    position = np.searchsorted(st, np.arange(P))
    worst = _grid_worst(path, scores, choice)
    for first, last in path.runs:
        for a, b in _whole_stretches(choice, position[first], position[last]):
            rows = np.arange(a, b + 1)
            band = corridor(candidates, scores, choice, rows)
            turning = _turning_length(path, st[a], st[b])
            x = turning[st[rows] - st[a]]
            count = int(path.counted[st].sum()) or 1
            share = path.counted[st[rows]] / count
            pinned = _pins(path, rows, band.phi, options)
            if x[-1] <= 0 or len(rows) < 3:
                delta = _one_rotation(band, share, pinned)
                curve = np.full(st[b] - st[a] + 1, 0.0) + np.interp(turning, x, band.phi) + delta
                offset = np.full(len(rows), delta)
            else:
                spline = _spline_run(path, rows, x, band, share, worst, pinned, velocity, options)
                curve, offset = spline(turning), spline(x) - band.phi
            phi[st[a] : st[b] + 1] = curve
            near = choice.q[rows] + band.slope * offset[:, None]
            for i in range(6):
                seed[st[a] : st[b] + 1, i] = np.interp(path.s[st[a] : st[b] + 1], path.s[st[rows]], near[:, i])
            seed[st[rows]] = near
    return Smoothed(phi=phi, seed=seed)


def _grid_worst(path: Path, scores: Scores, choice: Choice) -> float:
    at = np.flatnonzero(~choice.dropped & path.counted[path.stations])
    return float((scores.cost[at, choice.rotation[at], choice.branch[at]] / scores.scale).max(initial=0.0))


def _whole_stretches(choice: Choice, a: int, b: int) -> list[tuple[int, int]]:
    """The parts of stations a…b without dropped stations or breaks."""
    out, start = [], None
    for s in range(a, b + 1):
        if start is not None and (choice.dropped[s] or s in choice.broken):
            out.append((start, s - 1))
            start = None
        if start is None and not choice.dropped[s]:
            start = s
    if start is not None:
        out.append((start, b))
    return out


def _turning_length(path: Path, first: int, last: int) -> Array:
    """Path length from ``first`` on which the rotation may change: plunges do not count."""
    step = np.diff(path.s[first : last + 1])
    step[path.plunge[first + 1 : last + 1]] = 0.0
    return np.r_[0.0, np.cumsum(step)]


def _pins(path: Path, rows: NDArray[np.intp], phi: Array, options: PlanOptions) -> dict[int, float]:
    """The user's fixed rotations in this run: row to exact offset from the grid's phi."""
    points = path.stations[rows]
    pins = {}
    for fixed in options.fixed:
        for i in np.flatnonzero(np.abs(path.index[points] - fixed.point) < 1e-9):
            pins[int(i)] = float(wrap(fixed.gamma - path.offset[points[i]] - phi[i]))
    return pins


def _one_rotation(band: Corridor, share: Array, pinned: dict[int, float]) -> float:
    """Offset of a run that keeps one rotation: the parabola through the best grid value and its neighbours."""
    if pinned:
        return next(iter(pinned.values()))
    low, high = float(band.low.max()), float(band.high.min())
    total = share @ band.cost
    left, centre, right = total[REACH - 1], total[REACH], total[REACH + 1]
    curvature = left - 2 * centre + right
    if curvature <= 0 or low > -band.step or high < band.step:
        return 0.0
    return float(np.clip(0.5 * (left - right) / curvature * band.step, low, high))


def _spline_run(
    path: Path, rows: NDArray[np.intp], x: Array, band: Corridor, share: Array, worst: float,
    pinned: dict[int, float], velocity: Array, options: PlanOptions,
) -> BSpline:  # fmt: skip
    """phi over turning length as a cubic B-spline: C², bounded third derivative.

    Raises nothing: where IPOPT does not converge, its last iterate inside the bounds is used and judged by the
    caller like any other.
    """
    import casadi as ca

    length = float(x[-1])
    intervals = int(np.clip(length / KNOT_SPACING, 1, min(KNOTS, max(len(rows) // 2, 1))))
    knots = np.r_[[0.0] * 3, np.linspace(0, length, intervals + 1), [length] * 3]
    B = BSpline.design_matrix(np.clip(x, 0, length), knots, 3).tocsr()
    start = _least_squares(B, band.phi)
    c = ca.MX.sym("c", len(start))
    tau = ca.MX.sym("tau")
    delta = ca.mtimes(_casadi_sparse(ca, B), c) - band.phi
    index, grid = np.arange(len(rows), dtype=float), np.arange(-REACH, REACH + 1) * band.step
    table = ca.interpolant("cost", "bspline", [index, grid], band.cost.ravel(order="F"), {"degree": [1, 3]})
    cost = table(ca.vertcat(ca.DM(index).T, delta.T)).T
    w, runs = options.weights, cutting_runs(path)
    change = delta[1:] - delta[:-1] + np.diff(band.phi)
    dq0 = np.diff(band.q, axis=0)
    dq = dq0 + ca.DM(band.slope[1:]) * ca.repmat(delta[1:], 1, 6) - ca.DM(band.slope[:-1]) * ca.repmat(delta[:-1], 1, 6)
    small = np.radians(0.05)

    def length_of(v: object) -> object:  # |v|, smooth at zero
        return ca.sum1(ca.sqrt(ca.vec(v) ** 2 + small**2) - small)

    seconds = _programmed_time(path, rows)
    allowed = SPEED_SHARE * velocity[None, :] * np.maximum(seconds, 1e-6)[:, None]
    excess = ca.fmax(ca.fabs(dq) / ca.DM(allowed) - 1.0, 0.0)
    second = np.diff(np.eye(len(start)), n=2, axis=0) * intervals**1.5  # ∫ phi''² on the unit interval
    objective = (
        w.mean * ca.dot(ca.DM(share), cost)
        + w.worst * tau
        + w.travel / (np.pi * runs) * length_of(dq)
        + w.rotation / (np.pi * runs) * length_of(change)
        + STIFFNESS / runs * ca.sumsqr(ca.mtimes(ca.DM(second), c))
        + 0.2 / max(len(rows), 1) * ca.sumsqr(excess)
    )
    counted = np.flatnonzero(share > 0)
    g = [delta] + ([cost[counted.tolist()] - tau] if len(counted) else [])
    low = np.minimum(band.low, 0.0) + 0.0
    high = np.maximum(band.high, 0.0)
    for i, value in pinned.items():
        low[i] = high[i] = value
    lbg = np.r_[low, np.full(len(counted), -np.inf)]
    ubg = np.r_[high, np.zeros(len(counted))]
    tau0 = max(worst, 1e-9)
    solver = ca.nlpsol("smooth", "ipopt", {"x": ca.vertcat(c, tau), "f": objective, "g": ca.vertcat(*g)}, {
        "print_time": False, "error_on_fail": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 60, "tol": 1e-5, "acceptable_tol": 1e-4,
                  "hessian_approximation": "limited-memory"},
    })  # fmt: skip
    answer = solver(x0=np.r_[start, tau0], lbg=lbg, ubg=ubg, lbx=np.r_[np.full(len(start), -np.inf), 0.9 * tau0])
    coefficients = np.asarray(answer["x"]).ravel()[:-1]
    return BSpline(knots, coefficients if np.isfinite(coefficients).all() else start, 3)


def _least_squares(B: object, values: Array) -> Array:
    """Spline coefficients that follow the grid choice, lightly smoothed where stations are fewer than knots."""
    from scipy.sparse import diags, identity
    from scipy.sparse.linalg import spsolve

    n = B.shape[1]  # type: ignore[attr-defined]
    D = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n)) if n > 2 else identity(n)
    return np.asarray(spsolve((B.T @ B + 1e-3 * D.T @ D + 1e-12 * identity(n)).tocsc(), B.T @ values))  # type: ignore[attr-defined]


def _casadi_sparse(ca: object, B: object) -> object:
    coo = B.tocoo()  # type: ignore[attr-defined]
    return ca.DM.triplet(coo.row.tolist(), coo.col.tolist(), ca.DM(coo.data), *coo.shape)  # type: ignore[attr-defined]


def _programmed_time(path: Path, rows: NDArray[np.intp]) -> Array:
    """(n − 1,) s between stations at the programmed feed; infinite where none is programmed."""
    st = path.stations[rows]
    out = np.empty(len(rows) - 1)
    length = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    with np.errstate(invalid="ignore"):
        seconds = np.where(path.feed[1:] > 0, length / path.feed[1:], np.inf)
    total = np.r_[0.0, np.cumsum(np.where(np.isfinite(seconds), seconds, 1e3))]
    out[:] = total[st[1:]] - total[st[:-1]]
    return out
