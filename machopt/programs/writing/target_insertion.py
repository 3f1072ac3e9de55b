"""Selection of way points so that the controller's interpolation follows the motion within a tolerance.

Between two Cartesian targets a controller moves the tool tip on a straight line, rotates the tool at a constant rate
about one axis, and moves rails and positioners in proportion. The planned motion is known by its samples. Where they
leave that line, the sample with the largest deviation becomes a target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_axis_rotation

SHORT = 1e-4  # m; on a shorter line the position does not determine the rotation
AXIS_LEVER = 0.0229  # m/rad: 0.02 mm of place and 0.05° of the tool axis count alike
SPIN = 1e-3  # sine of the angle between tool axis and rotation axis, below which the tool axis does not move
APART = 1e-4  # m from another target: moves of a few micrometres make a controller stumble
SHARE = 0.8  # of the tolerance at the samples: between them the motion may be off a little more
AT_ONCE = 100_000  # samples


@dataclass(frozen=True)
class ProgramTolerance:
    """How far the controller's lines may leave the motion."""

    position: float = 5e-5  # m
    axis: float = float(np.radians(0.05))  # rad between the tool axes
    turn: float = float(np.radians(0.6))  # rad between the whole orientations, mostly about the tool's own axis
    external: float = 1e-3  # m or rad of an external axis: the tool's place does not hang on it, only the arm's posture


@dataclass(frozen=True, kw_only=True)
class LineDeviation:
    """How far the samples are from the controller's lines."""

    sample: NDArray[np.intp]  # (K,) those that belong to a line
    move: NDArray[np.intp]  # (K,) the move whose line it is
    position: Array  # (K,) m
    axis: Array  # (K,) rad
    turn: Array  # (K,) rad
    external: Array  # (K,) m or rad, the external axis farthest off; 0 where there is none

    def worst(self) -> tuple[float, float, float]:
        """Largest distance (m), angle between tool axes and between orientations (rad)."""
        return tuple(float(v.max(initial=0.0)) for v in (self.position, self.axis, self.turn))  # type: ignore[return-value]

    def share(self, tolerance: ProgramTolerance) -> Array:
        """Return the deviation as a share of the tolerance.

        Args:
            tolerance: Tolerance of position, orientation and external axes.

        Returns:
            Shares (K,); above 1 the tolerance is exceeded.
        """
        pairs = ((getattr(self, name), getattr(tolerance, name)) for name in ("position", "axis", "turn", "external"))
        parts = [off / most for off, most in pairs]
        return np.asarray(np.max(parts, axis=0))


def measure_line_deviation(
    T: Array,
    targets: Array,
    at: Array,
    linear: NDArray[np.bool_],
    samples: NDArray[np.intp] | None = None,
    external: tuple[Array, Array] | None = None,
) -> LineDeviation:
    """Samples of a motion against the straight lines between the targets of a program.

    Each sample is compared with the controller's pose at the same share of the line, not at the same time, which is a
    matter of feed. The share follows from the place, or from the tool axis where that moves more (a corner of the
    tool axis).

    Args:
        T: (S, 4, 4) poses of the tool at the samples, in any fixed frame.
        targets: (M, 4, 4) at the ends of the moves, in the same frame.
        at: (M,) place of each target among the samples, fractional, not falling.
        linear: (M,) True where the move is a straight line.
        samples: those to look at; all by default.
        external: (S, E) and (M, E) rad or m, external joints at samples and targets.

    Invalid for: corner rounding and curves that the controller draws by itself (SPL); they come on top.
    """
    rows = np.arange(len(T)) if samples is None else samples
    move = np.searchsorted(at, rows, side="left")
    inside = (move > 0) & (move < len(at))
    inside[inside] = linear[move[inside]]
    rows, move = rows[inside], move[inside]
    parts = [
        compare_with_line(T[rows[k : k + AT_ONCE]], targets[move[k : k + AT_ONCE] - 1], targets[move[k : k + AT_ONCE]])
        for k in range(0, len(rows), AT_ONCE)
    ]
    off = np.vstack(parts) if parts else np.empty((0, 4))
    aside = np.zeros(len(rows))
    if external is not None and external[0].shape[1]:
        driven, ends = external
        even = ends[move - 1] + off[:, 3:] * (ends[move] - ends[move - 1])
        aside = np.abs(driven[rows] - even).max(axis=1)
    return LineDeviation(sample=rows, move=move, position=off[:, 0], axis=off[:, 1], turn=off[:, 2], external=aside)


def insert_targets(
    T: Array,
    targets: Array,
    at: Array,
    linear: NDArray[np.bool_],
    tolerance: ProgramTolerance,
    external: tuple[Array, Array] | None = None,
) -> NDArray[np.intp]:
    """Select samples to become targets so that all samples keep to the lines.

    Args:
        T: Poses of the samples (K, 4, 4), m.
        targets: As in :func:`measure_line_deviation`.
        at: As in :func:`measure_line_deviation`.
        linear: As in :func:`measure_line_deviation`.
        tolerance: Tolerance of position, orientation and external axes.
        external: As in :func:`measure_line_deviation`; None without external axes.

    Returns:
        Ascending sample indices (A,). Where no sample is left to add, the deviation remains. Nothing is added
        within 0.1 mm of another target, unless the tool mainly rotates there.
    """
    added: list[NDArray[np.intp]] = []
    samples: NDArray[np.intp] = np.arange(len(T))
    while len(samples):
        off = measure_line_deviation(T, targets, at, linear, samples, external)
        share = off.share(tolerance)
        here = T[off.sample, :3, 3]
        ends = np.stack([np.linalg.norm(here - targets[off.move - k, :3, 3], axis=-1) for k in (0, 1)])
        turning = _find_pure_rotations(targets[off.move - 1], targets[off.move])
        free = ((ends > APART).all(axis=0) | turning) & ~np.isin(off.sample, at)  # no target twice
        bad = np.flatnonzero((share > SHARE) & free)
        order = bad[np.lexsort((share[bad], off.move[bad]))]
        last = np.append(np.diff(off.move[order]) > 0, True)[: len(order)]
        worst = order[last]  # of each move
        rows = off.sample[worst]
        if not len(rows):
            break
        samples = off.sample[np.isin(off.move, off.move[worst])]
        added.append(rows)
        place = off.move[worst]  # before the target that ends the move
        at, linear = np.insert(at, place, rows), np.insert(linear, place, True)
        targets = np.insert(targets, place, T[rows], axis=0)
        if external is not None:
            external = external[0], np.insert(external[1], place, external[0][rows], axis=0)
    return np.sort(np.concatenate(added)) if added else np.empty(0, np.intp)


def _find_pure_rotations(A: Array, B: Array) -> NDArray[np.bool_]:
    """(K,) True where the tool turns about its tip rather than travels from A to B."""
    way, turn = (np.linalg.norm(B[:, :3, c] - A[:, :3, c], axis=-1) for c in (3, 2))
    return np.asarray((way < SHORT) | (AXIS_LEVER * turn > way))


def compare_with_line(T: Array, A: Array, B: Array) -> Array:
    """Compare poses with the straight lines A → B.

    Args:
        T: Poses of the samples (K, 4, 4), m.
        A: Start pose of each line (K, 4, 4), m.
        B: End pose of each line (K, 4, 4), m.

    Returns:
        (K, 4): deviations in m, rad and rad, and the share of the line.
    """
    p, start = T[:, :3, 3], A[:, :3, 3]
    way = B[:, :3, 3] - start
    length2 = np.sum(way * way, axis=-1)
    share = np.sum((p - start) * way, axis=-1) / np.where(length2 > 0.0, length2, 1.0)
    share = np.clip(share, 0.0, 1.0)
    axis, angle = _compute_axis_angle(np.swapaxes(A[:, :3, :3], -1, -2) @ B[:, :3, :3])
    turned, arc = _compute_turn_share(A, T, axis, angle)
    by_turn = AXIS_LEVER * arc > np.sqrt(length2)
    share = np.where(by_turn, turned, share)
    gap = np.linalg.norm(p - start - share[:, None] * way, axis=-1)
    share = np.where(length2 < SHORT**2, turned, share)  # the position does not determine the rotation there
    R = A[:, :3, :3] @ compute_axis_rotation(axis, share * angle)
    z = np.linalg.norm(R[:, :, 2] - T[:, :3, 2], axis=-1)
    return np.column_stack([gap, 2.0 * np.arcsin(np.clip(z / 2.0, 0.0, 1.0)), _compute_angle(R, T[:, :3, :3]), share])


def _compute_turn_share(A: Array, T: Array, axis: Array, angle: Array) -> tuple[Array, Array]:
    """How far a rotation about one axis has come, by where the tool axis is.

    Args:
        A: (K, 4, 4) poses where it starts, T (K, 4, 4) now.
        axis: (K, 3) unit, of the rotation, in the frame of A; ``angle`` (K,) rad of the whole rotation.

    Returns:
        (K,) share, 0 to 1; (K,) rad, length of the arc that the tool axis moves along.
    """
    z = np.einsum("kji,kj->ki", A[:, :3, :3], T[:, :3, 2])
    start = np.array([0.0, 0.0, 1.0]) - axis[:, 2:] * axis
    now = z - np.sum(z * axis, axis=-1, keepdims=True) * axis
    radius = np.linalg.norm(start, axis=-1)
    done = np.arctan2(np.sum(axis * np.cross(start, now), axis=-1), np.sum(start * now, axis=-1))
    done = np.where(radius > SPIN, done, _compute_angle(A[:, :3, :3], T[:, :3, :3]))
    return np.clip(done / np.where(angle > 1e-12, angle, 1.0), 0.0, 1.0), angle * radius


def _compute_angle(R0: Array, R1: Array) -> Array:
    """Angle between rotations (..., 3, 3), exact for small ones: |R0 − R1| = √8 sin(θ/2)."""
    chord = np.linalg.norm(R0 - R1, axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.clip(chord, 0.0, 1.0)))


def _compute_axis_angle(R: Array) -> tuple[Array, Array]:
    """Axis (K, 3) and angle (K,) of rotations that are no half turn."""
    v = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=-1)
    sine = np.linalg.norm(v, axis=-1)
    angle = np.arctan2(sine, np.trace(R, axis1=1, axis2=2) - 1.0)
    safe = np.where(sine > 1e-15, sine, 1.0)
    return np.asarray(np.where(sine[:, None] > 1e-15, v / safe[:, None], [0.0, 0.0, 1.0])), np.asarray(angle)
