"""Where the robot is measured and under which loads, and how long each reading takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arm_model import Nominal, arm_of
from simulator.static_equilibrium import Setting, Statics

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
SPREAD = np.radians([60.0, 32.0, 38.0, 130.0, 65.0, 150.0])  # about home


def sample_poses(nominal: Nominal, count: int, rng: np.random.Generator) -> Array:
    """(count, 6) rad: inside the limits, in front of the robot, above the floor, away from singular configurations."""
    statics = Statics(arm_of(nominal))
    reach = float(sum(np.linalg.norm(j.t) for j in nominal.joints))
    margin = np.radians(6.0)
    kept: list[Array] = []
    while len(kept) < count:
        q = nominal.home + rng.uniform(-1.0, 1.0, (256, 6)) * SPREAD
        q = np.clip(q, nominal.lower + margin, nominal.upper - margin)
        x = np.zeros((256, len(statics.model.chain)))
        x[:, statics.model.joint] = q
        posture = statics.model.chain.forward(x)
        tip, _ = posture.tip()
        J = posture.jacobian()
        J[:, :3] /= 0.4 * reach  # turns and shifts weighed alike
        least = np.linalg.svd(J, compute_uv=False)[:, -1]
        radius = np.hypot(tip[:, 0], tip[:, 1])
        good = (least > 0.07) & (radius > 0.4 * reach) & (radius < 0.92 * reach) & (tip[:, 2] > 0.1 * reach)
        kept.extend(q[good])
    return np.round(np.array(kept[:count]), 6)


def random_directions(count: int, rng: np.random.Generator) -> Array:
    """(count, 3) unit vectors, half of them near an axis of the hall, as pulleys and weights are set up."""
    v = rng.normal(size=(count, 3))
    axis = rng.integers(0, 3, count)
    near = rng.random(count) < 0.5
    v[near] *= 0.15
    v[near, axis[near]] = rng.choice([-1.0, 1.0], near.sum())
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


@dataclass(frozen=True)
class LoadTestSequence:
    """B sequences of S states each: (session, pose) by (cycle, load step), in the order they happen."""

    poses: Array  # (P, 6) rad
    pose: Ints  # (B,)
    session: Ints  # (B,)
    cycle: Ints  # (S,) number of the cycle inside the sequence
    level: Array  # (S,) share of the full load; 0 with zero True is the state the displacements count from
    zero: NDArray[np.bool_]  # (S,) reference state of its cycle, not a reading
    branch: Ints  # (S,) +1 load, −1 unload
    wrench: Array  # (B, S, 6) N, N·m, base axes, at the TCP
    hold: Array  # (B, S) s
    time: Array  # (B, S) s from the start of the session
    full: float  # N

    @property
    def encoder(self) -> Array:
        return self.poses[self.pose]


LEVELS = (0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0)


def draw_load_tests(
    nominal: Nominal,
    rng: np.random.Generator,
    *,
    poses: int,
    cycles: int,
    sessions: int,
    moments: bool,
    deflection: float = 1.5e-3,
) -> LoadTestSequence:
    """Load–unload cycles in several directions at each pose, all of it again in each session.

    Args:
        nominal: of the cell.
        rng: draws poses, directions and times.
        poses, cycles, sessions: how many; the same load comes back in every session.
        moments: whether the load has a lever, as with a loading frame bolted to the flange.
        deflection: m that the full force causes at a typical pose of the nominal arm.
    """
    q = sample_poses(nominal, poses, rng)
    statics = Statics(arm_of(nominal))
    x = np.zeros((poses, len(statics.model.chain)))
    x[:, statics.model.joint] = q
    J = statics.model.chain.forward(x).jacobian()
    C = np.einsum("pik,k,pjk->pij", J[:, :3], 1.0 / nominal.stiffness, J[:, :3])
    full = float(np.round(deflection / np.median(np.linalg.eigvalsh(C)[:, -1]), -1))
    full = float(np.clip(full, 40.0, 4000.0))
    direction = random_directions(poses * cycles, rng).reshape(poses, cycles, 3)
    if cycles > 1:
        direction[:, 1] = -direction[:, 0]  # both signs of one direction
    moment = np.zeros((poses, cycles, 3))
    if moments:
        lever = rng.uniform(-0.35, 0.35, (poses, cycles, 3))
        moment = np.cross(lever, full * direction)
    steps = len(LEVELS) + 1
    level = np.tile(np.array([0.0, *LEVELS]), cycles)
    cycle = np.repeat(np.arange(cycles), steps)
    zero = np.tile(np.arange(steps) == 0, cycles)
    branch = np.tile(np.array([1, *np.where(np.arange(len(LEVELS)) < 4, 1, -1)]), cycles)
    pose, session, when, holds = [], [], [], []
    for s in range(sessions):
        clock = 0.0
        for p in rng.permutation(poses):
            pace = np.repeat(rng.choice([4.0, 8.0, 20.0], cycles), steps)
            hold = pace * rng.uniform(0.8, 1.3, cycles * steps)
            pose.append(p)
            session.append(s)
            holds.append(hold)
            when.append(clock + 25.0 + np.cumsum(hold))
            clock = float(when[-1][-1])
    force = np.concatenate([direction * full, moment], axis=2)  # (P, cycles, 6)
    share = rng.uniform(0.97, 1.03, (len(pose), cycles * steps))
    wrench = force[np.array(pose)][:, cycle] * (level * share)[:, :, None]
    return LoadTestSequence(
        q, np.array(pose), np.array(session), cycle, level, zero, branch, wrench, np.array(holds), np.array(when), full
    )


@dataclass(frozen=True)
class PoseSequence:
    """B visits to poses; at each, S states: unloaded, then with weights on the tool."""

    poses: Array  # (P, 6) rad
    pose: Ints  # (B,)
    session: Ints  # (B,)
    cycle: Ints  # (B,) which visit of its pose
    wrench: Array  # (B, S, 6)
    time: Array  # (B,) s

    @property
    def encoder(self) -> Array:
        return self.poses[self.pose]


def draw_pose_sequence(
    nominal: Nominal, rng: np.random.Generator, *, poses: int, visits: int, weights: int, sweep: int | None = None
) -> PoseSequence:
    """Poses in a new random order at each round; ``weights`` > 0 hangs 0.5 % … of the arm's weight on the tool.

    Args:
        nominal: of the cell.
        rng: draws poses and order.
        poses, visits, weights: how many.
        sweep: a joint (0-based) that a third of the poses step through while the others rest.
    """
    q = sample_poses(nominal, poses, rng)
    if sweep is not None:
        some = poses // 3
        q[:some] = q[0]
        centre, half = q[0, sweep], np.radians(40.0)
        low = max(centre - half, nominal.lower[sweep] + 0.1)
        high = min(centre + half, nominal.upper[sweep] - 0.1)
        q[:some, sweep] = np.round(np.linspace(low, high, some), 6)
    hung = np.arange(weights + 1) * 0.02 * nominal.mass[1:].sum() * 9.80665
    wrench = np.zeros((poses * visits, weights + 1, 6))
    wrench[:, :, 2] = -np.round(hung, 1)
    order = np.concatenate([rng.permutation(poses) for _ in range(visits)])
    number = np.repeat(np.arange(visits), poses)
    time = np.cumsum(rng.uniform(20.0, 40.0, poses * visits) + 30.0 * weights)
    time += number // 2 * 3600.0 * 16.0  # two rounds a day
    return PoseSequence(q, order, number // 2, number, wrench, time)


def torque_range(nominal: Nominal, encoder: Array, wrench: Array) -> tuple[Array, Array]:
    """Load torques |J_iᵀ w| (N, 6) and total gear torques (N, 6) N·m of the nominal arm."""
    statics = Statics(arm_of(nominal))
    loaded = statics.settle(Setting(encoder, wrench))
    empty = statics.settle(Setting(encoder, 0.0 * wrench))
    return np.asarray(loaded.torque - empty.torque), loaded.torque
