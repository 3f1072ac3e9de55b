"""Geometry of one continuous run: the polyline of toolpath points as a curve with three continuous derivatives.

The path parameter u is cumulative length in the metric du² = |dp|² + (ARM·dθ)², θ the rotation of the TCP, so that
a rotation on the spot has length too. In the coordinates X = (position, tool axis, reference, spin) the run is a
polyline; each vertex k is rounded on its own:

    X(u) = polyline(u) + Σ_k Δd_k e(u − u_k; L_k)      Δd_k change of slope, L_k half-width of the rounding

e is a ramp mollified with the kernel 15/16 (1 − x²)² minus the ramp itself: it vanishes for |x| ≥ L, its peak is
0.15625 L, and the sum stays three times differentiable for any overlap of the windows. L_k is as large as the
tolerance, the ends of the run and the feed allow. Where the path turns back on itself, and where the file dwells or
stops, the run is split: such a vertex is driven through exactly, from rest to rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.slow_moves import ARM, TURN_BACK
from machopt.numerics.array_types import Array
from machopt.numerics.compiled_functions import jit_compile
from machopt.numerics.rigid_transforms import compute_tool_rotation, normalise_vectors
from machopt.planning.retiming.smooth_stretches import fill_smooth_stretches
from machopt.planning.retiming.taylor_series import compute_curve_derivatives, compute_frame_derivatives

MERGE = 2e-6  # m of path: points nearer than this to the last kept one are merged
SAME = 1e-9  # m of path: points nearer than this are one point
TURN_BACK_COS = np.cos(TURN_BACK)  # corners with a stop
FLIP = np.cos(np.radians(170.0))  # linear interpolation of axis vectors is no rotation beyond this angle
TIME = 0.1  # s of travel at the programmed feed: the widest rounding
SPIN_TOLERANCE = np.radians(0.2)  # of reference and spin, where only smoothness matters
CHECKED = 8  # places of each segment that are compared with its line
GRADE = 1.0  # neighbouring half-widths differ by at most this share of their distance
NODES = 5  # nodes per half-width
COARSE = 2.5e-3  # m, largest distance of nodes
P, N, B, S = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 10)  # position, axis, reference, spin
POSE, TURN = slice(0, 6), slice(6, 10)


@dataclass(frozen=True)
class PoseJets:
    """Pose and its derivatives 1…3 with respect to u, in the workpiece frame."""

    position: Array  # (M, 4, 3) m/mᵏ
    rotation: Array  # (M, 4, 3, 3) columns are the TCP axes


@dataclass(frozen=True, kw_only=True)
class PathCurve:
    """A run between two stops, rounded."""

    u: Array  # (m,) m, parameter of the vertices, as :func:`compute_path_parameter` counts it
    X: Array  # (m, 10) vertices: position, axis, reference, spin about the axis
    width: Array  # (m, 2) m, half-width of the rounding of (position, axis) and of (reference, spin)
    first: Array  # (m,) point of the run where the vertex begins; fractional between points
    last: Array  # (m,) point where it ends: points in between are passed at rest
    turns: Array  # (m,) rad, spin − phi: part of the spin from the change of reference
    phi_curve: Callable[[Array], Array] | None

    def index(self, u: Array) -> Array:
        """Return the fractional point index.

        Args:
            u: (M,) m, path parameter.
        """
        k = np.clip(np.searchsorted(self.u, u, side="right") - 1, 0, len(self.u) - 2)
        f = np.clip((u - self.u[k]) / (self.u[k + 1] - self.u[k]), 0.0, 1.0)
        return np.asarray(self.last[k] + f * (self.first[k + 1] - self.last[k]), float)

    def coordinates(self, u: Array) -> Array:
        """Return X and its derivatives 1…3, (M, 4, 10).

        Args:
            u: (M,) m, increasing path parameter.
        """
        k = np.clip(np.searchsorted(self.u, u, side="right") - 1, 0, len(self.u) - 2).astype(np.int64)
        slope = np.diff(self.X, axis=0) / np.diff(self.u)[:, None]
        out = np.zeros((len(u), 4, self.X.shape[1]))
        out[:, 0] = self.X[k] + (u - self.u[k])[:, None] * slope[k]
        out[:, 1] = slope[k]
        bend = np.diff(slope, axis=0)
        for columns, width in ((POSE, self.width[1:-1, 0]), (TURN, self.width[1:-1, 1])):
            part = np.ascontiguousarray(out[:, :, columns])
            wide, bent = np.ascontiguousarray(width), np.ascontiguousarray(bend[:, columns])
            _round(u, k, self.u[1:-1], wide, bent, part)
            out[:, :, columns] = part
        if self.phi_curve is not None:
            out[:, :, 9] += compute_curve_derivatives(self.phi_curve, u, self.u[0], self.u[-1])
        return out

    def jets(self, u: Array) -> tuple[PoseJets, Array]:
        """Return poses along the curve and the rotation phi (M,) in rad.

        Args:
            u: (M,) m, increasing path parameter.
        """
        X = self.coordinates(u)
        rotation = compute_frame_derivatives(X[:, :, N], X[:, :, B], X[:, :, 9])
        return PoseJets(X[:, :, P], rotation), X[:, 0, 9] - np.interp(u, self.u, self.turns)

    def nodes(self) -> Array:
        """Return values of u dense enough for interpolation between them."""
        inner = self.u[1:-1]
        w = self.width[1:-1]
        edges = [np.clip(inner + side * w[:, c], self.u[0], self.u[-1]) for side in (-1, 1) for c in (0, 1)]
        marks = np.unique(np.concatenate([self.u, *edges]))
        spacing = np.full(len(marks) - 1, COARSE)
        middle = 0.5 * (marks[1:] + marks[:-1])
        for c in (0, 1):
            _finest(middle, inner, np.ascontiguousarray(w[:, c]), 1.0 / NODES, spacing)
        return np.asarray(_spread(marks, spacing))


def compute_path_parameter(position: Array, axis: Array, reference: Array, phi: Array) -> Array:
    """Return the cumulative length (n,) in the metric of this module: the argument s of a smooth rotation phi(s).

    Args:
        position: (n, 3) m.
        axis: (n, 3) unit tool axes.
        reference: (n, 3) directions of TCP x at phi = 0.
        phi: (n,) rad.
    """
    R = compute_tool_rotation(axis, reference, phi)
    return np.asarray(np.r_[0.0, np.cumsum(_distance(np.diff(position, axis=0), np.diff(R, axis=0)))])


def _distance(dp: Array, dR: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(dp**2, axis=-1) + ARM**2 * 0.5 * np.sum(dR**2, axis=(-2, -1))))


@dataclass(frozen=True, kw_only=True)
class RunPoints:
    """n points of one run, as far as its geometry needs them."""

    position: Array  # (n, 3) m
    axis: Array  # (n, 3) unit tool axes
    reference: Array  # (n, 3) directions of TCP x at phi = 0
    phi: Array  # (n,) rad
    feed: Array  # (n,) m/s of the move that ends at each point
    phi_curve: Callable[[Array], Array] | None = None  # phi by :func:`compute_path_parameter`; None: at the points only
    rests: tuple[int, ...] = ()  # points at which the run comes to rest, increasing


@dataclass(frozen=True)
class CornerTolerances:
    """Maximum deviations of the rounded run from its polyline."""

    position: float  # m
    axis: float  # rad, of the tool axis
    spin: float = SPIN_TOLERANCE  # rad, of the rotation about the tool axis


def build_curves(points: RunPoints, tolerances: CornerTolerances) -> list[PathCurve] | int:
    """Split a run where it turns back, and at its rest points; round the parts.

    Args:
        points: points of the run.
        tolerances: maximum deviations.

    Returns:
        The parts in order; none where the run has no length. Or the point up to which the tool axis flips.
    """
    u_all = compute_path_parameter(points.position, points.axis, points.reference, points.phi)
    rotation = compute_tool_rotation(points.axis, points.reference, points.phi)
    first, last = _vertices(points.position, rotation, u_all)
    if len(first) < 2:
        return []
    at = np.r_[first[:-1], last[-1]]  # representative point of the vertex
    n = points.axis[at]
    flips = np.flatnonzero(np.sum(n[1:] * n[:-1], axis=1) < FLIP)
    if len(flips):
        return int(at[flips[0] + 1])
    base, turn = _carried(n, points.reference[at])
    u = np.r_[u_all[first[:-1]], u_all[last[-1]]]
    smooth = 0.0 if points.phi_curve is None else points.phi_curve(u)
    rest = points.phi[at] - smooth  # a curve that misses the points is corrected
    X = np.column_stack([points.position[at], n, base, turn + rest])
    polyline = PathCurve(
        u=u,
        X=X,
        width=np.zeros((len(u), 2)),
        first=first.astype(float),
        last=last.astype(float),
        turns=turn,
        phi_curve=points.phi_curve,
    )
    wide = np.minimum(points.feed[last[:-1] + 1], np.r_[np.inf, points.feed[last[:-2] + 1]]) * TIME
    return [_round_part(polyline, a, b, wide, tolerances) for a, b in pairwise(_find_stops(polyline, points.rests))]


def _find_stops(polyline: PathCurve, rests: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the vertices at which the run stops: its ends, where it turns back, and the rest points."""
    slope = np.diff(polyline.X * np.r_[1, 1, 1, np.full(7, ARM)], axis=0) / np.diff(polyline.u)[:, None]
    size = np.linalg.norm(slope, axis=1)
    back = np.sum(slope[1:] * slope[:-1], axis=1) < TURN_BACK_COS * size[1:] * size[:-1]
    at_rest = np.searchsorted(polyline.last, rests)
    return np.unique(np.r_[0, 1 + np.flatnonzero(back), at_rest, len(polyline.u) - 1].astype(np.int64))


def _round_part(polyline: PathCurve, a: int, b: int, wide: Array, tolerances: CornerTolerances) -> PathCurve:
    """Return the part between the stops a and b, rounded; ``wide`` (m − 1,) m: largest half-width at the vertices.

    Smooth stretches are filled up first (:mod:`machopt.planning.retiming.smooth_stretches`). Where the result leaves
    the polyline by more than the tolerance, they are not.
    """
    part = slice(a, b + 1)
    lines = PathCurve(
        u=polyline.u[part],
        X=polyline.X[part],
        width=np.zeros((b - a + 1, 2)),
        first=polyline.first[part],
        last=polyline.last[part],
        turns=polyline.turns[part],
        phi_curve=polyline.phi_curve,
    )
    cap = np.append(wide, np.inf)[a : b + 1]
    scale = np.r_[np.full(3, 1 / tolerances.position), np.full(3, 1 / tolerances.axis)]
    filled = fill_smooth_stretches(lines.u, lines.X[:, POSE], scale, cap)
    if filled is not None:
        rows = np.arange(len(lines.u))
        X = np.column_stack([np.interp(filled.segment, rows, column) for column in lines.X.T])
        X[:, POSE] = filled.pose
        share = filled.segment - np.floor(filled.segment)
        on = np.floor(filled.segment).astype(int)
        after = np.minimum(on + 1, len(rows) - 1)
        place = lines.last[on] + share * (lines.first[after] - lines.last[on])
        smooth = replace(
            lines,
            u=filled.u,
            X=X,
            width=np.zeros((len(X), 2)),
            first=np.where(share > 0.0, place, lines.first[on]),
            last=np.where(share > 0.0, place, lines.last[on]),
            turns=np.interp(filled.segment, rows, lines.turns),
        )
        curve = _round_vertices(
            smooth, np.minimum(cap[on], cap[np.ceil(filled.segment).astype(int)]), scale, tolerances
        )
        if _measure_excess(curve, lines, scale) <= 1.0:
            return curve
    return _round_vertices(lines, cap, scale, tolerances)


def _round_vertices(lines: PathCurve, cap: Array, scale: Array, tolerances: CornerTolerances) -> PathCurve:
    """Return a polyline with its half-widths; ``cap`` (m,) m: the largest at each vertex."""
    width = np.zeros((len(lines.u), 2))
    width[:, 0] = _half_widths(lines.u, lines.X[:, POSE] * scale, (0, 3, 6), cap[1:-1])
    width[:, 1] = _half_widths(lines.u, lines.X[:, TURN] / tolerances.spin, (0, 4), 2.0 * cap[1:-1])
    return replace(lines, width=width)


def _measure_excess(curve: PathCurve, lines: PathCurve, scale: Array) -> float:
    """Return the largest deviation of position or axis from the polyline, in units of the tolerances."""
    share = np.arange(CHECKED) / CHECKED
    u = np.r_[(lines.u[:-1, None] + share * np.diff(lines.u)[:, None]).ravel(), lines.u[-1]]
    straight = np.column_stack([np.interp(u, lines.u, column) for column in lines.X[:, POSE].T])
    off = (replace(curve, phi_curve=None).coordinates(u)[:, 0, POSE] - straight) * scale
    return float(np.sqrt(np.maximum((off[:, :3] ** 2).sum(axis=1), (off[:, 3:] ** 2).sum(axis=1)).max()))


def _vertices(position: Array, R: Array, u: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last point of each vertex: points nearer than MERGE to the one before become part of its vertex."""
    n = len(position)
    if n == 0 or u[-1] < SAME:
        return np.zeros(min(n, 1), np.int64), np.full(min(n, 1), n - 1, np.int64)
    start = [0]
    if np.diff(u).min() >= MERGE:
        start = list(range(n))
    else:
        for k in range(1, n):
            a = start[-1]
            if u[k] - u[a] >= MERGE and float(_distance(position[k] - position[a], R[k] - R[a])) >= MERGE:
                start.append(k)
        gap = float(_distance(position[-1] - position[start[-1]], R[-1] - R[start[-1]]))
        if start[-1] != n - 1 and gap > SAME:  # the end is driven to exactly
            if len(start) > 1:
                start.pop()
            start.append(n - 1)
    first = np.array(start, np.int64)
    return first, np.r_[first[1:] - 1, n - 1].astype(np.int64)


def _carried(axis: Array, reference: Array) -> tuple[Array, Array]:
    """Return a reference transported by minimal rotation, and the angle (m,) from it to the given one, unwrapped."""
    seed = reference[0] - (reference[0] @ axis[0]) * axis[0]
    base = _carry(axis, seed / np.linalg.norm(seed))
    projected = normalise_vectors(reference - np.sum(reference * axis, axis=1, keepdims=True) * axis)
    side = np.cross(-axis, base)
    return base, np.unwrap(np.arctan2(np.sum(projected * side, axis=1), np.sum(projected * base, axis=1)))


@jit_compile
def _carry(axis: Array, start: Array) -> Array:
    """Transport ``start`` along the axes (m, 3); two reflections make each minimal rotation."""
    out = np.empty((len(axis), 3))
    for d in range(3):
        out[0, d] = start[d]
    for k in range(1, len(axis)):
        a0, a1, a2 = axis[k - 1, 0], axis[k - 1, 1], axis[k - 1, 2]
        n0, n1, n2 = axis[k, 0], axis[k, 1], axis[k, 2]
        b0, b1, b2 = out[k - 1, 0], out[k - 1, 1], out[k - 1, 2]
        f = 2.0 * (b0 * a0 + b1 * a1 + b2 * a2)
        b0, b1, b2 = b0 - f * a0, b1 - f * a1, b2 - f * a2
        v0, v1, v2 = a0 + n0, a1 + n1, a2 + n2
        f = 2.0 * (b0 * v0 + b1 * v1 + b2 * v2) / (v0 * v0 + v1 * v1 + v2 * v2)
        b0, b1, b2 = b0 - f * v0, b1 - f * v1, b2 - f * v2
        f = b0 * n0 + b1 * n1 + b2 * n2
        b0, b1, b2 = b0 - f * n0, b1 - f * n1, b2 - f * n2
        size = math.sqrt(b0 * b0 + b1 * b1 + b2 * b2)
        out[k, 0], out[k, 1], out[k, 2] = b0 / size, b1 / size, b2 / size
    return out


def _half_widths(u: Array, X: Array, groups: tuple[int, ...], cap: Array) -> Array:
    """Return half-widths (m,) for which the rounded polyline is within 1 of the polyline in every group of columns."""
    out = np.zeros(len(u))
    if len(u) < 3:
        return out
    bend = np.diff(np.diff(X, axis=0) / np.diff(u)[:, None], axis=0)
    inner = np.ascontiguousarray(u[1:-1])
    width = np.minimum(cap, np.minimum(inner - u[0], u[-1] - inner))
    share = (np.arange(4) / 4.0)[None, :]
    where = np.r_[(u[:-1, None] + share * np.diff(u)[:, None]).ravel(), u[-1]]
    for _ in range(200):
        _grade(inner, width)
        deviation = np.zeros((len(where), 1, X.shape[1]))
        _round(where, np.repeat(np.arange(len(u), dtype=np.int64), 4)[: len(where)], inner, width, bend, deviation)
        squares = [np.sum(deviation[:, 0, a:b] ** 2, axis=1) for a, b in pairwise(groups)]
        excess = np.sqrt(np.max(squares, axis=0))
        if excess.max() <= 1.0:
            break
        weights = [np.sum(bend[:, a:b] ** 2, axis=1) for a, b in pairwise(groups)]
        _shrink(where, excess, inner, np.sqrt(np.max(weights, axis=0)), width)
    else:
        width[:] = 0.0  # not expected; the time law would see exact corners as infinitely sharp
    out[1:-1] = width
    return out


@jit_compile
def _first(u: Array, x: float) -> int:
    """Index of the first of the increasing u that is not below x."""
    low, high = 0, len(u)
    while low < high:
        middle = (low + high) // 2
        if u[middle] < x:
            low = middle + 1
        else:
            high = middle
    return low


@jit_compile
def _bump(t: float) -> float:
    """e(t·L)/L for |t| ≤ 1."""
    a = abs(t)  # even
    b = a * a
    return 0.15625 - 0.5 * a + (15.0 / 16.0) * b * (0.5 - b / 6.0 + b * b / 30.0)


@jit_compile
def _round(u: Array, segment: NDArray[np.int64], uk: Array, width: Array, bend: Array, out: Array) -> None:
    """Add the rounding of every vertex to out (M, orders, D); segment (M,): the one each increasing u lies on."""
    for k in range(len(uk)):
        L = width[k]
        if L <= 0.0:
            continue
        for j in range(_first(u, uk[k] - L), len(u)):
            t = (u[j] - uk[k]) / L
            if t >= 1.0:
                break
            b = t * t
            e0 = _bump(t) * L
            e1 = 0.5 + (15.0 / 16.0) * t * (1.0 - 2.0 * b / 3.0 + b * b / 5.0) - (1.0 if segment[j] > k else 0.0)
            e2 = (15.0 / 16.0) * ((1.0 - b) * (1.0 - b)) / L
            e3 = -(15.0 / 4.0) * t * (1.0 - b) / (L * L)
            for d in range(bend.shape[1]):
                out[j, 0, d] += e0 * bend[k, d]
                if out.shape[1] > 1:
                    out[j, 1, d] += e1 * bend[k, d]
                    out[j, 2, d] += e2 * bend[k, d]
                    out[j, 3, d] += e3 * bend[k, d]


@jit_compile
def _grade(uk: Array, width: Array) -> None:
    """Lower half-widths until neighbours differ by no more than GRADE times their distance."""
    for k in range(1, len(uk)):
        width[k] = min(width[k], width[k - 1] + GRADE * (uk[k] - uk[k - 1]))
    for k in range(len(uk) - 2, -1, -1):
        width[k] = min(width[k], width[k + 1] + GRADE * (uk[k + 1] - uk[k]))


@jit_compile
def _shrink(u: Array, excess: Array, uk: Array, weight: Array, width: Array) -> None:
    """Narrow the vertices that contribute most where the sum is too large."""
    most = np.zeros(len(u))
    for k in range(len(uk)):
        for j in range(_first(u, uk[k] - width[k]), len(u)):
            t = (u[j] - uk[k]) / width[k]
            if t >= 1.0:
                break
            most[j] = max(most[j], weight[k] * width[k] * _bump(t))
    for k in range(len(uk)):
        factor = 1.0
        for j in range(_first(u, uk[k] - width[k]), len(u)):
            t = (u[j] - uk[k]) / width[k]
            if t >= 1.0:
                break
            if excess[j] > 1.0 and weight[k] * width[k] * _bump(t) >= 0.5 * most[j]:
                factor = min(factor, max(0.2, 0.99 / math.sqrt(excess[j])))
        width[k] *= factor


@jit_compile
def _finest(u: Array, uk: Array, width: Array, share: float, spacing: Array) -> None:
    """Lower spacing (M,) at u to share of the narrowest window that covers it."""
    for k in range(len(uk)):
        for j in range(_first(u, uk[k] - width[k]), len(u)):
            if u[j] >= uk[k] + width[k]:
                break
            spacing[j] = min(spacing[j], share * width[k])


@jit_compile
def _spread(marks: Array, spacing: Array) -> Array:
    """Nodes from mark to mark; marks closer than half the spacing to the node before are left out."""
    kept_marks = np.empty(len(marks), np.int64)
    kept_marks[0], n, total = 0, 1, 1
    fine = np.inf
    gap = np.empty(len(marks))
    for k in range(1, len(marks)):
        fine = min(fine, spacing[k - 1])
        step = marks[k] - marks[kept_marks[n - 1]]
        if step < 0.5 * fine and k == len(marks) - 1 and n > 1:  # the end replaces the last node
            n -= 1
            fine = min(fine, gap[n])
            step = marks[k] - marks[kept_marks[n - 1]]
            total += 1
        if step >= 0.5 * fine or k == len(marks) - 1:
            gap[n] = fine
            kept_marks[n] = k
            total += math.ceil(step / fine)
            n += 1
            fine = np.inf
    out = np.empty(total)
    out[0], m = marks[0], 1
    for k in range(1, n):
        a, b = marks[kept_marks[k - 1]], marks[kept_marks[k]]
        parts = math.ceil((b - a) / gap[k])
        for i in range(1, parts + 1):
            out[m] = b if i == parts else a + (b - a) * i / parts
            m += 1
    return out[:m]
