"""Candidate poses: quasi-random joint positions that are reachable, visible and free of collisions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from machopt.collision.collision_model import CollisionModel
from machopt.errors import OptionError
from machopt.kinematics.robot import ArmState, Robot
from machopt.numerics.array_types import Array, Bools, Ints
from machopt.numerics.rigid_transforms import normalise_vectors
from machopt.stiffness.kinetostatic_indices import compute_conditioning_index

BLOCK = 1024  # poses drawn at a time, a power of two as required by Sobol's sequence
MOST_TRIED = 100  # limit on drawn poses, relative to the required number
FULL_TURN = 2.0 * np.pi
AT_FLANGE = 1e-3  # m; for a TCP closer to the flange the direction to the flange is undefined


@dataclass(frozen=True, kw_only=True)
class PoseCriteria:
    """Criteria of a pose, independent of the load."""

    kci: float = 0.0  # least kinematic conditioning index 1/κ_F
    limit_margin: float = 0.0  # rad, margin to each joint limit
    floor: float = -np.inf  # m, least height of the TCP in world
    ceiling: float = np.inf  # m, greatest
    box: Array | None = None  # (2, 3) m, lowest and highest TCP in world
    tracker: Array | None = None  # (3,) m in world
    tracker_range: float = np.inf  # m, farthest target
    tracker_angle: float = 0.0  # rad, least angle between the line to the tracker and the line to the flange


@dataclass(frozen=True)
class PosePool:
    """P accepted poses in the order of drawing."""

    state: ArmState  # with bodies
    kci: Array  # (P,)
    drawn_count: int
    rejected: dict[str, int]  # reason: number of poses, counted at their first failure

    def __len__(self) -> int:
        return len(self.kci)

    @property
    def q(self) -> Array:
        """Joint angles (P, 6) rad."""
        return self.state.q

    @property
    def T_base_tcp(self) -> Array:
        """TCP poses (P, 4, 4)."""
        return self.state.T_base_tool


REASONS = (
    "TCP too low",
    "TCP too high",
    "TCP outside the box",
    "too far from the tracker",
    "hidden from the tracker",
    "KCI too low",
    "collision or too little clearance",
)


@dataclass(frozen=True, kw_only=True)
class PoseScreen:
    """Robot and cell data for the screening of poses."""

    robot: Robot
    T_flange_tcp: Array  # (4, 4)
    T_world_base: Array  # (4, 4)
    length: float  # m, characteristic length of KCI
    criteria: PoseCriteria
    collision: CollisionModel | None = None  # None: collisions are not checked

    def first_failures(self, q: Array) -> tuple[Ints, Array]:
        """Find the first criterion that each pose fails.

        Args:
            q: (S, 6) joint angles, rad.

        Returns:
            Index into REASONS (S,), −1 for accepted poses, and the conditioning index (S,).
        """
        c = self.criteria
        T, J = self.robot.compute_fk_jacobian(q, self.T_flange_tcp)
        dexterity = compute_conditioning_index(J, self.length)
        p = T[:, :3, 3] @ self.T_world_base[:3, :3].T + self.T_world_base[:3, 3]
        out = np.full(len(q), -1, np.int64)

        def fail(where: Bools, reason: str) -> None:
            out[(out < 0) & where] = REASONS.index(reason)

        fail(p[:, 2] < c.floor, "TCP too low")
        fail(p[:, 2] > c.ceiling, "TCP too high")
        if c.box is not None:
            fail(((p < c.box[0]) | (p > c.box[1])).any(axis=1), "TCP outside the box")
        if c.tracker is not None:
            sight = c.tracker - p
            fail(np.linalg.norm(sight, axis=1) > c.tracker_range, "too far from the tracker")
            back = (T[:, :3, :3] @ self._to_arm()) @ self.T_world_base[:3, :3].T
            aligned = np.einsum("nc,nc->n", normalise_vectors(sight), normalise_vectors(back))
            fail(aligned > np.cos(c.tracker_angle), "hidden from the tracker")
        fail(~(dexterity >= c.kci), "KCI too low")
        left = np.flatnonzero(out < 0)
        if self.collision is not None and len(left):
            hit = self.collision.check_configurations(q[left], np.zeros(len(left), bool)).hit
            out[left[hit]] = REASONS.index("collision or too little clearance")
        return out, dexterity

    def _to_arm(self) -> Array:
        """Return the direction (3,) from the TCP to the flange in TCP axes; opposite to the tool axis if they
        coincide.
        """
        back = -self.T_flange_tcp[:3, :3].T @ self.T_flange_tcp[:3, 3]
        return back if np.linalg.norm(back) > AT_FLANGE else np.array([0.0, 0.0, -1.0])


def sample_poses(
    screen: PoseScreen,
    limits: tuple[Array, Array],
    home: Array,
    wanted: int,
    seed: int,
    progress: Callable[[int], None] = lambda _: None,
) -> PosePool:
    """Draw joint positions until enough are accepted.

    Scrambled Sobol points over the joint ranges. A joint with more than one turn is drawn within half a turn of its
    home position.

    Args:
        screen: Screening of poses.
        limits: Lower and upper joint limits, each (6,) rad.
        home: (6,) home position, rad.
        wanted: Required number of poses.
        seed: Seed of the scrambling.
        progress: Called with the number of accepted poses.

    Returns:
        The accepted poses.

    Raises:
        InputError: A joint range is not wider than twice the margin.
    """
    lower, upper = _compute_sampling_range(limits, home, screen.criteria.limit_margin)
    sequence = qmc.Sobol(6, seed=seed)
    counts = np.zeros(len(REASONS), np.int64)
    accepted: list[Array] = []
    dexterity: list[Array] = []
    tried = passed = 0
    while passed < wanted and tried < MOST_TRIED * max(wanted, BLOCK):
        q = lower + (upper - lower) * sequence.random(BLOCK)
        failure, index = screen.first_failures(q)
        counts += np.bincount(failure[failure >= 0], minlength=len(REASONS))
        accepted.append(q[failure < 0])
        dexterity.append(index[failure < 0])
        tried, passed = tried + BLOCK, passed + len(accepted[-1])
        progress(min(passed, wanted))
    q, index = np.concatenate(accepted)[:wanted], np.concatenate(dexterity)[:wanted]
    rejected = {reason: int(n) for reason, n in zip(REASONS, counts, strict=True) if n}
    return PosePool(screen.robot.compute_state(q, screen.T_flange_tcp, bodies=True), index, tried, rejected)


def screen_given_poses(screen: PoseScreen, q: Array) -> PosePool:
    """Screen given poses like drawn ones.

    Args:
        screen: Screening of poses.
        q: (S, 6) joint angles, rad.

    Returns:
        The accepted poses.
    """
    failure, index = screen.first_failures(q)
    counts = np.bincount(failure[failure >= 0], minlength=len(REASONS))
    rejected = {reason: int(n) for reason, n in zip(REASONS, counts, strict=True) if n}
    ok = failure < 0
    return PosePool(screen.robot.compute_state(q[ok], screen.T_flange_tcp, bodies=True), index[ok], len(q), rejected)


def _compute_sampling_range(limits: tuple[Array, Array], home: Array, margin: float) -> tuple[Array, Array]:
    lower, upper = limits[0] + margin, limits[1] - margin
    for j in range(6):
        if not upper[j] > lower[j]:
            raise OptionError(
                f"a margin of {np.degrees(margin):g} deg leaves nothing of joint {j + 1}, which moves from "
                f"{np.degrees(limits[0][j]):g} to {np.degrees(limits[1][j]):g} deg",
                where="--limit-margin-deg",
            )
    wide = upper - lower > FULL_TURN
    middle = np.clip(home, lower + np.pi, np.maximum(upper - np.pi, lower + np.pi))
    return np.where(wide, middle - np.pi, lower), np.where(wide, middle + np.pi, upper)
