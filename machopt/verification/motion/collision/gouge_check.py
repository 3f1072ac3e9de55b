"""Gouge check: penetration of the cutter into the finished part, compared with gouge_tolerance_mm.

Points are spread over the cutter's surface on a spiral. One is inside a mesh when the lines through it along three
axes all cross the surface an odd number of times on one side; it is no deeper than the nearest of these crossings,
which settles most. Of the others coal measures the distance to the surface, those first that may be deepest. The three
axes are turned away from those that parts are drawn along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.plan_options import PlanOptions
from machopt.data_types.toolpath import Toolpath
from machopt.numerics.array_types import Array, Bools, Ints
from machopt.numerics.compiled_functions import jit_compile
from machopt.verification.check_results import VerificationCheck
from machopt.verification.motion.collision.bodies import CoalBody, invert_transforms
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.motion.path_geometry.sample_location import SampleLocations
from machopt.verification.tables.exported_tables import ExportedMotion

SAMPLE_SPACING_M, SAMPLE_SPACING_RAD = 5e-4, np.radians(0.25)  # m and rad between the checked samples
POINT_SPACING_M = 4e-4, 2e-3  # m between points of the cutter, a sixth of its radius in between
GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))  # rad from one point of the spiral to the next
MAX_MEASURED_POINTS = 3_000  # points whose distance coal measures once a gouge is known
BLOCK_ROWS = 64  # samples whose points are worked out at once
GRID_CELLS = 192  # along each side of the grids
# A turn about no axis in particular, by no round angle.
GRID_ROTATION = np.linalg.qr(np.array([[0.81, -0.37, 0.29], [0.43, 0.77, -0.41], [-0.19, 0.53, 0.88]]))[0]


def check_gouges(
    motion: ExportedMotion,
    toolpath: Toolpath,
    locations: SampleLocations,
    arm: UrdfKinematics,
    bodies: list[CoalBody],
    options: PlanOptions,
    shifted: bool,
) -> list[VerificationCheck]:
    """Check that the cutter is never deeper in the workpiece than the tolerance plus path deviations on feed moves.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        locations: Position of each motion sample relative to the toolpath.
        arm: Kinematics of the URDF with the cell's tool.
        bodies: All collision bodies of the cell.
        options: The planning options in force.
        shifted: The path is compensated; the cutter is then where the CAM file has it.
    """
    cutter, parts = arm.cell.tool.cutter, [b for b in bodies if b.kind == "workpiece"]
    if options.gouge is None or cutter is None or not parts:
        return []
    limit = options.gouge + locations.path_limit
    rows = _select_rows(locations.tool, np.flatnonzero(locations.on_feed_move))
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = locations.tool[rows, :3]
    if shifted:
        at = np.clip(motion.point[rows], 0.0, len(toolpath) - 1.0)
        own = np.arange(len(toolpath), dtype=float)
        T[:, :3, 3] -= locations.tcp[rows, :3, 3]
        T[:, :3, 3] += np.column_stack([np.interp(at, own, toolpath.position[:, c]) for c in range(3)])
    points = build_cutter_points(cutter)
    best, row, stated = 0.0, -1, "nowhere deeper than the tolerance"
    for part in parts:
        depth, at_row, x = find_deepest_point(part, points, T, limit)
        if depth > best:
            best, row = depth, int(rows[at_row])
            place = 1e3 * (part.place[:3, :3] @ x + part.place[:3, 3])
            stated = (
                f"in {part.name} at ({place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f}) mm, {motion.describe_row(row)}"
            )
    return [
        VerificationCheck(
            name="gouges", passed=best <= limit, value=1e3 * best, limit=1e3 * limit, unit="mm", where=stated
        )
    ]


def build_cutter_points(cutter: CutterGeometry) -> Array:
    """Return (K, 3) points on the cutter's surface in the TCP frame, m, on a spiral from the tip upwards.

    Args:
        cutter: Shape of the cutter.
    """
    r, c = cutter.diameter / 2.0, min(cutter.corner, cutter.diameter / 2.0)
    flat, arc, side = r - c, c * np.pi / 2.0, cutter.length - c
    step = float(np.clip(r / 6.0, *POINT_SPACING_M))
    edges = np.array([flat, flat + arc, flat + arc + side])  # where the profile bends: rings there are checked too
    fine = np.union1d(np.linspace(0.0, 1.0, 4001) * edges[-1], edges)  # along the profile
    turn = np.clip((fine - flat) / max(c, 1e-12), 0.0, np.pi / 2.0)
    radius = np.minimum(fine, flat) + c * np.sin(turn)
    height = c * (1.0 - np.cos(turn)) + np.maximum(fine - flat - arc, 0.0)
    area = np.append(0.0, np.cumsum(np.pi * (radius[1:] + radius[:-1]) * np.diff(fine)))
    count = int(np.ceil(area[-1] / step**2))
    at = np.concatenate([np.interp((np.arange(count) + 0.5) / count * area[-1], area, fine), np.repeat(edges, 48)])
    angle = np.append(GOLDEN_ANGLE * np.arange(count), np.tile(np.arange(48) * np.pi / 24.0, len(edges)))
    rho, up = np.interp(at, fine, radius), np.interp(at, fine, height)
    return np.ascontiguousarray(np.column_stack([rho * np.cos(angle), rho * np.sin(angle), -up]))


def find_deepest_point(part: CoalBody, points: Array, T: Array, limit: float) -> tuple[float, int, Array]:
    """Return the greatest penetration of points into the part, m; 0 where it does not exceed the limit.

    Args:
        part: The finished part.
        points: (K, 3) points on the cutter, m.
        T: (M, 4, 4) poses of the points' frame in the part's frame.
        limit: Greatest allowed penetration, m.

    Returns:
        Depth, row (−1 if not above the limit) and place (3,) m in the part's frame.
    """
    seen = np.ascontiguousarray(invert_transforms(part.place) @ T)
    kind = type(part.shape).__name__
    none = 0.0, -1, np.full(3, np.nan)
    if not len(T):
        return none
    if not kind.startswith("BVH"):
        depth, at = _compute_depth_in_solid(part.shape, kind, points, seen)
        k = int(depth.argmax())
        return (float(depth[k]), k, at[k]) if depth[k] > limit else none
    most, row, x = _find_points_in_mesh(part, points, seen, limit)
    best, which = limit, -1
    for n, k in enumerate(np.argsort(-most, kind="stable").tolist()):
        if most[k] <= best or (n >= MAX_MEASURED_POINTS and which >= 0):
            break
        d = _measure_distance(part.shape, x[k])
        if d > best:
            best, which = d, k
    return (best, int(row[which]), x[which]) if which >= 0 else none


def _compute_depth_in_solid(shape: object, kind: str, points: Array, T: Array) -> tuple[Array, Array]:
    """The deepest point of each row in a box, cylinder or sphere: (M,) m and (M, 3) m."""
    depth, place = np.empty(len(T)), np.empty((len(T), 3))
    for start in range(0, len(T), BLOCK_ROWS):
        M = T[start : start + BLOCK_ROWS]
        x = points @ np.swapaxes(M[:, :3, :3], 1, 2) + M[:, None, :3, 3]
        if kind == "Box":
            d = (np.asarray(shape.halfSide).ravel() - np.abs(x)).min(axis=2)  # type: ignore[attr-defined]
        elif kind == "Cylinder":
            along = shape.halfLength - np.abs(x[..., 2])  # type: ignore[attr-defined]
            d = np.minimum(shape.radius - np.linalg.norm(x[..., :2], axis=2), along)  # type: ignore[attr-defined]
        else:
            d = shape.radius - np.linalg.norm(x, axis=2)  # type: ignore[attr-defined]
        k = d.argmax(axis=1)
        depth[start : start + BLOCK_ROWS] = d[np.arange(len(M)), k]
        place[start : start + BLOCK_ROWS] = x[np.arange(len(M)), k]
    return depth, place


def _find_points_in_mesh(part: CoalBody, points: Array, T: Array, limit: float) -> tuple[Array, Ints, Array]:
    """Points inside that may be deeper than the limit: a bound of their depth (N,) m, row (N,) and place (N, 3) m."""
    shape = part.shape
    corner = np.array([[t[0], t[1], t[2]] for t in (shape.tri_indices(n) for n in range(int(shape.num_tris)))])
    vertices = np.asarray(shape.vertices(), float).reshape(-1, 3)
    low, high = vertices[corner].min(axis=(0, 1)), vertices[corner].max(axis=(0, 1))
    columns = [_build_triangle_grid(np.roll(vertices @ GRID_ROTATION.T, -axis, axis=1)[corner]) for axis in range(3)]
    x, y, z = columns
    bounds, rows, places = [np.zeros(0)], [np.zeros(0, np.int64)], [np.zeros((0, 3))]
    for start in range(0, len(T), BLOCK_ROWS):
        M = T[start : start + BLOCK_ROWS]
        most = _bound_depths(points, M, GRID_ROTATION, low, high, *x.arrays, *y.arrays, *z.arrays, limit)
        m, k = np.nonzero(most)
        bounds.append(most[m, k])
        rows.append(start + m)
        places.append(np.einsum("nij,nj->ni", M[m, :3, :3], points[k]) + M[m, :3, 3])
    return np.concatenate(bounds), np.concatenate(rows), np.concatenate(places)


@dataclass(frozen=True, kw_only=True)
class _TriangleGrid:
    """Triangles (F, 3, 3) m by the cells of a grid across their last axis."""

    triangles: Array
    corner: Array  # (2,) m, of the grid
    size: float  # m, of a cell
    shape: Ints  # (2,)
    first: Ints  # (cells + 1,)
    member: Ints

    @property
    def arrays(self) -> tuple[Array, Array, float, Ints, Ints, Ints]:
        return self.triangles, self.corner, self.size, self.shape, self.first, self.member


def _build_triangle_grid(triangles: Array) -> _TriangleGrid:
    flat = triangles[:, :, :2]
    corner = flat.min(axis=(0, 1))
    extent = flat.max(axis=(0, 1)) - corner
    side = int(np.clip(np.sqrt(len(triangles)), 1, GRID_CELLS))
    size = float(max(extent.max() / side, 1e-6))
    shape = (extent / size).astype(np.int64) + 1
    low = ((flat.min(axis=1) - corner) / size).astype(np.int64)
    high = np.minimum(((flat.max(axis=1) - corner) / size).astype(np.int64), shape - 1)
    wide = high - low + 1
    count = wide.prod(axis=1)
    member = np.repeat(np.arange(len(triangles)), count)
    nth = np.arange(len(member)) - np.repeat(np.cumsum(count) - count, count)
    cell = (low[member, 0] + nth // wide[member, 1]) * shape[1] + low[member, 1] + nth % wide[member, 1]
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(int(shape.prod()) + 1))
    return _TriangleGrid(
        triangles=np.ascontiguousarray(triangles),
        corner=corner,
        size=size,
        shape=shape,
        first=first,
        member=member[order],
    )


@jit_compile
def _find_nearest_crossing(
    u: float, v: float, w: float, triangles: Array, corner: Array, size: float, shape: Ints, first: Ints, member: Ints
) -> float:
    """m to the nearest crossing of the line through (u, v) with the surface, from w; −1 where w is outside."""
    i, j = int(np.floor((u - corner[0]) / size)), int(np.floor((v - corner[1]) / size))
    if i < 0 or j < 0 or i >= shape[0] or j >= shape[1]:
        return -1.0
    above, near = 0, np.inf
    cell = i * shape[1] + j
    for n in range(first[cell], first[cell + 1]):
        A = triangles[member[n]]
        p = (A[1, 0] - u) * (A[2, 1] - v) - (A[1, 1] - v) * (A[2, 0] - u)
        q = (A[2, 0] - u) * (A[0, 1] - v) - (A[2, 1] - v) * (A[0, 0] - u)
        r = (A[0, 0] - u) * (A[1, 1] - v) - (A[0, 1] - v) * (A[1, 0] - u)
        if not ((p >= 0.0 and q >= 0.0 and r >= 0.0) or (p <= 0.0 and q <= 0.0 and r <= 0.0)) or p + q + r == 0.0:
            continue
        height = (p * A[0, 2] + q * A[1, 2] + r * A[2, 2]) / (p + q + r) - w
        above += 1 if height > 0.0 else 0
        near = min(near, abs(height))
    return near if above % 2 == 1 else -1.0


@jit_compile
def _bound_depths(
    points: Array,
    T: Array,
    lean: Array,
    low: Array,
    high: Array,
    t0: Array,
    c0: Array,
    s0: float,
    h0: Ints,
    f0: Ints,
    m0: Ints,
    t1: Array,
    c1: Array,
    s1: float,
    h1: Ints,
    f1: Ints,
    m1: Ints,
    t2: Array,
    c2: Array,
    s2: float,
    h2: Ints,
    f2: Ints,
    m2: Ints,
    limit: float,
) -> Array:
    """(M, K) m, a bound on the depth of each point in each row; 0 where it is outside or the bound is not above the
    limit."""
    out, x, y = np.zeros((len(T), len(points))), np.empty(3), np.empty(3)
    for m in range(len(T)):
        for k in range(len(points)):
            within = True  # no place nearer than the limit to the box around the part is deeper than it
            for c in range(3):
                x[c] = T[m, c, 0] * points[k, 0] + T[m, c, 1] * points[k, 1] + T[m, c, 2] * points[k, 2] + T[m, c, 3]
                within = within and low[c] + limit < x[c] < high[c] - limit
            if not within:
                continue
            for c in range(3):
                y[c] = lean[c, 0] * x[0] + lean[c, 1] * x[1] + lean[c, 2] * x[2]
            d = _find_nearest_crossing(y[0], y[1], y[2], t0, c0, s0, h0, f0, m0)
            if d > limit:
                d = min(d, _find_nearest_crossing(y[1], y[2], y[0], t1, c1, s1, h1, f1, m1))
            if d > limit:
                d = min(d, _find_nearest_crossing(y[2], y[0], y[1], t2, c2, s2, h2, f2, m2))
            out[m, k] = d if d > limit else 0.0
    return out


def _measure_distance(shape: object, x: Array) -> float:
    """m from a point to the surface of a mesh, by coal."""
    import coal

    request, result = coal.DistanceRequest(), coal.DistanceResult()
    here = coal.Transform3s(np.eye(3), np.asarray(x))
    return float(coal.distance(shape, coal.Transform3s.Identity(), coal.Sphere(1e-9), here, request, result))


def _select_rows(tcp: Array, rows: Ints) -> Ints:
    """Return rows at least one sample spacing from the row before, and the first and last."""
    if not len(rows):
        return rows
    x, z = tcp[rows, :3, 3], tcp[rows, :3, 2]
    way = (
        np.linalg.norm(np.diff(x, axis=0), axis=1) / SAMPLE_SPACING_M
        + np.linalg.norm(np.diff(z, axis=0), axis=1) / SAMPLE_SPACING_RAD
    )
    gone = np.floor(np.append(0.0, np.cumsum(way)))
    keep: Bools = np.append(True, np.diff(gone) > 0)
    keep[-1] = True
    return np.asarray(rows[keep])
