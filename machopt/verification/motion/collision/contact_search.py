"""Search for contacts along a motion, at the samples and between them, by coal.

Let D be the second body's relative motion between two rows. A pair is free between the rows if the lower bounds of
its distance at both rows exceed D together. Cheap bounds prove this for most stretches. In the others neither row may
touch, with a body grown by D/2 (coal's security margin). Where that is not so, the stretch is halved, first at
samples, then between two samples, linear in the joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array, Bools
from machopt.numerics.compiled_functions import jit_compile
from machopt.verification.motion.collision.bodies import (
    CoalBody,
    bound_distances,
    bound_sphere_box_distance,
    compute_reach,
    invert_transforms,
    is_near,
)
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics

LEAP, LEAP_FACTOR = 2.0 * np.pi, 10.0  # rad or m; times the limit of velocity
MAX_JOINT_STEP_RAD = np.radians(0.5)  # joint motion between the rows that are checked first
BLOCK_ROWS = 5_000  # rows whose frames are held at a time
MIN_MOTION_M = 1e-4  # m, motion below which a stretch is not halved any more


@dataclass(frozen=True)
class ContactInterval:
    """One pair of bodies in contact somewhere along the motion."""

    pair: str
    sample: int  # first one, or the one before a contact in between
    stretches: tuple[int, ...]  # sample before or in each stretch in contact


def find_leap(joints: Array, velocity: Array, sample_time: float) -> int | None:
    """Return the first sample that a joint reaches by a leap, too far to divide into steps; None where none does.

    A leap is longer than ``LEAP_FACTOR`` times the joint's limit of velocity allows, and than ``LEAP``.

    Args:
        joints: (S, 6 + E) rad or m.
        velocity: (6 + E,) rad/s or m/s, limits.
        sample_time: s.
    """
    far = np.zeros(max(len(joints) - 1, 0), bool)
    for column, limit in zip(joints.T, LEAP + LEAP_FACTOR * velocity * sample_time, strict=True):
        far |= np.abs(np.diff(column)) > limit
    rows = np.flatnonzero(far)
    return int(rows[0]) + 1 if len(rows) else None


def find_contacts(
    arm: UrdfKinematics, wanted: list[tuple[CoalBody, CoalBody]], q: Array, external: Array, free: Bools
) -> list[ContactInterval]:
    """Return every pair of bodies that touches along the motion.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        wanted: Pairs to check, from :func:`machopt.verification.motion.collision.checked_pairs.list_checked_pairs`.
        q: (S, 6) joint positions, rad.
        external: (S, E) positions of the external joints, rad or m.
        free: (S,) the move to the sample is no feed move of the CAM file, so the cutter must not touch the workpiece.
    """
    joints = np.hstack([q, external]) if external.shape[1] else q
    place, rows = _divide_steps(joints)
    fast = free[np.ceil(place - 1e-9).astype(int)]
    stops = _select_stop_rows(rows, fast)
    bodies = [b for pair in wanted for b in pair]
    lever = _bound_lever(arm, bodies, rows)
    hits: list[list[int]] = [[] for _ in wanted]
    for some in _split_blocks(stops):  # stretch after stretch, so that frames of few rows are held at a time
        first, last = int(some[0]), int(some[-1])
        scene, ends = PlacedBodies(arm, bodies, rows[first : last + 1], lever), some - first
        for n, (a, b) in enumerate(wanted):
            is_requested = (
                fast[some[1:]] if (a.kind, b.kind) == ("workpiece", "grazing") else np.ones(len(ends) - 1, bool)
            )
            hits[n] += [first + hit for hit in scene.find_contact_rows(a, b, ends, is_requested)]
    return [
        ContactInterval(f"{a.name} ~ {b.name}", int(place[found[0]]), tuple(int(place[h]) for h in found))
        for (a, b), found in zip(wanted, hits, strict=True)
        if found
    ]


def find_polyline_contacts(
    arm: UrdfKinematics, wanted: list[tuple[CoalBody, CoalBody]], polylines: Sequence[Array]
) -> list[tuple[str, int]]:
    """Return every pair of bodies that touches along some ways, with the number of the first such way.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        wanted: Pairs to check, from :func:`machopt.verification.motion.collision.checked_pairs.list_checked_pairs`.
        polylines: (R, 6 + E) rad or m each, straight in the joints between rows.
    """
    divided = [_divide_steps(way)[1] for way in polylines]
    if not divided:
        return []
    rows = np.vstack(divided)
    owner = np.repeat(np.arange(len(divided)), [len(way) for way in divided])
    is_same_corner = owner[1:] == owner[:-1]
    scene = PlacedBodies(arm, [b for pair in wanted for b in pair], rows)
    stops = np.arange(len(rows))
    found = [(f"{a.name} ~ {b.name}", scene.find_contact_rows(a, b, stops, is_same_corner)) for a, b in wanted]
    return [(pair, int(owner[hits[0]])) for pair, hits in found if hits]


def _divide_steps(joints: Array) -> tuple[Array, Array]:
    """(M,) place among the samples and (M, n) joint positions, with rows between samples where a step is too long."""
    parts = np.maximum(np.ceil(_compute_steps(joints) / MAX_JOINT_STEP_RAD), 1).astype(int)
    if (parts == 1).all():
        return np.arange(len(joints), dtype=float), joints
    before = np.repeat(np.arange(len(parts)), parts)
    nth = np.arange(len(before)) - np.repeat(np.cumsum(parts) - parts, parts)  # 0 … parts − 1 in each step
    place = np.append(0.0, before + (nth + 1.0) / parts[before])
    samples, rows = np.arange(len(joints)), np.empty((len(place), joints.shape[1]))
    for n, column in enumerate(joints.T):
        rows[:, n] = np.interp(place, samples, column)
    return place, rows


def _compute_steps(rows: Array) -> Array:
    """(M − 1,) rad or m, the largest joint step between neighbouring rows (M, n)."""
    out = np.zeros(max(len(rows) - 1, 0))
    for column in rows.T:
        np.maximum(out, np.abs(np.diff(column)), out=out)
    return out


def _split_blocks(stops: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """The stops in successive parts, each beginning with the last one of the part before, of about BLOCK rows."""
    first = 0
    while first < len(stops) - 1:
        last = int(np.searchsorted(stops, stops[first] + BLOCK_ROWS, side="right")) - 1
        last = min(max(last, first + 1), len(stops) - 1)  # a stretch longer than a block is not divided
        yield stops[first : last + 1]
        first = last


def _bound_lever(arm: UrdfKinematics, bodies: list[CoalBody], rows: Array) -> float:
    """m, twice a bound on how far any point of the moving bodies is from any axis, over all rows."""
    rides = bool(arm.list_moving_joints(arm.workpiece_placement))
    size = max((compute_reach(b) for b in bodies if b.link >= 0 or arm.list_moving_joints(b.carrier)), default=0.0)
    length = 0.0
    for start in range(0, len(rows), BLOCK_ROWS):
        some = rows[start : start + BLOCK_ROWS]
        origins = arm.compute_placements(some[:, :6], some[:, 6:])[:, : None if rides else -1, :3, 3]
        length = max(length, float(np.linalg.norm(origins - origins[:, :1], axis=-1).max()))
    return 2.0 * (length + size)


class PlacedBodies:
    """Bodies and where they are in each row of joint positions (M, 6 + E) rad or m, arm joints first."""

    def __init__(self, arm: UrdfKinematics, bodies: list[CoalBody], rows: Array, lever: float | None = None) -> None:
        self.arm, self.rows, self.bodies = arm, rows, bodies
        self.world = arm.compute_placements(rows[:, :6], rows[:, 6:])
        # m, no point of the robot is farther from any axis; of the whole motion where the rows are a part of one
        self.lever = _bound_lever(arm, bodies, rows) if lever is None else lever
        # a slide by d moves points as a turn by d over the lever would, and bends no path by more than that does
        self.turn = np.abs(np.diff(rows, axis=0)) @ (arm.total_rotation / np.where(arm.slides, self.lever, 1.0))
        self._turned = np.append(0.0, np.cumsum(self.turn))
        self._relative: dict[tuple[int, int], Array] = {}
        self._gone: dict[tuple[int, int], Array] = {}

    def compute_relative_motion(self, a: CoalBody, b: CoalBody) -> Array:
        """Return (M, 4, 4) poses of b's carrier in a's carrier.

        Args:
            a: The first body.
            b: The second body.
        """
        key = (a.carrier, b.carrier)
        if key not in self._relative:
            self._relative[key] = _compute_relative_poses(self.world, a.carrier, b.carrier, np.arange(len(self.world)))
        return self._relative[key]

    def find_contact_rows(self, a: CoalBody, b: CoalBody, stops: NDArray[np.int64], is_requested: Bools) -> list[int]:
        """Return the rows, one for each stretch, in which a and b touch or between which and the next row they do.

        Args:
            a: The first body.
            b: The second body.
            stops: Rows at which the stretches begin and end.
            is_requested: Stretches to search.
        """
        clear = bound_sphere_box_distance(a, b, self._get_relative_poses(a, b, stops))
        most = 2.0 * self.lever * np.diff(self._turned[stops])  # twice what the way can be
        if not (is_requested & (clear[1:] + clear[:-1] <= most)).any():
            return []
        T, way = self.compute_relative_motion(a, b), self.compute_travelled_distance(a, b)
        gone = way[stops[1:]] - way[stops[:-1]]
        doubt = is_requested & (clear[1:] + clear[:-1] <= gone)
        ends = np.append(doubt, False) | np.append(False, doubt)
        most = np.maximum(np.append(gone, 0.0), np.append(0.0, gone))
        below, _ = bound_distances(a, b, T[stops], np.flatnonzero(ends), claim=most)
        doubt &= below[1:] + below[:-1] <= gone
        chase = _PairContactSearch(self, a, b, T, way)
        hits = []
        for k in np.flatnonzero(doubt):
            row = chase.search_stretch(int(stops[k]), int(stops[k + 1]))
            if row >= 0:
                hits.append(row)
        return hits

    def _get_relative_poses(self, a: CoalBody, b: CoalBody, rows: NDArray[np.int64]) -> Array:
        """(K, 4, 4) b's carrier seen from a's in some rows: few of the many, and most pairs ask for no more."""
        if (a.carrier, b.carrier) in self._relative:
            return self._relative[a.carrier, b.carrier][rows]
        return np.asarray(_compute_relative_poses(self.world, a.carrier, b.carrier, rows))

    def compute_travelled_distance(self, a: CoalBody, b: CoalBody) -> Array:
        """Return (M,) the sum of :meth:`compute_step_motion` up to each row, m.

        Args:
            a: The first body.
            b: The second body.
        """
        key = (a.carrier, id(b))
        if key not in self._gone:
            self._gone[key] = np.append(0.0, np.cumsum(self.compute_step_motion(b, self.compute_relative_motion(a, b))))
        return self._gone[key]

    def compute_step_motion(self, b: CoalBody, T: Array) -> Array:
        """Return (M − 1,) an upper bound of |x(t) − x(start)| + |x(end) − x(t)| over all points x of b, m.

        The chord, of the centre and by rotation, and what the path bends off it: a point's second derivative is at
        most (Σ|Δq|)² times the longest lever L (|Δ|/L of a slide: its product with a turn is 2 |Δ| |Δq|, with a slide
        nothing), the bend therefore an eighth of that, there and back a quarter.

        Args:
            b: The body.
            T: (M, 4, 4) poses of b's carrier.
        """
        chord = _compute_chords(T, b.place[:3, :3] @ b.box_centre + b.place[:3, 3], float(np.linalg.norm(b.half_size)))
        bend: Array = chord + self.turn**2 * self.lever / 4.0
        return bend


@jit_compile
def _compute_relative_poses(world: Array, a: int, b: int, rows: NDArray[np.int64]) -> Array:
    """(K, 4, 4) frame b seen from frame a, −1 the world, in some rows of ``world`` (M, F, 4, 4)."""
    out, hall = np.zeros((len(rows), 4, 4)), np.eye(4)
    for n in range(len(rows)):
        T = world[rows[n], b] if b >= 0 else hall
        if a < 0:
            for i in range(4):
                for j in range(4):
                    out[n, i, j] = T[i, j]
            continue
        S = world[rows[n], a]
        for i in range(3):
            for j in range(3):
                out[n, i, j] = S[0, i] * T[0, j] + S[1, i] * T[1, j] + S[2, i] * T[2, j]
                out[n, i, 3] += S[j, i] * (T[j, 3] - S[j, 3])
        out[n, 3, 3] = 1.0
    return out


@jit_compile
def _compute_chords(T: Array, centre: Array, radius: float) -> Array:
    """(M − 1,) m by which a ball that T (M, 4, 4) carries moves from row to row at most, along the chord."""
    out = np.empty(max(len(T) - 1, 0))
    for n in range(len(out)):
        trace, way = -1.0, 0.0
        for i in range(3):
            step = T[n + 1, i, 3] - T[n, i, 3]
            for j in range(3):
                trace += T[n, i, j] * T[n + 1, i, j]
                step += (T[n + 1, i, j] - T[n, i, j]) * centre[j]
            way += step * step
        out[n] = np.sqrt(way) + radius * np.arccos(min(max(trace / 2.0, -1.0), 1.0))
    return out


@dataclass
class _PairContactSearch:
    """Looks for the contact of one pair in a stretch."""

    scene: PlacedBodies
    a: CoalBody
    b: CoalBody
    T: Array  # (M, 4, 4) b's carrier seen from a's
    way: Array  # (M,) m, cumulative motion

    def __post_init__(self) -> None:
        self._seen: dict[int, bool] = {}

    def search_stretch(self, first: int, last: int) -> int:
        """Return the row of a contact within a stretch; −1 if there is none.

        Args:
            first: First row of the stretch.
            last: Last row of the stretch.
        """
        for row in (first, last):
            if row not in self._seen:
                self._seen[row] = self._is_near(self.T[row], 0.0)
            if self._seen[row]:
                return row
        way = float(self.way[last] - self.way[first])
        if not self._is_near(self.T[first], way / 2) and not self._is_near(self.T[last], way / 2):
            return -1
        if last - first > 1:
            middle = (first + last) // 2
            row = self.search_stretch(first, middle)
            return row if row >= 0 else self.search_stretch(middle, last)
        ends = self.scene.rows[first], self.scene.rows[last]
        return first if self._search_between(*ends, self.T[first], self.T[last], way) else -1

    def _search_between(self, qa: Array, qb: Array, Ta: Array, Tb: Array, way: float) -> bool:
        if way < MIN_MOTION_M or not (self._is_near(Ta, way / 2) or self._is_near(Tb, way / 2)):
            return False
        q = 0.5 * (qa + qb)
        world = self.scene.arm.compute_placements(q[None, :6], q[None, 6:])[0]
        T = world[self.b.carrier] if self.b.carrier >= 0 else np.eye(4)
        if self.a.carrier >= 0:
            T = invert_transforms(world[self.a.carrier]) @ T
        if self._is_near(T, 0.0):
            return True
        return self._search_between(qa, q, Ta, T, 0.5 * way) or self._search_between(q, qb, T, Tb, 0.5 * way)

    def _is_near(self, T: Array, margin: float) -> bool:
        """b, carried by T, is within ``margin`` of a."""
        return is_near(self.a, self.b, T, margin)


def _select_stop_rows(rows: Array, fast: Bools) -> NDArray[np.int64]:
    """Rows STEP apart in the joint that moves farthest, and those where free moves begin and end."""
    gone = np.append(0.0, np.cumsum(_compute_steps(rows)))
    keep = np.append(True, np.diff(np.floor(gone / MAX_JOINT_STEP_RAD)) > 0)
    keep[:-1] |= fast[1:] != fast[:-1]
    keep[[0, -1]] = True
    stops = np.flatnonzero(keep)
    long = np.flatnonzero(np.diff(stops) > BLOCK_ROWS)  # where the arm hardly moves
    between = [np.arange(stops[k] + BLOCK_ROWS, stops[k + 1], BLOCK_ROWS) for k in long]
    return np.sort(np.concatenate([stops, *between])) if between else stops
