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
from machopt.collision.gouge_depth_kernels import compute_row_depths
from machopt.data_types.cell import CollisionShape, CutterGeometry
from machopt.errors import MeshError
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.parallel_map import map_in_threads
from machopt.numerics.rigid_transforms import invert_transform

BLOCK_ROWS = 256  # rows of one task, independent of the number of cores
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
        return compute_row_depths(
            led.points, led.leader, led.leader_distance, some, *_list_mesh_arrays(mesh), RAY_DIRECTIONS, limit
        )

    found = map_in_threads(block, range(0, len(T), BLOCK_ROWS))
    none = np.zeros(0), np.zeros(0, np.int64)
    depths, which = zip(none, *found, strict=True)
    return np.concatenate(depths), np.concatenate(which)


def _list_mesh_arrays(mesh: BoxTreeMesh) -> tuple[Array, Array, Array, Ints, Ints, Ints, Ints]:
    return mesh.corners, mesh.low, mesh.high, mesh.child, mesh.first, mesh.count, mesh.order
