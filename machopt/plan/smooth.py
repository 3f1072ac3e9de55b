"""Rotation as a smooth curve along the path, between and beyond the grid.

In each run phi(s) is a cubic B-spline over path length (plunges excluded: there it stays constant). CasADi
and IPOPT minimise the objective of :mod:`machopt.plan.score` with the cost of the chosen branch interpolated
from the grid, inside the corridor of rotations that are feasible around the grid optimum, with joint speeds held to
what the programmed feed leaves. Runs without travel (drilling) have one rotation: the vertex of a parabola.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, PchipInterpolator

from machopt.domain.options import PlanOptions
from machopt.plan.candidates import Candidates
from machopt.plan.choose import Choice
from machopt.plan.path import Path
from machopt.plan.realise import between_stations
from machopt.plan.score import AXIS_SPEED, Scores
from machopt.se3 import wrap

Array = NDArray[np.float64]
REACH = 16  # grid steps to either side of the chosen rotation that the corridor may span
SIDE_STEP = np.radians(30.0)  # largest joint step between neighbouring rotations of one branch
PROGRAMME = 400  # most stations of a run in the nonlinear programme
KNOTS = 160  # most spline intervals in a run
KNOT_SPACING = 0.15  # s at the programmed feed, least distance of knots
SWEEPS = 2  # over the runs
FINE = 8  # steps a grid step is divided into for runs with one rotation
CURVATURE = 2e-3  # price of the mean square angular acceleration of phi, per (rad/s²)²


Merit = Callable[[BSpline, tuple[Array | None, Array | None], float], float]
"""Worth of an answer, given the joints the rapid moves come from and go to, and the worst cost elsewhere."""


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


def smooth(
    path: Path, candidates: Candidates, scores: Scores, choice: Choice, velocity: Array, options: PlanOptions
) -> Smoothed:
    """Smooth every run of the choice. Stations without a vertex stay NaN, and so do the points around them.

    Args:
        velocity: (6,) rad/s, joint velocity limits.
    """
    P, st = len(path.index), path.stations
    worst = _grid_worst(path, scores, choice)
    position = np.searchsorted(st, np.arange(P))
    parts = [
        _Stretch.of(path, candidates, scores, choice, np.arange(a, b + 1), options)
        for first, last in path.runs
        for a, b in _whole_stretches(choice, position[first], position[last])
    ]
    for part, ends in zip(parts, _neighbours(parts), strict=True):
        if part.x[-1] > 0 and len(part.rows) >= 3:
            part.turns = True
            part.answers, part.merit = _spline_run(path, part, _worst_elsewhere(parts, part), ends, velocity, options)
            if part.pins:  # where no answer keeps to the corridor, the grid's own sequence is moved to meet the pins
                part.offset = np.interp(part.x, part.x[list(part.pins)], list(part.pins.values()))
    for _ in range(
        SWEEPS
    ):  # runs are tied by the rapid moves between them, so each is chosen with the others as they are
        for n, part in enumerate(parts):
            if part.turns:
                ends = _ends(parts, n)
                elsewhere = _worst_elsewhere(parts, part)
                value, spline = min(
                    ((part.merit(a, ends, elsewhere), a) for a in part.answers), key=lambda pair: pair[0]
                )
                if np.isfinite(value):
                    part.spline, part.offset = spline, spline(part.x) - part.band.phi
        _constant_rotations(path, parts, worst, options)
    phi, seed = np.full(P, np.nan), np.full((P, 6), np.nan)
    for part in parts:
        rows = slice(part.points[0], part.points[-1] + 1)
        turning = _turning_length(path, part.points[0], part.points[-1])
        bend = part.spline(turning) if part.spline else np.interp(turning, part.x, part.band.phi + part.offset)
        phi[rows] = bend
        near = part.joints()
        for i in range(6):
            seed[rows, i] = np.interp(path.s[rows], path.s[part.points], near[:, i])
        seed[part.points] = near
    return Smoothed(phi=phi, seed=seed)


def _ends(parts: list[_Stretch], n: int) -> tuple[Array | None, Array | None]:
    """Joints (6,) the rapid moves before and after stretch n come from and go to; None at the first and last."""
    return parts[n - 1].joints()[-1] if n else None, parts[n + 1].joints()[0] if n + 1 < len(parts) else None


def _worst_elsewhere(parts: list[_Stretch], one: _Stretch) -> float:
    """Worst cost of the other stretches as they are: improving this one below it gains nothing."""
    return max((p.worst() for p in parts if p is not one), default=0.0)


def _neighbours(parts: list[_Stretch]) -> list[tuple[Array | None, Array | None]]:
    return [_ends(parts, n) for n in range(len(parts))]


@dataclass
class _Stretch:
    """A continuous stretch of stations while it is being smoothed."""

    rows: NDArray[np.intp]  # stations
    points: NDArray[np.int32]  # their planning points
    band: Corridor
    x: Array  # (n,) m, turning length at the stations
    share: Array  # (n,) weight in the mean index
    weight: float  # of its motion
    pins: dict[int, float]  # fixed offsets by row
    offset: Array  # (n,) rad, found so far
    turns: bool = False  # the rotation may change along it
    spline: BSpline | None = None
    answers: tuple[BSpline, ...] = ()  # what the rotation may be, from IPOPT's to the plainest
    merit: Merit = lambda *_: float("inf")

    @classmethod
    def of(
        cls, path: Path, candidates: Candidates, scores: Scores, choice: Choice, rows: NDArray[np.intp], options: PlanOptions
    ) -> _Stretch:  # fmt: skip
        points = path.stations[rows]
        band = corridor(candidates, scores, choice, rows)
        turning = _turning_length(path, points[0], points[-1])
        share = path.counted[points] / max(int(path.counted[path.stations].sum()), 1)
        return cls(
            rows,
            points,
            band,
            turning[points - points[0]],
            share,
            float(path.motion_share[points[0]]),
            _pins(path, rows, band.phi, options),
            np.zeros(len(rows)),
        )

    def bounds(self) -> tuple[Array, Array]:
        """(n,) rad each: the corridor, closed to the exact value where the user fixed it."""
        low, high = np.minimum(self.band.low, 0.0), np.maximum(self.band.high, 0.0)
        for row, value in self.pins.items():
            low[row] = high[row] = value
        return low, high

    def worst(self) -> float:
        """Largest cost where it counts, at the offset as it is."""
        at = np.flatnonzero(self.share > 0)
        if not len(at):
            return 0.0
        x = np.clip(self.offset[at] / self.band.step + REACH, 0, 2 * REACH - 1e-9)
        k = x.astype(int)
        low, high = self.band.cost[at, k], self.band.cost[at, k + 1]
        return float((low + (x - k) * (high - low)).max())

    def joints(self) -> Array:
        """(n, 6) rad, to first order in the offset."""
        return self.band.q + self.band.slope * self.offset[:, None]


def _constant_rotations(path: Path, parts: list[_Stretch], worst: float, options: PlanOptions) -> None:
    """One rotation per drilling run, between the grid steps: the cheapest sequence over a fine grid (exact there).

    Holes are tied to each other by the joint travel between them, so they are chosen together; the cost between grid
    steps is the parabola through three of them.
    """
    fine = np.linspace(-1.0, 1.0, 2 * FINE + 1)
    choices, value, back = [], np.zeros(1), []
    previous = None
    for part in parts:
        free = not part.turns
        delta = fine * part.band.step if free else np.zeros(1)
        node = np.zeros(len(delta))
        if free:
            c0, c1, c2 = (part.band.cost[:, REACH + j] for j in (-1, 0, 1))
            cost = c1 + 0.5 * (c2 - c0) * fine[:, None] + 0.5 * (c0 - 2 * c1 + c2) * fine[:, None] ** 2  # (F, n)
            node = options.weights.mean * cost @ part.share
            low, high = float(part.band.low.max()), float(part.band.high.min())
            outside = (
                (delta < low - 1e-12)
                | (delta > high + 1e-12)
                | (cost[:, part.share > 0] > worst * (1 + 1e-9)).any(axis=1)
            )
            if part.pins:
                delta, node, outside = np.array([next(iter(part.pins.values()))]), np.zeros(1), np.zeros(1, bool)
            node = np.where(outside & (np.abs(delta) > 1e-12), np.inf, node)
        offset = delta + (np.zeros((2, 1)) if free else part.offset[[0, -1]][:, None])  # (2, F)
        start = part.band.q[0] + part.band.slope[0] * offset[0][:, None]
        end = part.band.q[-1] + part.band.slope[-1] * offset[1][:, None]
        if previous is None:
            back.append(np.zeros(len(delta), int))
            value = node
        else:
            total = value[:, None] + options.weights.travel / np.pi * part.weight * np.abs(
                start[None] - previous[:, None]
            ).sum(axis=-1)
            back.append(total.argmin(axis=0))
            value = total.min(axis=0) + node
        previous = end
        choices.append(delta)
    pick = int(value.argmin())
    for part, delta, source in zip(parts[::-1], choices[::-1], back[::-1], strict=True):
        if not part.turns:
            part.offset = np.full(len(part.rows), delta[pick])
        pick = int(source[pick])


def follow_grid(path: Path, candidates: Candidates, choice: Choice) -> Smoothed:
    """The grid optimum itself, linear in path length between stations."""
    phi = np.where(choice.dropped, np.nan, candidates.phi[choice.rotation])
    run = path.run[path.stations]
    for n in np.unique(run):
        rows = np.flatnonzero((run == n) & ~choice.dropped)
        phi[rows] = np.unwrap(phi[rows])
    return Smoothed(phi=between_stations(path, phi), seed=between_stations(path, choice.q))


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
    for fixed in sorted(options.fixed, key=lambda f: f.point):
        for i in np.flatnonzero(np.abs(path.index[points] - fixed.point) < 1e-9):
            pins[int(i)] = float(wrap(fixed.gamma - path.offset[points[i]] - phi[i]))
    return pins


def _spline_run(
    path: Path, part: _Stretch, elsewhere: float, ends: tuple[Array | None, Array | None], velocity: Array, options: PlanOptions
) -> tuple[tuple[BSpline, ...], Merit]:  # fmt: skip
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

    def length_of(v: object, typical: float) -> object:  # |v|, smooth at zero; far below the typical step
        small = max(0.03 * typical, 0.2 * band.step / len(use))  # sums to less than a fifth of a grid step
        return ca.sum1(ca.sqrt(ca.vec(v) ** 2 + small**2) - small)

    seconds = np.diff(path.time[part.points])
    allowed = AXIS_SPEED * velocity[None, :] * np.maximum(np.add.reduceat(seconds, use[:-1]), 1e-6)[:, None]
    excess = ca.fmax(ca.fabs(dq) / ca.DM(allowed) - 1.0, 0.0)
    second = np.diff(np.eye(len(start)), n=2, axis=0) * (intervals / duration) ** 2 / np.sqrt(intervals)  # d²phi/dt²
    objective = (
        w.mean * ca.dot(ca.DM(share), cost)
        + w.worst * tau
        + price_q * (length_of(dq, float(np.abs(dq0).mean())) + sum(length_of(f, 0.1) for f in flights))
        + price_r
        * length_of(
            delta[1:] - delta[:-1] + np.diff(band.phi[use]), float(np.abs(np.diff(band.phi[use])).mean()) + 1e-5
        )
        + CURVATURE * part.weight * ca.sumsqr(ca.mtimes(ca.sparsify(ca.DM(second)), c))
        + w.feed * part.weight / len(use) * ca.sumsqr(excess)
    )
    counted = np.flatnonzero(share > 0)
    g = [delta] + ([cost[counted.tolist()] - tau] if len(counted) else [])
    x = ca.vertcat(c, tau)
    here = float(band.cost[use[counted], REACH].max()) if len(counted) else 0.0
    solver = ca.nlpsol("smooth", "ipopt", {"x": x, "f": objective, "g": ca.vertcat(*g)}, {
        "print_time": False, "error_on_fail": False,
        "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 80, "mu_strategy": "adaptive", "tol": 1e-5, "acceptable_tol": 1e-4},
    })  # fmt: skip
    answer = solver(
        x0=np.r_[start, max(here, elsewhere)], lbx=np.r_[np.full(len(start), -np.inf), elsewhere],
        lbg=np.r_[low[use], np.full(len(counted), -np.inf)], ubg=np.r_[high[use], np.zeros(len(counted))],
    )  # fmt: skip
    found = np.asarray(answer["x"]).ravel()[:-1]
    places = np.stack([index, np.zeros(len(index))])
    all_counted = np.flatnonzero(part.share > 0)

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
