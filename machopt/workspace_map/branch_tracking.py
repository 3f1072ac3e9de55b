"""Postures along a straight path: one branch followed without a jump, as the robot would be driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.numerics.array_types import Array
from machopt.workspace_map.postures import (
    BranchPick,
    CollisionCheck,
    GoodnessFunction,
    MapPostures,
    PostureCandidates,
    ReachingArm,
    add_whole_turns,
    compute_candidates,
)

MAX_JOINT_STEP = np.radians(45.0)
"""A joint that moves further between neighbouring samples has jumped: another branch differs by far more (a flipped
wrist by 180° of axis 4), a joint that is driven along a finely sampled line by far less."""


def track_branches(
    arm: ReachingArm,
    T_base_tcp: Array,
    gamma: Array,
    goodness: GoodnessFunction,
    pick: BranchPick,
    collides: CollisionCheck | None = None,
) -> MapPostures:
    """Track every branch of every rotation from its first sample on, and keep the best chain.

    A chain takes, sample by sample, the posture nearest to the previous one. Where that is a jump the sample is
    NO_PATH and the chain continues from there. At each rotation the chain that covers most samples is selected; of
    those,
    by ``pick``, the one whose least good sample is best ("best") or worst ("worst"), whose start is nearest home
    ("home"), or that starts in the branch of that number. Of the rotations, the one whose chain covers most and whose
    least good sample is best. The rotation does not change along the line.

    Args:
        arm: kinematics, limits, margins.
        T_base_tcp: (M, R, 4, 4).
        gamma: (R,) rad; the first is preferred among equals.
        goodness: larger is better.
        pick: see above.
        collides: postures that break a chain; None: not checked.
    """
    M, R = T_base_tcp.shape[:2]
    found = compute_candidates(arm, T_base_tcp)
    B = found.reason.shape[1]
    q, branch, reason = _track_chains(arm, found, M, R, B)  # (M, R, B…): one chain a start branch
    value = np.full(reason.shape, np.nan)
    value[reason == InfeasibilityReason.OK] = goodness(q[reason == InfeasibilityReason.OK])
    chains = _TrackedChains(q, branch, reason, value)
    best = _select_chain(arm, chains, gamma, pick, collides)
    every = np.where(reason == InfeasibilityReason.COLLIDING, reason, found.reason.reshape(M, R, B)).reshape(M, R * B)
    why = np.where(every == InfeasibilityReason.OK, InfeasibilityReason.NO_PATH, every).max(axis=1).astype(np.uint8)
    out = MapPostures(
        q=np.full((M, 6), np.nan),
        branch=np.full(M, -1, np.int8),
        gamma=np.full(M, np.nan),
        reason=why,
        shortfall=found.shortfall.reshape(M, R).min(axis=1),
        count=np.asarray((found.reason.reshape(M, R * B) == InfeasibilityReason.OK).sum(axis=1)),
        rotations=np.asarray((found.reason.reshape(M, R, B) == InfeasibilityReason.OK).any(axis=2).mean(axis=1)),
    )
    if best is None:
        return out
    r, b = best
    there = reason[:, r, b] == InfeasibilityReason.OK
    out.q[there], out.branch[there], out.gamma[there] = q[there, r, b], branch[there, r, b], gamma[r]
    out.reason[there] = InfeasibilityReason.OK
    own = ~there & (
        (reason[:, r, b] == InfeasibilityReason.COLLIDING) | (reason[:, r, b] == InfeasibilityReason.NO_PATH)
    )
    out.reason[own] = reason[own, r, b]
    return out


@dataclass(frozen=True)
class _TrackedChains:
    """Chains of M samples, one for each of R rotations and B branches in which it starts."""

    q: Array  # (M, R, B, 6) rad
    branch: NDArray[np.int64]  # (M, R, B)
    reason: NDArray[np.uint8]  # (M, R, B); collisions are entered by _select_chain
    value: Array  # (M, R, B), NaN where the sample is not covered


def _select_chain(
    arm: ReachingArm, chains: _TrackedChains, gamma: Array, pick: BranchPick, collides: CollisionCheck | None
) -> tuple[int, int] | None:
    """Return rotation and branch of the best chain; None where none covers a sample."""
    q, branch, reason, value = chains.q, chains.branch, chains.reason, chains.value
    best: tuple[tuple[float, ...], int, int] | None = None
    for r in range(len(gamma)):
        turned = float(abs(np.angle(np.exp(1j * (gamma[r] - gamma[0])))))
        chosen: tuple[tuple[float, ...], int] | None = None
        for rank, b in sorted(
            (_rank_chain(q[:, r, b], branch[:, r, b], value[:, r, b], arm.home, pick), b) for b in range(q.shape[2])
        ):
            if rank[0] >= 0:
                break  # this chain and the following ones cover no sample
            free = -rank[0]
            if collides is not None:
                there = np.flatnonzero(reason[:, r, b] == InfeasibilityReason.OK)
                hit = there[collides(q[there, r, b])]
                reason[hit, r, b], value[hit, r, b] = InfeasibilityReason.COLLIDING, np.nan
                free -= len(hit)
            if chosen is None or -free < chosen[0][0]:
                chosen = (-free, *rank[1:]), b
            if free == -rank[0]:
                break  # no following chain covers more
        if chosen is not None and chosen[0][0] < 0:
            b = chosen[1]
            rank = (chosen[0][0], _round_value(-float(np.nanmin(value[:, r, b]))), turned)
            if best is None or rank < best[0]:
                best = rank, r, b
    return None if best is None else best[1:]


def _track_chains(
    arm: ReachingArm, candidates: PostureCandidates, M: int, R: int, B: int
) -> tuple[Array, NDArray[np.int64], NDArray[np.uint8]]:
    """R·B chains over M samples: postures (M, R, B, 6), branches and reasons (M, R, B)."""
    options, why = candidates.q.reshape(M, R, B, 6), candidates.reason.reshape(M, R, B)
    q = np.full((M, R, B, 6), np.nan)
    branch = np.full((M, R, B), -1)
    reason = np.empty((M, R, B), np.uint8)
    last = np.full((R, B, 6), np.nan)  # last posture of each chain
    r = np.arange(R)[:, None]
    for m in range(M):
        fresh = ~np.isfinite(last[..., 0])
        choice = add_whole_turns(
            options[m][:, None], arm.lower, arm.upper, np.where(fresh[..., None], arm.home, last)[:, :, None]
        )
        step = np.abs(choice - last[:, :, None]).max(axis=-1)  # (R, chain, B)
        step = np.where(np.isfinite(choice[..., 0]), step, np.inf)
        own = np.where(np.eye(B, dtype=bool) & np.isfinite(options[m][:, None, :, 0]), 0.0, np.inf)
        step = np.where(fresh[..., None], own, step)
        pick = np.argmin(step, axis=-1)  # (R, chain)
        size = np.take_along_axis(step, pick[..., None], axis=-1)[..., 0]
        exists = np.isfinite(size)
        posture = np.take_along_axis(choice, pick[..., None, None], axis=2)[:, :, 0]
        good = exists & (size <= MAX_JOINT_STEP)
        q[m][good], branch[m][good] = posture[good], pick[good]
        best_reason = why[m].max(axis=1, initial=0)[r[:, 0]]
        blocked = np.where((why[m] == InfeasibilityReason.OK).any(axis=1), InfeasibilityReason.NO_PATH, best_reason)[
            :, None
        ]
        reason[m] = np.where(good, InfeasibilityReason.OK, np.broadcast_to(blocked, (R, B)))
        last = np.where(exists[..., None], posture, last)
    return q, branch, reason


def _rank_chain(q: Array, branch: NDArray[np.int64], value: Array, home: Array, pick: BranchPick) -> tuple[float, ...]:
    """Return the sort key of chains of one rotation, best first: samples covered (negative), ``pick``, travel from
    home.
    """
    covered = np.flatnonzero(np.isfinite(q[:, 0]))
    if not len(covered) or (isinstance(pick, int) and branch[covered[0]] != pick):
        return 0.0, np.inf, np.inf
    start_distance = float(np.abs(q[covered[0]] - home).max())
    least = _round_value(float(np.nanmin(value)))
    return float(-len(covered)), {"best": -least, "worst": least}.get(str(pick), start_distance), start_distance


def _round_value(value: float) -> float:
    """Six digits: chains that are equally good (a flipped wrist) shall tie."""
    return float(f"{value:.6g}")
