"""Coordinate systems that change inside one file, and their transforms into the first one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_axis_rotation
from machopt.path_building.point_collector import Vector

ORTHONORMAL = 1e-3  # axes printed with four decimals are that far from orthonormal
SAME = 1e-6  # mm and sines: nearer than that, two systems are one


class FrameError(ValueError):
    """The axes of a coordinate system are not orthonormal; the reader adds file and line."""


@dataclass(frozen=True)
class CoordinateSystem:
    """p_abs = R p + t, as a file prints it (mm)."""

    R: Array  # (3, 3)
    t: Array  # (3,)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.R).all() and np.isfinite(self.t).all()):
            raise FrameError("a number of the coordinate system is not finite")
        if np.abs(self.R.T @ self.R - np.eye(3)).max() > ORTHONORMAL:
            raise FrameError("the axes are not unit vectors at right angles")
        if np.linalg.det(self.R) < 0.0:
            raise FrameError("the axes are left-handed")

    def same_as(self, other: CoordinateSystem) -> bool:
        """Return whether two coordinate systems agree within the tolerance SAME.

        Args:
            other: The other coordinate system.
        """
        return bool(np.allclose(self.R, other.R, atol=SAME) and np.allclose(self.t, other.t, atol=SAME))

    def __str__(self) -> str:
        rows = np.column_stack([self.R, self.t])
        return "; ".join(" ".join(f"{v:.7g}" for v in row) for row in rows)


@dataclass(frozen=True)
class SystemTransform:
    """Points of a later system in the first one: p₁ = R p + t (mm); R is a rotation, or one mirrored or scaled too."""

    R: Array
    t: Array

    @classmethod
    def between(cls, first: CoordinateSystem, later: CoordinateSystem) -> SystemTransform:
        """Compute the transform from a later system into the first: p₁ = R₁ᵀ(R p + t − t₁).

        Args:
            first: Target coordinate system.
            later: Source coordinate system.

        Returns:
            The transform.
        """
        return cls(first.R.T @ later.R, first.R.T @ (later.t - first.t))

    @classmethod
    def shift(cls, x: float, y: float, z: float) -> SystemTransform:
        """Build a translation.

        Args:
            x: Shift along X, mm.
            y: Shift along Y, mm.
            z: Shift along Z, mm.

        Returns:
            The transform.
        """
        return cls(np.eye(3), np.array([x, y, z]))

    @classmethod
    def rotation(cls, axis: str, angle_deg: float) -> SystemTransform:
        """Build a right-handed rotation about X, Y or Z.

        Args:
            axis: Letter of the axis.
            angle_deg: Angle, degrees.

        Returns:
            The transform.
        """
        return cls(compute_axis_turn(axis, angle_deg), np.zeros(3))

    def then(self, outer: SystemTransform) -> SystemTransform:
        """Compose with a transform that is applied after this one.

        Args:
            outer: The transform applied second.

        Returns:
            The composition.
        """
        return SystemTransform(outer.R @ self.R, outer.R @ self.t + outer.t)

    @classmethod
    def factors(cls, x: float, y: float, z: float, about: Vector = (0.0, 0.0, 0.0)) -> SystemTransform:
        """Build a scale, or for negative factors a mirror, about a point: p₁ = c + S (p − c).

        Args:
            x: Factor along X.
            y: Factor along Y.
            z: Factor along Z.
            about: Fixed point c, mm.

        Returns:
            The transform.
        """
        S, c = np.diag([x, y, z]), np.array(about)
        return cls(S, c - S @ c)

    @cached_property
    def rigid(self) -> bool:
        """Neither scaled nor mirrored."""
        return bool(np.abs(self.R.T @ self.R - np.eye(3)).max() < SAME) and float(np.linalg.det(self.R)) > 0.0

    def inverse(self) -> SystemTransform:
        orthonormal = np.abs(self.R.T @ self.R - np.eye(3)).max() < SAME
        back = np.asarray(self.R.T if orthonormal else np.linalg.inv(self.R), dtype=np.float64)
        return SystemTransform(back, -back @ self.t)

    @property
    def only_shifts(self) -> bool:
        return bool(np.abs(self.R - np.eye(3)).max() < SAME)

    @property
    def nothing(self) -> bool:
        return self.only_shifts and bool(np.abs(self.t).max() < SAME)

    @property
    def z(self) -> Vector:
        """The system's z axis in the first one."""
        return self.direction((0.0, 0.0, 1.0))

    def point(self, p: Vector) -> Vector:
        """Transform one point.

        Args:
            p: Point, mm.

        Returns:
            Transformed point, mm.
        """
        x, y, z = (self.R @ np.array(p) + self.t).tolist()
        return x, y, z

    def points(self, p: Array) -> Array:
        """Transform points.

        Args:
            p: Points (N, 3), mm.

        Returns:
            Transformed points (N, 3), mm.
        """
        return np.asarray(p @ self.R.T + self.t)

    def direction(self, d: Vector) -> Vector:
        """Transform a direction; its length stays the same.

        Args:
            d: Direction.

        Returns:
            Transformed direction.
        """
        turned = self.R @ np.array(d)
        x, y, z = turned.tolist() if self.rigid else (turned * np.linalg.norm(d) / np.linalg.norm(turned)).tolist()
        return x, y, z


def compute_axis_turn(axis: str, angle_deg: float) -> Array:
    """Compute the right-handed rotation about X, Y or Z; multiples of 90° are exact.

    Args:
        axis: Letter of the axis.
        angle_deg: Angle, degrees.

    Returns:
        Rotation (3, 3).
    """
    angle = math.radians(angle_deg)
    c, s = math.cos(angle), math.sin(angle)
    if angle_deg % 90.0 == 0.0:
        c, s = float(round(c)), float(round(s))
    if axis == "X":
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    if axis == "Y":
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def compute_rotation_about(axis: Vector, angle_deg: float) -> Array:
    """Compute the right-handed rotation about any axis.

    Args:
        axis: Direction of the axis, any length.
        angle_deg: Angle, degrees.

    Returns:
        Rotation (3, 3).

    Raises:
        FrameError: the axis is zero.
    """
    n = np.array(axis)
    length = float(np.linalg.norm(n))
    if not length > 1e-9:
        raise FrameError("the axis of a rotation is zero")
    return compute_axis_rotation(n / length, np.array(math.radians(angle_deg)))
