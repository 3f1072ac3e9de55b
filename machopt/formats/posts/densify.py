"""Way points close enough that what a controller draws between them is the plan, within a stated tolerance.

Between two targets a controller moves the tool tip on a straight line and turns it evenly about one axis (LIN), or
moves every joint evenly (PTP, servoj, a joint trajectory). The plan q(s) does neither exactly. Each stretch is halved
until the plan stays within the tolerances of the controller's line at eight places of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.se3 import axis_rotation

Array = NDArray[np.float64]

MOST_HALVINGS = 16
PROBES = (np.arange(8) + 0.5) / 8  # where a stretch is compared with the plan
SHARE = 0.8  # of the tolerance allowed at the probes: between them the deviation may be a little larger


@dataclass(frozen=True)
class Tolerance:
    """How far the controller's line may leave the plan."""

    position: float = 2e-5  # m
    angle: float = float(np.radians(0.02))  # rad


@dataclass(frozen=True)
class Densified:
    """Parameters of the way points, old and new, and how far the controller's motion is from the plan."""

    s: Array  # (W,) rising
    added: NDArray[np.bool_]  # (W,) True where a point was put in
    position_error: float  # m, largest at the probes
    angle_error: float  # rad
    complete: bool  # False: a stretch was halved as often as allowed and still leaves the plan


def densify(
    q_of_s: Callable[[Array], Array], s: Array, fk: Callable[[Array], Array],
    tolerance: Tolerance | None = None, interpolation: Literal["lin", "joint"] = "lin",
) -> Densified:  # fmt: skip
    """Add way points until the controller's interpolation keeps to the plan.

    The position is compared with the nearest point of the controller's line, because where on the line the robot is at
    a time is a matter of feed; the orientation with the one the controller has there.

    Args:
        q_of_s: the plan, (N, 6) rad at parameters (N,).
        s: (W,) strictly rising parameters of the way points, W ≥ 2.
        fk: poses (N, 4, 4) of the tool in any fixed frame.
        tolerance: position and angle.
        interpolation: what the controller does between the points.

    Raises:
        ValueError: ``s`` does not rise.

    Invalid for: corner rounding and curves that the controller draws by itself (SPL); they come on top.
    """
    tolerance = tolerance or Tolerance()
    s = np.asarray(s, float)
    if len(s) < 2 or not (np.diff(s) > 0).all():
        raise ValueError("the way points' parameters must rise, at least two of them")
    points, added = s.copy(), np.zeros(len(s), bool)
    open_stretch = np.ones(len(s) - 1, bool)
    done = np.zeros((len(s) - 1, 2))  # deviations of each stretch, once they are known
    for halvings in range(MOST_HALVINGS + 1):
        at = np.flatnonzero(open_stretch)
        done[at] = _deviation(q_of_s, points[at], points[at + 1], fk, interpolation)
        bad = at[(done[at, 0] > SHARE * tolerance.position) | (done[at, 1] > SHARE * tolerance.angle)]
        open_stretch[:] = False
        if not len(bad) or halvings == MOST_HALVINGS:
            open_stretch[bad] = True
            break
        middle = (points[bad] + points[bad + 1]) / 2.0
        points, added = np.insert(points, bad + 1, middle), np.insert(added, bad + 1, True)
        done = np.insert(done, bad + 1, 0.0, axis=0)
        open_stretch = np.insert(open_stretch, bad + 1, True)
        open_stretch[bad + np.arange(len(bad))] = True  # the first halves; each insertion moved the later ones on
    worst = done.max(axis=0)
    return Densified(points, added, float(worst[0]), float(worst[1]), not open_stretch.any())


def _deviation(
    q_of_s: Callable[[Array], Array], a: Array, b: Array, fk: Callable[[Array], Array], interpolation: str
) -> Array:  # fmt: skip
    """(K, 2) m and rad: largest deviations on the K stretches a…b."""
    n, probes = len(a), len(PROBES)
    places = a[:, None] + (b - a)[:, None] * PROBES
    q_plan = q_of_s(places.ravel())
    T_plan = fk(q_plan).reshape(n, probes, 4, 4)
    q_a, q_b = q_of_s(a), q_of_s(b)
    if interpolation == "joint":
        q_line = q_a[:, None] + (q_b - q_a)[:, None] * PROBES[:, None]
        T_line = fk(q_line.reshape(-1, 6)).reshape(n, probes, 4, 4)
        gap = np.linalg.norm(T_plan[..., :3, 3] - T_line[..., :3, 3], axis=-1)
        return np.stack([gap.max(axis=1), _angle(T_plan[..., :3, :3], T_line[..., :3, :3]).max(axis=1)], axis=-1)
    T_a, T_b = fk(q_a), fk(q_b)
    p = T_plan[..., :3, 3]
    start, way = T_a[:, None, :3, 3], (T_b - T_a)[:, None, :3, 3]
    length2 = np.sum(way * way, axis=-1)
    # on a stretch that only turns there is no place on the line to go by: the share of the parameter is taken
    turning = length2 < 1e-16
    share = np.where(turning, PROBES, np.sum((p - start) * way, axis=-1) / np.where(turning, 1.0, length2))
    share = np.clip(share, 0.0, 1.0)
    gap = np.linalg.norm(p - start - share[..., None] * way, axis=-1)
    turn = np.swapaxes(T_a[:, :3, :3], -1, -2) @ T_b[:, :3, :3]
    axis, angle = _axis_angle(turn)
    partial = axis_rotation(axis[:, None], share * angle[:, None])
    R_line = T_a[:, None, :3, :3] @ partial
    return np.stack([gap.max(axis=1), _angle(T_plan[..., :3, :3], R_line).max(axis=1)], axis=-1)


def _angle(R0: Array, R1: Array) -> Array:
    """Angle between rotations (..., 3, 3), exact for small ones: |R0 − R1| = √8 sin(θ/2)."""
    chord = np.linalg.norm(R0 - R1, axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))


def _axis_angle(R: Array) -> tuple[Array, Array]:
    """Axis (K, 3) and angle (K,) of rotations that are no half turn."""
    v = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=-1)
    sine = np.linalg.norm(v, axis=-1)
    angle = np.arctan2(sine, np.trace(R, axis1=1, axis2=2) - 1.0)
    safe = np.where(sine > 1e-15, sine, 1.0)
    return np.asarray(np.where(sine[:, None] > 1e-15, v / safe[:, None], [0.0, 0.0, 1.0])), np.asarray(angle)
