"""Contact of a cutter whose axis turns against the stock, recomputed from the exact mesh and exact poses.

The outline of the cutter is sampled at angles and heights. A sample is in contact where it lies inside of the mesh and
in none of the poses along the earlier moves. A line from it crosses the triangles; their number shows whether it is
inside. No cells are used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machopt.data_types.cell import CutterGeometry
from machopt.data_types.tool_segments import ToolSegment
from machopt.numerics.array_types import Array
from machopt.verification.motion.process.lines_through_mesh import build_axis_frame, find_mesh_heights

STEP = 0.25e-3  # m, between poses, at the tip and at the upper end of the cutter
ANGLES = 90
PASSES = ((40, 32), (80, 80))  # slices of the corner and of the cylindrical part
HEIGHTS = 24  # along the axis, where the material is measured that a plunge or ramp removes; closer near the tip
BATCH = 64  # poses at a time
PAIRS = 200_000  # of a triangle and a place, at a time
TOUCHED = 1e-9  # m
_RAY = np.array([0.31622, 0.50341, 0.80409])  # no direction of a plane that a part is likely to have


@dataclass(frozen=True, kw_only=True)
class TurningPoses:
    """Earlier poses of all tools in the CAM frame."""

    tip: Array  # (P, 3) m
    axis: Array  # (P, 3) unit
    shape: Array  # (P, 4) radius m, corner radius m, slope of a drill's point, height m
    length: Array  # (P,) m, path from the start of the job
    begins: np.ndarray  # (N,) first pose of the move that ends at each point of the job

    def find_end(self, point: int) -> int:
        """Return the pose at the end of a move.

        Args:
            point: Point of the job at which the move ends.
        """
        return int(self.begins[point + 1] if point + 1 < len(self.begins) else len(self.length)) - 1


def list_turning_poses(segments: Sequence[ToolSegment]) -> TurningPoses:
    """Return poses along all moves of a job.

    Args:
        segments: Segments of the job; their tools have cutters.
    """
    tips, axes, shapes, lengths = [], [], [], []
    begins: list[int] = []
    count, before = 0, 0.0
    for segment in segments:
        cutter = segment.cell.tool.cutter
        assert cutter is not None
        cone = 0.0 if cutter.point_angle is None else 1.0 / math.tan(0.5 * cutter.point_angle)
        shape = [0.5 * cutter.diameter, cutter.corner, cone, cutter.length]
        p, a = segment.toolpath.position, segment.toolpath.axis
        for k in range(len(p)):
            begins.append(count)
            last = max(k - 1, 0)
            turn = math.acos(min(max(float(a[last] @ a[k]), -1.0), 1.0))
            size = float(np.linalg.norm(p[k] - p[last]))
            n = max(math.ceil(max(size, size + turn * cutter.length) / STEP), 1)
            share = np.arange(1, n + 1)[:, None] / n
            tips.append(p[last] + share * (p[k] - p[last]))
            axes.append(_turn_axis(a[last], a[k], turn, share))
            shapes.append(np.tile(shape, (n, 1)))
            lengths.append(before + share[:, 0] * size)
            count, before = count + n, before + size
    return TurningPoses(
        tip=np.concatenate(tips),
        axis=np.concatenate(axes),
        shape=np.concatenate(shapes),
        length=np.concatenate(lengths),
        begins=np.array(begins),
    )


def _turn_axis(a: Array, b: Array, turn: float, share: Array) -> Array:
    if turn < 1e-9:
        return np.tile(b, (len(share), 1))
    if turn > math.pi - 1e-6:  # any plane
        across = np.eye(3)[0 if abs(a[0]) < 0.9 else 1]
        across = across - (across @ a) * a
        across /= np.linalg.norm(across)
        return np.asarray(np.cos(share * turn) * a + np.sin(share * turn) * across)
    return np.asarray((np.sin((1.0 - share) * turn) * a + np.sin(share * turn) * b) / math.sin(turn))


@dataclass(frozen=True, kw_only=True)
class TurningCut:
    """Cutter at one point, and what was removed before."""

    cutter: CutterGeometry
    tip: Array  # (3,) m, CAM frame
    axis: Array  # (3,) unit
    travel: Array  # (3,) unit, direction of travel across the axis
    poses: TurningPoses
    counted: slice  # poses that were removed before
    triangles: Array  # (F, 3, 3) m, corners of the stock, CAM frame


def find_turning_arcs(cut: TurningCut, moved: float, stated: Array) -> list[tuple[float, float, float, float]]:
    """Return low, high, start and end of the contact, one row for each sampled angle and slice.

    The range of heights is narrowed in ``PASSES``; heights of the stated contact are always compared.

    Args:
        cut: The cutter and what was removed before.
        moved: m, how far the outline is moved outwards.
        stated: Heights of the stated contact, m; may be empty.
    """
    low, high = 0.0, cut.cutter.length
    for slices in PASSES:
        parts = _divide(cut.cutter, (low, high), slices)
        rows = _sample(cut, moved, parts)
        ends = [*(row[0] for row in rows), *(row[1] for row in rows), *stated.tolist()]
        if not ends:
            break
        low, high = _widen(min(ends), max(ends), parts)
    return rows


def _widen(low: float, high: float, parts: tuple[Array, Array, Array]) -> tuple[float, float]:
    """Return a range of heights with one slice more at either end."""
    below, above = parts[0][parts[0] < low - TOUCHED], parts[1][parts[1] > high + TOUCHED]
    return float(below.max(initial=parts[0][0])), float(above.min(initial=parts[1][-1]))


def measure_turning_material(
    axis: Array, places: Array, ranges: Array, removed: tuple[TurningPoses, slice], triangles: Array
) -> Array:
    """Return (P,) m of material on lines along an axis, between two heights above the tip.

    Args:
        axis: (3,) unit, from tip to shank.
        places: (P, 3) m, across the axis at the height of the tip.
        ranges: (2, P) m, lower and upper height.
        removed: Poses, and which of them were removed before.
        triangles: (F, 3, 3) m, corners of the stock.
    """
    low, high = _clip_to_mesh(axis, places, ranges, triangles)
    edges = (np.arange(HEIGHTS + 1) / HEIGHTS) ** 2
    heights = low + (0.5 * (edges[:-1] + edges[1:]))[:, None] * (high - low)  # (H, P)
    at = (places + heights[..., None] * axis).reshape(-1, 3)
    inside = _find_inside(at, triangles)
    inside[inside] = _find_uncut(at[inside], *removed)
    return np.asarray(np.diff(edges) @ inside.reshape(heights.shape) * (high - low))


def _clip_to_mesh(axis: Array, places: Array, ranges: Array, triangles: Array) -> tuple[Array, Array]:
    """Return (P,) m each, the ends of lines along an axis without what lies below or above a mesh."""
    frame = build_axis_frame(axis)
    flat = places @ frame.T
    bottom, top = find_mesh_heights(flat[:, :2], triangles @ frame.T)
    low = np.maximum(ranges[0], bottom - flat[:, 2])
    return low, np.maximum(np.minimum(ranges[1], top - flat[:, 2]), low)


def _sample(
    cut: TurningCut, moved: float, slices: tuple[Array, Array, Array]
) -> list[tuple[float, float, float, float]]:
    left = np.cross(cut.axis, cut.travel)
    turn = math.pi / ANGLES
    phi = (np.arange(ANGLES) + 0.5) * turn
    low, high, radius = slices
    middle = 0.5 * (low + high)
    across = np.cos(phi)[:, None] * left + np.sin(phi)[:, None] * cut.travel
    place = (cut.tip + middle[:, None, None] * cut.axis + (radius[:, None, None] + moved) * across).reshape(-1, 3)
    inside = _find_inside(place, cut.triangles)
    inside[inside] = _find_uncut(place[inside], cut.poses, cut.counted)
    found = np.flatnonzero(inside)
    which, angles = found // ANGLES, found % ANGLES
    return [
        (float(low[s]), float(high[s]), float(m * turn), float((m + 1) * turn))
        for s, m in zip(which.tolist(), angles.tolist(), strict=True)
    ]


def _divide(
    cutter: CutterGeometry, heights: tuple[float, float], numbers: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """Return low, high and radius of slices between two heights: of equal angle in the corner, and above it."""
    R, rc = 0.5 * cutter.diameter, cutter.corner
    edges: list[float] = []
    if heights[0] < rc:
        a, b = (math.acos(1.0 - min(h, rc) / rc) for h in heights)
        angles = np.linspace(a, b, numbers[0] + 1)
        edges += (rc * (1.0 - np.cos(angles))).tolist()
    first, last = max(heights[0], rc), min(heights[1], cutter.length)
    cylinder: list[float] = []
    if last > first:
        cylinder = np.linspace(first, last, numbers[1] + 1).tolist()
    low, high = np.array([*edges[:-1], *cylinder[:-1]]), np.array([*edges[1:], *cylinder[1:]])
    x = np.clip(rc - 0.5 * (low + high), 0.0, rc)
    return low, high, R - rc + np.sqrt(rc * rc - x * x)


def _find_inside(place: Array, triangles: Array) -> np.ndarray:
    """Return (n,) whether places lie inside of a closed mesh."""
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    some = np.flatnonzero(((place >= low) & (place <= high)).all(axis=1))
    if not len(some):
        return np.zeros(len(place), bool)
    u = np.cross(_RAY, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    frame = np.stack([u, np.cross(_RAY, u) / np.linalg.norm(_RAY), _RAY / np.linalg.norm(_RAY)])
    p = place[some] @ frame.T
    order = np.argsort(p[:, 0])
    count = np.zeros(len(place), int)
    count[some[order]] = _count_crossings(p[order], triangles @ frame.T)
    return count > 0


def _count_crossings(p: Array, lines: Array) -> np.ndarray:
    """Return (n,) faces that lines from places along the third axis leave through, less those they enter through.

    Args:
        p: (n, 3) places in ascending order of the first coordinate.
        lines: (F, 3, 3) corners of the triangles.
    """
    least, most = lines.min(axis=1), lines.max(axis=1)
    is_near = (least[:, 1] <= p[:, 1].max()) & (most[:, 1] >= p[:, 1].min()) & (most[:, 2] >= p[:, 2].min())
    e, f = lines[:, 1] - lines[:, 0], lines[:, 2] - lines[:, 0]
    area = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    which = np.flatnonzero(is_near & (np.abs(area) >= 1e-18))
    begin = np.searchsorted(p[:, 0], least[which, 0], "left")
    end = np.searchsorted(p[:, 0], most[which, 0], "right")
    number = end - begin
    total = np.cumsum(number)
    count = np.zeros(len(p), int)
    first = 0
    while first < len(which):  # pairs of a triangle and a place beside it, ``PAIRS`` at a time
        last = max(int(np.searchsorted(total, total[first] - number[first] + PAIRS, "right")), first + 1)
        some = slice(first, last)
        row = np.repeat(which[some], number[some])
        begins = np.cumsum(number[some]) - number[some]
        at = np.arange(len(row)) - np.repeat(begins - begin[some], number[some])
        g = p[at] - lines[row, 0]
        s = (g[:, 0] * f[row, 1] - g[:, 1] * f[row, 0]) / area[row]
        v = (e[row, 0] * g[:, 1] - e[row, 1] * g[:, 0]) / area[row]
        hit = (s >= 0.0) & (v >= 0.0) & (s + v <= 1.0) & (s * e[row, 2] + v * f[row, 2] > g[:, 2])
        count += np.bincount(at[hit], np.where(area[row[hit]] > 0.0, 1, -1), len(p)).astype(int)
        first = last
    return count


def _find_uncut(place: Array, poses: TurningPoses, counted: slice) -> np.ndarray:
    """Return (n,) whether places lie in none of the earlier poses."""
    left = np.ones(len(place), bool)
    tip, axis, shape = poses.tip[counted], poses.axis[counted], poses.shape[counted]
    if not len(place) or not len(tip):
        return left
    low, high = place.min(axis=0), place.max(axis=0)
    ends = tip + shape[:, 3:] * axis
    room = shape[:, :1]
    near = (np.minimum(tip, ends) - room <= high).all(axis=1) & (np.maximum(tip, ends) + room >= low).all(axis=1)
    rows = np.flatnonzero(near)[::-1]  # the last ones first: they remove most
    for first in range(0, len(rows), BATCH):
        some = rows[first : first + BATCH]
        open_places = np.flatnonzero(left)
        if not len(open_places):
            break
        v = place[open_places, None] - tip[some]
        z = np.einsum("npi,pi->np", v, axis[some])
        r = np.sqrt(np.maximum(np.einsum("npi,npi->np", v, v) - z * z, 0.0))
        R, rc, cone, height = shape[some].T
        beyond = np.clip(r - R + rc, 0.0, rc)
        surface = rc - np.sqrt(rc * rc - beyond**2) + cone * r
        cut = (r < R - TOUCHED) & (z > surface) & (z < height)
        left[open_places[cut.any(axis=1)]] = False
    return left
