"""Reflectors on the flange and frames of the tracker (one for each of its stations).

Without ``targets`` a recording measures the TCP. Without ``frame`` the tracker did not move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from machopt.data_types.measurements.recording import Recording
from machopt.effects.recording.record_faults import LENGTHS
from machopt.errors import RecordingError
from machopt.kinematics.robot import Robot
from machopt.measurement import thresholds
from machopt.numerics.array_types import Array, Ints
from machopt.numerics.rigid_transforms import (
    convert_quaternion_to_matrix,
    convert_to_quaternion,
    convert_to_rotation_vector,
    skew_matrix,
)

Flags = NDArray[np.bool_]
ALIGNMENTS = 12  # iterations of the frame fit by least absolute deviations
FEWEST = 3  # non-collinear points determine a frame


def index_tracker_frames(recording: Recording) -> Ints:
    """Return the tracker station of each reading.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        (N,) station index, 0-based.
    """
    if recording.frame is None:
        return np.zeros(len(recording), np.int64)
    return np.unique(recording.frame, return_inverse=True)[1].reshape(-1).astype(np.int64)


def list_frame_labels(recording: Recording) -> list[str]:
    """Return the labels of the tracker stations.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        One label per station.
    """
    return ["1"] if recording.frame is None else [str(v) for v in np.unique(recording.frame)]


def index_reflectors(recording: Recording) -> Ints:
    """Return the reflector of each reading.

    Args:
        recording: Recording as read, or with earlier corrections applied.

    Returns:
        (N,) reflector index, 0-based.
    """
    return np.zeros(len(recording), np.int64) if recording.target is None else recording.target


def list_reflector_positions(recording: Recording, T_flange_tcp: Array) -> Array:
    """Return the nominal positions of all reflectors; the TCP if none is listed.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        (T, 3) m in the flange frame.
    """
    if not recording.targets:
        return np.asarray(T_flange_tcp[None, :3, 3])
    return np.array([t.place for t in recording.targets])


def compute_nominal_points(recording: Recording, robot: Robot, T_flange_tcp: Array) -> tuple[Array, Array]:
    """Compute the nominal positions of the measured points by forward kinematics.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        (N, 3) positions in m, and (N, 3, 3) flange orientations, both in base_link.
    """
    T_base_tcp = robot.compute_fk(recording.q, T_flange_tcp)
    R = T_base_tcp[:, :3, :3] @ T_flange_tcp[:3, :3].T
    if not recording.targets:
        return T_base_tcp[:, :3, 3], R
    offset = list_reflector_positions(recording, T_flange_tcp)[index_reflectors(recording)] - T_flange_tcp[:3, 3]
    return T_base_tcp[:, :3, 3] + np.einsum("nij,nj->ni", R, offset), R


def build_frame_and_reflector_columns(recording: Recording, p: Array, R: Array) -> Array:
    """Build the columns of the unknowns of tracker frames and reflector positions.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        p: (N, 3) nominal points, m, base_link.
        R: (N, 3, 3) flange orientations.

    Returns:
        (N, 3, P) per m and rad: translation and rotation of each frame, position of each reflector in the
        flange.
    """
    eye = np.broadcast_to(np.eye(3), R.shape)
    parts = []
    if recording.registration == "fit":
        parts += [
            _select_rows(np.concatenate([eye, -skew_matrix(p)], axis=2), rows)
            for rows in _list_group_rows(index_tracker_frames(recording))
        ]
    if recording.registration == "fit" or recording.targets:
        parts += [
            _select_rows(R, rows)
            for rows in _list_group_rows(index_reflectors(recording), max(len(recording.targets), 1))
        ]
    return np.concatenate(parts, axis=2) if parts else np.zeros((len(p), 3, 0))


def transform_to_base(recording: Recording, robot: Robot, T_flange_tcp: Array) -> tuple[Recording, tuple[str, ...]]:
    """Transform measured poses to base_link if the tracker frame is free, and report the frame.

    Nothing is done if a single frame already lies close to base_link: the base unknowns absorb the rest. A scale
    factor of lengths is not removed; the check of units finds it.

    Args:
        recording: Recording as read, or with earlier corrections applied.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The recording (unchanged if nothing was done), and notes.

    Raises:
        InputError: The points of a tracker station do not determine its frame.
    """
    if recording.kind != "absolute" or recording.registration != "fit" or recording.position is None:
        return recording, ()
    p, _ = compute_nominal_points(recording, robot, T_flange_tcp)
    stand, names = index_tracker_frames(recording), list_frame_labels(recording)
    several = len(names) > 1
    x, out, notes = recording.position, recording.position.copy(), []
    turned = None if recording.quaternion is None else recording.quaternion.copy()
    for n, rows in enumerate(_list_group_rows(stand)):
        if several:
            _check_frame_is_determined(recording, x[rows], names[n])
        scale = _estimate_length_factor(x[rows], p[rows])
        turn, shift = fit_rigid_transform(scale * x[rows], p[rows])
        angle, distance = float(np.linalg.norm(convert_to_rotation_vector(turn))), float(np.linalg.norm(shift))
        is_close = angle < thresholds.LIMITS.large_rotation and distance < thresholds.LIMITS.lever
        if is_close and not several:
            return recording, ()
        out[rows] = (scale * x[rows] @ turn.T + shift) / scale
        if turned is not None:
            turned[rows] = convert_to_quaternion(turn @ convert_quaternion_to_matrix(turned[rows]))
        position = ", ".join(f"{1e3 * v:.1f}" for v in shift)
        name = f"stand {names[n]} of the tracker" if several else "the tracker"
        notes.append(
            f"{name}: its frame lies at ({position}) mm in base_link, turned by {np.degrees(angle):.2f}°, "
            "and is refitted"
        )
    return replace(recording, position=out, quaternion=turned), tuple(notes)


def register_positions(recording: Recording, robot: Robot, T_flange_tcp: Array) -> Recording:
    """Transform positions to base_link if the tracker frame is free, for any rotation (Kabsch, robust).

    Args:
        recording: Recording as read, or with earlier corrections applied.
        robot: Kinematic model of the arm.
        T_flange_tcp: (4, 4) pose of the TCP in the flange frame, m.

    Returns:
        The recording with registered positions.
    """
    if recording.kind != "absolute" or recording.registration != "fit" or recording.position is None:
        return recording
    p, _ = compute_nominal_points(recording, robot, T_flange_tcp)
    out = recording.position.copy()
    for rows in _list_group_rows(index_tracker_frames(recording)):
        turn, shift = fit_rigid_transform(recording.position[rows], p[rows])
        out[rows] = recording.position[rows] @ turn.T + shift
    return replace(recording, position=out)


def fit_rigid_transform(x: Array, p: Array) -> tuple[Array, Array]:
    """Fit a rotation and a translation of points x to points p by least absolute deviations (reweighted Kabsch).

    Args:
        x: (n, 3) points to transform, m.
        p: (n, 3) target points, m.

    Returns:
        Rotation (3, 3) and translation (3,) m.
    """
    weight, turn, shift = np.ones(len(p)), np.eye(3), np.zeros(3)
    for _ in range(ALIGNMENTS):
        w = weight / weight.sum()
        a, b = w @ x, w @ p
        from_a, from_b = x - a, p - b
        U, _, Vt = np.linalg.svd((w[:, None] * from_a).T @ from_b)
        turn = Vt.T @ U.T
        if _compute_determinant(turn) < 0.0:  # a mirror image: the nearest rotation is another one
            turn = (Vt.T * (1.0, 1.0, -1.0)) @ U.T
        shift = b - turn @ a
        left = from_a @ turn.T - from_b
        size = np.sqrt(np.einsum("ni,ni->n", left, left))
        weight = 1.0 / np.maximum(size, max(0.1 * _compute_median(size), 1e-9))
    return turn, shift


def _compute_determinant(M: Array) -> float:
    """Determinant of a (3, 3) matrix; NumPy's takes longer for its checks."""
    (a, b, c), (d, e, f), (g, h, i) = M.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def _compute_median(values: Array) -> float:
    """Median of (n,) values as NumPy's, which takes longer for its choices than for a hundred values."""
    high = len(values) // 2
    low = high if len(values) % 2 else high - 1
    part = np.partition(values, (low, high, len(values) - 1))
    return float("nan") if np.isnan(part[-1]) else float(0.5 * (part[low] + part[high]))


def _estimate_length_factor(x: Array, p: Array) -> float:
    """Return the factor that makes the spread of the points equal to that of the arm's points; 1 if none does."""
    spread = [float(np.median(np.linalg.norm(v - np.median(v, axis=0), axis=1))) for v in (x, p)]
    ratio = spread[1] / max(spread[0], 1e-300)
    return next((f for f in (1.0, *LENGTHS.values()) if abs(ratio / f - 1.0) < thresholds.SHARES.load_tolerance), 1.0)


def _check_frame_is_determined(recording: Recording, x: Array, name: str) -> None:
    extent = np.linalg.svd(x - x.mean(axis=0), compute_uv=False) if len(x) >= FEWEST else np.zeros(3)
    if extent[1] <= thresholds.SHARES.negligible * extent[0]:
        raise RecordingError(
            f"frame {name} has {len(x)} reading{'' if len(x) == 1 else 's'}"
            f"{', all on one line' if len(x) >= FEWEST else ''}, which do not fix the place of the tracker; expected "
            f"{FEWEST} points or more that are not on one line, or leave these rows out",
            file=recording.source,
        )


def _list_group_rows(label: Ints, count: int = 0) -> list[Flags]:
    return [label == n for n in range(count or int(label.max()) + 1)]


def _select_rows(columns: Array, rows: Flags) -> Array:
    return columns if rows.all() else columns * rows[:, None, None]
