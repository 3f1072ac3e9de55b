"""Rounded corners between rapid moves: rapid_corners.csv against the motion, the points, the CAM file and the cell.

Between the two neighbouring nodes of a corner w (the row where the move to it begins, and the row where the move from
it ends, which are corners or stops), with the steps Δ_a to it and Δ_b from it, every sample is

    q = w − u Δ_a + v Δ_b,      u, v ≥ 0,      u/α + v/β ≤ 1  or  u = 0  or  v = 0,

with the shares α and β of the table: on one of the two straight moves, or in the triangle that the table states. u, v
are found by least squares. A controller that rounds the corner within these shares stays in the same triangle. So the
whole triangle is searched for contacts, along chords parallel to its base. The shares are those that were driven: the
last sample on the move to the corner lies before α, and the first one on the move from it behind β, but for the time in
which the departure from the move is smaller than what the table prints. Where both moves are one straight line, the
corner is a point that the tool passes, and nothing is rounded.

A corner at a point of the toolpath lies within ``rapid_blend_mm`` of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from machopt.data_types.rapid_corners import RapidCorners
from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.check_results import VerificationCheck, build_count_check, build_worst_value_check
from machopt.verification.motion.collision.bodies import CoalBody
from machopt.verification.motion.collision.contact_search import find_polyline_contacts
from machopt.verification.motion.kinematics.urdf_kinematics import UrdfKinematics
from machopt.verification.tables.exported_tables import ExportedMotion
from machopt.verification.tables.rapid_corner_table import PRINTED_SHARE

OFF_TOLERANCE_DEG = 1e-3  # of a sample from the moves and the triangle; a metre of a slide counts as a radian
AWAY_TOLERANCE_MM = 0.02  # of a corner beyond the distance by which the tool may pass its point, as of rapid points
STRAIGHT = 1e-8  # rad or m, of a corner from the straight way between its neighbours: no corner but a passed point
WHOLE = 1e-6  # of an index
CHORD_M, CHORD_RAD = 5e-3, float(np.radians(2.0))  # distance of the chords, at the tool and in the joints
LEAST_CHORDS = 2
BETWEEN, DRIVEN, SHARES, AT_POINTS = (
    "rapid corners between rapid moves",
    "rapid corners as driven",
    "rapid corner shares",
    "rapid corners at the points",
)
CORNERS_CLEAR = "rapid corners clear"
CORNER_CHECKS = frozenset((BETWEEN, DRIVEN, SHARES, AT_POINTS))
DEPARTED = 1e-8  # share of the other move at which a sample has left its own; joints have nine decimals
PRINTED_RAD = 2e-11  # of joints with nine decimals of a degree, in all axes together
ONSET_JERK = 1.0  # 1/s³, with which a move begins: 4 ms to the share DEPARTED


@dataclass(frozen=True)
class CornerTriangle:
    """One corner with its neighbours."""

    corner: Array  # (n,) rad or m
    start: Array  # (n,) where the move to it begins
    end: Array  # (n,) where the move from it ends
    share: Array  # (2,) stated

    @property
    def base(self) -> Array:
        """(2, n) where the rounding begins and ends at most."""
        return np.array(
            [
                self.corner + self.share[0] * (self.start - self.corner),
                self.corner + self.share[1] * (self.end - self.corner),
            ]
        )

    @property
    def is_straight(self) -> bool:
        """Whether both moves are one straight line."""
        return bool(_measure_segment(self.corner[None], self.start, self.end)[0] <= STRAIGHT)

    def resolve(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the shares u and v of samples and how far these leave them.

        Args:
            x: (S, n) rad or m.

        Returns:
            (S,) u, (S,) v, (S,) rad or m, the axis farthest from that place.
        """
        A = np.column_stack([self.start - self.corner, self.end - self.corner])
        parts, *_ = np.linalg.lstsq(A, (x - self.corner).T, rcond=None)
        return parts[0], parts[1], np.abs(x - self.corner - parts.T @ A.T).max(axis=1)

    def measure_deviation(self, x: Array) -> Array:
        """Return (S,) rad or m by which samples leave both moves and the triangle.

        Args:
            x: (S, n) rad or m.
        """
        sides = [_measure_segment(x, self.corner, end) for end in (self.start, self.end)]
        if self.is_straight:
            return np.minimum(*sides)
        u, v, off = self.resolve(x)
        inside = (u >= -PRINTED_SHARE) & (v >= -PRINTED_SHARE)
        inside &= u / self.share[0] + v / self.share[1] <= 1.0 + PRINTED_SHARE / self.share.min()
        return np.minimum(np.minimum(*sides), np.where(inside, off, np.inf))

    @property
    def departed(self) -> float:
        """Share of one move at which a sample has visibly left the other one: more where the corner is flat or short,
        since printed joints do not tell the moves apart.
        """
        A = np.column_stack([self.start - self.corner, self.end - self.corner])
        least = float(np.linalg.svd(A, compute_uv=False)[-1])
        return max(DEPARTED, PRINTED_RAD / max(least, PRINTED_RAD))

    def measure_excess(self, arriving: Array, leaving: Array, sample_time: float) -> float:
        """Return by how much the stated shares exceed those that were driven.

        Args:
            arriving: (A, n) rad or m, samples up to the corner.
            leaving: (L, n) rad or m, samples from the corner on, in reverse order.
            sample_time: s; a departure may be unseen in the samples of the onset.
        """
        excess = 0.0
        if self.is_straight:
            return excess
        departed = self.departed
        unseen = math.ceil((6.0 * departed / ONSET_JERK) ** (1.0 / 3.0) / sample_time)
        for n, x in enumerate((arriving, leaving)):
            parts = self.resolve(x)[:2]
            own, other = parts[n], parts[1 - n]
            last = int(np.flatnonzero(other <= departed)[-1]) if (other <= departed).any() else 0
            excess = max(excess, float(self.share[n] - own[max(last - unseen, 0)]))
        return excess


def list_corner_triangles(corners: RapidCorners, x: Array) -> list[CornerTriangle]:
    """Return the triangles of the corners; a neighbour that is a corner is where its moves meet.

    Args:
        corners: Rounded corners of the motion.
        x: (S, n) rad or m, samples of the motion.
    """
    at, own = dict(zip(corners.sample.tolist(), range(len(corners)), strict=True)), corners.x

    def node(row: int) -> Array:
        return np.asarray(own[at[row]] if row in at else x[min(row, len(x) - 1)])

    return [
        CornerTriangle(own[n], node(int(corners.before[n])), node(int(corners.after[n])), corners.share[n])
        for n in range(len(corners))
    ]


def check_rapid_corners(
    motion: ExportedMotion, toolpath: Toolpath, corners: RapidCorners, place: Array, passing: float
) -> list[VerificationCheck]:
    """Check the table against motion and CAM file.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        toolpath: The toolpath, points in the workpiece frame, SI.
        corners: Rounded corners (rapid_corners.csv).
        place: (C, 3) m, the tool at the corners, in the workpiece frame.
        passing: m by which the tool may pass a point.
    """
    wrong = _list_misplaced_corners(motion, toolpath, corners)
    out = [build_count_check(BETWEEN, wrong, "corners")]
    if wrong:
        return out
    x = motion.joints
    triangles = list_corner_triangles(corners, x)
    off = np.zeros(len(x))
    touched = np.zeros(len(x), bool)
    deviation = np.full(len(x), np.inf)
    excess = np.zeros(len(triangles))
    for n, triangle in enumerate(triangles):
        turn = int(corners.sample[n])
        arriving, leaving = x[corners.before[n] : turn + 1], x[turn : corners.after[n] + 1][::-1]
        excess[n] = triangle.measure_excess(arriving, leaving, motion.sample_time)
        rows = np.arange(corners.before[n], corners.after[n] + 1)
        deviation[rows] = np.minimum(deviation[rows], triangle.measure_deviation(x[rows]))
        touched[rows] = True
    off[touched] = np.degrees(deviation[touched])
    point = motion.point[corners.sample]
    whole = np.flatnonzero([_is_whole(motion, row) for row in corners.sample.tolist()])
    apart = np.full(len(whole), np.inf)
    for n, c in enumerate(whole.tolist()):
        k = round(float(point[c]))
        if 0 <= k < len(toolpath):
            apart[n] = 1e3 * max(float(np.linalg.norm(place[c] - toolpath.position[k])) - passing, 0.0)
    return [
        *out,
        build_worst_value_check(DRIVEN, "deg", off, OFF_TOLERANCE_DEG, motion.describe_row),
        build_worst_value_check(
            SHARES,
            "%",
            100.0 * np.append(excess, 0.0),
            100.0 * PRINTED_SHARE,
            lambda n: motion.describe_row(int(corners.sample[n])) if n < len(corners) else "there are none",
        ),
        build_worst_value_check(
            AT_POINTS,
            "mm",
            np.append(apart, 0.0),
            AWAY_TOLERANCE_MM,
            lambda n: f"point {point[whole[n]]:.0f}" if n < len(whole) else "there are none at points",
        ),
    ]


def _list_misplaced_corners(motion: ExportedMotion, toolpath: Toolpath, corners: RapidCorners) -> list[str]:
    """Corners with samples of another tool, beside a feed move, where the machine acts, or whose moves overlap."""
    acting = {event.index - 1 for event in toolpath.events if event.kind != "comment"}
    wrong = []
    for n, row in enumerate(corners.sample.tolist()):
        first, last = int(corners.before[n]), int(corners.after[n])
        if first < 0 or last >= len(motion.time):
            wrong.append(f"corner {n + 1}: its moves are from sample {first} to {last} of {len(motion.time)}")
            continue
        at = motion.describe_row(row)
        if (motion.move[first + 1 : last + 1] != MoveKind.RAPID).any():
            wrong.append(f"{at}: beside a move that is not rapid")
        elif np.isfinite(motion.point[row]) and round(float(motion.point[row])) in acting and _is_whole(motion, row):
            wrong.append(f"{at}: the CAM file acts there, and the machine has to stop")
        elif n and first not in (int(corners.sample[n - 1]), *range(int(corners.after[n - 1]), len(motion.time))):
            wrong.append(f"{at}: its move begins before the corner before it")
    return wrong


def _is_whole(motion: ExportedMotion, row: int) -> bool:
    """Whether a row is at a point of the toolpath; corners of a lift inside of a cut are away from it."""
    away = motion.lifted is not None and bool(motion.lifted[row])
    return not away and bool(abs(motion.point[row] - np.round(motion.point[row])) <= WHOLE)


def measure_passing_distance(motion: ExportedMotion, corners: RapidCorners, tcp: Array, toolpath: Toolpath) -> Array:
    """Return (N,) m by which the tool passes each toolpath point at a rounded corner; inf where none is rounded.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        corners: Rounded corners (rapid_corners.csv).
        tcp: (S, 3, 4) poses of the TCP in the workpiece frame.
        toolpath: The toolpath, points in the workpiece frame, SI.
    """
    out = np.full(len(toolpath), np.inf)
    place = tcp[:, :3, 3]
    for row in corners.sample.tolist():
        if not (0 < row < len(place) - 1 and np.isfinite(motion.point[row]) and _is_whole(motion, row)):
            continue
        k = round(float(motion.point[row]))
        if 0 <= k < len(toolpath):
            p = toolpath.position[k]
            near = [np.linalg.norm(_find_offsets(p[None], place[row], place[row + s])) for s in (-1, 1)]
            out[k] = min(out[k], *near)
    return out


def check_corner_contacts(
    arm: UrdfKinematics, wanted: list[tuple[CoalBody, CoalBody]], motion: ExportedMotion, corners: RapidCorners
) -> VerificationCheck:
    """Search the triangles of all corners for contacts.

    Args:
        arm: Kinematics of the URDF with the cell's tool.
        wanted: Pairs of bodies to check.
        motion: The exported motion with true angles.
        corners: Rounded corners with true angles.
    """
    x = motion.joints
    fans = [build_chords(triangle, arm) for triangle in list_corner_triangles(corners, x)]
    hits = find_polyline_contacts(arm, wanted, fans)
    named = [f"{pair} beside {motion.describe_row(int(corners.sample[n]))}" for pair, n in hits]
    return build_count_check(CORNERS_CLEAR, named, "contacts")


def build_chords(triangle: CornerTriangle, arm: UrdfKinematics) -> Array:
    """Return chords over a triangle, to and fro, (F, n) rad or m.

    Args:
        triangle: The triangle.
        arm: Kinematics of the URDF with the cell's tool.
    """
    w, base = triangle.corner, triangle.base
    places = np.array([w, base.mean(axis=0)])
    tip = arm.compute_tcp_in_workpiece(places[:, :6], places[:, 6:])[:, :3, 3]
    height = np.linalg.norm(tip[1] - tip[0]) / CHORD_M, np.abs(places[1] - places[0]).max() / CHORD_RAD
    count = max(int(np.ceil(max(height))), LEAST_CHORDS)
    chords = [w + k / count * (base - w) for k in range(count, 0, -1)]
    return np.vstack([chord[:: 1 if n % 2 == 0 else -1] for n, chord in enumerate(chords)])


def unround_motion(motion: ExportedMotion, corners: RapidCorners) -> ExportedMotion:
    """Return the motion with its samples at rounded corners moved onto the straight moves, as a program states them.

    Args:
        motion: The exported motion (trajectory.csv), SI.
        corners: Rounded corners (rapid_corners.csv).
    """
    x = motion.joints
    out = x.copy()
    for n, triangle in enumerate(list_corner_triangles(corners, x)):
        row = int(corners.sample[n])
        rows = np.arange(corners.before[n] + 1, min(int(corners.after[n]), len(x)))
        if triangle.is_straight:
            out[row] = triangle.corner
            continue
        u, v, _ = triangle.resolve(x[rows])
        inside = (u > 0.0) & (v > 0.0) & (u <= triangle.share[0]) & (v <= triangle.share[1])
        arriving = inside & (rows < row)
        leaving = inside & (rows > row)
        out[rows[arriving]] = triangle.corner + u[arriving, None] * (triangle.start - triangle.corner)
        out[rows[leaving]] = triangle.corner + v[leaving, None] * (triangle.end - triangle.corner)
        out[row] = triangle.corner
    return replace(motion, q=out[:, :6], external=out[:, 6:])


def _measure_segment(x: Array, a: Array, b: Array) -> Array:
    """(S,) distance of places (S, n) from the segment a → b, of the axis farthest away."""
    return np.asarray(np.abs(_find_offsets(x, a, b)).max(axis=1))


def _find_offsets(x: Array, a: Array, b: Array) -> Array:
    """(S, n) from the nearest places on the segment a → b to places (S, n)."""
    way = b - a
    square = float(way @ way)
    share = np.clip((x - a) @ way / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(x))
    return np.asarray(x - a - share[:, None] * way)
