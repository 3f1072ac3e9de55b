"""Order of the measurement: short travel between poses, and an order in which drift does not imitate stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.numerics.array_types import Array, Ints


@dataclass(frozen=True)
class ScheduledLoadTest:
    """One load test in the order of work."""

    round: int  # 0-based pass over all poses
    pose: int  # index into the design's blocks
    reading: int  # index into the load cases
    cycle: int  # 0-based number of the load cycle at this pose


def build_schedule(
    blocks: Sequence[Sequence[int]], rounds: int, rng: np.random.Generator
) -> tuple[ScheduledLoadTest, ...]:
    """Schedule every reading once per round, with rounds in alternating directions and shuffled loads.

    Every second round runs backwards, which cancels a linear drift between the two readings of a pose. Every other
    pair of rounds starts at another pose.

    Args:
        blocks: Readings by pose, poses in an order with short travel (:func:`order_poses_by_travel`).
        rounds: Number of rounds over all poses.
        rng: Random generator for loads and start poses.

    Returns:
        The load tests in order.
    """
    way = np.arange(len(blocks))
    done = [0] * len(blocks)
    out = []
    for n in range(rounds):
        if n % 2 == 0:
            forward = way if n == 0 else np.roll(way, -int(rng.integers(len(way))))
        for pose in forward if n % 2 == 0 else forward[::-1]:
            for reading in rng.permutation(np.asarray(blocks[pose], np.int64)):
                out.append(ScheduledLoadTest(n, int(pose), int(reading), done[pose]))
                done[pose] += 1
    return tuple(out)


def order_poses_by_travel(q: Array, home: Array, velocity: Array) -> Ints:
    """Order poses for short travel: nearest neighbours, then 2-opt until convergence.

    Args:
        q: (B, 6) joint angles, rad.
        home: (6,) start position, rad.
        velocity: (6,) joint speed limits, rad/s; travel is measured in time.

    Returns:
        Pose indices in order.
    """
    at = np.concatenate([home[None], q])
    seconds = np.max(np.abs(at[:, None] - at[None]) / velocity, axis=-1)
    order = [0]
    left = set(range(1, len(at)))
    while left:
        order.append(min(left, key=lambda n: (seconds[order[-1], n], n)))
        left.remove(order[-1])
    improved = True
    while improved:
        improved = False
        for i in range(1, len(order) - 1):
            for j in range(i + 1, len(order)):
                gain = seconds[order[i - 1], order[i]] - seconds[order[i - 1], order[j]]
                if j + 1 < len(order):
                    gain += seconds[order[j], order[j + 1]] - seconds[order[i], order[j + 1]]
                if gain > 1e-9:  # s; smaller gains are rounding and could cause cycling
                    order[i : j + 1] = order[i : j + 1][::-1]
                    improved = True
    return np.array(order[1:], np.int64) - 1
