"""Penetration depth of a cutter in the part: largest distance of its surface points from the part's surface, from
inside.

The depth of a point inside a solid is its distance from the nearest place of the surface; of several bodies the
deepest counts. Boxes, cylinders and spheres are exact, meshes use their triangles.

From row to row a point moves little. A point found outside by d cannot be deeper than the limit before it has
moved by d plus the limit. A point inside by d is not deeper than d plus its motion since. Most points of a path are
therefore checked once in many rows. The deepest one of the previous row is checked first, and most others cannot be
deeper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.collision.bodies import is_closed_surface, triangulate_shape
from machopt.collision.bounding_box_tree import BoxTreeMesh, build_box_tree_of_triangles
from machopt.data_types.cell import CollisionShape, CutterGeometry
from machopt.errors import MeshError
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform

BLOCK_ROWS = 256  # rows of one task, independent of the number of cores
MAX_TREE_DEPTH = 128  # stack size of the tree traversal
MIN_SPACING_M, MAX_SPACING_M = 5e-4, 3e-3  # m between points of the cutter's surface; between, a quarter of its radius
CHORD_TOLERANCE_M = 2e-5  # m, maximum underestimate of a depth between two points of a ring, like the path tolerance
GOLDEN_RATIO = (
    np.sqrt(5.0) - 1.0
) / 2.0  # rotation from ring to ring, as a share of a step: a few rings cover the step evenly
RING_POINT_LIMITS = 24, 96  # fewest and most points of a circle
SPIRAL_SPACING_M = (
    3e-4,
    1.2e-3,
)  # m between points of the spiral, a ninth of the radius in between, for thin features between rings
ROUNDING_M = 1e-12  # m
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))  # rad from one point of it to the next
PROFILE_SAMPLES = 4001  # samples along the profile of the spiral
# Directions that avoid typical edge directions of CAM files: the majority of three decides whether a point is inside.
RAY_DIRECTIONS = np.array([[0.5381, 0.3127, 0.7827], [-0.2911, 0.8713, -0.3951], [0.7219, -0.6037, 0.3389]])


@dataclass(frozen=True)
class GougeDepth:
    """The cutter's deepest point at each of M poses."""

    depth: Array  # (M,) m; 0 where it is not deeper than the limit
    place: Array  # (M, 3) m, in the frame of the part; NaN where it is not


def build_cutter_points(cutter: CutterGeometry) -> Array:
    """Return (K, 3) m, points of the cutter's surface in the TCP frame: tip, corner and side, rings along the axis.

    Args:
        cutter: dimensions of the cutter.
    """
    radius, corner = cutter.diameter / 2.0, min(cutter.corner, cutter.diameter / 2.0)
    step = float(np.clip(radius / 4.0, MIN_SPACING_M, MAX_SPACING_M))
    flat = np.linspace(0.0, radius - corner, int(np.ceil((radius - corner) / step)) + 1)
    turn = np.linspace(0.0, np.pi / 2, int(np.ceil(corner * np.pi / 2 / step)) + 1)[1:]
    side = np.linspace(corner, cutter.length, max(int(np.ceil((cutter.length - corner) / step)), 1) + 1)[1:]
    profile = [(r, 0.0) for r in flat]
    profile += [(radius - corner + corner * np.sin(t), corner * (1.0 - np.cos(t))) for t in turn]
    profile += [(radius, h) for h in side]
    out = []
    for n, (r, height) in enumerate(profile):
        count = _count_ring_points(r, step) if r > 0.0 else 1
        # Each ring is rotated relative to the previous one, so that no wall lies between the points of all of them.
        angle = 2.0 * np.pi * (np.arange(count) + (n - len(flat) + 1) * GOLDEN_RATIO % 1.0) / count
        out.append(np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(count, -height)]))
    return np.concatenate(out)


def build_spiral_points(cutter: CutterGeometry) -> Array:
    """Return (K, 3) m, even points of the cutter's surface on a spiral from the tip up, for features between the rings.

    Args:
        cutter: dimensions of the cutter.
    """
    radius, corner, length = cutter.diameter / 2.0, min(cutter.corner, cutter.diameter / 2.0), cutter.length
    step = float(np.clip(radius / 9.0, *SPIRAL_SPACING_M))
    flat, bend = radius - corner, corner * np.pi / 2.0
    along = np.linspace(0.0, flat + bend + length - corner, PROFILE_SAMPLES)
    turn = np.clip((along - flat) / max(corner, 1e-12), 0.0, np.pi / 2.0)
    out = np.minimum(along, flat) + corner * np.sin(turn)
    up = corner * (1.0 - np.cos(turn)) + np.maximum(along - flat - bend, 0.0)
    area = np.append(0.0, np.cumsum(np.pi * (out[1:] + out[:-1]) * np.diff(along)))
    count = int(np.ceil(area[-1] / step**2))
    at, angle = np.interp((np.arange(count) + 0.5) / count * area[-1], area, along), GOLDEN_ANGLE * np.arange(count)
    r = np.interp(at, along, out)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), -np.interp(at, along, up)])


def _count_ring_points(radius: float, step: float) -> int:
    """Return the number of points of a ring: at most ``step`` apart, with a sagitta of at most CHORD_TOLERANCE_M."""
    shallow = np.pi / np.arccos(max(1.0 - CHORD_TOLERANCE_M / radius, 0.0))
    return int(np.clip(np.ceil(max(2.0 * np.pi * radius / step, shallow)), *RING_POINT_LIMITS))


def compute_gouge_depth(
    shapes: tuple[CollisionShape, ...], points: Array, T_part_tool: Array, limit: float, between: Array | None = None
) -> GougeDepth:
    """Return the places where the points penetrate the part deeper than ``limit``.

    Args:
        shapes: closed bodies of the part, in its frame.
        points: (K, 3) m, on the tool.
        T_part_tool: (M, 4, 4), fastest where neighbouring rows are neighbouring poses.
        limit: m.
        between: (B, 3) m, additional points, checked only where the nearest of the first is near to the surface.

    Raises:
        InputError: a mesh is open, so nothing is inside it.
    """
    led = _GuidedPoints.build(points, np.zeros((0, 3)) if between is None else between)
    rows = np.ascontiguousarray(T_part_tool, float)
    best, place = np.zeros(len(rows)), np.full((len(rows), 3), np.nan)
    for shape in shapes:
        seen = invert_transform(shape.T_parent_shape) @ rows
        depth, k = (
            _compute_depth_in_mesh(shape, led, seen, limit)
            if shape.kind == "mesh"
            else _compute_depth_in_solid(shape, led.points, seen)
        )
        more = (depth > limit) & (depth > best)
        best[more] = depth[more]
        at = rows[more]
        place[more] = np.einsum("mij,mj->mi", at[:, :3, :3], led.points[k[more]]) + at[:, :3, 3]
    return GougeDepth(best, place)


@dataclass(frozen=True)
class _GuidedPoints:
    """Points, some of which are checked only where their leading point is near to the surface."""

    points: Array  # (K, 3) m, leading points first
    leader: Ints  # (K,) leading point, −1 for none
    leader_distance: Array  # (K,) m, how far the leader is

    @classmethod
    def build(cls, leaders: Array, others: Array) -> _GuidedPoints:
        """Assign each other point its nearest leading point.

        Args:
            leaders: (K, 3) m.
            others: (L, 3) m.
        """
        from scipy.spatial import cKDTree  # imported here: not available where a wheel is built

        leader_distance, leader = (
            cKDTree(leaders).query(others) if len(others) else (np.zeros(0), np.zeros(0, np.int64))
        )
        n = len(leaders)
        return cls(
            np.ascontiguousarray(np.concatenate([leaders, others])),
            np.concatenate([np.full(n, -1, np.int64), leader.astype(np.int64)]),
            np.concatenate([np.zeros(n), leader_distance]),
        )


def _compute_depth_in_solid(shape: CollisionShape, points: Array, T: Array) -> tuple[Array, Ints]:
    """Return (M,) greatest depth in m in a box, cylinder or sphere, negative outside, and (M,) the point that has
    it.
    """
    depth, which = np.empty(len(T)), np.empty(len(T), np.int64)
    for start in range(0, len(T), BLOCK_ROWS):
        some = T[start : start + BLOCK_ROWS]
        x = np.einsum("mij,kj->mki", some[:, :3, :3], points) + some[:, None, :3, 3]
        if shape.kind == "box":
            d = (np.array(shape.size) / 2.0 - np.abs(x)).min(axis=-1)
        elif shape.kind == "cylinder":
            d = np.minimum(shape.size[0] - np.hypot(x[..., 0], x[..., 1]), shape.size[1] / 2.0 - np.abs(x[..., 2]))
        else:
            d = shape.size[0] - np.linalg.norm(x, axis=-1)
        k = d.argmax(axis=1)
        depth[start : start + BLOCK_ROWS], which[start : start + BLOCK_ROWS] = d[np.arange(len(k)), k], k
    return depth, which


def _compute_depth_in_mesh(shape: CollisionShape, led: _GuidedPoints, T: Array, limit: float) -> tuple[Array, Ints]:
    vertices, faces = triangulate_shape(shape)
    if not is_closed_surface(faces):
        raise MeshError(
            f"mesh of {shape.name!r} is open, so nothing is inside it and no gouge can be seen; a closed surface of "
            "the finished part would work, or no gouge_tolerance_mm",
            file=shape.mesh,
        )
    mesh = build_box_tree_of_triangles(vertices, faces)

    def block(start: int) -> tuple[Array, Ints]:
        some = T[start : start + BLOCK_ROWS]
        return _compute_row_depths(
            led.points, led.leader, led.leader_distance, some, *_list_mesh_arrays(mesh), RAY_DIRECTIONS, limit
        )

    found = map_in_threads(block, range(0, len(T), BLOCK_ROWS))
    none = np.zeros(0), np.zeros(0, np.int64)
    depths, which = zip(none, *found, strict=True)
    return np.concatenate(depths), np.concatenate(which)


def _list_mesh_arrays(mesh: BoxTreeMesh) -> tuple[Array, Array, Array, Ints, Ints, Ints, Ints]:
    return mesh.corners, mesh.low, mesh.high, mesh.child, mesh.first, mesh.count, mesh.order


@jit_compile
def _place_point(T: Array, point: Array, last: Array, x: Array) -> float:
    """Write a point in the system of the part to ``x``; returns the square of its motion since ``last``, m²."""
    square = 0.0
    for c in range(3):
        x[c] = T[c, 0] * point[0] + T[c, 1] * point[1] + T[c, 2] * point[2] + T[c, 3]
        square += (x[c] - last[c]) ** 2
    return square


@jit_compile
def _compare_known_depth(
    x: Array, moved: float, deep: float, triangle: Array, deepest: float, is_later: bool
) -> tuple[bool, bool]:
    """Return whether a point that was inside at the depth ``deep`` cannot be the deepest, and whether it still is
    inside.

    Its motion bounds the depth, and so does the triangle that was nearest.
    """
    if deep + moved < deepest - ROUNDING_M:
        return True, False
    most = np.sqrt(_compute_triangle_distance(x, triangle))
    if most < deepest or (most == deepest and is_later):
        return True, False
    return False, moved < deep - ROUNDING_M


@jit_compile
def _is_inside_mesh(
    x: Array,
    rays: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    waiting: Ints,
) -> bool:
    """Return whether most of three rays cross the mesh an odd number of times."""
    votes = 0
    for r in range(3):
        votes += _count_ray_crossings(x, rays[r], corners, low, high, child, first, count, order, waiting) % 2
    return votes >= 2


@jit_compile
def _compute_row_depths(
    points: Array,
    leader: Ints,
    leader_distance: Array,
    T: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    rays: Array,
    limit: float,
) -> tuple[Array, Ints]:
    """Return (M,) greatest depth in m above ``limit``, else 0, and (M,) its point; rows T (M, 4, 4) of a mesh."""
    depth, which = np.zeros(len(T)), np.zeros(len(T), np.int64)
    # m, motion of a point before it must be checked again, and its place then
    room, last = np.zeros(len(points)), np.zeros((len(points), 3))
    left = np.zeros(len(points))  # m, distance from the part in this row
    deep = np.full(len(points), -1.0)  # m, last known depth; negative outside
    near = np.full(len(points), order[0])  # nearest triangle at that time
    waiting, gaps, x = np.empty(MAX_TREE_DEPTH, np.int64), np.empty(MAX_TREE_DEPTH), np.empty(3)
    for m in range(len(T)):
        begin = -1 if m > 0 and depth[m - 1] > 0.0 else 0
        for n in range(begin, len(points)):
            # the deepest point of the previous row first: most others are known to be less deep
            k = which[m - 1] if n < 0 else n
            if begin < 0 and n == which[m - 1]:
                continue
            if leader[k] >= 0 and n >= 0 and left[leader[k]] > leader_distance[k]:
                continue
            square = _place_point(T[m], points[k], last[k], x)
            if m > 0 and square < room[k] * room[k]:
                left[k] = room[k] - np.sqrt(square) if left[k] > 0.0 else 0.0
                continue
            inside = False
            if deep[k] > 0.0:
                is_later, nearest = k > which[m], corners[near[k]]
                less, inside = _compare_known_depth(x, np.sqrt(square), deep[k], nearest, depth[m], is_later)
                if less:
                    continue
            square, near[k] = _find_nearest_triangle(
                x, corners, low, high, child, first, count, order, limit * limit, waiting, gaps, near[k]
            )
            d = np.sqrt(square)
            left[k], deep[k] = 0.0, -1.0
            for c in range(3):
                last[k, c] = x[c]
            if d <= limit:
                room[k] = max(limit - d - ROUNDING_M, 0.0)
                continue
            if not (inside or _is_inside_mesh(x, rays, corners, low, high, child, first, count, order, waiting)):
                room[k] = d + limit
                left[k] = room[k]
                continue
            room[k], deep[k] = 0.0, d
            if d > depth[m] or (d == depth[m] and k < which[m]):
                depth[m], which[m] = d, k
    return depth, which


@jit_compile
def _compute_box_distance(x: Array, low: Array, high: Array, k: int) -> float:
    """m² from a point to a box."""
    gap = 0.0
    for c in range(3):
        off = max(low[k, c] - x[c], x[c] - high[k, c], 0.0)
        gap += off * off
    return float(gap)


@jit_compile
def _find_nearest_triangle(
    x: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    enough: float,
    waiting: Ints,
    gaps: Array,
    guess: int,
) -> tuple[float, int]:
    """Return m² to the nearest triangle and its index; any distance below ``enough`` suffices, ``guess`` is tried
    first.
    """
    best, found = _compute_triangle_distance(x, corners[guess]), guess
    if best <= enough:
        return best, found
    waiting[0], gaps[0], depth = 0, _compute_box_distance(x, low, high, 0), 1
    while depth:
        depth -= 1
        k = waiting[depth]
        if gaps[depth] >= best:
            continue
        if child[k] < 0:
            for s in range(first[k], first[k] + count[k]):
                square = _compute_triangle_distance(x, corners[order[s]])
                if square < best:
                    best, found = square, order[s]
            if best <= enough:
                return best, found
            continue
        k1, k2 = child[k], child[k] + 1
        g1, g2 = _compute_box_distance(x, low, high, k1), _compute_box_distance(x, low, high, k2)
        if g1 < g2:  # the nearer one is examined first
            k1, k2, g1, g2 = k2, k1, g2, g1
        waiting[depth], gaps[depth], waiting[depth + 1], gaps[depth + 1] = k1, g1, k2, g2
        depth += 2
    return best, found


@jit_compile
def _compute_triangle_distance(p: Array, A: Array) -> float:
    """m² from a point to a triangle (Ericson 2005, section 5.1.5)."""
    u0, u1, u2 = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1], A[1, 2] - A[0, 2]
    v0, v1, v2 = A[2, 0] - A[0, 0], A[2, 1] - A[0, 1], A[2, 2] - A[0, 2]
    w0, w1, w2 = p[0] - A[0, 0], p[1] - A[0, 1], p[2] - A[0, 2]
    d1, d2 = u0 * w0 + u1 * w1 + u2 * w2, v0 * w0 + v1 * w1 + v2 * w2
    if d1 <= 0.0 and d2 <= 0.0:
        return float(w0 * w0 + w1 * w1 + w2 * w2)
    uu, uv, vv = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    d3, d4 = d1 - uu, d2 - uv
    d5, d6 = d1 - uv, d2 - vv
    s, t = 0.0, 0.0
    a, b, c = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d3 >= 0.0 and d4 <= d3:
        s = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        t = 1.0
    elif c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s = d1 / (d1 - d3) if d1 > d3 else 0.0
    elif b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6) if d2 > d6 else 0.0
    elif a <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        size = (d4 - d3) + (d5 - d6)
        t = (d4 - d3) / size if size > 0.0 else 0.0
        s = 1.0 - t
    else:
        size = a + b + c
        s, t = (b / size, c / size) if size > 0.0 else (0.0, 0.0)
    x, y, z = w0 - s * u0 - t * v0, w1 - s * u1 - t * v1, w2 - s * u2 - t * v2
    return float(x * x + y * y + z * z)


@jit_compile
def _count_ray_crossings(
    x: Array,
    ray: Array,
    corners: Array,
    low: Array,
    high: Array,
    child: Ints,
    first: Ints,
    count: Ints,
    order: Ints,
    waiting: Ints,
) -> int:
    """Return how often a ray from a point crosses the surface (Möller and Trumbore 1997)."""
    hits = 0
    waiting[0], depth = 0, 1
    while depth:
        depth -= 1
        k = waiting[depth]
        entry_length, exit_length = 0.0, np.inf
        for c in range(3):
            a, b = (low[k, c] - x[c]) / ray[c], (high[k, c] - x[c]) / ray[c]
            entry_length, exit_length = max(entry_length, min(a, b)), min(exit_length, max(a, b))
        if entry_length > exit_length + 1e-9:
            continue
        if child[k] >= 0:
            waiting[depth], waiting[depth + 1] = child[k], child[k] + 1
            depth += 2
            continue
        for s in range(first[k], first[k] + count[k]):
            A = corners[order[s]]
            u0, u1, u2 = A[1, 0] - A[0, 0], A[1, 1] - A[0, 1], A[1, 2] - A[0, 2]
            v0, v1, v2 = A[2, 0] - A[0, 0], A[2, 1] - A[0, 1], A[2, 2] - A[0, 2]
            p0, p1, p2 = ray[1] * v2 - ray[2] * v1, ray[2] * v0 - ray[0] * v2, ray[0] * v1 - ray[1] * v0
            det = u0 * p0 + u1 * p1 + u2 * p2
            if det == 0.0:
                continue
            w0, w1, w2 = x[0] - A[0, 0], x[1] - A[0, 1], x[2] - A[0, 2]
            f = (w0 * p0 + w1 * p1 + w2 * p2) / det
            if f < 0.0 or f > 1.0:
                continue
            r0, r1, r2 = w1 * u2 - w2 * u1, w2 * u0 - w0 * u2, w0 * u1 - w1 * u0
            g = (ray[0] * r0 + ray[1] * r1 + ray[2] * r2) / det
            if g < 0.0 or f + g > 1.0:
                continue
            if (v0 * r0 + v1 * r1 + v2 * r2) / det > 0.0:
                hits += 1
    return hits
