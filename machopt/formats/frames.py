"""Coordinate systems that change inside one file, brought into the first one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machopt.domain.toolpath import Array
from machopt.formats.pathbuilder import Vector

ORTHONORMAL = 1e-3  # axes printed with four decimals are that far from orthonormal


class FrameError(ValueError):
    """The axes of a coordinate system are not orthonormal; the reader adds file and line."""


@dataclass(frozen=True)
class Frame:
    """p_abs = R p + t, as a file prints it (mm)."""

    R: Array  # (3, 3)
    t: Array  # (3,)

    def __post_init__(self) -> None:
        if not np.isfinite(self.R).all() or np.abs(self.R.T @ self.R - np.eye(3)).max() > ORTHONORMAL:
            raise FrameError("the axes are not unit vectors at right angles")
        if np.linalg.det(self.R) < 0.0:
            raise FrameError("the axes are left-handed")

    def same_as(self, other: Frame) -> bool:
        return bool(np.allclose(self.R, other.R, atol=1e-6) and np.allclose(self.t, other.t, atol=1e-6))

    def __str__(self) -> str:
        rows = np.column_stack([self.R, self.t])
        return "; ".join(" ".join(f"{v:.7g}" for v in row) for row in rows)


@dataclass(frozen=True)
class Transfer:
    """Points of a later system in the first one: p₁ = R₁ᵀ(R p + t − t₁)."""

    R: Array
    t: Array

    @classmethod
    def between(cls, first: Frame, later: Frame) -> Transfer:
        return cls(first.R.T @ later.R, first.R.T @ (later.t - first.t))

    def point(self, p: Vector) -> Vector:
        x, y, z = (self.R @ np.array(p) + self.t).tolist()
        return x, y, z

    def points(self, p: Array) -> Array:
        return np.asarray(p @ self.R.T + self.t)

    def direction(self, d: Vector) -> Vector:
        x, y, z = (self.R @ np.array(d)).tolist()
        return x, y, z
