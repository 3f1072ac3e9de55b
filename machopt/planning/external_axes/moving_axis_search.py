"""Curves of external joints along the path: the best sequence over a grid of values, coarse to fine, then smoothed.

At some stations every value g of a grid, rotation r (15°) and branch b is a vertex. Inside a run a step leads to the
neighbouring value and rotation in the same branch; over a rapid move any value may follow any other. With c the index,
c₀ its unit, and the terms of :mod:`machopt.planning.cost.objective`:

    cost = Σ w_mean·share·c/c₀ + Σ (travel + rotation + time lost) + w_worst·max c/c₀

The worst index is traded by caps on it. The resulting step function is smoothed along the path (Whittaker's smoother
with third differences: Eilers 2003, eq. 4, here by path length), and a finer grid is built around the curve, a few
times. The result is a proposal: it is planned in full like a fixed value, and accepted where it is better
(:mod:`machopt.planning.external_axis_optimization.coarse_to_fine_search`). Contacts and whole turns of
the arm's joints are considered only in further attempts, where points are lost or the sequence breaks without them.
Point operations, and runs too short for a curve, keep one value each. Joints with one value per operation are tried at
a few.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.parallel_map import map_in_threads
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.external_axes.axis_curve_smoothing import (
    WAVE,
    GroupAxisRange,
    compute_narrowing_length,
    smooth_step_curve,
)
from machopt.planning.external_axes.moving_axis_kernels import compute_transition_costs, find_cheapest_value_sequence
from machopt.planning.external_axes.position_constraints import compute_axis_range_along_path, find_nearest_allowed
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sequence_search.search_kernels import compute_joint_jump_limit
from machopt.planning.stations.path_subset import select_path_runs
from machopt.planning.stations.planning_path import PlanningPath

COARSE = {1: 9, 2: 7, 3: 4}  # most values of each joint, by how many move
CLEAR = {1: 25, 2: 9, 3: 5}  # the same with contact checks: free ranges may be narrow
WOUND = {1: np.pi / 9.0, 2: np.pi / 4.0, 3: np.pi / 2.0}  # rad between coarse values where turns are counted
WINDS = 3.0 * np.pi  # rad, joint range from which whole turns are ignored
APART = 0.8  # equivalent rad: minimum distance of coarse values
HELD = 5  # values of a joint that keeps one, besides home and that of the best fixed plan
AROUND = {1: 2, 2: 1, 3: 1}  # steps to either side of the curve in the finer grids
FINER = 4  # maximum number of finer grids, each with half the step, down to FINEST
FINEST = 0.2  # equivalent rad
VERTICES = 1_500_000  # maximum size of a grid
MOST, LEAST = 240, 60  # stations
STEP = np.radians(15.0)  # of rotation
LOST = 1e3  # price of a path without a reachable station
CAPS = (0.0, 0.15, 0.3, 0.5, 0.75)  # position between the least possible worst index and that of the cheapest sequence


@dataclass(frozen=True, kw_only=True)
class AxisCurveSearch:
    """Setup and settings of a search for curves."""

    setup: PlanningSetup
    options: PlanOptions
    scale: float  # c₀
    clear: bool = False  # use only poses without contact. Every pose has to be checked, so there are fewer stations.
    turns: bool = False  # count whole turns of the arm's joints: a part may have to be turned to keep a joint inside
    tables: dict[bytes, _ValueVertices] = field(default_factory=dict)  # coarse grids: other weights use them again


@dataclass(frozen=True, kw_only=True)
class _GroupSearch:
    """Search along the runs of one group."""

    search: AxisCurveSearch
    options: PlanOptions  # with the rotation step of the search
    part: PlanningPath  # the runs of the group
    group: GroupAxisRange
    weight: Array  # (E,) factor of the travel of the external joints
    winds: Bools  # (6,) whole turns of the joint are ignored
    least: Array  # (n, E) m or rad, range of the external joints at the planning points
    most: Array

    def place(self, u: Array, rows: NDArray[np.integer[Any]] | slice) -> Array:
        """Return values u (…, E) over the whole range as shares of the range at some planning points."""
        if not self.group.bounds:
            return u
        low, high = self.group.low, self.group.high
        span = np.where(high > low, high - low, 1.0)
        a, b = (room[rows].reshape(-1, *(1,) * (u.ndim - 2), u.shape[-1]) for room in (self.least, self.most))
        return np.where(self.group.moving, a + (u - low) / span * (b - a), u)

    def find_steps(self, u: Array, near: NDArray[np.int64], again: bool = False) -> tuple[float, Array]:
        """Return the cost of the best sequence through a grid of values u (S, G, E), and its values (S, E).

        Args:
            u: values of the grid.
            near: (G, 3^k) numbers of the values next to each.
            again: other weights will search the same grid.
        """
        values, tables = self.place(u, self.part.stations), self.search.tables
        key = repr(self.group.runs).encode() + values.tobytes()
        vertices = tables.get(key) or _build_vertices(self, values, near)
        if again and sum(known.cost.size for known in tables.values()) + vertices.cost.size <= VERTICES:
            tables[key] = vertices
        cost, at = _find_best_sequence(self, vertices)
        return cost, np.asarray(u[np.arange(len(u)), at])


def compute_axis_curve(
    search: AxisCurveSearch, path: PlanningPath, group: GroupAxisRange, weight: Array, finer: int = FINER
) -> Array:
    """Return the (n, E) external joints in m or rad at the planning points of a group's runs, in order.

    Args:
        search: setup and settings of the search.
        path: planning points.
        group: group of operations and the ranges of its joints.
        weight: (E,) factor of their travel.
        finer: most finer grids that are searched.
    """
    setup = search.setup
    free = np.flatnonzero(group.moving & (group.high > group.low))
    size = (group.high - group.low)[free] * setup.per_rad[6:][free]
    counts = _count_coarse_values(setup, free, size, clear=search.clear, turns=search.turns)
    own = _prepare_group(search, path, group, weight, int(np.prod(counts)))
    step = np.zeros(len(group.fixed))
    step[free] = (group.high - group.low)[free] / (np.array(counts) - 1)
    stairs, fixed_values = _find_coarse_steps(own, free, counts)
    found = smooth_step_curve(own.part, stairs, group, WAVE)
    for level in range(1, finer + 1):
        if float((step * setup.per_rad[6:]).max()) <= FINEST:
            break
        step = 0.5 * step
        side = AROUND[len(free)]
        around = _combine_values(free, [np.arange(-side, side + 1) * step[k] for k in free], np.zeros(len(group.fixed)))
        around = found[own.part.stations][:, None] + around
        near = _number_neighbours([2 * side + 1] * len(free))
        values = np.where(group.moving, np.clip(around, group.low, group.high), fixed_values)
        _, stairs = own.find_steps(values, near)
        found = smooth_step_curve(own.part, stairs, group, WAVE / 1.5**level)
    return np.where(group.moving, own.place(found, slice(None)), fixed_values)


def _prepare_group(
    search: AxisCurveSearch, path: PlanningPath, group: GroupAxisRange, weight: Array, count: int
) -> _GroupSearch:
    """Return the search along the runs of a group, with as many stations as ``count`` coarse values permit."""
    setup, rotation_step = search.setup, max(search.options.rotation_step, STEP)
    whole = round(2 * np.pi / rotation_step) * setup.arm.solver.branches
    stations = LEAST if search.clear else int(np.clip(VERTICES / (whole * count), LEAST, MOST))
    part = select_path_runs(path, group.runs, stations)
    winds = np.full(6, True) if not search.turns else np.asarray(setup.arm.upper - setup.arm.lower >= WINDS)
    least, most = compute_axis_range_along_path(
        part, group.low, group.high, group.bounds, [compute_narrowing_length(part, run) for run in part.runs]
    )
    return _GroupSearch(
        search=search,
        options=replace(search.options, rotation_step=rotation_step),
        part=part,
        group=group,
        weight=weight,
        winds=winds,
        least=least,
        most=most,
    )


def _find_coarse_steps(group_search: _GroupSearch, free: NDArray[np.intp], counts: list[int]) -> tuple[Array, Array]:
    """Return the best sequence (S, E) over the coarse grid, and the (E,) values of the joints that keep one."""
    low, high, near = group_search.group.low, group_search.group.high, _number_neighbours(counts)
    of_each = [np.linspace(low[k], high[k], n) for k, n in zip(free, counts, strict=True)]
    tries = []
    for fixed_values in _list_held_values(group_search.group):  # of joints that keep one value
        grid = _combine_values(free, of_each, fixed_values)
        cost, stairs = group_search.find_steps(
            np.broadcast_to(grid, (len(group_search.part.stations), *grid.shape)), near, again=True
        )
        tries.append((cost, stairs, fixed_values))
    _, stairs, fixed_values = min(tries, key=lambda found: found[0])
    return stairs, fixed_values


def _count_coarse_values(
    setup: PlanningSetup, free: NDArray[np.intp], size: Array, *, clear: bool, turns: bool
) -> list[int]:
    """Return the number of coarse values of each free joint whose range is equivalent to ``size`` rad."""
    if clear:
        return [CLEAR[len(free)]] * len(free)
    finest = COARSE[len(free)]
    if turns:
        return [max(int(np.ceil(way / WOUND[len(free)])) + 1, 3) for way in size]
    if len(free) == 1 and not setup.cell.external_prismatic[free[0]]:
        finest = int(np.ceil(finest * max(float(size[0]) / (2 * np.pi), 1.0)))  # a shaft that turns several times
    return [int(np.clip(np.ceil(way / APART) + 1, 3, finest)) for way in size]


def _list_held_values(group: GroupAxisRange) -> list[Array]:
    """Return the (E,) values tried of the joints with one value; those of the best fixed plan first."""
    choices = [
        [group.fixed[k]]
        if group.moving[k] or a == b
        else list(
            dict.fromkeys(
                [group.fixed[k], group.home[k], *(_get_next_value(group, k, v) for v in np.linspace(a, b, HELD))]
            )
        )
        for k, (a, b) in enumerate(zip(group.low, group.high, strict=True))
    ]
    return [np.array(values) for values in itertools.product(*choices)]


def _get_next_value(group: GroupAxisRange, k: int, value: float) -> float:
    return find_nearest_allowed(group.allowed[k], value) if group.allowed else value


def _combine_values(free: NDArray[np.intp], of_each: list[Array], fixed: Array) -> Array:
    """(G, E) all combinations of the values of the free joints, the others at ``fixed``."""
    out = np.tile(fixed, (int(np.prod([len(v) for v in of_each])), 1))
    out[:, free] = np.array(list(itertools.product(*of_each)))
    return out


def _number_neighbours(counts: list[int]) -> NDArray[np.int64]:
    """(G, 3^k) numbers of the values next to each, itself among them; −1 where the grid ends."""
    at = np.array(list(itertools.product(*(range(n) for n in counts))))
    out = []
    for side in itertools.product((0, -1, 1), repeat=len(counts)):
        to = at + np.array(side)
        inside = ((to >= 0) & (to < np.array(counts))).all(axis=1)
        out.append(np.where(inside, np.ravel_multi_index(np.clip(to, 0, np.array(counts) - 1).T, counts), -1))
    return np.array(out, np.int64).T.copy()


@dataclass(frozen=True, kw_only=True)
class _ValueVertices:
    """Vertices of a grid of values and the steps between them: S stations, G values, R rotations, B branches."""

    values: Array  # (S, G, E) m or rad, external joints
    near: NDArray[np.int64]  # (G, 3^k) numbers of the values next to each, −1 where the grid ends
    cost: Array  # (S, G, R, B) index in units of c₀, NaN where infeasible
    edges: NDArray[np.float32]  # (S, 3^(k+1), G·R·B) price of the steps without the travel of the external joints


def _build_vertices(group_search: _GroupSearch, values: Array, near: NDArray[np.int64]) -> _ValueVertices:
    """Return the vertices at values of the external joints (S, G, E) and the steps between neighbours (G, 3^k)."""
    cost, q, is_stable = _score_values(group_search, values, near)
    edges = _compute_edges(group_search, values, near, q, is_stable)
    return _ValueVertices(values=values, near=near, cost=cost, edges=edges)


def _find_joined(part: PlanningPath) -> Bools:
    """Return (S,) whether a station continues the run of the previous one."""
    return np.asarray(np.r_[False, part.run[part.stations][1:] == part.run[part.stations][:-1]])


def _find_best_sequence(group_search: _GroupSearch, vertices: _ValueVertices) -> tuple[float, NDArray[np.int64]]:
    """Return the cost of the best sequence through a grid of values, and the index (S,) in G it takes."""
    setup, part, values = group_search.search.setup, group_search.part, vertices.values
    S, (R, B) = len(values), vertices.cost.shape[2:]
    terms, w = ObjectiveTerms.at_stations(part, setup.velocity, group_search.options), group_search.options.weights
    joined = _find_joined(part)
    flown = np.ascontiguousarray(w.travel * terms.travel)
    c = vertices.cost.reshape(S, -1)
    node = terms.share[:, None] * w.mean * c
    node = np.where(np.isfinite(node), node, LOST / S)
    counted = np.asarray(part.counted[part.stations])
    raw = np.where(counted[:, None] & np.isfinite(c), c, 0.0)
    scaled = values * setup.per_rad[6:] * group_search.weight

    def under(cap: float) -> tuple[float, float, NDArray[np.int64]]:
        way, total = find_cheapest_value_sequence(
            np.where(raw > cap, LOST / S, node), vertices.edges, vertices.near, scaled, R, B, joined, flown
        )
        worst = float(raw[np.arange(S), way].max())
        return total + w.worst / max(group_search.group.share, 1e-9) * worst, worst, way

    best = under(np.inf)
    most = best[1]
    reached = np.where(np.isfinite(c), c, np.inf).min(axis=1)[counted]
    least = float(reached[np.isfinite(reached)].max(initial=0.0))
    if most > least:
        capped = map_in_threads(under, [least + t * (most - least) for t in CAPS])
        best = min([best, *capped], key=lambda f: f[0])
    return best[0], best[2] // (R * B)


def _score_values(group_search: _GroupSearch, values: Array, near: NDArray[np.int64]) -> tuple[Array, Array, bool]:
    """Return index and joints of the configurations at every value of the grid (S, G, E).

    Returns:
        (S, G, R, B) index in units of c₀, and (S, G·R·B, 6) rad, NaN each where infeasible, B the branches that occur;
        whether a branch is the same assembly mode at every pose.
    """
    setup, part = group_search.search.setup, group_search.part
    S, G = values.shape[:2]
    station_of = np.minimum(np.searchsorted(part.stations, np.arange(len(part.index))), S - 1)
    across = compute_sideways_directions(part)

    def at(g: int) -> tuple[Array, Array, bool]:
        there = replace(part, external=values[station_of, g])
        candidates = enumerate_candidates(there, setup.arm, group_search.options, every_branch=True)
        d = compute_load_directions(there, setup.arm, setup.elasticity, group_search.options.force, across)
        cost = score_candidates(there, candidates, setup.elasticity, d, group_search.options).cost
        if group_search.search.clear:
            cost = _free(cost, candidates.q, values[:, g], part, setup)
        return cost, candidates.q, candidates.stable

    found_at = map_in_threads(at, range(G))
    occurs = np.any([np.isfinite(cost).any(axis=(0, 1)) for cost, _, _ in found_at], axis=0)
    occurs[0] |= not occurs.any()
    c = np.stack([cost[..., occurs] for cost, _, _ in found_at], axis=1) / group_search.search.scale  # (S, G, R, B)
    q = np.stack([q[..., occurs, :] for _, q, _ in found_at], axis=1)
    q[~np.isfinite(c)] = np.nan
    if group_search.search.clear:
        c[_find_near_contact(np.asarray(np.isfinite(c).any(axis=(2, 3))), near)] = np.nan
    return c, q.reshape(S, -1, 6), found_at[0][2]


def _compute_edges(
    group_search: _GroupSearch, values: Array, near: NDArray[np.int64], q: Array, is_stable: bool
) -> NDArray[np.float32]:
    """Return the price of every transition between neighbouring vertices of one run, whose joints are q (S, V, 6)."""
    part, w, setup = group_search.part, group_search.options.weights, group_search.search.setup
    terms = ObjectiveTerms.at_stations(part, setup.velocity, group_search.options)
    still: Bools = part.is_drilling | part.plunge
    R = round(2 * np.pi / group_search.options.rotation_step)
    return compute_transition_costs(
        q,
        np.ascontiguousarray(values * setup.per_rad[6:]),
        near,
        R,
        q.shape[1] // (values.shape[1] * R),
        _find_joined(part),
        still[part.stations],
        group_search.winds,
        terms.seconds,
        terms.slowness,
        np.ascontiguousarray(w.travel * terms.travel),
        np.ascontiguousarray(w.rotation * terms.rotation),
        np.ascontiguousarray(w.feed * terms.lost),
        compute_joint_jump_limit(is_stable),
        LOST / len(values),
    )


def _free(cost: Array, q: Array, external: Array, part: PlanningPath, setup: PlanningSetup) -> Array:
    """The costs (S, R, B) of poses q (S, R, B, 6) at external (S, E), NaN where one touches anything."""
    if setup.collision is None:
        return cost
    at = np.nonzero(np.isfinite(cost))
    found = setup.collision.check_configurations(
        np.hstack([q[at], external[at[0]]]), part.may_touch[part.stations][at[0]]
    )
    out = cost.copy()
    out[tuple(k[found.hit] for k in at)] = np.nan
    return out


def _find_near_contact(free: Bools, near: NDArray[np.int64]) -> Bools:
    """Return (S, G) contact-free values next to one with contact, where their station has others: a smooth curve
    cuts corners.
    """
    inner = free & (free[:, near] | (near < 0)).all(axis=2)
    return np.asarray(free & ~inner & np.any(inner, axis=1, keepdims=True))
