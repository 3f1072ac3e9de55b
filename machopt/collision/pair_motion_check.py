"""Distance of two bodies along a motion: measured where necessary, elsewhere bounded by their relative motion."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bounding_box_tree import BoxTreeMesh
from machopt.collision.distance_bounds import DistanceMemory, MotionRows
from machopt.collision.fcl_distance import FclSurfaces
from machopt.collision.mesh_distance import compute_distance
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.rigid_transforms import invert_transform

ROUNDING_M = 1e-12  # reserve for rounding where rows are skipped
MIN_SEGMENT_MOTION_M = 1e-4  # m, motion below which a segment between two free rows is no longer halved


def is_too_near(distance: float, clearance: float) -> bool:
    """Return whether a distance is below the clearance; surfaces in contact always are.

    Args:
        distance: m.
        clearance: m.
    """
    return distance <= 0.0 or distance < clearance


@dataclass(kw_only=True)
class PairMotionCheck:
    """Check of one pair along the rows: an exact distance and the relative motion since it was measured."""

    rows: MotionRows
    starts: Bools  # (S,) rows that begin another motion
    p: int  # of the pair
    pair: tuple[int, int]  # of its bodies
    meshes: tuple[BoxTreeMesh, BoxTreeMesh]  # the same two
    clearance: float  # m
    surfaces: FclSurfaces
    memory: DistanceMemory | None
    measured_row: int = -1
    known_distance: float = 0.0  # m, exact distance at row ``last``

    def __post_init__(self) -> None:
        travel = self.rows.bound_motion(self.p)
        self._travel: list[float] = travel.tolist()  # read once per row: Python floats are faster
        self._way: list[float] = np.append(0.0, np.cumsum(travel)).tolist()
        self._near = 0, 0  # triangles, one of each body

    def bound_motion(self, n: int) -> float:
        """Return an upper bound of the relative motion in m since the measured row.

        Args:
            n: row.
        """
        return abs(self._way[n] - self._way[self.measured_row])

    def bound_distance(self, n: int) -> float:
        """Return a lower bound of the distance in m at a row, without measuring it.

        Args:
            n: row.
        """
        since = -np.inf if self.measured_row < 0 else self.known_distance - self.bound_motion(n)
        if self.memory is None or since > self.clearance:
            return since
        return max(since, self.memory.bound_distance(self.rows.q[n]))

    def measure_distance(self, n: int) -> float:
        """Return the exact distance in m at a row; 0 where one body is inside the other.

        Args:
            n: row.
        """
        if n != self.measured_row:
            T = self.rows.compute_relative_motion(self.p)[n]
            d = self._measure_surfaces(T)
            # Surfaces farther apart than the motion since a row known to be outside cannot have crossed.
            fresh = (
                self.measured_row < 0
                or self.known_distance <= 0.0
                or max(d, self.known_distance) <= self.bound_motion(n)
            )
            if d > 0.0 and fresh and self.surfaces.is_contained(self.pair, T):
                d = 0.0
            self.measured_row, self.known_distance = n, d
            if self.memory is not None and d > self.clearance:
                self.memory.add_distance(self.rows.q[n], d)
        return self.known_distance

    def _measure_surfaces(self, T: Array) -> float:
        """Return the distance in m of the surfaces with the second body moved by T (4, 4); contacts are confirmed by
        fcl.
        """
        d, self._near = compute_distance(*self.meshes, T, self._near)
        return self.surfaces.compute_distance(self.pair, T) if is_too_near(d, self.clearance) else d

    def is_colliding(self, n: int) -> bool:
        """Return whether the bodies are too near at a row.

        Args:
            n: row.
        """
        return is_too_near(self.measure_distance(n), self.clearance)

    def select_unproven(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return those of some ascending rows that remembered distances do not prove free, with the motion to them.

        Args:
            rows: (n,) rows.
        """
        if self.memory is None or not len(rows):
            return rows
        begins = (rows == 0) | self.starts[rows]
        known = np.where(begins, rows, rows - 1)
        travel = np.append(0.0, self.rows.bound_motion(self.p))[rows]
        needed = self.clearance + ROUNDING_M + np.where(begins, 0.0, travel)
        return rows[~self.memory.find_farther(self.rows.q[known], needed)]

    def list_ways(self, rows: NDArray[np.intp]) -> list[float]:
        """Return the (n,) bound of the relative motion in m from the first row to each of some rows.

        Args:
            rows: (n,) rows.
        """
        return [self._way[m] for m in rows.tolist()]

    def skip_proven(self, ways: list[float], k: int) -> int:
        """Return the next index after ``k`` in some rows whose freedom the last measured distance does not prove.

        Args:
            ways: (n,) result of :meth:`list_ways` for these rows.
            k: index in them.
        """
        if self.measured_row < 0:
            return k + 1
        proven = self._way[self.measured_row] + self.known_distance - self.clearance - ROUNDING_M
        return bisect_left(ways, proven, lo=k + 1)

    def find_first_contact(self, m: int) -> float:
        """Return the fractional row of a contact in a row or on the motion to it, NaN if free.

        Args:
            m: row.
        """
        if m == 0 or self.starts[m]:
            # bounds hold between any two rows, driven or not: those of the motion before hold for this start too
            free = not is_too_near(self.bound_distance(m), self.clearance)
            return np.nan if free or not self.is_colliding(m) else float(m)
        way = self._travel[m - 1]
        if not is_too_near(self.bound_distance(m - 1) - way, self.clearance):
            return np.nan
        before = self.measure_distance(m - 1)
        if is_too_near(before, self.clearance):
            return m - 1.0
        if before - way >= self.clearance:
            return np.nan
        after = self.measure_distance(m)
        if is_too_near(after, self.clearance):
            return float(m)
        inner = self._find_contact_between(self.rows.q[m - 1], self.rows.q[m], before, after, way)
        return m - 1.0 + inner

    def _find_contact_between(self, qa: Array, qb: Array, da: float, db: float, way: float) -> float:
        """Return the fraction of the motion from qa to qb where a contact is, NaN if there is none."""
        if way < MIN_SEGMENT_MOTION_M or da + db - 2.0 * self.clearance >= way:
            return np.nan
        middle = 0.5 * (qa + qb)
        i, j = self.rows.pairs.links[self.p]
        poses = self.rows.pairs.lines.compute_link_poses(middle)
        d = self._measure_surfaces(invert_transform(poses[i]) @ poses[j])
        if is_too_near(d, self.clearance):
            return 0.5
        # The bound is a sum over joints of |Δq| times the lever, so half the joint step is half the bound.
        inner = 0.5 * self._find_contact_between(qa, middle, da, d, 0.5 * way)
        return inner if not np.isnan(inner) else 0.5 + 0.5 * self._find_contact_between(middle, qb, d, db, 0.5 * way)
