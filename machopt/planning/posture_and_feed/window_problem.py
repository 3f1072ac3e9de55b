"""The nonlinear program of one window, solved by IPOPT with exact first and second derivatives from CasADi.

Variables per node: joints x_k, rotation φ_k, excess s_k of the error; per segment: speed u_k as a share of its cap.
With τ_k = h_k/w_k, w_k = u_k · cap_k, velocity, acceleration and jerk are the differences

    v_k = (x_{k+1} − x_k)/τ_k,   a_k = 2 (v_k − v_{k−1})/(τ_k + τ_{k−1}),   j_k = (a_{k+1} − a_k)/τ_k

so that Σ τ_k is the duration. The excess has a price that is higher than any time it could save. Solver: Wächter &
Biegler, Math. Program. 106 (2006) 25.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from machopt.numerics.array_types import Array
from machopt.planning.posture_and_feed.symbolic_machine import SymbolicMachine
from machopt.planning.posture_and_feed.window_data import WindowData, WindowSolution

MILLIMETRE = 1e-3  # m, unit of errors and positions in the program
SLOWEST = 0.02  # share of the cap, lower bound of the speed
START = 0.98  # of the largest speed that keeps all limits on the present path
EXCESS_PRICE = 20.0  # times the time of a segment, per share of the limit
BENDING = 1e-3  # s per (rad/step)² of the second difference of the rotation: keeps the curve smooth between nodes
ITERATIONS = 80
TOLERANCE = 1e-4
_OPTIONS: dict[str, Any] = {
    "ipopt.print_level": 0,
    "print_time": False,
    "ipopt.sb": "yes",
    "ipopt.max_iter": ITERATIONS,
    "ipopt.tol": TOLERANCE,
    "ipopt.constr_viol_tol": 1e-6,
    "ipopt.acceptable_tol": 1e-2,
    "ipopt.acceptable_iter": 5,
    "ipopt.acceptable_constr_viol_tol": 1e-5,
    "ipopt.mu_strategy": "adaptive",
    "ipopt.bound_relax_factor": 0.0,
}


@dataclass(frozen=True)
class _Variables:
    """Decision variables as matrices with one column per node or segment."""

    x: ca.MX  # (n, N)
    phi: ca.MX  # (1, N)
    speed: ca.MX  # (1, N − 1)
    excess: ca.MX  # (1, N), in units of the limit


class _Constraints:
    """Constraint rows with their bounds, collected block by block."""

    def __init__(self) -> None:
        self.rows: list[ca.MX] = []
        self.low: list[Array] = []
        self.high: list[Array] = []

    def add(self, rows: ca.MX, low: Array | float, high: Array | float) -> None:
        """Add a block; the bounds have its shape or are one number."""
        flat = ca.vec(rows)
        count = flat.numel()
        if not count:
            return
        self.rows.append(flat)
        for bounds, value in ((self.low, low), (self.high, high)):
            whole = np.broadcast_to(np.asarray(value, float), (rows.shape[0], rows.shape[1]))
            bounds.append(whole.ravel(order="F"))


def solve_window(machine: SymbolicMachine, data: WindowData) -> WindowSolution:
    """Return the solution of a window; that of the last iteration where the solver did not finish.

    Args:
        machine: Symbolic kinematics.
        data: Numbers of the window.
    """
    v = _create_variables(machine.count, len(data.phi))
    found = _Constraints()
    _add_poses(found, machine, data, v)
    tau = ca.DM(data.way / data.cap).T / v.speed
    _add_motion_limits(found, data, v, tau)
    _add_joint_ranges(found, data, v)
    _add_errors(found, machine, data, v)
    _add_local_limits(found, data, v)
    _add_plunges(found, data, v)
    has_bend = len(data.phi) > 2
    bend = ca.sumsqr(v.phi[2:] - 2.0 * v.phi[1:-1] + v.phi[:-2]) if has_bend else ca.MX(0.0)
    cost = ca.sum2(tau) + EXCESS_PRICE * ca.sum2(v.excess * ca.DM(_weigh_nodes(data)).T) + BENDING * bend
    unknowns = ca.vertcat(ca.vec(v.x), ca.vec(v.phi), ca.vec(v.speed), ca.vec(v.excess))
    program: dict[str, Any] = {"x": unknowns, "f": cost, "g": ca.vertcat(*found.rows)}
    solver = ca.nlpsol("window", "ipopt", program, _OPTIONS)
    low, high = _bound_variables(data)
    start = _list_start(machine, data)
    result = solver(
        x0=np.clip(start, low, high), lbx=low, ubx=high, lbg=np.concatenate(found.low), ubg=np.concatenate(found.high)
    )
    return _read_solution(data, np.asarray(result["x"]).ravel(), solver.stats())


def _create_variables(n: int, count: int) -> _Variables:
    return _Variables(
        x=ca.MX.sym("x", n, count),
        phi=ca.MX.sym("phi", 1, count),
        speed=ca.MX.sym("u", 1, count - 1),
        excess=ca.MX.sym("s", 1, count),
    )


def _add_poses(constraints: _Constraints, machine: SymbolicMachine, data: WindowData, v: _Variables) -> None:
    """Tip and axes of the tool are those of the path at the rotation."""
    x, phi = ca.SX.sym("x", machine.count), ca.SX.sym("phi")
    place, axes = ca.SX.sym("p", 3), ca.SX.sym("R", 3, 3)
    position, rotation = machine.pose(x)
    across = -ca.sin(phi) * axes[:, 0] + ca.cos(phi) * axes[:, 1]
    residual = ca.vertcat(
        (position - place) / MILLIMETRE,
        ca.dot(rotation[:, 2], axes[:, 0]) / MILLIMETRE,
        ca.dot(rotation[:, 2], axes[:, 1]) / MILLIMETRE,
        ca.dot(rotation[:, 0], across) / MILLIMETRE,
    )
    node = ca.Function("node", [x, phi, place, axes], [residual])
    count = len(data.phi)
    frames = ca.horzcat(*(ca.DM(frame) for frame in data.frame))
    out = node.map(count)(v.x, v.phi, ca.DM(data.position.T), frames)
    free = np.flatnonzero(~data.is_fixed).tolist()
    if free:
        constraints.add(out[:, free], 0.0, 0.0)


def _add_motion_limits(constraints: _Constraints, data: WindowData, v: _Variables, tau: ca.MX) -> None:
    """Velocity, acceleration and jerk of every axis, each in units of its limit."""
    count = len(data.phi)
    axes = np.flatnonzero(np.r_[np.ones(6, bool), data.is_free]).tolist()
    rate = (v.x[axes, 1:] - v.x[axes, :-1]) / ca.repmat(tau, len(axes), 1)
    constraints.add(rate / ca.DM(np.tile(data.velocity[axes][:, None], count - 1)), -1.0, 1.0)
    still = ca.MX.zeros(len(axes), 1)
    left = [still] if data.starts_at_rest else []
    right = [still] if data.ends_at_rest else []
    rates = ca.horzcat(*left, rate, *right)
    times = ca.horzcat(*([tau[:, 0]] if left else []), tau, *([tau[:, -1]] if right else []))
    span = 0.5 * (times[:, 1:] + times[:, :-1])
    change = (rates[:, 1:] - rates[:, :-1]) / ca.repmat(span, len(axes), 1)
    constraints.add(change / ca.DM(np.tile(data.acceleration[axes][:, None], change.shape[1])), -1.0, 1.0)
    if change.shape[1] < 2:
        return
    between = times[:, 1:-1]
    jerk = (change[:, 1:] - change[:, :-1]) / ca.repmat(between, len(axes), 1)
    constraints.add(jerk / ca.DM(np.tile(data.jerk[axes][:, None], jerk.shape[1])), -1.0, 1.0)


def _add_joint_ranges(constraints: _Constraints, data: WindowData, v: _Variables) -> None:
    """Joints keep their range between nodes.

    A parabola through three nodes at distances g, h leaves its chord by c max(g, h)² / 4; c is its divided difference.
    """
    way = np.maximum(data.way, np.finfo(float).tiny)
    left, right = way[:-1], way[1:]
    part = np.maximum(left, right) ** 2 / (4.0 * (left + right))
    before, after = part / left, part / right  # of the differences to both neighbours; 1/8 at equal distances
    step, present = v.x[:, 1:] - v.x[:, :-1], np.diff(data.x, axis=0)
    count = data.x.shape[1]
    bend = step[:, 1:] * ca.DM(np.tile(after, (count, 1))) - step[:, :-1] * ca.DM(np.tile(before, (count, 1)))
    inner = v.x[:, 1:-1] - bend
    now = data.x[1:-1] - (present[1:] * after[:, None] - present[:-1] * before[:, None])
    axes = np.r_[np.ones(6, bool), data.is_free]
    rows = np.flatnonzero(~data.is_fixed[1:-1])
    at = rows.tolist()
    for n in np.flatnonzero(axes).tolist():
        low, high = np.minimum(data.lower[n], now[rows, n]), np.maximum(data.upper[n], now[rows, n])
        constraints.add(inner[n, at], low[None], high[None])


def _add_errors(constraints: _Constraints, machine: SymbolicMachine, data: WindowData, v: _Variables) -> None:
    """The nominal error at both segments of a node stays within its limit, but for the excess."""
    loads, count = data.loads, len(data.phi)
    share = data.cap * data.length / data.way  # tip speed at full speed
    for first, last in ((1, count), (0, count - 1)):  # the segment that ends at the node, the one that leaves it
        rows = np.flatnonzero(data.has_tolerance[first:last]) + first
        if not len(rows):
            continue
        segment = (rows - first).tolist()
        feed = v.speed[:, segment] * ca.DM(share[segment]).T
        wrench = ca.DM(loads.edge[rows].T) + ca.DM(loads.slope[rows].T) * ca.repmat(feed, 6, 1)
        columns = rows.tolist()
        error = machine.deflection.map(len(rows))(
            v.x[:, columns], ca.DM(loads.compliance[rows].T), wrench, ca.DM(loads.normal[rows].T)
        )
        use = error / ca.DM(loads.limit[rows]).T
        constraints.add(use - v.excess[:, columns], -np.inf, 1.0)
        constraints.add(use + v.excess[:, columns], -1.0, np.inf)


def _add_local_limits(constraints: _Constraints, data: WindowData, v: _Variables) -> None:
    limits, free = data.limits, np.flatnonzero(~data.is_fixed)
    for column in range(limits.count):
        rows = free[np.isfinite(limits.value[free, column])]
        if not len(rows):
            continue
        at = rows.tolist()
        change = (v.phi[:, at] - ca.DM(data.phi[rows]).T) * ca.DM(limits.by_phi[rows, column]).T
        for e in np.flatnonzero(data.is_free).tolist():
            moved = v.x[6 + e, at] - ca.DM(data.x[rows, 6 + e]).T
            change = change + moved * ca.DM(limits.by_external[rows, column, e]).T
        # where the present plan is nearer than the linear model's reserve, it must not get nearer
        constraints.add(change, -np.maximum(limits.value[rows, column], 0.0)[None], np.inf)


def _add_plunges(constraints: _Constraints, data: WindowData, v: _Variables) -> None:
    rows = np.flatnonzero(data.is_plunge & ~(data.is_fixed[1:] & data.is_fixed[:-1])).tolist()
    if rows:
        constraints.add(v.phi[:, [k + 1 for k in rows]] - v.phi[:, rows], 0.0, 0.0)


def _weigh_nodes(data: WindowData) -> Array:
    """Return (N,) s, half the time of either segment at its cap."""
    time = data.way / data.cap
    return np.asarray(0.5 * (np.r_[time, 0.0] + np.r_[0.0, time]))


def _bound_variables(data: WindowData) -> tuple[Array, Array]:
    count, n = data.x.shape
    low, high = np.tile(data.lower, (count, 1)), np.tile(data.upper, (count, 1))
    for e in range(n - 6):
        reach = data.external_trust if data.is_free[e] else 0.0
        low[:, 6 + e] = np.maximum(low[:, 6 + e], data.x[:, 6 + e] - reach)
        high[:, 6 + e] = np.minimum(high[:, 6 + e], data.x[:, 6 + e] + reach)
    phi_low, phi_high = data.phi_lower.copy(), data.phi_upper.copy()
    is_fixed = data.is_fixed
    low[is_fixed], high[is_fixed] = data.x[is_fixed], data.x[is_fixed]
    phi_low[is_fixed], phi_high[is_fixed] = data.phi[is_fixed], data.phi[is_fixed]
    speed, excess = np.full(count - 1, SLOWEST), np.where(data.has_tolerance, np.inf, 0.0)
    return (
        np.concatenate([low.ravel(), phi_low, speed, np.zeros(count)]),
        np.concatenate([high.ravel(), phi_high, np.ones(count - 1), excess]),
    )


def _list_start(machine: SymbolicMachine, data: WindowData) -> Array:
    """Return the present plan at one share of the feed that keeps the limits nearly everywhere."""
    speed = np.clip(START * compute_kept_speed(data), SLOWEST * 1.1, 1.0)
    return np.concatenate([data.x.ravel(), data.phi, speed, np.zeros(len(data.phi))])


def compute_kept_speed(data: WindowData) -> Array:
    """Return (N − 1,) the share of the cap at which each segment alone keeps velocity and acceleration.

    Args:
        data: Numbers of the window.
    """
    slope = np.diff(data.x, axis=0) / data.way[:, None]
    fast = np.abs(slope) / data.velocity
    share = 1.0 / np.maximum(data.cap * fast.max(axis=1), 1.0)
    bend = np.zeros_like(data.x)
    bend[1:-1] = np.diff(slope, axis=0) / (0.5 * (data.way[1:] + data.way[:-1]))[:, None]
    need = np.sqrt((np.abs(bend) / data.acceleration).max(axis=1))
    most = np.maximum(need[1:], need[:-1])
    return np.asarray(np.minimum(share, 1.0 / np.maximum(data.cap * most, 1.0)))


def _read_solution(data: WindowData, values: Array, stats: dict[str, object]) -> WindowSolution:
    count, n = data.x.shape
    x = values[: count * n].reshape(count, n)
    phi = values[count * n : count * (n + 1)]
    speed = values[count * (n + 1) : count * (n + 2) - 1]
    excess = values[count * (n + 2) - 1 :]
    limit = np.where(data.has_tolerance, data.loads.limit, 0.0)
    iterations = stats.get("iter_count", 0)
    return WindowSolution(
        x=x,
        phi=phi,
        feed=speed * data.cap * data.length / data.way,
        time=float(np.sum(data.way / (data.cap * np.maximum(speed, SLOWEST)))),
        is_solved=bool(stats.get("success", False)),
        status=str(stats.get("return_status", "")),
        iterations=iterations if isinstance(iterations, int) else 0,
        excess=excess * limit,
    )
