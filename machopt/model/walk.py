"""How near two bodies come along a motion: measured where it may matter, elsewhere bounded by how far they moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.arrays import Array
from machopt.model.bounds import Memory, Rows
from machopt.model.boxes import Mesh
from machopt.model.surfaces import Surfaces
from machopt.model.triangles import distance
from machopt.se3 import inverse

FINE = 1e-4  # m, motion below which a segment between two free rows is not halved any more


def too_near(distance: float, clearance: float) -> bool:
    """Both in m; surfaces that meet are too near whatever the clearance."""
    return distance <= 0.0 or distance < clearance


@dataclass(kw_only=True)
class Walk:
    """One pair followed along the rows: an exact distance and how far the bodies have moved since."""

    rows: Rows
    p: int  # of the pair
    pair: tuple[int, int]  # of its bodies
    meshes: tuple[Mesh, Mesh]  # the same two
    clearance: float  # m
    surfaces: Surfaces
    memory: Memory | None
    last: int = -1
    known: float = 0.0  # m, exact distance at row ``last``

    def __post_init__(self) -> None:
        travel = self.rows.travel(self.p)
        self._travel: list[float] = travel.tolist()  # asked for once a row: Python's own numbers are read quickest
        self._way: list[float] = np.append(0.0, np.cumsum(travel)).tolist()
        self._near = 0, 0  # triangles, one of each body

    def moved(self, n: int) -> float:
        """m, bound on the relative motion between row ``last`` and row n."""
        return abs(self._way[n] - self._way[self.last])

    def bound(self, n: int) -> float:
        """m, what is known of the distance at row n without measuring it."""
        since = -np.inf if self.last < 0 else self.known - self.moved(n)
        if self.memory is None or since > self.clearance:
            return since
        return max(since, self.memory.bound(self.rows.q[n]))

    def distance(self, n: int) -> float:
        """Exact distance (m) at row n; 0 where one body is inside the other."""
        if n != self.last:
            T = self.rows.relative(self.p)[n]
            d = self._measured(T)
            # Surfaces apart by more than the way since a row known to be outside cannot have been crossed.
            fresh = self.last < 0 or self.known <= 0.0 or max(d, self.known) <= self.moved(n)
            if d > 0.0 and fresh and self.surfaces.contained(self.pair, T):
                d = 0.0
            self.last, self.known = n, d
            if self.memory is not None and d > self.clearance:
                self.memory.add(self.rows.q[n], d)
        return self.known

    def _measured(self, T: Array) -> float:
        """m between the surfaces with the second body moved by T (4, 4); what is too near is so by fcl's word."""
        d, self._near = distance(*self.meshes, T, self._near)
        return self.surfaces.distance(self.pair, T) if too_near(d, self.clearance) else d

    def hits(self, n: int) -> bool:
        return too_near(self.distance(n), self.clearance)

    def motion(self, m: int) -> float:
        """Fractional row of a contact in row m or on the way to it, NaN if free."""
        if m == 0:
            return 0.0 if self.hits(0) else np.nan
        way = self._travel[m - 1]
        if not too_near(self.bound(m - 1) - way, self.clearance):
            return np.nan
        before = self.distance(m - 1)
        if too_near(before, self.clearance):
            return m - 1.0
        if before - way >= self.clearance:
            return np.nan
        after = self.distance(m)
        if too_near(after, self.clearance):
            return float(m)
        inner = self._between(self.rows.q[m - 1], self.rows.q[m], before, after, way)
        return m - 1.0 + inner

    def _between(self, qa: Array, qb: Array, da: float, db: float, way: float) -> float:
        """Fraction of the way from qa to qb where a contact is, NaN if there is none."""
        if way < FINE or da + db - 2.0 * self.clearance >= way:
            return np.nan
        middle = 0.5 * (qa + qb)
        i, j = self.rows.pairs.links[self.p]
        poses = self.rows.pairs.lines.link_poses(middle)
        d = self._measured(inverse(poses[i]) @ poses[j])
        if too_near(d, self.clearance):
            return 0.5
        # The bound is a sum over joints of |Δq| times the lever, so half the joint step is half the bound.
        inner = 0.5 * self._between(qa, middle, da, d, 0.5 * way)
        return inner if not np.isnan(inner) else 0.5 + 0.5 * self._between(middle, qb, d, db, 0.5 * way)
