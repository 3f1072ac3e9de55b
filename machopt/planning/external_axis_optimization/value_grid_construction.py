"""Construction of the sequences over values of external joints at selected stations of a planned path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.plan_options import PlanOptions
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.parallel_map import map_in_threads
from machopt.planning.cost.objective import ObjectiveTerms, compute_node_cost
from machopt.planning.cost.process_force_direction import compute_sideways_directions
from machopt.planning.cost.stiffness_index import compute_load_directions, score_candidates
from machopt.planning.external_axes.operation_groups import OperationGroup
from machopt.planning.external_axis_optimization.value_grid import GroupValueGrid
from machopt.planning.external_axis_optimization.value_grid_sequences import ValueGridSequences
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.pipeline.planning_setup import PlanningSetup
from machopt.planning.sampling.candidate_enumeration import enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.stations.planning_path import PlanningPath, compute_tcp_poses

STEP = np.radians(15.0)  # of rotation
VERTICES = 600_000  # maximum in all, where the number of stations can be reduced
REFUSED = 1_200_000  # maximum where it cannot

ROUNDED = 1e-9  # of a turn: tolerance of the joint limits

HIGH = 0.97  # share of the worst index from which a point counts as near it


def select_busy_points(plan: Plan) -> Array:
    """Return (P,) weights: large where a plan moves much or its index is near its worst, so that stations are denser
    there.

    Args:
        plan: complete plan.
    """
    path, x = plan.path, plan.setup.in_rad(plan.path, plan.chosen.assignment.q)
    step = np.abs(np.diff(x, axis=0, prepend=x[:1])).sum(axis=1)
    step[[first for first, _ in path.runs]] = 0.0
    cost = np.where(path.counted, np.nan_to_num(plan.chosen.cost), 0.0)
    high = (cost >= HIGH * cost.max()) & path.counted
    return np.asarray(step / max(step.sum(), 1e-12) + high / max(int(high.sum()), 1))


def _list_values(
    part: PlanningPath, groups: Sequence[OperationGroup], grids: Sequence[GroupValueGrid], of_point: NDArray[np.intp]
) -> Array:
    """Return the (P, G, E) external joints in m or rad of each value of the grids; ``of_point`` (P,): its group."""
    value = np.stack([values.value for values in grids])[of_point]
    value = np.where(np.isfinite(value), value, part.external[:, None])
    away = np.stack([values.offset for values in grids])[of_point]
    low, high = (np.stack(ends)[of_point][:, None] for ends in zip(*((g.low, g.high) for g in groups), strict=True))
    return np.where(away != 0.0, np.clip(value + away, low, high), value)


def _turn_references(part: PlanningPath, turn: Array) -> PlanningPath:
    """Return the path with its rotations counted from ``turn`` (P,) rad."""
    frames = compute_tcp_poses(part, np.arange(len(turn), dtype=np.int32), turn)
    return replace(part, reference=np.ascontiguousarray(frames[:, :3, 0]), offset=part.offset + turn)


def _score_values(
    setup: PlanningSetup, options: PlanOptions, part: PlanningPath, turn: Array, value: Array
) -> list[tuple[CandidateGrid, Array]]:
    """Return candidates and cost (S, R, B) with each of the values (P, G, E); rotations are counted from ``turn``."""
    across = compute_sideways_directions(part)
    own = _turn_references(part, turn)

    def at(k: int) -> tuple[CandidateGrid, Array]:
        there = replace(own, external=np.ascontiguousarray(value[:, k]))
        candidates = enumerate_candidates(there, setup.arm, options, every_branch=True)
        d = compute_load_directions(there, setup.arm, setup.elasticity, options.force, across)
        return candidates, score_candidates(there, candidates, setup.elasticity, d, options).cost

    return map_in_threads(at, range(value.shape[1]))


def _find_step_kinds(part: PlanningPath, of_point: NDArray[np.intp]) -> Bools:
    """Return (S, 3) whether the step into each station stays in its group, in its run, and in it plunges only."""
    st = part.stations
    same_run = np.r_[False, np.diff(part.run[st]) == 0]
    plunged = np.r_[0, np.cumsum(~part.plunge)]
    still = np.r_[False, plunged[st[1:] + 1] == plunged[st[:-1] + 1]]  # plunges only
    return np.column_stack([np.r_[False, np.diff(of_point[st]) == 0], same_run, still & same_run])


def build_value_grid_sequences(
    setup: PlanningSetup,
    options: PlanOptions,
    part: PlanningPath,
    groups: Sequence[OperationGroup],
    grids: Sequence[GroupValueGrid],
    scale: float,
    turned: Array | None = None,
) -> ValueGridSequences:
    """Return all sequences over the values of each group, at the stations of a path.

    Args:
        setup: planning setup of the cell.
        options: plan options.
        part: path with few stations.
        groups: operation groups.
        grids: value grid of each group.
        scale: c₀.
        turned: (P,) rad, rotation that the grid of rotations is counted from; None: the path's own reference.
    """
    G = max(len(values.value) for values in grids)
    grids = [values.padded(G) for values in grids]
    of_run = np.empty(len(part.runs), int)
    for n, group in enumerate(groups):
        of_run[list(group.runs)] = n
    of_point, st = of_run[part.run], part.stations
    value = _list_values(part, groups, grids, of_point)
    exists = np.stack([values.exists for values in grids])[of_point[st]]  # (S, G)
    turn = np.zeros(len(part.index)) if turned is None else turned
    every = _score_values(setup, options, part, turn, value)
    candidates, index = every[0][0], [cost for _, cost in every]
    joints, e = [one.q for one, _ in every], [value[st, k] for k in range(G)]
    phi, stable = candidates.phi_at() + turn[st][:, None], candidates.stable
    terms, w, S = ObjectiveTerms.at_stations(part, setup.velocity, options), options.weights, len(st)
    c = np.where(exists[..., None, None], np.stack(index, axis=1) / scale, np.nan)  # (S, G, R, B)
    q, more = unwrap_to_lower_limits(np.stack(joints, axis=1).reshape(S, -1, 6), setup.arm.lower, setup.arm.upper)
    preference_price = terms.liked(phi.T).T[:, None, :, None]
    node = terms.share[:, None, None, None] * compute_node_cost(c, preference_price, w.mean)
    return ValueGridSequences(
        node=np.where(np.isfinite(c), node, np.inf).reshape(S, -1),
        raw=np.where(terms.counted[:, None, None, None] & np.isfinite(c), c, 0.0).reshape(S, -1),
        q=q,
        more=more,
        e=np.stack(e, axis=1) * setup.per_rad[6:],
        phi=np.ascontiguousarray(phi),
        held=np.stack([values.held for values in grids])[of_point[st]],
        branches=c.shape[3],
        stable=stable,
        kind=_find_step_kinds(part, of_point),
        priced=np.column_stack(
            [terms.seconds, w.travel * terms.travel, w.rotation * terms.rotation, w.feed * terms.lost]
        ),
        slowness=terms.slowness,
        worst=w.worst,
    )


def unwrap_to_lower_limits(q: Array, lower: Array, upper: Array) -> tuple[Array, NDArray[np.int8]]:
    """Return joints shifted by whole turns to the range above their lower limits, and how many turns the upper limits
    leave.

    Args:
        q: (…, 6) rad, joints.
        lower: (6,) rad, lower limits.
        upper: (6,) rad, upper limits.
    """
    whole = 2.0 * np.pi
    low = q - whole * np.floor((q - lower) / whole + ROUNDED)
    more = np.floor((upper - low) / whole + ROUNDED)
    return np.ascontiguousarray(low), np.nan_to_num(np.maximum(more, 0.0)).astype(np.int8)
