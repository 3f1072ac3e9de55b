"""Arcs of a robot program through three poses, divided into chords."""

from __future__ import annotations

import math

import numpy as np

from machopt.numerics.array_types import Array
from machopt.path_building.arc_chords import ArcError, compute_arc_chords
from machopt.programs.reading.rotation_conventions import interpolate_rotations

SAME_ATTITUDE = 1e-6  # of a rotation matrix: programs carry six digits at most


def compute_circle_poses(
    start: Array, via: Array, end: Array, tolerance: float, sweep_deg: float | None = None
) -> Array:
    """Poses (N, 4, 4) at the chords' ends, the first behind ``start`` and the last at ``end``.

    Args:
        start: (4, 4), where the robot is; so are ``via``, whose place alone counts, and ``end``. m.
        tolerance: m between chord and arc.
        sweep_deg: the arc ends after that angle instead, the other way round where negative (KUKA's CA).

    Raises:
        ArcError: the three points lie on a line; or, with an angle, the tool turns.
    """
    p0, p1, p2 = start[:3, 3], via[:3, 3], end[:3, 3]
    normal = np.cross(p1 - p0, p2 - p1)
    length = np.linalg.norm(normal)
    if not length > 1e-12:
        raise ArcError("the three points of an arc lie on a line")
    n = normal / length
    # the centre is equally far from all three points, in their plane
    A = np.array([p1 - p0, p2 - p0, n])
    half = np.array([(p1 @ p1 - p0 @ p0) / 2.0, (p2 @ p2 - p0 @ p0) / 2.0, n @ p0])
    try:
        centre = np.linalg.solve(A, half)
        if sweep_deg is None:
            points = compute_arc_chords(p0, p2, centre, n, tolerance).points
        else:
            if np.abs(end[:3, :3] - start[:3, :3]).max() > SAME_ATTITUDE:
                raise ArcError("an angle (CA) is read for a tool that does not turn; end the arc at its end point")
            points = _compute_swept_points(p0 - centre, n, math.radians(sweep_deg), tolerance) + centre
    except (ArcError, np.linalg.LinAlgError) as problem:
        raise ArcError(f"no arc through these points: {problem}") from None
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, :3] = interpolate_rotations(start[:3, :3], end[:3, :3], np.arange(1, len(points) + 1) / len(points))
    poses[:, :3, 3] = points
    return poses


def _compute_swept_points(spoke: Array, n: Array, angle: float, tolerance: float) -> Array:
    """(N, 3) chord ends of the arc that ``spoke`` (3,), square to ``n``, sweeps by ``angle`` (rad)."""
    radius = float(np.linalg.norm(spoke))
    if not 0.0 < abs(angle) < 1e3:
        raise ArcError(f"an arc of {math.degrees(angle):g} degrees")
    step = 2.0 * math.acos(max(1.0 - tolerance / radius, 0.0))
    t = angle * np.arange(1, (count := max(math.ceil(abs(angle) / step), 2)) + 1)[:, None] / count
    out: Array = np.cos(t) * spoke + np.sin(t) * np.cross(n, spoke)
    return out
