"""Lower bound of J over all sequences that also choose the values of the external joints.

The bound of :mod:`machopt.planning.optimality_certificate` applies to the external joints of the plan. Here they are
part of the sequence: at some stations of the path every value g, rotation r and branch b is a vertex
(:mod:`~machopt.planning.external_axis_optimization.value_grid_sequences`). The values are a grid over the joint ranges,
the plan's own at each station and some near it (:mod:`~machopt.planning.external_axis_optimization.value_grid`); the
rotations are the plan's own there and every 15° from it. The plan is therefore one of the sequences, and the bound is
never above it. A joint that moves may take any value at any station. One that keeps a value for an operation takes one
wherever that operation continues without another in between. While the tool drills or plunges nothing moves. J is that
of :mod:`~machopt.planning.cost.objective` at these stations, with the worst index traded exactly
(:mod:`~machopt.planning.sequence_search.worst_value_constraint`).

Each step uses the whole turns of the arm's joints that suit it best, within the limits. Where those of the best
sequence are inconsistent, the turns become part of the vertices
(:mod:`~machopt.planning.external_axis_optimization.turn_resolved_grid`). Crowding is left out. Contacts are left out
unless the best sequence has one: that vertex and likely colliding ones of the same station are excluded, and the search
is repeated, a few times. Everything left out can only raise J, so the bound holds for drivable plans as well. The path
between the stations counts like the stations next to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.continuous_refinement.starting_point import RefinementStart
from machopt.planning.cost.objective import ObjectiveTerms
from machopt.planning.external_axes.axis_modes import resolve_axis_options
from machopt.planning.external_axes.operation_groups import OperationGroup, build_operation_groups
from machopt.planning.external_axis_optimization.turn_resolved_grid import is_turn_consistent, resolve_turns
from machopt.planning.external_axis_optimization.value_grid import VALUES, build_group_value_grid, find_largest_steps
from machopt.planning.external_axis_optimization.value_grid_construction import (
    REFUSED,
    STEP,
    VERTICES,
    build_value_grid_sequences,
    select_busy_points,
)
from machopt.planning.external_axis_optimization.value_grid_sequences import ValueGridSequences
from machopt.planning.external_axis_optimization.whole_turns import compute_run_turns
from machopt.planning.pipeline.plan_data_types import ExternalAxisBound, Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup, StageTimings
from machopt.planning.sampling.joint_path import interpolate_between_stations
from machopt.planning.sequence_search.worst_value_constraint import GAP
from machopt.planning.stations.path_subset import select_path_runs
from machopt.planning.stations.planning_path import PlanningPath

MOST, LEAST = 240, 24  # stations
STRUCK = 6  # maximum number of rounds in which colliding poses are excluded,
LOOKED_AT = 2_000  # and maximum number per round
# shares of the way from the best sequence to the plan: up to there colliding poses are looked for, in turn until enough
SEARCHED = 0.03, 0.25
SHARES = 0.1, 0.4, 1.0  # the same for sequences with consistent turns, tried in turn
TOLD_APART = 2_500_000  # maximum number of vertices of a turn-resolved grid, limited by memory
SLACK = 1e-9  # of J, rounding tolerance: vertices of the plan itself are kept


def bound_over_external_axes(
    plan: Plan, toolpath: Toolpath, timings: StageTimings, values: dict[int, int] | None = None
) -> ExternalAxisBound | None:
    """Return the lower bound of a plan of one tool, stored or newly computed; None where no external joint was free.

    Args:
        plan: plan of one tool.
        toolpath: its toolpath.
        timings: receives the duration of the stages.
        values: of each joint in the grid, by how many are free; default :data:`VALUES`.
    """
    if plan.over_external is not None and values is None:
        return plan.over_external
    setup, path = plan.setup, plan.path
    axes = resolve_axis_options(setup.cell, plan.options) if setup.cell.external_joints else ()
    groups = build_operation_groups(setup.cell, toolpath, path, axes) if axes else []
    if all((g.low == g.high).all() for g in groups):
        return None
    if plan.found is None or plan.breaks or len(plan.missing):
        return ExternalAxisBound(why="the plan has gaps or breaks, or was not searched")
    with timings.stage("external"):
        around = BoundSearch.build(plan, groups, VALUES if values is None else values)
        return ExternalAxisBound(why=around) if isinstance(around, str) else around.bound(around.best())


@dataclass(frozen=True)
class BoundSequence:
    """Best sequence of the bound search."""

    total: float  # its J at the stations
    bound: float  # no sequence has less
    vertex: NDArray[np.int64]  # (S,) of it


@dataclass(frozen=True, kw_only=True)
class BoundSearch:
    """Search over values, rotations and branches around a plan, which is one of the sequences."""

    setup: PlanningSetup
    part: PlanningPath  # the stations
    lattice: ValueGridSequences
    own: float  # J of the plan there
    values: int  # of the grid, without the plan's own
    step: float  # rad, of rotation
    apart: Array  # (E,) m or rad, largest distance of neighbouring values of each joint

    @classmethod
    def build(cls, plan: Plan, groups: Sequence[OperationGroup], values: dict[int, int]) -> BoundSearch | str:
        """Return the search around a complete plan; a message where the grid would be too large.

        Args:
            plan: plan without gaps or breaks.
            groups: operation groups.
            values: number of grid values per joint, by the number of free joints.
        """
        setup, path = plan.setup, plan.path
        options = replace(plan.options, rotation_step=max(plan.options.rotation_step, STEP))
        grids = [build_group_value_grid(g, path, setup.per_rad[6:], values) for g in groups]
        rotations, branches = round(2 * np.pi / options.rotation_step), setup.arm.solver.branches
        most = max(len(g.value) for g in grids)
        least = max(LEAST, 2 * len(path.runs))
        if most * rotations * branches * least > REFUSED:
            return (
                f"{most} values x {rotations} rotations x {branches} branches at no less than {least} stations are "
                f"more than the {REFUSED} poses that it may look at"
            )
        count = int(np.clip(VERTICES // (most * rotations * branches), least, MOST))
        part, phi = (
            select_path_runs(path, range(len(path.runs)), count, select_busy_points(plan)),
            plan.chosen.assignment.phi,
        )
        lattice = build_value_grid_sequences(setup, options, part, groups, grids, plan.scores.scale, phi)
        own, step = _compute_station_objective(plan, part), 2 * np.pi / rotations
        apart = find_largest_steps(grids)
        return cls(setup=setup, part=part, lattice=lattice, own=own, values=most - 1, step=step, apart=apart)

    def best(self) -> BoundSequence | None:
        """Return the best sequence, with colliding poses of earlier ones excluded; None where there is none.

        Its turns are consistent, unless the turn-resolved grid would be too large.
        """
        known = self.own * (1.0 + SLACK)
        onward = self.lattice.onward(known)
        found = self._free(self.lattice, onward)
        if found is None or is_turn_consistent(self.lattice, found.vertex):
            return found
        for share in SHARES:
            most = max(found.total + share * (known - found.total), min(found.total, known))
            apart = resolve_turns(self.lattice, self.lattice.through(onward, most), TOLD_APART)
            finer = None if apart is None else self._free(apart.lattice, apart.lattice.onward(most), apart.vertex)
            if apart is not None and finer is not None and (finer.total <= most or share == SHARES[-1]):
                bound = max(found.bound, min(finer.bound, most))
                return BoundSequence(finer.total, bound, apart.vertex[finer.vertex])
        return found

    def _free(
        self, lattice: ValueGridSequences, onward: Array, of: NDArray[np.int64] | None = None
    ) -> BoundSequence | None:
        """Return the best sequence of a grid whose vertices are those (V,) of the original one.

        Args:
            lattice: sequences; vertices with contacts are excluded in place.
            onward: result of its :meth:`~ValueGridSequences.onward`.
            of: (V,) vertices of the original grid; None: it is the original one.
        """
        found, limit, free = lattice.best(GAP, onward, self.own), -np.inf, np.zeros(lattice.node.shape, bool)
        through = np.full(lattice.node.shape, np.inf)
        for n in range(STRUCK):
            if found is None:
                return None
            vertex = found[2] if of is None else of[found[2]]
            hit = self.touching(np.arange(len(vertex)), vertex)
            if not hit.any():
                break
            rows, most = np.flatnonzero(hit), LOOKED_AT << n
            for share in SEARCHED:
                candidates = np.isfinite(through[rows]) & np.isfinite(lattice.node[rows]) & ~free[rows]
                if found[0] <= limit and np.count_nonzero(candidates) >= most:
                    break
                further = found[0] + share * max(self.own - found[0], 0.0)
                if further > limit:  # excluded vertices only raise it, so that it stays a lower bound
                    limit, through = further, lattice.through(onward, further)
            self._exclude_vertices(lattice, of, (rows, found[2][hit]), through, free, most)
            found = lattice.best(GAP, onward, self.own)
        return None if found is None else BoundSequence(*found)

    def bound(self, bound_sequence: BoundSequence | None) -> ExternalAxisBound:
        """Return the bound of the plan from the best sequence.

        Args:
            bound_sequence: best sequence, or None.
        """
        if bound_sequence is None:
            return ExternalAxisBound(why="no sequence of the grid leads through all of the path")
        return ExternalAxisBound(
            bound=bound_sequence.bound,
            sequence=bound_sequence.total,
            plan=self.own,
            values=self.values,
            stations=len(self.part.stations),
            step=self.step,
            apart=tuple(zip(self.setup.cell.external_joints, self.apart.tolist(), strict=True)),
        )

    def start(self, vertex: NDArray[np.int64], plan: Plan) -> RefinementStart:
        """Return a sequence as a starting point for the refinement of the plan.

        Args:
            vertex: (S,) vertices of the sequence.
            plan: plan that is refined.
        """
        x, st, a = self.lattice, self.part.stations, plan.chosen.assignment
        at, R = np.arange(len(vertex)), x.phi.shape[1]
        e = x.e[at, vertex // (R * x.branches)] / self.setup.per_rad[6:] - plan.path.external[st]
        turn = np.asarray(wrap_angle(x.phi[at, vertex // x.branches % R] - a.phi[st]))
        for first, last in self.part.runs:
            own = (st >= first) & (st <= last)
            turn[own] = np.unwrap(turn[own])
        q = self._unwind_joints(vertex, a.q[st]) - a.q[st]
        phi, external, seed = (interpolate_between_stations(self.part, away) for away in (turn, e, q))
        return RefinementStart(a.phi + phi, plan.path.external + external, a.q + seed)

    def _unwind_joints(self, vertex: NDArray[np.int64], plan: Array) -> Array:
        """Return (S, 6) rad, the joints of a sequence without whole turns in its runs, and with the fewest between
        them.
        """
        st, arm = self.part.stations, self.setup.arm
        q = self.lattice.q[np.arange(len(vertex)), vertex]
        own = [np.flatnonzero((st >= first) & (st <= last)) for first, last in self.part.runs]
        own = [rows for rows in own if len(rows)]
        for rows in own:
            q[rows] = np.unwrap(q[rows], axis=0)
        return q + 2 * np.pi * compute_run_turns(q, own, arm.lower, arm.upper, plan)

    def touching(self, station: NDArray[np.int64], vertex: NDArray[np.int64]) -> Bools:
        """Return (n,) whether the pose of each vertex has a forbidden contact.

        Args:
            station: (n,) index of the station.
            vertex: (n,) vertex at that station.
        """
        if self.setup.collision is None:
            return np.zeros(len(vertex), bool)
        x = self.lattice
        e = x.e[station, vertex // (x.phi.shape[1] * x.branches)] / self.setup.per_rad[6:]
        rows = self.part.stations[station]
        return np.asarray(
            self.setup.collision.check_configurations(
                np.hstack([x.q[station, vertex], e]), self.part.may_touch[rows]
            ).hit
        )

    def _exclude_vertices(
        self,
        lattice: ValueGridSequences,
        of: NDArray[np.int64] | None,
        touching: tuple[NDArray[np.int64], NDArray[np.int64]],
        through: Array,
        free: Bools,
        most: int,
    ) -> None:
        """Exclude colliding vertices and others that collide at the same stations, those of the best sequences first.

        Args:
            lattice: sequences; vertices are excluded in place.
            of: (V,) vertices of the original grid; None: it is the original one.
            touching: (n,) stations and (n,) vertices that collide.
            through: (S, V) lower bound of J of a sequence through each vertex.
            free: (S, V) vertices that were checked and have no contact; those found are added.
            most: maximum number of vertices to check.
        """
        stations, vertex = touching
        lattice.node[stations, vertex] = np.inf
        s, others = np.nonzero(np.isfinite(through[stations]) & np.isfinite(lattice.node[stations]) & ~free[stations])
        s = stations[s]
        first = np.argsort(through[s, others], kind="stable")[:most]
        s, others = s[first], others[first]
        hit = self.touching(s, others if of is None else of[others])
        lattice.node[s[hit], others[hit]] = np.inf
        free[s[~hit], others[~hit]] = True


def _compute_station_objective(plan: Plan, part: PlanningPath) -> float:
    """Return J of the plan as the sequences are priced: at the stations of a part that has all runs."""
    terms, w, rows = (
        ObjectiveTerms.at_stations(part, plan.setup.velocity, plan.options),
        plan.options.weights,
        part.stations,
    )
    x, phi = plan.setup.in_rad(plan.path, plan.chosen.assignment.q)[rows], plan.chosen.assignment.phi[rows]
    cost = plan.chosen.cost[rows] / plan.scores.scale
    worst = float(cost[terms.counted].max(initial=0.0))
    return float(terms.nodes(cost, phi).sum() + terms.steps(x, phi).sum() + w.worst * worst)
