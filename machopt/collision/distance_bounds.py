"""Cheap bounds on distances and motions of pairs of bodies, for many rows at once.

The collision check uses two facts. Spheres that cover one body and a box around the other bound their
distance from below. And while the joints move by Δq, no point of one body moves relative to the other by more
than D = Σ_k |Δq_k| (ρ_k + D), with ρ_k the largest distance of the body from axis k at the start (a lever
cannot grow by more than the motion itself), hence D = Σ|Δq_k| ρ_k / (1 − Σ|Δq_k|); half the joint step has
half the bound. A sliding joint adds |Δq_k| directly (ρ_k = 1) and lengthens no lever of its own, so it does not
count in the denominator.

Rows contain θ, one value per line of the chain (:class:`machopt.kinematics.machine_lines.MachineLines`): between links
i < j are the lines i … j − 1, as between links 0 and 3 of an arm its joints 1 to 3.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bodies import CollisionBody
from machopt.kinematics.machine_lines import MachineLines
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform

BLOCK_ROWS = 256  # rows per block and thread
MAX_REMEMBERED = 3000  # maximum number of stored distances of one pair
UNKNOWN_MOTION_M = 1e3  # m, the motion bound of joint steps too large for one


class BodyPairs:
    """Spheres and boxes of P pairs as arrays.

    Args:
        lines: kinematics.
        bodies: all bodies.
        index: (P) of two indices into ``bodies``, the lower link first.
    """

    def __init__(self, lines: MachineLines, bodies: list[CollisionBody], index: list[tuple[int, int]]) -> None:
        self.lines, self.bodies, self.index = lines, bodies, index
        self.links = [(bodies[i].link, bodies[j].link) for i, j in index]
        self.groups = sorted(set(self.links))
        self.group = np.array([self.groups.index(g) for g in self.links], int)
        # Spheres around the body that they fit better, a box around the other.
        self.flip = np.array([bodies[i].sphere_radius < bodies[j].sphere_radius for i, j in index], bool)
        boxed = [bodies[j if f else i] for (i, j), f in zip(index, self.flip, strict=True)]
        balls = [bodies[i if f else j] for (i, j), f in zip(index, self.flip, strict=True)]
        self.to_box = np.array([_build_box_transform(b) for b in boxed]).reshape(-1, 3, 4)
        self.half = np.array([b.box_half for b in boxed]).reshape(-1, 3)
        self.spheres = np.cumsum([0, *(len(b.sphere_centres) for b in balls)])  # (P + 1,) first row of each pair
        self.centres = np.concatenate([np.zeros((0, 3)), *(b.sphere_centres for b in balls)])
        self.radius = np.array([b.sphere_radius for b in balls])
        self.reach = _bound_reach(lines, bodies)
        self.scale = _compute_joint_scale(lines, self.reach)

    @property
    def robot(self) -> Robot:
        """The arm with independent lines."""
        return self.lines.machine.robot.uncoupled_robot

    def compute_relative_motion(self, p: int, q: Array) -> Array:
        """Return the (S, 4, 4) motion of a pair's second body from zero, relative to the first body's link.

        Args:
            p: index of the pair.
            q: (S, n) θ, rad or m.
        """
        return self.lines.compute_relative_motion(*self.links[p], q)

    def compute_lever(self, p: int) -> float:
        """Return the largest distance in m of a pair's second body from the axis of the joint between the two; 1 if it
        slides.

        Args:
            p: index of a pair with one joint in between.
        """
        body, lines = self.bodies[self.index[p][1]], self.lines
        k = body.link - 1
        if lines.slides[k]:
            return 1.0
        return float(np.linalg.norm(np.cross(body.vertices - lines.point[k], lines.axis[k]), axis=1).max())


@dataclass
class MotionRows:
    """Poses, distance bounds and motion bounds of one sequence of joint positions."""

    pairs: BodyPairs
    q: Array  # (S, n) rad or m, θ of the lines
    bound: Array = field(init=False)  # (S, P) m, never above the true distance
    reach: Array = field(init=False)  # (S − 1,) m, never below any pair's relative motion to the next row

    def __post_init__(self) -> None:
        pairs, self.q = self.pairs, np.asarray(self.q, float).reshape(-1, self.pairs.lines.count)
        self.poses = pairs.lines.compute_link_poses(self.q)
        self._relative = np.empty((len(pairs.groups), len(self.q), 4, 4))
        for g, (i, j) in enumerate(pairs.groups):
            self._relative[g] = self.poses[:, j] if i == 0 else invert_transform(self.poses[:, i]) @ self.poses[:, j]
        self._travel: dict[tuple[int, int], Array] = {}
        self.bound = np.empty((len(self.q), len(pairs.index)))
        map_in_threads(self._fill_bounds, range(0, len(self.q), BLOCK_ROWS))
        delta = np.abs(np.diff(self.q, axis=0))
        slides = pairs.lines.slides
        self._delta, self._turn = delta, (delta[:, ~slides] if slides.any() else delta).sum(axis=1)
        self.reach = _bound_step_motion(delta @ pairs.reach, self._turn)

    def _fill_bounds(self, start: int) -> None:
        pairs, rows = self.pairs, slice(start, start + BLOCK_ROWS)
        _bound_pair_distances(
            self._relative,
            start,
            pairs.group,
            pairs.flip,
            pairs.to_box,
            pairs.half,
            pairs.spheres,
            pairs.centres,
            pairs.radius,
            self.bound[rows],
        )

    def compute_relative_motion(self, p: int) -> Array:
        """Return the (S, 4, 4) motion of a pair's second body from q = 0, relative to the first body's link.

        Args:
            p: index of the pair.
        """
        T: Array = self._relative[self.pairs.group[p]]
        return T

    def bound_motion(self, p: int) -> Array:
        """Return (S − 1,) m, upper bound of the motion of any point of a pair's second body relative to the first.

        Args:
            p: index of the pair.
        """
        i, j = self.pairs.index[p]
        low = self.pairs.bodies[i].link
        if (low, j) not in self._travel:
            body, lines = self.pairs.bodies[j], self.pairs.lines
            centre = self.poses[:-1, body.link] @ np.append(body.box_centre, 1.0)
            lever = np.zeros((len(self.q) - 1, lines.count))
            for k in range(low, body.link):
                if lines.slides[k]:
                    lever[:, k] = 1.0
                    continue
                pose = self.poses[:-1, k]
                arm = centre[:, :3] - (pose[:, :3, :3] @ lines.point[k] + pose[:, :3, 3])
                lever[:, k] = _measure_axis_distance(pose[:, :3, :3] @ lines.axis[k], arm)
                lever[:, k] += np.linalg.norm(body.box_half)
            self._travel[low, j] = _bound_step_motion(np.einsum("sk,sk->s", self._delta, lever), self._turn)
        return self._travel[low, j]


class DistanceMemory:
    """Earlier distances of a pair with one or two joints in between, for any other pose of the arm.

    On a straight line in joint space no point of the second body moves by more than Σ_k |Δq_k| ρ_k, ρ_k being its
    largest distance from axis k in any pose; so every distance d found at q' bounds that at q by d − Σ|Δq_k| ρ_k.
    Neighbouring links are always near each other, so without it they would need a distance at every pose. A sliding
    line has ρ_k = 1 and lengthens the levers before it by its stroke.
    """

    def __init__(self, lines: MachineLines, low: int, body: CollisionBody) -> None:
        self.joints = slice(low, body.link)
        self._levers = np.zeros(body.link - low)
        for n, k in enumerate(range(low, body.link)):
            arm = body.vertices - lines.point[body.link - 1]
            if lines.slides[k]:
                self._levers[n] = 1.0
            elif k == body.link - 1:  # moved by this joint alone: the distance from its axis is constant
                self._levers[n] = np.linalg.norm(np.cross(arm, lines.axis[k]), axis=1).max()
            else:
                self._levers[n] = _bound_chain_length(lines, k, body.link) + np.linalg.norm(arm, axis=1).max()
        self._at = np.empty((MAX_REMEMBERED, body.link - low))
        self._distance = np.empty(MAX_REMEMBERED)
        self._count = 0

    def bound_distance(self, q: Array) -> float:
        """Return a lower bound of the distance in m.

        Args:
            q: (n,) θ, rad or m.
        """
        n = min(self._count, MAX_REMEMBERED)
        if n == 0:
            return -np.inf
        return float((self._distance[:n] - np.abs(self._at[:n] - q[self.joints]) @ self._levers).max())

    def find_farther(self, q: Array, least: Array) -> Bools:
        """Return (S,) whether the lower bound of :meth:`bound_distance` is at least a given distance at each row.

        Args:
            q: (S, n) θ, rad or m.
            least: (S,) m.
        """
        n = min(self._count, MAX_REMEMBERED)
        joints = np.ascontiguousarray(q[:, self.joints])
        found: Bools = _find_farther(joints, np.asarray(least, float), self._at[:n], self._distance[:n], self._levers)
        return found

    def add_distance(self, q: Array, distance: float) -> None:
        """Store a measured distance.

        Args:
            q: (n,) θ, rad or m.
            distance: m.
        """
        self._at[self._count % MAX_REMEMBERED] = q[self.joints]
        self._distance[self._count % MAX_REMEMBERED] = distance
        self._count += 1


@jit_compile
def _bound_pair_distances(
    relative: Array,
    first: int,
    group: NDArray[np.int64],
    flip: Bools,
    to_box: Array,
    half: Array,
    spheres: NDArray[np.int64],
    centres: Array,
    radius: Array,
    bound: Array,
) -> None:
    """Write the (S, P) distances in m of the spheres around one body of each pair from the box around the other.

    Args:
        relative: (G, N, 4, 4) pose of the second body's link relative to the first one's, by pair of links.
        first: first of the S rows.
        group: (P,) index into them.
        flip: (P,) the spheres are around the first body.
        to_box: (P, 3, 4) frame of the box from the link of its body.
        half: (P, 3) m, half edges of the box.
        spheres: (P + 1,) first row of ``centres`` of each pair.
        centres: (n, 3) m, in the link of the body that the spheres are around.
        radius: (P,) m, of all spheres of a pair.
        bound: (S, P) m, output.
    """
    local, place = np.empty((3, 4)), np.empty((3, 4))
    for s in range(len(bound)):
        for p in range(len(group)):
            link = relative[group[p], first + s]
            for i in range(3):
                place[i, 3] = link[i, 3]
                for j in range(3):
                    place[i, j] = link[j, i] if flip[p] else link[i, j]
            if flip[p]:
                for i in range(3):
                    place[i, 3] = -(link[0, i] * link[0, 3] + link[1, i] * link[1, 3] + link[2, i] * link[2, 3])
            for i in range(3):
                for j in range(4):
                    local[i, j] = to_box[p, i, 3] if j == 3 else 0.0
                    for k in range(3):
                        local[i, j] += to_box[p, i, k] * place[k, j]
            nearest = np.inf
            for n in range(spheres[p], spheres[p + 1]):
                squared = 0.0
                for i in range(3):
                    along = local[i, 3]
                    for k in range(3):
                        along += local[i, k] * centres[n, k]
                    away = abs(along) - half[p, i]
                    if away > 0.0:
                        squared += away * away
                nearest = min(nearest, squared)
            bound[s, p] = np.sqrt(nearest) - radius[p]


@jit_compile
def _find_farther(q: Array, least: Array, at: Array, distance: Array, levers: Array) -> Bools:
    """Return (S,) whether some known distance proves that the one at q (S, k) is at least ``least`` (S,) in m.

    Args:
        q: (S, k) rad or m, joints between the bodies.
        least: (S,) m.
        at: (n, k) joints of the known distances.
        distance: (n,) m.
        levers: (k,) m of motion per rad or m.
    """
    out = np.zeros(len(q), np.bool_)
    for s in range(len(q)):
        for n in range(len(at)):
            bound = distance[n]
            for k in range(len(levers)):
                bound -= abs(at[n, k] - q[s, k]) * levers[k]
            if bound >= least[s]:
                out[s] = True
                break
    return out


def refine_motion(
    q: Array, step: float, scale: Array | None = None, starts: Bools | None = None
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return rows at most ``step`` apart in every joint, the row each leads to, and its fractional row.

    Args:
        q: (S, n) θ of the lines.
        step: rad.
        scale: (n,) equivalent rad per unit of each line; None: 1.
        starts: (S,) rows that begin another motion: nothing is added on the way to them.
    """
    if len(q) == 0:
        return q.reshape(0, q.shape[-1]), np.zeros(0, np.int64), np.zeros(0)
    way = np.abs(np.diff(q, axis=0))
    parts = np.maximum(np.ceil((way if scale is None else way * scale).max(axis=1) / step), 1).astype(int)
    if starts is not None:
        parts[starts[1:]] = 1
    owner = np.repeat(np.arange(1, len(q)), parts)
    count = np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    share = count / np.repeat(parts, parts)
    dense = q[owner - 1] + share[:, None] * (q[owner] - q[owner - 1])
    dense[share == 1.0] = q[owner[share == 1.0]]
    return np.vstack([q[:1], dense]), np.append(0, owner), np.append(0.0, owner - 1 + share)


def _bound_chain_length(lines: MachineLines, k: int, end: int) -> float:
    """Return an upper bound in m of the distance between points of line k and of the last line before link ``end``."""
    between = np.linalg.norm(np.diff(lines.point[k:end], axis=0), axis=1).sum()
    return float(between + lines.stroke[k + 1 : end].sum()) if lines.slides.any() else float(between)


def _bound_reach(lines: MachineLines, bodies: list[CollisionBody]) -> Array:
    """Return (n,) m, an upper bound of the distance of any body point from axis k; 1 for a sliding line."""
    point = lines.point
    out = np.zeros(lines.count)
    for body in bodies:
        own = np.linalg.norm(body.box_centre - point[body.link - 1]) + np.linalg.norm(body.box_half)
        for k in range(body.link):
            out[k] = max(out[k], _bound_chain_length(lines, k, body.link) + own)
    return np.where(lines.slides, 1.0, out) if lines.slides.any() else out


def _compute_joint_scale(lines: MachineLines, reach: Array) -> Array | None:
    """Return (n,) equivalent rad per unit of each line: the rotation that moves bodies as far; None: all rotate."""
    if not lines.slides.any():
        return None
    return np.where(lines.slides, 1.0 / max(float(reach[~lines.slides].max()), 1e-3), 1.0)


def _measure_axis_distance(axis: Array, arm: Array) -> Array:
    """(S,) |axis × arm|; written out, because ``np.cross`` costs several times the products in short calls."""
    (ax, ay, az), (bx, by, bz) = axis.T, arm.T
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _bound_step_motion(first_order: Array, turn: Array) -> Array:
    """Bound of the motion over a whole step from the levers at its start.

    A lever grows by at most the motion D itself, so D ≤ Σ|Δq| (ρ + D), D ≤ Σ|Δq| ρ / (1 − Σ|Δq|).
    """
    share = 1.0 - turn
    return np.where(share > 0.1, first_order / np.maximum(share, 0.1), UNKNOWN_MOTION_M)


def _build_box_transform(body: CollisionBody) -> Array:
    """(3, 4): coordinates in base_link at q = 0 → coordinates along the box axes from its centre."""
    R = body.box_rotation.T
    return np.column_stack([R, -R @ body.box_centre])
