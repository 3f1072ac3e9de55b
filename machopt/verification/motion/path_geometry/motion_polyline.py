"""Polyline of the motion: its samples, and the corners of the commanded path that lie between two of them.

A control sample every 12 ms or more rarely lies on a corner of the path. The straight chord between the samples
before and after it cuts the corner off by up to half of their distance. The motion itself passes the corner; a
separate check proves that it keeps to the path (:mod:`machopt.verification.motion.checks.path_following`).

Where points are denser than the tolerance of the path, a motion that rounds them may be at one point while its samples
already state the next. A corner therefore belongs to the chord that passes it best within twice that tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machopt.data_types.toolpath import MoveKind, Toolpath
from machopt.numerics.array_types import Array
from machopt.verification.motion.path_geometry.nearest_chords import find_nearest_chords
from machopt.verification.motion.path_geometry.sample_location import AXIS_LEVER_M, PATH_MM
from machopt.verification.tables.exported_tables import ExportedMotion

CHORD_TOLERANCE_M = 5e-6  # m: a corner nearer than this to the chord between its samples is left out
CHORD_TOLERANCE_RAD = float(np.radians(0.01))  # rad, the same of the tool axis
INDEX_TOLERANCE = 1e-6  # of an index, which is printed with six decimals
# m along the motion: a rounded point is within the tolerance of its place, and so are the samples that state it
LOCATION_REACH_M = 2.0 * (1e-3 * PATH_MM)


@dataclass(frozen=True, kw_only=True)
class CommandedPath:
    """Corners that the motion passes, and their poses by the controller's own kinematics."""

    toolpath: Toolpath
    index: Array  # (P,) fractional toolpath index of each corner, not falling
    position: Array  # (P, 3) m in workpiece
    offset: Array  # (S, 3) m from where nominal kinematics put the tool to where it truly is, at the motion's samples
    tilt: Array  # (S, 3) what is to be added to the tool axis (tip to shank) for the same reason


@dataclass(frozen=True, kw_only=True)
class MotionPolyline:
    """Polyline of V vertices in order of time."""

    position: Array  # (V, 3) m, of the TCP in the workpiece
    rotation: Array  # (V, 3, 3) of the TCP in the workpiece
    joints: Array  # (V, n) rad or m, joints and external axes
    sample: Array  # (V,) fractional index of the sample, rising

    def convert_to_sample(self, at: Array) -> Array:
        """Convert fractional vertices to fractional samples; NaN stays NaN.

        Args:
            at: (K,) fractional vertices.
        """
        return np.asarray(np.interp(at, np.arange(len(self.sample)), self.sample))


def build_motion_polyline(
    motion: ExportedMotion, tcp: Array, driven: Array, path: CommandedPath | None
) -> MotionPolyline:
    """Build the polyline of a motion.

    Args:
        motion: trajectory.csv, S samples.
        tcp: (S, 3, 4) their poses in the workpiece.
        driven: (S, n) rad or m.
        path: None: the samples alone.
    """
    rows = np.arange(len(tcp), dtype=float)
    own = MotionPolyline(
        position=np.ascontiguousarray(tcp[:, :3, 3]),
        rotation=np.ascontiguousarray(tcp[:, :3, :3]),
        joints=driven,
        sample=rows,
    )
    if path is None or len(tcp) < 2:
        return own
    before, corner = _find_corners(motion, path)
    T, share = _compute_corner_poses(tcp, path, before, corner)
    keep = _is_off_chord(tcp, T, before, share)
    before, share, T, corner = before[keep], share[keep], T[keep], corner[keep]
    if not len(T):
        return own
    nearest = find_nearest_chords(
        np.ascontiguousarray(tcp),
        np.ascontiguousarray(T),
        before,
        AXIS_LEVER_M,
        LOCATION_REACH_M,
        0.5 * CHORD_TOLERANCE_M,
    )
    if (nearest != before).any():
        before = np.maximum.accumulate(nearest)
        T, share = _compute_corner_poses(tcp, path, before, corner)
        keep = _is_off_chord(tcp, T, before, share)
        before, share, T = before[keep], share[keep], T[keep]
    sample = before + share
    order = np.argsort(np.concatenate([rows, sample]), kind="stable")
    between = driven[before] + share[:, None] * (driven[before + 1] - driven[before])
    return MotionPolyline(
        position=np.concatenate([own.position, T[:, :3, 3]])[order],
        rotation=np.concatenate([own.rotation, T[:, :3, :3]])[order],
        joints=np.concatenate([driven, between])[order],
        sample=np.concatenate([rows, sample])[order],
    )


def _find_corners(motion: ExportedMotion, path: CommandedPath) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The sample before each corner that lies strictly between two samples on the path, and the corner's number."""
    s, fed = motion.point, motion.move != MoveKind.RAPID
    a = np.flatnonzero(np.isfinite(s[:-1]) & np.isfinite(s[1:]) & (s[1:] >= s[:-1]) & (fed[:-1] | fed[1:]))
    first = np.searchsorted(path.index, s[a] + INDEX_TOLERANCE, side="right")
    count = np.maximum(np.searchsorted(path.index, s[a + 1] - INDEX_TOLERANCE, side="left") - first, 0)
    nth = np.repeat(np.arange(len(a)), count)
    corner = first[nth] + np.arange(len(nth)) - np.repeat(np.cumsum(count) - count, count)
    toward = np.clip(np.ceil(path.index[corner] - INDEX_TOLERANCE).astype(int), 0, len(path.toolpath) - 1)
    led = (path.toolpath.move[toward] != MoveKind.RAPID) | (
        path.toolpath.move[np.minimum(toward + 1, len(path.toolpath) - 1)] != MoveKind.RAPID
    )
    return a[nth][led], corner[led]


def _compute_corner_poses(
    tcp: Array, path: CommandedPath, before: NDArray[np.intp], corner: NDArray[np.intp]
) -> tuple[Array, Array]:
    """(C, 4, 4) poses at the corners by the controller's kinematics, and (C,) shares of the chord."""
    T = np.tile(np.eye(4), (len(corner), 1, 1))
    if not len(corner):
        return T, np.empty(0)
    offset = 0.5 * (path.offset[before] + path.offset[before + 1])
    tilt = 0.5 * (path.tilt[before] + path.tilt[before + 1])
    T[:, :3, 3] = path.position[corner] - offset
    last = len(path.toolpath) - 1
    low = np.clip(np.floor(path.index[corner] + INDEX_TOLERANCE).astype(int), 0, last)
    whole = np.abs(path.index[corner] - low) <= INDEX_TOLERANCE
    ways = np.stack([np.linalg.norm(T[:, :3, 3] - tcp[before + k, :3, 3], axis=1) for k in (0, 1)])
    share = np.where(ways.sum(axis=0) > 0.0, ways[0] / np.maximum(ways.sum(axis=0), 1e-300), 0.5)
    share = _sort_shares(before, share)
    start, end = (Rotation.from_matrix(tcp[before + k, :3, :3]) for k in (0, 1))
    R = start * Rotation.from_rotvec(share[:, None] * (start.inv() * end).as_rotvec())
    # a corner of the path is a toolpath point, whose axis is known; a corner of the shift alone turns nothing
    shank = np.where(whole[:, None], path.toolpath.axis[low] - tilt, -R.apply([0.0, 0.0, 1.0]))
    T[:, :3, :3] = _tilt_rotations(R, -shank)
    return T, share


def _sort_shares(before: NDArray[np.intp], share: Array) -> Array:
    """Shares (C,) of the same chord in the order of the corners."""
    out = share.copy()
    for k in range(1, len(out)):
        if before[k] == before[k - 1]:
            out[k] = max(out[k], out[k - 1])
    return out


def _tilt_rotations(R: Rotation, z: Array) -> Array:
    """(C, 3, 3) rotations turned by the smallest angle so that their third axis is along z (C, 3)."""
    now = R.apply([0.0, 0.0, 1.0])
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    normal = np.cross(now, z)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", now, z))
    turn = Rotation.from_rotvec(normal * (angle / np.where(sine > 1e-15, sine, 1.0))[:, None])
    return np.asarray((turn * R).as_matrix())


def add_corrections(T: Array, offset: Array, tilt: Array) -> Array:
    """Return poses (M, 4, 4) by nominal kinematics moved to where the tool truly is.

    Args:
        T: (M, 4, 4) poses of the TCP in the workpiece frame.
        offset: (M, 3) m to be added to the position.
        tilt: (M, 3) to be added to the tool axis (tip to shank).
    """
    out = T.copy()
    out[:, :3, 3] += offset
    turned = np.flatnonzero(np.abs(tilt).max(axis=1) > 0.0)
    if len(turned):
        out[turned, :3, :3] = _tilt_rotations(Rotation.from_matrix(T[turned, :3, :3]), T[turned, :3, 2] - tilt[turned])
    return out


def _is_off_chord(tcp: Array, T: Array, before: NDArray[np.intp], share: Array) -> NDArray[np.bool_]:
    """(C,) True where the chord between the samples misses the corner."""
    a, b, f = tcp[before], tcp[before + 1], share[:, None]
    place = np.linalg.norm((1.0 - f) * a[:, :3, 3] + f * b[:, :3, 3] - T[:, :3, 3], axis=1)
    axis = np.linalg.norm((1.0 - f) * a[:, :3, 2] + f * b[:, :3, 2] - T[:, :3, 2], axis=1)
    return np.asarray((place > CHORD_TOLERANCE_M) | (axis > CHORD_TOLERANCE_RAD))
