"""The objective along one run as a smooth nonlinear programme in the coefficients of a spline, for IPOPT.

Absolute values and maxima stand as slack variables with linear sides, so that the programme is the objective itself and
not a rounded copy of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.plan.corridor import REACH, Ends, Stretch
from machopt.plan.costtable import CostTable
from machopt.plan.objective import disliked, edge_price, node_price

Array = NDArray[np.float64]
IPOPT: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 80,
    "mu_strategy": "adaptive",
    "tol": 1e-5,
    "acceptable_tol": 1e-4,
}


@dataclass(frozen=True)
class Programme:
    """J of one stretch over x = (coefficients, tau, slacks); CasADi's types are not known to mypy."""

    coefficients: Any  # (m,) of the spline
    x: Any  # (m + 1 + number of slacks,)
    value: Any  # J, but for the worst cost of other stretches
    offset: Any  # (n,) rad, to be kept inside the corridor
    above: Any  # to be kept below 0: costs where they count, less tau, the worst
    sides: Any  # to be kept at or above 0
    slacks: Any  # function: coefficients → least slacks; with them ``value`` is J exactly
    worst: float  # at the grid's own sequence

    def at(self, coefficients: Array, worst: float) -> float:
        """J at coefficients (m,) and a worst cost, in units of c₀."""
        import casadi as ca

        x = np.r_[coefficients, worst, np.asarray(self.slacks(coefficients)).ravel()]
        return float(ca.Function("value", [self.x], [self.value])(x))

    def solve(self, start: Array, bend: Any, low: Array, high: Array, elsewhere: float) -> Array:
        """(m,) coefficients: IPOPT's last iterate, which is judged like any other answer.

        Args:
            start: (m,) coefficients.
            bend: price of bending, in the coefficients; no part of J.
            low, high: (n,) rad, the corridor.
            elsewhere: worst cost of the other stretches.
        """
        import casadi as ca

        problem = {"x": self.x, "f": self.value + bend, "g": ca.vertcat(self.offset, self.above, self.sides)}
        options: Any = {"print_time": False, "error_on_fail": False, "ipopt": IPOPT}
        first = np.asarray(self.slacks(start)).ravel()
        above, sides = self.above.shape[0], self.sides.shape[0]
        answer = ca.nlpsol("smooth", "ipopt", problem, options)(
            x0=np.r_[start, max(self.worst, elsewhere), first],
            lbx=np.r_[np.full(len(start), -np.inf), elsewhere, np.zeros(len(first))],
            lbg=np.r_[low, np.full(above, -np.inf), np.zeros(sides)],
            ubg=np.r_[high, np.zeros(above), np.full(sides, np.inf)],
        )
        return np.asarray(answer["x"]).ravel()[: len(start)]


def programme(part: Stretch, table: CostTable, basis: Any, use: NDArray[np.intp], ends: Ends) -> Programme:
    """The programme of one stretch at some of its stations.

    Args:
        table: the cost at its stations.
        basis: (n, m) sparse, the spline's at these stations.
        use: (n,) rows of the stations, the first and the last of the stretch among them.
        ends: what the rapid moves before and after come from and go to.
    """
    import casadi as ca

    band, terms, w = part.band, part.terms, part.terms.weights
    c, tau = ca.MX.sym("c", basis.shape[1]), ca.MX.sym("tau")
    delta = ca.mtimes(_sparse(basis), c) - band.phi[use]
    cost = table(use, delta)
    own, n = terms.take(use), len(use) - 1
    share = np.add.reduceat(terms.share, use)
    seconds = np.add.reduceat(terms.seconds[1:], use[:-1])
    joints = ca.DM(band.q[use]) + ca.DM(band.slope[use]) * ca.repmat(delta, 1, 6)
    angle = delta + band.phi[use]
    slack: list[Any] = []
    least: list[Any] = []  # what each slack is at given coefficients
    sides: list[Any] = []  # not below 0

    def size(v: Any) -> Any:
        """|v| as a slack t ≥ ±v: exact, and IPOPT sees no kink."""
        t = ca.MX.sym(f"t{len(slack)}", *v.shape)
        slack.append(ca.vec(t))
        least.append(ca.vec(ca.fabs(v)))
        sides.extend((ca.vec(t - v), ca.vec(t + v)))
        return t

    steps = joints[1:, :] - joints[:-1, :]
    moved, turned = size(steps), size(angle[1:] - angle[:-1])
    behind = ca.MX.sym("behind", n)  # late() as a slack too: no axis is later
    room, slowness = ca.repmat(ca.DM(seconds), 1, 6), ca.repmat(ca.DM(own.slowness).T, n, 1)
    slack.append(behind)
    needed: list[Any] = ca.horzsplit(ca.fabs(steps) * slowness - room)
    least.append(reduce(ca.fmax, needed, 0.0))
    sides.append(ca.vec(ca.repmat(behind, 1, 6) + room - moved * slowness))
    prices = (w.travel * own.travel[1:], w.rotation * own.rotation[1:], w.feed * own.lost[1:])
    flown = ((0, ends.before, w.travel * own.travel[0]), (-1, ends.after, ends.onward))
    flights = [price * ca.sum2(size(joints[i, :] - ca.DM(q).T)) for i, q, price in flown if q is not None]
    liked = 0.0 * angle
    if terms.options.preferred_rotation is not None:
        away = angle + ca.DM(own.offset) - terms.options.preferred_rotation
        liked = disliked(ca.cos(away), terms.options.preferred_weight)
    if band.crowded is not None:  # on the line between the grid's rotations, as Stretch.price takes it
        steps_off = np.arange(-REACH, REACH + 1) * band.step
        rows = np.arange(len(band.q), dtype=float)
        near = ca.interpolant("crowded", "linear", [rows, steps_off], band.crowded.ravel(order="F"))
        liked = liked + w.clearance * near(ca.vertcat(ca.DM(use.astype(float)).T, delta.T)).T
    value = (
        ca.dot(ca.DM(share), node_price(cost, liked, w.mean))
        + w.worst * tau
        + ca.sum1(edge_price(ca.sum2(moved), turned, behind, *map(ca.DM, prices)))
        + sum(flights)
    )
    counted = np.flatnonzero(np.logical_or.reduceat(terms.counted, use))
    return Programme(
        coefficients=c, x=ca.vertcat(c, tau, *slack), value=value, offset=delta,
        above=cost[counted.tolist()] - tau if len(counted) else ca.MX(0, 1), sides=ca.vertcat(*sides),
        slacks=ca.Function("slacks", [c], [ca.vertcat(*least)]),
        worst=float(band.cost[use[counted], REACH].max()) if len(counted) else 0.0,
    )  # fmt: skip


def _sparse(B: Any) -> Any:
    import casadi as ca

    coo = B.tocoo()
    return ca.DM.triplet(coo.row.tolist(), coo.col.tolist(), ca.DM(coo.data), *coo.shape)
