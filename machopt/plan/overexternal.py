"""What no sequence undercuts when the values of the external joints are free too: a lower bound of J over them.

The bound of :mod:`machopt.plan.certificate` holds with the external joints as the plan has them. Here they are part of
the sequence: at some stations of the path every value g, rotation r and branch b is a vertex (:mod:`~.lattice`). The
values are a grid over what the joints may take, and the plan's own at each station, so that the plan with its rotation
on the grid is one of the sequences. A joint that moves may take any of them at any station; one that keeps a value
for an operation takes one wherever that operation goes on without another in between; while the tool drills or plunges
nothing moves. J is that of :mod:`~.objective` at these stations, the worst index traded exactly (:mod:`~.caps`).

Contacts, crowding and whole turns of the arm's joints are left out. They can only raise J, so the bound holds for
what can be driven as well. What lies between the stations counts as the stations beside it do.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array, Bools
from machopt.domain.options import PlanOptions
from machopt.domain.toolpath import Toolpath
from machopt.plan.axes import axes_of
from machopt.plan.candidates import enumerate_candidates
from machopt.plan.caps import GAP, Capped, trade
from machopt.plan.engage import sideways
from machopt.plan.groups import Group, groups_of
from machopt.plan.lattice import follow, reach
from machopt.plan.made import ExternalBound, Plan
from machopt.plan.objective import Terms, node_price
from machopt.plan.part import part_of
from machopt.plan.path import Path
from machopt.plan.score import directions, score_candidates
from machopt.plan.setup import Setup, Timings

VALUES = {1: 13, 2: 5, 3: 3}  # of each joint in the grid, by how many are free
STEP = np.radians(15.0)  # of rotation
VERTICES = 600_000  # in all: what the bound may cost
MOST, LEAST = 240, 24  # stations
SLACK = 1e-12  # of a limit, for rounding: both ways of adding up one sequence


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """Sequences over values, rotations and branches, and what they cost."""

    node: Array  # (S, V) price of the vertices without the worst index, infinite where there is none
    raw: Array  # (S, V) index in units of c₀ where it counts, 0 elsewhere
    q: Array  # (S, V, 6) rad
    e: Array  # (S, G, E) lengths as they count in rad
    phi: Array  # (S, R) rad
    held: NDArray[np.int64]  # (S, G) what the joints that keep one value stand at, by number
    branches: int
    stable: bool
    kind: Bools  # (S, 3) as in :func:`machopt.plan.lattice.reach`
    priced: Array  # (S, 4) likewise
    slowness: Array  # (6 + E,) s/rad
    worst: float  # price of the worst index

    def best(self, gap: float = GAP) -> tuple[float, float, NDArray[np.int64]] | None:
        """J of the best sequence, what none has less than, and the vertices (S,) of it; None where there is none.

        Args:
            gap: share of J by which a better one may be missed.
        """
        onward = self._onward()
        if not np.isfinite(onward[0].min()):
            return None
        limit = float(onward[0].min())
        free = self._capped(self.node, onward, limit * (1.0 + SLACK))
        if free is None:
            raise AssertionError("the cheapest sequence is within its own price")

        def under(cap: float, most: float) -> Capped | None:
            return self._capped(np.where(self.raw <= cap, self.node, np.inf), onward, most)

        there = np.where(np.isfinite(self.node), self.raw, np.inf)
        found = trade(free, float(there.min(axis=1).max()), self.worst, under, gap)
        return found.total, min(found.bound, found.total), found.best.vertex.astype(np.int64)

    def _onward(self) -> Array:
        """(S, V) what the way from each vertex on costs, its own price included."""
        after = np.r_[0, np.arange(len(self.node) - 1, 0, -1)]  # the step into a station of the reversed path
        node = np.ascontiguousarray(self.node[::-1])
        back = self._reach(node, self.kind[after], self.priced[after], node, np.inf, reverse=True)
        return np.ascontiguousarray(back[::-1])

    def _capped(self, node: Array, onward: Array, limit: float) -> Capped | None:
        """The cheapest sequence over the vertices that ``node`` (S, V) leaves; None where none is below the limit."""
        reached = self._reach(node, self.kind, self.priced, onward, limit)
        value = float(reached[-1].min())
        if not np.isfinite(value):
            return None
        along = self.q, self.e, self.phi, self.held, self.branches, self.stable, self.kind, self.priced
        vertex = follow(reached, *along, self.slowness)
        return Capped(vertex.astype(np.int32), value, float(self.raw[np.arange(len(vertex)), vertex].max()))

    def _reach(
        self, node: Array, kind: Bools, priced: Array, onward: Array, limit: float, reverse: bool = False
    ) -> Array:
        q, e, phi, held = self.q, self.e, self.phi, self.held
        if reverse:
            q, e, phi = (np.ascontiguousarray(a[::-1]) for a in (q, e, phi))
            held = np.ascontiguousarray(held[::-1])
        found: Array = reach(
            node, q, e, phi, held, self.branches, self.stable, kind, priced, self.slowness, onward, limit
        )
        return found


@dataclass(frozen=True)
class Values:
    """What the external joints of one group of operations may stand at; all groups of a lattice have as many rows."""

    value: Array  # (G, E) m or rad, NaN where the path has them
    held: NDArray[np.int64]  # (G,) what the joints that keep one value stand at, by number
    exists: Bools  # (G,) False: only there to have as many

    def padded(self, count: int) -> Values:
        more = count - len(self.value)
        value = np.vstack([self.value, np.full((more, self.value.shape[1]), np.nan)])
        return Values(value, np.r_[self.held, np.zeros(more, np.int64)], np.r_[self.exists, np.zeros(more, bool)])


def over_external(
    plan: Plan, toolpath: Toolpath, timings: Timings, values: dict[int, int] | None = None
) -> ExternalBound | None:
    """The bound of a plan of one tool; None where no external joint was free.

    Args:
        values: of each joint in the grid, by how many are free; default :data:`VALUES`.
    """
    setup, path = plan.setup, plan.path
    axes = axes_of(setup.cell, plan.options) if setup.cell.external_joints else ()
    groups = groups_of(setup.cell, toolpath, path, axes) if axes else []
    if all((g.low == g.high).all() for g in groups):
        return None
    if plan.found is None or plan.breaks or len(plan.missing):
        return ExternalBound(why="the plan has gaps or breaks, or was not searched")
    with timings.stage("external"):
        options = replace(plan.options, rotation_step=max(plan.options.rotation_step, STEP))
        grids = [_values(g, path, VALUES if values is None else values) for g in groups]
        rotations, branches = round(2 * np.pi / options.rotation_step), setup.arm.solver.branches
        most = max(len(g.value) for g in grids)
        least = max(LEAST, 2 * len(path.runs))
        if most * rotations * branches * least > VERTICES:
            return ExternalBound(
                why=f"{most} values x {rotations} rotations x {branches} branches at no less than {least} stations are "
                f"more than the {VERTICES} poses that it may look at"
            )
        count = int(np.clip(VERTICES // (most * rotations * branches), least, MOST))
        part = part_of(path, range(len(path.runs)), count)
        found = lattice_of(setup, options, part, groups, grids, plan.scores.scale).best()
        if found is None:
            return ExternalBound(why="no sequence of the grid leads through all of the path")
        total, bound, _ = found
        return ExternalBound(
            bound=bound,
            sequence=total,
            plan=_at_stations(plan, part),
            values=most - 1,
            stations=len(part.stations),
            step=2 * np.pi / rotations,
        )


def _at_stations(plan: Plan, part: Path) -> float:
    """J of the plan as the sequences are priced: at the stations of a part that has all runs."""
    terms, w, rows = Terms.at_stations(part, plan.setup.velocity, plan.options), plan.options.weights, part.stations
    x, phi = plan.setup.in_rad(plan.path, plan.chosen.assignment.q)[rows], plan.chosen.assignment.phi[rows]
    cost = plan.chosen.cost[rows] / plan.scores.scale
    worst = float(cost[terms.counted].max(initial=0.0))
    return float(terms.nodes(cost, phi).sum() + terms.steps(x, phi).sum() + w.worst * worst)


def _values(group: Group, path: Path, counts: dict[int, int]) -> Values:
    """A grid over what the group's joints may take, and the plan's own values last."""
    own = path.external[path.runs[group.runs[0]][0]]
    free = group.high > group.low
    count = counts.get(int(free.sum()), 2)
    of_each = []
    for a, b, moves, at in zip(group.low, group.high, group.moving, own, strict=True):
        grid = np.linspace(a, b, count if b > a else 1)
        of_each.append(grid if moves else np.unique(np.r_[grid, at]))
    value = np.array([*itertools.product(*of_each), own])
    keeps = free & ~group.moving
    _, held = np.unique(value[:, keeps], axis=0, return_inverse=True)
    value[-1] = np.nan
    return Values(value, np.asarray(held, np.int64).reshape(-1), np.ones(len(value), bool))


def lattice_of(
    setup: Setup, options: PlanOptions, part: Path, groups: Sequence[Group], grids: Sequence[Values], scale: float
) -> Lattice:
    """All sequences over the values of each group, at the stations of a path; ``scale`` is c₀."""
    G = max(len(values.value) for values in grids)
    grids = [values.padded(G) for values in grids]
    of_run = np.empty(len(part.runs), int)
    for n, group in enumerate(groups):
        of_run[list(group.runs)] = n
    of_point, st = of_run[part.run], part.stations
    value = np.stack([values.value for values in grids])[of_point]  # (P, G, E)
    exists = np.stack([values.exists for values in grids])[of_point[st]]  # (S, G)
    across, index, joints, e = sideways(part), [], [], []
    for k in range(G):
        there = replace(part, external=np.where(np.isfinite(value[:, k]), value[:, k], part.external))
        candidates = enumerate_candidates(there, setup.arm, options)
        d = directions(there, setup.arm, setup.elasticity, options.force, across)
        cost = score_candidates(there, candidates, setup.elasticity, d, options).cost / scale
        index.append(np.where(exists[:, k, None, None], cost, np.nan))
        joints.append(candidates.q)
        e.append(there.external[st])
    phi, stable = candidates.phi_at(), candidates.stable
    terms, w, S = Terms.at_stations(part, setup.velocity, options), options.weights, len(st)
    c = np.stack(index, axis=1)  # (S, G, R, B)
    liked = terms.liked(phi.T).T[:, None, :, None]
    node = terms.share[:, None, None, None] * node_price(c, liked, w.mean)
    same_run = np.r_[False, np.diff(part.run[st]) == 0]
    plunged = np.r_[0, np.cumsum(~part.plunge)]
    still = np.r_[False, plunged[st[1:] + 1] == plunged[st[:-1] + 1]]  # made only of plunges
    return Lattice(
        node=np.where(np.isfinite(c), node, np.inf).reshape(S, -1),
        raw=np.where(terms.counted[:, None, None, None] & np.isfinite(c), c, 0.0).reshape(S, -1),
        q=np.stack(joints, axis=1).reshape(S, -1, 6),
        e=np.stack(e, axis=1) * setup.per_rad[6:],
        phi=np.ascontiguousarray(phi),
        held=np.stack([values.held for values in grids])[of_point[st]],
        branches=c.shape[3],
        stable=stable,
        kind=np.column_stack([np.r_[False, np.diff(of_point[st]) == 0], same_run, still & same_run]),
        priced=np.column_stack(
            [terms.seconds, w.travel * terms.travel, w.rotation * terms.rotation, w.feed * terms.lost]
        ),
        slowness=terms.slowness,
        worst=w.worst,
    )
