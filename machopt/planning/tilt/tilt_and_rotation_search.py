"""Sequence of rotation, branch and tilt over a coarse grid, by dynamic programming.

The prices are those of J (:mod:`machopt.planning.cost.objective`); a change of the tilt costs the travel of the joints.
The worst index is limited by a cap, which is tried at a few values; the sequence with the least J
counts. Vertices that collide are excluded and the search is repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.pipeline.plan_data_types import Plan, TiltBound
from machopt.planning.sequence_search.search_kernels import compute_joint_jump_limit
from machopt.planning.tilt.tilt_and_rotation_search_kernel import find_joint_sequence
from machopt.planning.tilt.tilt_grid import TiltGrid

CAPS = (np.inf, 0.6, 0.3, 0.1)  # of the way from the least possible worst index to that without a cap
BREAK = 1e3  # price of a break inside a run, above every J
TURN = np.radians(30.0)  # largest step of the rotation between two coarse stations
CONTACT_ROUNDS = 12  # searches with more colliding vertices excluded
NEIGHBOURS = 1  # rotations to either side of a colliding vertex that are excluded with it


@dataclass(frozen=True, kw_only=True)
class JointSequence:
    """One vertex at each coarse station; NaN where a station has none."""

    stations: NDArray[np.int32]  # (S,)
    phi: Array  # (S,) rad, unwrapped along each run
    q: Array  # (S, 6) rad
    tangent: Array  # (S, 3)
    cost: Array  # (S, K) index of all tilts at the rotation and branch of the vertex, in units of c₀; inf for none
    mean: float  # index in units of c₀, over the length cut
    worst: float


@dataclass(frozen=True, kw_only=True)
class _Vertices:
    first: NDArray[np.int64]  # (S + 1,)
    begin: NDArray[np.int64]  # (S, R + 1) first vertex of each rotation
    place: NDArray[np.intp]  # (N, 4) station, tilt, rotation, branch
    cost: Array  # (N,)
    q: Array  # (N, 6)
    tangent: Array  # (N, 3)


def find_tilt_sequence(plan: Plan, grid: TiltGrid, options: PlanOptions) -> JointSequence | None:
    """Return the best sequence over the grid without contact at its stations; None where there is no vertex at all.

    Args:
        plan: plan with the axes of the CAM file.
        grid: vertices.
        options: plan options of the path.
    """
    vertices = _list_vertices(grid)
    if not len(vertices.cost):
        return None
    path = replace(plan.path.programmed, stations=grid.stations)
    terms = ObjectiveTerms.at_stations(path, plan.setup.velocity, options)
    is_free = np.ones(len(vertices.cost), bool)
    chosen = np.full(len(grid.stations), -1)
    caps: tuple[float, ...] = CAPS
    for _ in range(CONTACT_ROUNDS):
        chosen, best = _find_least_objective(plan, grid, vertices, terms, is_free, caps)
        caps = (np.inf, best) if np.isfinite(best) else (np.inf,)
        hit = _find_contacts(plan, grid, vertices, chosen)
        if not len(hit):
            break
        _exclude(vertices, chosen[hit], is_free, grid)
    return _build_sequence(grid, vertices, chosen, terms)


def compute_tilt_bound(plan: Plan, grid: TiltGrid) -> TiltBound:
    """Return the lower bounds of mean and worst index over the grid, in units of c₀: the best vertex of each station.

    Motion and contacts are not counted, so no sequence over the grid has a lower mean or a lower worst index.

    Args:
        plan: plan with the axes of the CAM file.
        grid: vertices.
    """
    path = replace(plan.path.programmed, stations=grid.stations)
    least = grid.cost.reshape(len(grid.stations), -1).min(axis=1)
    known = np.isfinite(least)
    weight = path.station_weight
    counted = known & path.counted[grid.stations]
    return TiltBound(
        mean=float(weight[known] @ least[known]),
        worst=float(least[counted].max(initial=0.0)),
        stations=len(grid.stations),
        tilts=len(grid.nodes.tangent),
        step=grid.step,
    )


def _list_vertices(grid: TiltGrid) -> _Vertices:
    s, r, k, b = np.nonzero(np.isfinite(np.swapaxes(grid.cost, 1, 2)))  # ordered by station and rotation
    S, R = grid.phi.shape
    begin = np.searchsorted(s * R + r, np.arange(S * R + 1)).astype(np.int64)
    return _Vertices(
        first=np.ascontiguousarray(begin[::R]),
        begin=np.ascontiguousarray(np.column_stack([begin[:-1].reshape(S, R), begin[R::R]])),
        place=np.column_stack([s, k, r, b]),
        cost=grid.cost[s, k, r, b],
        q=np.ascontiguousarray(grid.q[s, k, r, b]),
        tangent=np.ascontiguousarray(grid.nodes.tangent[k, grid.stations[s]]),
    )


def _find_least_objective(
    plan: Plan,
    grid: TiltGrid,
    v: _Vertices,
    terms: ObjectiveTerms,
    is_free: NDArray[np.bool_],
    caps: Sequence[float],
) -> tuple[NDArray[np.int64], float]:
    """(S,) the vertices of the sequence with the least J among those with some caps of the worst index; its cap."""
    s = v.place[:, 0]
    counted = terms.counted[s]
    gamma_price = terms.liked(grid.phi.T).T  # (S, R)
    price = terms.share[s] * (terms.weights.mean * v.cost + gamma_price[s, v.place[:, 2]])
    price = np.where(is_free, price, np.inf)
    joined = np.r_[False, plan.path.run[grid.stations[1:]] == plan.path.run[grid.stations[:-1]]]
    w = terms.weights
    step = np.column_stack([w.travel * terms.travel, w.rotation * terms.rotation, w.feed * terms.lost, terms.seconds])
    count = grid.phi.shape[1]
    rule = np.array(
        [count, max(round(TURN / grid.step), 1), grid.step, grid.stable, compute_joint_jump_limit(grid.stable), BREAK],
        float,
    )
    label = np.ascontiguousarray(v.place[:, 2:].astype(np.int64))

    def search(prices: Array) -> NDArray[np.int64]:
        return find_joint_sequence(
            v.first, label, prices, v.q, v.begin, joined, step, np.ascontiguousarray(terms.slowness[:6]), rule
        )

    usable = np.where(is_free & counted, v.cost, np.inf)
    best_of = np.minimum.reduceat(np.r_[usable, np.inf], np.minimum(v.first[:-1], len(usable)))
    best_of = best_of[np.diff(v.first) > 0]
    floor = float(best_of[np.isfinite(best_of)].max(initial=0.0))
    found, top = [], np.inf
    for share in caps:
        cap = np.inf if not np.isfinite(share) else floor + share * max(top - floor, 0.0) + 1e-12
        chosen = search(np.where(counted & (v.cost > cap), np.inf, price))
        worst = float(v.cost[chosen[chosen >= 0]][counted[chosen[chosen >= 0]]].max(initial=0.0))
        found.append((_compute_total(v, chosen, price, step, joined, rule, terms) + w.worst * worst, chosen, share))
        top = min(top, worst)
    _, chosen, share = min(found, key=lambda one: one[0])
    return chosen, share


def _compute_total(
    v: _Vertices,
    chosen: NDArray[np.int64],
    price: Array,
    step: Array,
    joined: NDArray[np.bool_],
    rule: Array,
    terms: ObjectiveTerms,
) -> float:
    """Return J without the worst index of a sequence; stations without a vertex and breaks cost BREAK each."""
    at = np.flatnonzero(chosen >= 0)
    n = chosen[at]
    total = float(price[n].sum()) + BREAK * float((chosen < 0).sum())
    a, b, s = n[:-1], n[1:], at[1:]
    d = np.abs(v.q[b] - v.q[a])
    d = np.where(d > np.pi, np.abs(2 * np.pi - d), d)
    run = joined[s] & (np.diff(at) == 1)
    turn = np.abs(v.place[b, 2] - v.place[a, 2])
    turn = np.minimum(turn, rule[0] - turn)
    cut = run & ((turn > rule[1]) | (d.max(axis=1, initial=0.0) > rule[4]))
    if rule[3]:
        cut |= run & (v.place[b, 3] != v.place[a, 3])
    late = np.maximum((d * terms.slowness[:6]).max(axis=1, initial=0.0) - step[s, 3], 0.0)
    inside = step[s, 1] * turn * rule[2] + step[s, 2] * late
    moved = float((step[s, 0] * d.sum(axis=1) + np.where(run, inside, 0.0))[~cut].sum())
    return total + moved + BREAK * float(cut.sum())


def _find_contacts(plan: Plan, grid: TiltGrid, v: _Vertices, chosen: NDArray[np.int64]) -> NDArray[np.intp]:
    """(M,) the stations at which the chosen configuration touches something."""
    model, at = plan.setup.collision, np.flatnonzero(chosen >= 0)
    if model is None or not len(at):
        return np.empty(0, np.intp)
    rows = grid.stations[at]
    q = plan.path.whole(v.q[chosen[at]], rows)
    return at[model.check_configurations(q, plan.path.may_touch[rows]).hit]


def _exclude(v: _Vertices, hit: NDArray[np.int64], is_free: NDArray[np.bool_], grid: TiltGrid) -> None:
    """Exclude colliding vertices, and those of the same station, tilt and branch at the neighbouring rotations."""
    count = grid.phi.shape[1]
    for n in hit:
        s, k, r, b = v.place[n]
        rows = np.arange(v.first[s], v.first[s + 1])
        turn = np.abs(v.place[rows, 2] - r)
        near = np.minimum(turn, count - turn) <= NEIGHBOURS
        is_free[rows[near & (v.place[rows, 1] == k) & (v.place[rows, 3] == b)]] = False


def _build_sequence(
    grid: TiltGrid, v: _Vertices, chosen: NDArray[np.int64], terms: ObjectiveTerms
) -> JointSequence | None:
    at = np.flatnonzero(chosen >= 0)
    if not len(at):
        return None
    S, n = len(grid.stations), chosen[at]
    phi, q, tangent = np.full(S, np.nan), np.full((S, 6), np.nan), np.full((S, 3), np.nan)
    phi[at] = grid.phi[at, v.place[n, 2]]
    q[at], tangent[at] = v.q[n], v.tangent[n]
    costs = np.full((S, len(grid.nodes.tangent)), np.inf)
    costs[at] = grid.cost[at, :, v.place[n, 2], v.place[n, 3]]
    cost = v.cost[n]
    return JointSequence(
        stations=grid.stations,
        phi=phi,
        q=q,
        tangent=tangent,
        cost=costs,
        mean=float(terms.share[at] @ cost),
        worst=float(cost[terms.counted[at]].max(initial=0.0)),
    )
