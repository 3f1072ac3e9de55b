"""One run's rotation as a cubic B-spline: the nonlinear programme, and what each of its answers is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PchipInterpolator

from machopt.domain.options import PlanOptions
from machopt.plan.corridor import REACH, Merit, Stretch
from machopt.plan.path import Path
from machopt.plan.score import AXIS_SPEED

Array = NDArray[np.float64]
PROGRAMME = 400  # most stations of a run in the nonlinear programme
KNOTS = 160  # most spline intervals in a run
KNOT_SPACING = 0.15  # s at the programmed feed, least distance of knots
CURVATURE = 2e-2  # price of the mean square angular acceleration of phi, per (rad/s²)²


def spline_answers(
    path: Path,
    part: Stretch,
    elsewhere: float,
    ends: tuple[Array | None, Array | None],
    velocity: Array,
    options: PlanOptions,
) -> tuple[tuple[BSpline, ...], Merit]:
    """phi over turning length as cubic B-splines (C², bounded third derivative), and what each is worth.

    Raises nothing: where IPOPT does not converge, its last iterate is one of the answers and judged like any other.

    Args:
        ends: (6,) rad, joints the rapid moves before and after come from and go to; None at the first and last.
    """
    import casadi as ca

    band, w = part.band, options.weights
    length = float(part.x[-1])
    duration = max(float(path.time[part.points[-1]] - path.time[part.points[0]]), 1e-3)
    intervals = int(np.clip(duration / KNOT_SPACING, 1, min(KNOTS, max(len(part.rows) // 2, 1))))
    knots = np.r_[[0.0] * 3, np.linspace(0, length, intervals + 1), [length] * 3]
    B = BSpline.design_matrix(np.clip(part.x, 0, length), knots, 3).tocsr()
    start = _least_squares(B, band.phi)
    treads = _least_squares(B, _through_plateaus(part.x, band.phi))
    price_q, price_r = w.travel / np.pi * part.weight, w.rotation / np.pi * part.weight
    low, high = part.bounds()
    index, grid = np.arange(len(part.rows), dtype=float), np.arange(-REACH, REACH + 1) * band.step
    table = ca.interpolant("cost", "bspline", [index, grid], band.cost.ravel(order="F"), {"degree": [1, 3]})

    # the programme sees an even choice of the stations, with every pinned one; merit() sees them all
    use = np.unique(
        np.r_[np.linspace(0, len(index) - 1, min(len(index), PROGRAMME)).round().astype(int), list(part.pins)]
    ).astype(int)
    c, tau = ca.MX.sym("c", len(start)), ca.MX.sym("tau")
    delta = ca.mtimes(_casadi_sparse(ca, B[use]), c) - band.phi[use]
    cost = table(ca.vertcat(ca.DM(index[use]).T, delta.T)).T
    dq0 = np.diff(band.q[use], axis=0)
    slope = band.slope[use]
    dq = dq0 + ca.DM(slope[1:]) * ca.repmat(delta[1:], 1, 6) - ca.DM(slope[:-1]) * ca.repmat(delta[:-1], 1, 6)
    flights = [band.q[i] + band.slope[i] * delta[i] - q for i, q in ((0, ends[0]), (-1, ends[1])) if q is not None]
    share = np.add.reduceat(part.share, use)

    bounds: list[tuple[Any, Any]] = []  # (t, v) with t ≥ |v|: exact, and IPOPT sees no kink

    def length_of(v: Any) -> Any:
        v = ca.vec(v)
        t = ca.MX.sym(f"t{len(bounds)}", v.shape[0])
        bounds.append((t, v))
        return ca.sum1(t)

    seconds = np.diff(path.time[part.points])
    allowed = AXIS_SPEED * velocity[None, :] * np.maximum(np.add.reduceat(seconds, use[:-1]), 1e-6)[:, None]
    excess = ca.fmax(ca.fabs(dq) / ca.DM(allowed) - 1.0, 0.0)
    second = np.diff(np.eye(len(start)), n=2, axis=0) * (intervals / duration) ** 2 / np.sqrt(intervals)  # d²phi/dt²
    objective = (
        w.mean * ca.dot(ca.DM(share), cost)
        + w.worst * tau
        + price_q * (length_of(dq) + sum(length_of(f) for f in flights))
        + price_r * length_of(delta[1:] - delta[:-1] + np.diff(band.phi[use]))
        + CURVATURE * part.weight * ca.sumsqr(ca.mtimes(ca.sparsify(ca.DM(second)), c))
        + w.feed * part.weight / len(use) * ca.sumsqr(excess)
    )
    counted = np.flatnonzero(np.logical_or.reduceat(part.counted, use))
    g = [delta] + ([cost[counted.tolist()] - tau] if len(counted) else [])
    g += [side for t, v in bounds for side in (t - v, t + v)]
    m = sum(t.shape[0] for t, _ in bounds)
    lengths = ca.Function("lengths", [c], [ca.vertcat(*(ca.fabs(v) for _, v in bounds))])
    here = float(band.cost[use[counted], REACH].max()) if len(counted) else 0.0
    x = ca.vertcat(c, tau, *(t for t, _ in bounds))
    ipopt: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "max_iter": 80,
        "mu_strategy": "adaptive",
        "tol": 1e-5,
        "acceptable_tol": 1e-4,
    }
    problem = {"x": x, "f": objective, "g": ca.vertcat(*g)}
    solver = ca.nlpsol("smooth", "ipopt", problem, {"print_time": False, "error_on_fail": False, "ipopt": ipopt})
    tight = int((high[use] - low[use] < 1e-9).sum()) >= len(start)  # no room: the corridor is the answer
    answer = (
        {"x": np.full(len(start), np.nan)}
        if tight
        else solver(
            x0=np.r_[start, max(here, elsewhere), np.asarray(lengths(start)).ravel()],
            lbx=np.r_[np.full(len(start), -np.inf), elsewhere, np.zeros(m)],
            lbg=np.r_[low[use], np.full(len(counted), -np.inf), np.zeros(2 * m)],
            ubg=np.r_[high[use], np.zeros(len(counted)), np.full(2 * m, np.inf)],
        )
    )
    found = np.asarray(answer["x"]).ravel()[: len(start)]
    places = np.stack([index, np.zeros(len(index))])
    all_counted = np.flatnonzero(part.counted)

    def merit(answer: BSpline, ends: tuple[Array | None, Array | None], elsewhere: float) -> float:
        """The objective with true absolute values; infinite outside the corridor."""
        phi = B @ answer.c
        off = phi - band.phi
        if not ((off >= low - 0.02 * band.step) & (off <= high + 0.02 * band.step)).all():
            return float("inf")
        places[1] = off
        values = np.asarray(table(places)).ravel()
        joints = band.q + band.slope * off[:, None]
        steps = np.abs(np.diff(joints, axis=0))
        flown = sum(np.abs(joints[i] - q).sum() for i, q in ((0, ends[0]), (-1, ends[1])) if q is not None)
        late = np.maximum((steps / (AXIS_SPEED * velocity)).max(axis=1) - seconds, 0.0).sum()
        return float(
            w.mean * part.share @ values + w.worst * max(values[all_counted].max(initial=0.0), elsewhere)
            + price_q * (steps.sum() + flown) + price_r * np.abs(np.diff(phi)).sum()
            + w.feed * late / max(float(path.time[-1]), 1e-9)
        )  # fmt: skip

    still = np.full(len(start), float(np.median(band.phi)))
    tries = [start, treads, still]
    if np.isfinite(found).all():  # on the way from the plain answers to IPOPT's, whose kinks are rounded
        tries = [found, *(base + f * (found - base) for base in (treads, still) for f in (0.75, 0.5, 0.25)), *tries]
    return tuple(BSpline(knots, t, 3) for t in tries), merit


def _through_plateaus(x: Array, phi: Array) -> Array:
    """The grid's staircase as a monotone curve through the middle of every tread: as much rotation, without steps."""
    edge = np.flatnonzero(np.diff(phi) != 0)
    if not len(edge) or x[-1] <= 0:
        return phi
    first, last = np.r_[0, edge + 1], np.r_[edge, len(phi) - 1]
    middle, value = 0.5 * (x[first] + x[last]), phi[first]
    middle[0], middle[-1] = x[0], x[-1]
    keep = np.r_[True, np.diff(middle) > 1e-9]
    if keep.sum() < 2:
        return phi
    return np.asarray(PchipInterpolator(middle[keep], value[keep])(x))


def _least_squares(B: Any, values: Array) -> Array:
    """Spline coefficients that follow the grid choice, lightly smoothed where stations are fewer than knots."""
    from scipy.sparse import diags, identity
    from scipy.sparse.linalg import spsolve

    n = B.shape[1]
    D = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(n - 2, n)) if n > 2 else identity(n)
    return np.asarray(spsolve((B.T @ B + 1e-3 * D.T @ D + 1e-12 * identity(n)).tocsc(), B.T @ values))


def _casadi_sparse(ca: Any, B: Any) -> Any:
    coo = B.tocoo()
    return ca.DM.triplet(coo.row.tolist(), coo.col.tolist(), ca.DM(coo.data), *coo.shape)
