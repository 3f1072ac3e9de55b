"""Feasible postures of a sample, the reason where there is none, and the selection of the one a map shows.

Reach, limits and distance from singularities are checked as by the planner: every branch of the inverse
kinematics, every whole turn inside the limits, the cell's margins. Of the remaining postures only those that a map
would show are checked for collisions; where one collides, the next best replaces it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.infeasibility_reasons import InfeasibilityReason
from machopt.kinematics.inverse.solver import InverseKinematicsSolver, SingularityMargins, compute_branch_reasons
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, invert_transform

ReasonCodes = NDArray[np.uint8]
GoodnessFunction = Callable[[Array], Array]  # q (K, 6) rad → (K,), larger is better
CollisionCheck = Callable[[Array], NDArray[np.bool_]]  # q (K, 6) rad → (K,)
BranchPick = Literal["best", "worst", "home"] | int

POSE_BLOCK_SIZE = 8_192  # bounds the memory of the closed form's intermediates
TIE_TOLERANCE = 1e-6  # relative; postures this near the best (a flipped wrist is equally stiff) are ranked by travel


@dataclass(frozen=True, kw_only=True)
class ReachingArm:
    """Inputs of the inverse kinematics from a cell."""

    robot: Robot
    solver: InverseKinematicsSolver
    T_flange_tcp: Array  # (4, 4)
    lower: Array  # (6,) rad, reduced by the limit margin
    upper: Array  # (6,)
    home: Array  # (6,) rad, decides among equal postures and whole turns
    margins: SingularityMargins


@dataclass(frozen=True)
class PostureCandidates:
    """Every branch at N poses."""

    q: Array  # (N, B, 6) rad, inside the limits and by whole turns nearest to home; NaN where impossible
    reason: ReasonCodes  # (N, B) Reason
    shortfall: Array  # (N,) m, missing reach of every branch
    singularity_margin: Array  # (N, B) rad, smaller angle of elbow and wrist from the singularity


@dataclass(frozen=True, kw_only=True)
class MapPostures:
    """One posture per sample, or the reason why there is none."""

    q: Array  # (M, 6) rad, NaN where none
    branch: NDArray[np.int8]  # (M,) −1 where none
    gamma: Array  # (M,) rad, NaN where none
    reason: ReasonCodes  # (M,) Reason
    shortfall: Array  # (M,) m, 0 inside the reach
    count: NDArray[np.int64]  # (M,) branches within limits and margins, over all rotations tried
    rotations: Array  # (M,) share of the tried rotations that have such a branch, 0 … 1

    @property
    def ok(self) -> NDArray[np.bool_]:
        """(M,) samples with a posture."""
        return np.asarray(self.reason == InfeasibilityReason.OK)


def build_tool_poses(position: Array, tool_axis: Array, gamma: Array) -> Array:
    """Return TCP poses for every position and rotation.

    At gamma = 0, TCP x is the frame's x axis projected on the plane normal to the tool axis (y where they are
    parallel); gamma rotates the TCP about its own z.

    Args:
        position: (N, 3) m.
        tool_axis: (3,) unit, tip to shank.
        gamma: (R,) rad.

    Returns:
        (N, R, 4, 4) in the frame of the inputs.
    """
    along_x = abs(float(tool_axis[0])) > 1 - 1e-9
    reference = np.array([0.0, 1.0, 0.0]) if along_x else np.array([1.0, 0.0, 0.0])
    R = compute_tool_rotation(tool_axis, reference, gamma)
    return build_transform(
        np.broadcast_to(R, (len(position), *R.shape)), np.repeat(position[:, None], len(gamma), axis=1)
    )


def add_whole_turns(q: Array, lower: Array, upper: Array, near: Array) -> Array:
    """Return joints shifted by whole turns inside their limits, nearest to ``near``; NaN where that is impossible.

    Joints are independent of each other here, so no combination of turns is missed.

    Args:
        q: (..., 6) rad.
        lower: (6,) rad.
        upper: (6,) rad.
        near: (..., 6) rad.
    """
    turn = 2 * np.pi
    with np.errstate(invalid="ignore"):
        first = np.ceil((lower - 1e-12 - q) / turn)
        last = np.floor((upper + 1e-12 - q) / turn)
        best = np.clip(np.round((near - q) / turn), first, last)
        return np.where(first <= last, q + turn * best, np.nan)


def compute_candidates(arm: ReachingArm, T_base_tcp: Array) -> PostureCandidates:
    """Return all branches of a grid of poses, flattened to N·R rows.

    Args:
        arm: kinematics, limits, margins.
        T_base_tcp: (N, R, 4, 4).
    """
    branches = arm.solver.solve_grid(T_base_tcp @ invert_transform(arm.T_flange_tcp))
    reason = compute_branch_reasons(branches, arm.margins)
    q = add_whole_turns(branches.q, arm.lower, arm.upper, arm.home)
    outside = (reason == InfeasibilityReason.OK) & ~np.isfinite(q).all(axis=-1)
    reason[outside] = InfeasibilityReason.LIMIT
    q[reason != InfeasibilityReason.OK] = np.nan
    return PostureCandidates(q, reason, branches.shortfall, np.minimum(branches.elbow, branches.wrist))


def choose_postures(
    arm: ReachingArm,
    poses: Callable[[slice], Array],
    size: tuple[int, int],
    gamma: Array,
    goodness: GoodnessFunction,
    pick: BranchPick,
    collides: CollisionCheck | None = None,
) -> MapPostures:
    """Return the posture of every sample: a branch by ``pick`` at each rotation, then the best rotation.

    "best" and "worst" compare branches by ``goodness``, "home" selects the branch that moves no joint far from home,
    a number selects that branch. Among equally good postures the one nearest to home is selected, among
    rotations the one nearest to the first.

    Args:
        arm: kinematics, limits, margins.
        poses: returns T_base_tcp (n, R, 4, 4) of a slice of the samples.
        size: (M, R).
        gamma: (R,) rad; the first is the preferred one.
        goodness: larger is better.
        pick: selection rule for the branch.
        collides: postures that must not be shown; None: not checked.
    """
    M, R = size
    order = np.argsort(np.abs(np.angle(np.exp(1j * (gamma - gamma[0])))), kind="stable")
    rows = max(POSE_BLOCK_SIZE // R, 1)
    parts = []
    for a in range(0, M, rows):
        part = slice(a, min(a + rows, M))
        n = part.stop - part.start
        found = compute_candidates(arm, poses(part)[:, order])
        parts.append(_choose_block(found, n, arm.home, gamma[order], goodness, pick, collides))
    return MapPostures(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(MapPostures)})


def _choose_block(
    candidates: PostureCandidates,
    n: int,
    home: Array,
    gamma: Array,
    goodness: GoodnessFunction,
    pick: BranchPick,
    collides: CollisionCheck | None,
) -> MapPostures:
    R, B = len(gamma), candidates.reason.shape[1]
    reason, q = candidates.reason.reshape(n, R, B).copy(), candidates.q.reshape(n, R, B, 6)
    ok = np.asarray(reason == InfeasibilityReason.OK)
    allowed = ok & (np.arange(B) == pick) if isinstance(pick, int) else ok.copy()
    rotations = np.asarray(allowed.any(axis=2).mean(axis=1))
    home_distance = np.where(allowed, np.abs(q - home).max(axis=-1, initial=0.0), np.inf)
    good = np.full(ok.shape, -np.inf)
    good[allowed] = goodness(q[allowed])
    rotation, branch = np.zeros(n, np.intp), np.zeros(n, np.intp)
    usable = np.zeros(n, bool)
    todo = np.arange(n)
    while len(todo):
        some, rotation[todo], branch[todo] = _pick_one(good[todo], allowed[todo], home_distance[todo], pick)
        usable[todo] = some
        todo = todo[some]
        if collides is None or not len(todo):
            break
        todo = todo[collides(q[todo, rotation[todo], branch[todo]])]
        allowed[todo, rotation[todo], branch[todo]] = False
        reason[todo, rotation[todo], branch[todo]] = InfeasibilityReason.COLLIDING
        usable[todo] = False
    at = np.arange(n)
    why = np.where(reason == InfeasibilityReason.OK, InfeasibilityReason.BOUNDS, reason).max(axis=(1, 2))
    return MapPostures(
        q=np.where(usable[:, None], q[at, rotation, branch], np.nan),
        branch=np.where(usable, branch, -1).astype(np.int8),
        gamma=np.where(usable, gamma[rotation], np.nan),
        reason=np.where(usable, InfeasibilityReason.OK, why).astype(np.uint8),
        shortfall=candidates.shortfall.reshape(n, R).min(axis=1),
        count=np.asarray(ok.sum(axis=(1, 2))),
        rotations=rotations,
    )


def _pick_one(
    good: Array, allowed: NDArray[np.bool_], home_distance: Array, pick: BranchPick
) -> tuple[NDArray[np.bool_], NDArray[np.intp], NDArray[np.intp]]:
    """Whether anything is allowed, and which rotation and branch, for (n, R, B) candidates."""
    n, R, _ = good.shape
    if pick in ("best", "worst"):
        branch = _find_nearest_of_equal(-good if pick == "worst" else good, allowed, home_distance)
    else:
        branch = np.asarray(np.argmin(np.where(allowed, home_distance, np.inf), axis=-1))
    i, r = np.indices((n, R))
    there = np.asarray(allowed[i, r, branch])
    value = np.where(there, good[i, r, branch], -np.inf)
    with np.errstate(invalid="ignore"):
        top = value.max(axis=1, keepdims=True)
        rotation = np.asarray(np.argmax(there & (value >= top - TIE_TOLERANCE * np.abs(top)), axis=1))
    return np.asarray(there.any(axis=1)), rotation, branch[np.arange(n), rotation]


def _find_nearest_of_equal(score: Array, allowed: NDArray[np.bool_], home_distance: Array) -> NDArray[np.intp]:
    """Return the index along the last axis of the highest score; of those within TIE_TOLERANCE of it, the nearest
    one.
    """
    score = np.where(allowed, score, -np.inf)
    top = score.max(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore"):
        close = allowed & (score >= top - TIE_TOLERANCE * np.abs(top))
    return np.asarray(np.argmin(np.where(close, home_distance, np.inf), axis=-1))


def check_given_postures(q: Array, lower: Array, upper: Array, collides: CollisionCheck | None = None) -> MapPostures:
    """Return given postures as samples; those outside the limits, or in collision, are infeasible.

    Args:
        q: (M, 6) rad.
        lower: (6,) rad.
        upper: (6,) rad.
        collides: collision check; None: none.
    """
    inside = np.asarray(((q >= lower - 1e-12) & (q <= upper + 1e-12)).all(axis=1))
    reason = np.where(inside, InfeasibilityReason.OK, InfeasibilityReason.LIMIT).astype(np.uint8)
    if collides is not None and inside.any():
        there = np.flatnonzero(inside)
        reason[there[collides(q[there])]] = InfeasibilityReason.COLLIDING
    M, ok = len(q), np.asarray(reason == InfeasibilityReason.OK)
    return MapPostures(
        q=np.where(ok[:, None], q, np.nan),
        branch=np.full(M, -1, np.int8),
        gamma=np.full(M, np.nan),
        reason=reason,
        shortfall=np.zeros(M),
        count=ok.astype(np.int64),
        rotations=ok.astype(float),
    )
