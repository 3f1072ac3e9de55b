"""Nearest pair of bodies and its distance at every row of a long path, on all cores.

The pair with the least bounds is processed first. A row needs a distance only where neither the spheres' bound nor
the distance known from an earlier row proves that another pair is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.collision.bounding_box_tree import BoxTreeMesh
from machopt.collision.distance_bounds import BodyPairs, MotionRows
from machopt.collision.fcl_distance import FclSurfaces
from machopt.collision.mesh_distance import compute_distances_along_rows
from machopt.numerics.array_types import Array, Bools
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform

MAX_DISTANCE_M = 0.5  # m, largest measured distance
BLOCK_ROWS = 4096  # rows of one task, independent of the number of cores, so that the result is too
MIN_BLOCK_ROWS = 256
MEASURED_ROW_INTERVAL = 32  # rows between those at which every near pair is measured
ROUNDING_M = 1e-9  # m, rounding error of sums of motions


@dataclass(frozen=True)
class NearestPairs:
    """Least distance over all pairs."""

    distance: Array  # (S,) m; 0 in contact, capped at ``cap``
    pair: NDArray[np.int32]  # (S,) index of the pair, −1 where everything is beyond the cap


def find_nearest_pairs(
    stack: BodyPairs,
    surfaces: FclSurfaces,
    meshes: list[BoxTreeMesh],
    q: Array,
    requested: Bools,
    cap: float = MAX_DISTANCE_M,
) -> NearestPairs:
    """Return the least distance over all pairs at each row, and its pair; 0 in contact.

    Args:
        stack: the pairs.
        surfaces: fcl meshes of the bodies.
        meshes: box trees of the same bodies.
        q: (S, n) θ, fastest where neighbouring rows are neighbouring poses.
        requested: (S, P) which pairs count in which rows.
        cap: m, distances above it are not measured.
    """
    size = min(BLOCK_ROWS, max(MIN_BLOCK_ROWS, len(q) // 4))
    starts = range(0, len(q), size)

    def block(start: int) -> tuple[Array, NDArray[np.int32]]:
        some = slice(start, start + size)
        return _find_nearest_in_block(stack, surfaces, meshes, q[some], requested[some], cap)

    found = map_in_threads(block, starts)
    if not found:
        return NearestPairs(np.empty(0), np.empty(0, np.int32))
    return NearestPairs(np.concatenate([d for d, _ in found]), np.concatenate([p for _, p in found]))


def _find_nearest_in_block(
    stack: BodyPairs, surfaces: FclSurfaces, meshes: list[BoxTreeMesh], q: Array, requested: Bools, cap: float
) -> tuple[Array, NDArray[np.int32]]:
    rows = MotionRows(stack, q)
    best, which = np.full(len(q), cap), np.full(len(q), -1, np.int32)
    bound = np.where(requested, rows.bound, np.inf)
    least = _tighten_bound(_PairDistances(stack, surfaces, meshes, rows), bound, cap)
    for p in np.argsort(np.median(bound, axis=0), kind="stable").tolist():
        most = np.minimum(best, least)
        if (bound[:, p] < most).any():
            d = _PairDistances(stack, surfaces, meshes, rows).measure_rows(p, np.arange(len(q)), bound[:, p], most)[0]
            nearer = d < best
            best[nearer], which[nearer] = d[nearer], p
    return best, which


def _tighten_bound(measure: _PairDistances, bound: Array, cap: float) -> Array:
    """Return (S,) m, an upper bound of the least distance, from every MEASURED_ROW_INTERVAL-th row.

    ``bound`` (S, P) below is raised in place. No distance changes by more than the bodies move.
    """
    count = len(bound)
    stations = np.unique(np.append(np.arange(0, count, MEASURED_ROW_INTERVAL), count - 1))
    least = np.full(count, cap)
    every = np.arange(count)
    for p in np.argsort(np.median(bound, axis=0), kind="stable").tolist():
        if not (bound[stations, p] < least[stations]).any():
            continue
        d, way, sound = measure.measure_rows(p, stations, bound[:, p], least)
        known = np.flatnonzero(np.isfinite(d))
        if not len(known) or not sound:
            continue
        nth = np.searchsorted(known, every)
        for near in (known[np.minimum(nth, len(known) - 1)], known[np.maximum(nth - 1, 0)]):
            motion = np.abs(way - way[near]) + ROUNDING_M
            wanted = np.isfinite(bound[:, p])
            bound[:, p] = np.where(wanted, np.maximum(bound[:, p], d[near] - motion), np.inf)
            least = np.where(wanted, np.minimum(least, d[near] + motion), least)
    return least


@dataclass(frozen=True)
class _PairDistances:
    stack: BodyPairs
    surfaces: FclSurfaces
    meshes: list[BoxTreeMesh]
    rows: MotionRows

    def measure_rows(self, p: int, rows: NDArray[np.intp], bound: Array, most: Array) -> tuple[Array, Array, bool]:
        """Return distances of a pair at some rows, where they can be below ``most``.

        Args:
            p: index of the pair.
            rows: rows to measure.
            bound: (S,) m, known lower bound of the distance.
            most: (S,) m, larger distances are not needed.

        Returns:
            (S,) m, infinite where not measured; (S,) m of motion, no point of one body moves relative to the other by
            more
            than the difference of two of them; whether the bodies are outside each other in all of these rows.
        """
        (i, j), (low, high), T = self.stack.index[p], self.stack.links[p], self.rows.compute_relative_motion(p)
        order = rows[bound[rows] < most[rows]]
        if high - low == 1:  # moved by one joint alone: rows with neighbouring values of it are neighbours
            angle = self.rows.q[:, low]
            order = order[np.argsort(angle[order], kind="stable")]
            way = angle * self.stack.compute_lever(p)
        else:
            way = np.append(0.0, np.cumsum(self.rows.bound_motion(p)))
        still, moving, motion = self.meshes[i], self.meshes[j], T
        if len(still.corners) < len(moving.corners):  # the smaller one is moved, at every row
            still, moving, motion = moving, still, invert_transform(T)
        d, fresh = compute_distances_along_rows(
            still.corners,
            still.normals,
            still.low,
            still.high,
            still.child,
            still.first,
            still.count,
            still.order,
            moving.corners,
            moving.normals,
            moving.child,
            moving.first,
            moving.count,
            moving.order,
            order,
            np.ascontiguousarray(motion),
            way,
            bound,
            most,
        )
        if self.surfaces.find_contained((i, j), T[fresh & (d > 0.0)]).any():
            within = self.surfaces.find_contained((i, j), T[order])
            for n, is_inside in zip(order.tolist(), within.tolist(), strict=True):
                # the distance of the surfaces proves nothing for the rows between
                d[n] = 0.0 if is_inside else max(self.surfaces.compute_distance((i, j), T[n]), 0.0)
            return d, way, False
        return d, way, True
