"""Cheap bounds on distances and motions of pairs of bodies, for many rows at once (NumPy only).

Two facts carry the collision check. Spheres that cover one body and a box around the other bound their
distance from below. And while the joints move by Δq, no point of one body moves relative to the other by more
than D = Σ_k |Δq_k| (ρ_k + D), with ρ_k the largest distance of the body from axis k at the start (a lever
cannot grow by more than the motion itself), hence D = Σ|Δq_k| ρ_k / (1 − Σ|Δq_k|); half the joint step has
half the bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.arrays import Array
from machopt.model.bodies import Body
from machopt.model.robot import Robot
from machopt.se3 import inverse

BLOCK = 1024  # rows bounded at once; keeps the work arrays in cache
MEMORY = 3000  # distances remembered of one pair
UNKNOWN = 1e3  # m, the motion bound of joint steps too large for one


class PairStack:
    """Spheres and boxes of P pairs as arrays.

    Args:
        robot: kinematics.
        bodies: all bodies.
        index: (P) of two indices into ``bodies``, the lower link first.
    """

    def __init__(self, robot: Robot, bodies: list[Body], index: list[tuple[int, int]]) -> None:
        self.robot, self.bodies, self.index = robot, bodies, index
        self.links = [(bodies[i].link, bodies[j].link) for i, j in index]
        self.groups = sorted(set(self.links))
        self.group = np.array([self.groups.index(g) for g in self.links], int)
        # Spheres around the body they fit better, a box around the other.
        self.flip = np.array([bodies[i].sphere_radius < bodies[j].sphere_radius for i, j in index], bool)
        boxed = [bodies[j if f else i] for (i, j), f in zip(index, self.flip, strict=True)]
        balls = [bodies[i if f else j] for (i, j), f in zip(index, self.flip, strict=True)]
        most = max((len(b.sphere_centres) for b in balls), default=1)
        self.to_box = np.array([_to_box(b) for b in boxed]).reshape(-1, 3, 4)
        self.half = np.array([b.box_half for b in boxed]).reshape(-1, 3, 1)
        padded = [np.resize(b.sphere_centres, (most, 3)) for b in balls]
        self.centres = np.array([np.vstack([c.T, np.ones(most)]) for c in padded]).reshape(-1, 4, most)
        self.radius = np.array([b.sphere_radius for b in balls])
        self.reach = _reach(robot, bodies)

    def relative(self, p: int, q: Array) -> Array:
        """(S, 4, 4) motion of pair p's second body from q = 0 to q (S, 6) rad, seen from the first body's link."""
        poses = self.robot.link_poses(q)
        i, j = self.links[p]
        return np.asarray(poses[:, j] if i == 0 else inverse(poses[:, i]) @ poses[:, j])

    def lever(self, p: int) -> float:
        """m, how far pair p's second body reaches from the axis of the one joint between the two."""
        body = self.bodies[self.index[p][1]]
        k = body.link - 1
        return float(np.linalg.norm(np.cross(body.vertices - self.robot.point[k], self.robot.axis[k]), axis=1).max())


@dataclass
class Rows:
    """Poses, distance bounds and motion bounds of one sequence of joint positions."""

    pairs: PairStack
    q: Array
    bound: Array = field(init=False)  # (S, P) m, never above the true distance
    reach: Array = field(init=False)  # (S − 1,) m, never below any pair's relative motion to the next row

    def __post_init__(self) -> None:
        pairs, self.q = self.pairs, np.asarray(self.q, float).reshape(-1, 6)
        self.poses = pairs.robot.link_poses(self.q)
        self._relative = np.empty((len(pairs.groups), len(self.q), 4, 4))
        for g, (i, j) in enumerate(pairs.groups):
            self._relative[g] = self.poses[:, j] if i == 0 else inverse(self.poses[:, i]) @ self.poses[:, j]
        self._travel: dict[tuple[int, int], Array] = {}
        self.bound = np.empty((len(self.q), len(pairs.index)))
        for start in range(0, len(self.q), BLOCK):
            self.bound[start : start + BLOCK] = self._bounds(slice(start, start + BLOCK))
        delta = np.abs(np.diff(self.q, axis=0))
        self._delta, self._turn = delta, delta.sum(axis=1)
        self.reach = _whole(delta @ pairs.reach, self._turn)

    def _bounds(self, rows: slice) -> Array:
        """(B, P): distance of spheres from boxes."""
        pairs = self.pairs
        forth = self._relative[:, rows]
        M = np.where(pairs.flip[:, None, None, None], inverse(forth)[pairs.group], forth[pairs.group])
        local = pairs.to_box[:, None, :, :3] @ M[..., :3, :]  # rotation part onto the box axes
        local[..., 3] += pairs.to_box[:, None, :, 3]
        away = np.abs(local @ pairs.centres[:, None]) - pairs.half[:, None]
        np.maximum(away, 0.0, out=away)
        distance = np.sqrt(np.einsum("pbxk,pbxk->pbk", away, away).min(axis=-1))
        bound: Array = (distance - pairs.radius[:, None]).T
        return bound

    def relative(self, p: int) -> Array:
        """(S, 4, 4) motion of pair p's second body from q = 0, seen from the first body's link."""
        T: Array = self._relative[self.pairs.group[p]]
        return T

    def travel(self, p: int) -> Array:
        """(S − 1,) m, bound on how far any point of pair p's second body moves relative to the first."""
        i, j = self.pairs.index[p]
        low = self.pairs.bodies[i].link
        if (low, j) not in self._travel:
            body, robot = self.pairs.bodies[j], self.pairs.robot
            centre = self.poses[:-1, body.link] @ np.append(body.box_centre, 1.0)
            lever = np.zeros((len(self.q) - 1, 6))
            for k in range(low, body.link):
                pose = self.poses[:-1, k]
                arm = centre[:, :3] - (pose[:, :3, :3] @ robot.point[k] + pose[:, :3, 3])
                lever[:, k] = np.linalg.norm(np.cross(pose[:, :3, :3] @ robot.axis[k], arm), axis=1)
                lever[:, k] += np.linalg.norm(body.box_half)
            self._travel[low, j] = _whole(np.einsum("sk,sk->s", self._delta, lever), self._turn)
        return self._travel[low, j]


class Memory:
    """Distances found earlier of a pair with one or two joints in between, wherever the arm came from.

    Straight through joint space no point of the second body moves by more than Σ_k |Δq_k| ρ_k, ρ_k being its
    largest distance from axis k in any pose; so every distance d found at q' bounds that at q by d − Σ|Δq_k| ρ_k.
    Neighbouring links are always near each other, so without it they would cost a distance at every pose.
    """

    def __init__(self, robot: Robot, low: int, body: Body) -> None:
        self.joints = slice(low, body.link)
        self._levers = np.zeros(body.link - low)
        for n, k in enumerate(range(low, body.link)):
            arm = body.vertices - robot.point[body.link - 1]
            if k == body.link - 1:  # turns with this joint alone: the distance from its axis stays
                self._levers[n] = np.linalg.norm(np.cross(arm, robot.axis[k]), axis=1).max()
            else:
                chain = np.linalg.norm(np.diff(robot.point[k : body.link], axis=0), axis=1).sum()
                self._levers[n] = chain + np.linalg.norm(arm, axis=1).max()
        self._at = np.empty((MEMORY, body.link - low))
        self._distance = np.empty(MEMORY)
        self._count = 0

    def bound(self, q: Array) -> float:
        """m, never above the distance at q (6,) rad."""
        n = min(self._count, MEMORY)
        if n == 0:
            return -np.inf
        return float((self._distance[:n] - np.abs(self._at[:n] - q[self.joints]) @ self._levers).max())

    def add(self, q: Array, distance: float) -> None:
        self._at[self._count % MEMORY] = q[self.joints]
        self._distance[self._count % MEMORY] = distance
        self._count += 1


def densify(q: Array, step: float) -> tuple[Array, NDArray[np.int64], Array]:
    """Rows at most ``step`` apart in every joint, the row each leads to, and its fractional row."""
    if len(q) == 0:
        return q.reshape(0, 6), np.zeros(0, np.int64), np.zeros(0)
    parts = np.maximum(np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1) / step), 1).astype(int)
    owner = np.repeat(np.arange(1, len(q)), parts)
    count = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    share = count / np.repeat(parts, parts)
    dense = q[owner - 1] + share[:, None] * (q[owner] - q[owner - 1])
    dense[share == 1.0] = q[owner[share == 1.0]]
    return np.vstack([q[:1], dense]), np.append(0, owner), np.append(0.0, owner - 1 + share)


def _reach(robot: Robot, bodies: list[Body]) -> Array:
    """(6,) m: no body point is ever farther from axis k than this."""
    point = robot.point
    out = np.zeros(6)
    for body in bodies:
        for k in range(body.link):
            chain = np.linalg.norm(np.diff(point[k : body.link], axis=0), axis=1).sum()
            own = np.linalg.norm(body.box_centre - point[body.link - 1]) + np.linalg.norm(body.box_half)
            out[k] = max(out[k], chain + own)
    return out


def _whole(first_order: Array, turn: Array) -> Array:
    """Bound of the motion over a whole step from the levers at its start.

    A lever grows by at most the motion D itself, so D ≤ Σ|Δq| (ρ + D), D ≤ Σ|Δq| ρ / (1 − Σ|Δq|).
    """
    share = 1.0 - turn
    return np.where(share > 0.1, first_order / np.maximum(share, 0.1), UNKNOWN)


def _to_box(body: Body) -> Array:
    """(3, 4): coordinates in base_link at q = 0 → coordinates along the box axes from its centre."""
    R = body.box_rotation.T
    return np.column_stack([R, -R @ body.box_centre])
