"""Collision map of the grid for the report: configurations checked by the plan, and the others on request.

The others are checked from coarse to fine along the path, so that a time limit leaves unchecked configurations evenly
over the map. The map is for display only; the plan does not depend on it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array, Bools, compute_any_last
from machopt.planning.collision_handling.contact_lookahead import ContactLookahead
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sampling.candidate_grid import CandidateGrid, spread_branches

SECONDS = 30.0  # time limit for the unchecked configurations
COARSE = 32  # stations apart in the first pass, half of that in each next
BLOCK = 512  # configurations between two time checks


@dataclass(frozen=True)
class CollisionMap:
    """Known contacts of the grid's configurations."""

    candidates: CandidateGrid
    known: Bools  # (S, R, B) found free; colliding ones are no longer feasible
    is_full_check: bool  # a full check was requested
    seconds: float = 0.0  # s, duration of the check
    postures: NDArray[np.float32] | None = None  # (N, R, 6) rad, at the N cut stations; None: the grid has no joints

    @property
    def open(self) -> int:
        """Number of configurations within reach, limits and margins that were not checked."""
        return int((self.candidates.usable & ~self.known).sum())

    @property
    def looked_at(self) -> int:
        """Number of configurations that were checked."""
        return int((self.candidates.reason == InfeasibilityReason.COLLIDING).sum() + self.known.sum())


def compute_collision_map(plan: Plan, full: bool = False, seconds: float = SECONDS) -> CollisionMap:
    """Return the contacts of the grid's configurations, as far as they are known.

    Args:
        plan: plan of a job or of one tool.
        full: also check the configurations that the plan did not check, at cutting stations.
        seconds: s, time after which no further block is started.
    """
    if plan.parts:
        return _join_maps(plan, [compute_collision_map(p.plan, full, seconds * p.share) for p in plan.parts])
    found = _check_configurations(plan, full, seconds)
    if not found.candidates.q.shape[-1]:
        return found
    return replace(found, postures=_select_postures(plan, found))


def _check_configurations(plan: Plan, full: bool, seconds: float) -> CollisionMap:
    c = plan.candidates
    checked = np.zeros(c.reason.shape, bool) if plan.found is None else plan.found.looked
    known = checked & c.usable
    model = plan.setup.collision
    if not full or model is None:
        return CollisionMap(c, known, full)
    start = time.perf_counter()
    c = replace(c, feasible=c.feasible.copy(), reason=c.reason.copy())
    touch = plan.path.may_touch[plan.path.stations]
    ahead = ContactLookahead(
        candidates=c,
        model=model,
        may_touch=touch,
        external=plan.path.external[plan.path.stations],
        pairs=np.full(c.reason.shape, -1, np.int32),
    )
    cut = plan.path.counted[plan.path.stations]
    pass_ = COARSE
    while pass_:
        every = np.flatnonzero(cut)[::pass_]
        usable = compute_any_last(c.feasible[every]) & ~known[every]
        r, b, n = np.nonzero(usable.transpose(1, 2, 0))  # along the path: the next pose is near
        rows = np.ravel_multi_index((every[n], r, b), known.shape)
        for k in range(0, len(rows), BLOCK):
            if time.perf_counter() - start > seconds:
                return CollisionMap(c, known, full, time.perf_counter() - start)
            _check_ahead(ahead, known, rows[k : k + BLOCK])
        pass_ //= 2
    return CollisionMap(c, known, full, time.perf_counter() - start)


def _join_maps(plan: Plan, parts: list[CollisionMap]) -> CollisionMap:
    """Return the map of a whole job from its stretches."""
    numbers = plan.candidates.branch
    some = [p.candidates.expand_branches(numbers) for p in parts]
    reason = np.concatenate([c.reason for c in some])
    usable = np.concatenate([c.usable for c in some])
    c = replace(plan.candidates, reason=reason, feasible=plan.candidates.feasible & usable[..., None])
    known = [
        spread_branches(p.known, np.searchsorted(numbers, p.candidates.branch), len(numbers), False, axis=2)
        for p in parts
    ]
    postures = [p.postures for p in parts if p.postures is not None]
    return CollisionMap(
        c,
        np.concatenate(known),
        parts[0].is_full_check,
        sum(p.seconds for p in parts),
        np.concatenate(postures) if len(postures) == len(parts) else None,
    )


def find_cut_stations(plan: Plan) -> NDArray[np.intp]:
    """Return (N,) the stations that the map shows: those that the tool cuts to.

    Args:
        plan: The plan.
    """
    return np.flatnonzero(plan.path.counted[plan.path.stations])


def find_best_branch(plan: Plan, collision_map: CollisionMap, st: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array]:
    """Return (N, R) the feasible branch with the least cost, and that cost; infinite where none is feasible.

    Args:
        plan: The plan.
        collision_map: The map of feasible rotations and branches.
        st: (N,) numbers of the stations.
    """
    usable = compute_any_last(collision_map.candidates.feasible[st])
    rated = np.where(usable, plan.scores.cost[st], np.inf)
    first = rated.argmin(axis=2)
    return first, np.take_along_axis(rated, first[:, :, None], axis=2)[:, :, 0]


def _select_postures(plan: Plan, collision_map: CollisionMap) -> NDArray[np.float32]:
    """Return (N, R, 6) rad the posture at each cut station and rotation whose index or reason the map shows.

    It is wound into the middle of the joint limits, and NaN where there is none.
    """
    c, limits, st = collision_map.candidates, plan.setup.driven.limits, find_cut_stations(plan)
    usable: Bools = compute_any_last(c.feasible[st])
    branch, _ = find_best_branch(plan, collision_map, st)
    farthest = np.where(np.isfinite(c.q[st, :, :, 0]), c.reason[st], 0).argmax(axis=2)
    pick = np.where(usable.any(axis=2), branch, farthest)
    q = c.q[st[:, None], np.arange(pick.shape[1]), pick]
    middle = 0.5 * (limits.lower[:6] + limits.upper[:6])
    return np.asarray(q - 2 * np.pi * np.round((q - middle) / (2 * np.pi)), np.float32)


def _check_ahead(ahead: ContactLookahead, known: Bools, rows: NDArray[np.intp]) -> None:
    """Check configurations (n,), flat over (S, R, B), that are not excluded yet, and the neighbours of those that
    collide.
    """
    s, r, b = np.unravel_index(rows, known.shape)
    left = compute_any_last(ahead.candidates.feasible[s, r, b])
    s, r, b, rows = s[left], r[left], b[left], rows[left]
    found = ahead.model.check_configurations(ahead.whole(s, r, b), ahead.may_touch[s])
    free = ~found.hit
    known[s[free], r[free], b[free]] = True
    order = np.argsort(rows[found.hit])
    vertices, pair = rows[found.hit][order], found.pair[found.hit][order]
    ahead.strike(vertices, pair)
    ahead.look(vertices, pair, 8 * BLOCK)
