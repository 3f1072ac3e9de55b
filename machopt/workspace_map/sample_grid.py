"""Samples of a map: even grids of TCP positions or of joint angles, and the extent an arm can reach."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array

MapKind = Literal["slice", "volume", "line", "joints"]
XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class SampleAxis:
    """One direction of sampling."""

    name: str  # "x", "y", "z", "s" (length along a line), or a joint's name
    unit: Literal["m", "rad"]
    values: Array  # (n,) rising evenly; n ≥ 2


@dataclass(frozen=True)
class MapSamples:
    """M samples in the order of a table: the last axis varies fastest."""

    kind: MapKind
    axes: tuple[SampleAxis, ...]
    position: Array | None = None  # (M, 3) m, TCP in the map's frame; None for joint planes
    q: Array | None = None  # (M, 6) rad; None where inverse kinematics has to find them

    def __len__(self) -> int:
        return prod(self.shape)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return tuple(len(axis.values) for axis in self.axes)


def build_even_values(low: float, high: float, step: float) -> Array:
    """Return low, low + step, … up to ``high``, which is included where the step divides the range.

    Args:
        low: first value.
        high: upper end.
        step: distance of values.
    """
    return np.asarray(low + step * np.arange(int(np.floor((high - low) / step * (1 + 1e-12) + 1e-9)) + 1), float)


def build_position_grid(kind: MapKind, axes: tuple[SampleAxis, ...], fixed: Array) -> MapSamples:
    """Return a slice or volume along frame axes.

    Args:
        kind: "slice" (two axes) or "volume" (three).
        axes: named x, y or z.
        fixed: (3,) m, the coordinates of the other axes.
    """
    mesh = np.meshgrid(*(axis.values for axis in axes), indexing="ij")
    position = np.broadcast_to(np.asarray(fixed, float), (mesh[0].size, 3)).copy()
    for axis, values in zip(axes, mesh, strict=True):
        position[:, XYZ.index(axis.name)] = values.ravel()
    return MapSamples(kind, axes, position=position)


def build_straight_line(start: Array, end: Array, count: int) -> MapSamples:
    """Return a straight path of the TCP, both ends included.

    Args:
        start: (3,) m.
        end: (3,) m.
        count: number of samples.
    """
    length = float(np.linalg.norm(np.subtract(end, start)))
    share = np.linspace(0.0, 1.0, count)
    position = np.asarray(start, float) + share[:, None] * np.subtract(end, start)
    return MapSamples("line", (SampleAxis("s", "m", share * length),), position=position)


def build_joint_grid(axes: tuple[SampleAxis, ...], joints: tuple[int, ...], fixed: Array) -> MapSamples:
    """Return a grid of one or two varied joints, the others fixed.

    Args:
        axes: the angles of the varied joints.
        joints: their numbers, 0 … 5.
        fixed: (6,) rad, a posture.
    """
    mesh = np.meshgrid(*(axis.values for axis in axes), indexing="ij")
    q = np.broadcast_to(np.asarray(fixed, float), (mesh[0].size, 6)).copy()
    for joint, values in zip(joints, mesh, strict=True):
        q[:, joint] = values.ravel()
    return MapSamples("joints", axes, q=q)


def compute_farthest_reach(robot: Robot, T_flange_tcp: Array) -> tuple[Array, float]:
    """Return a ball that contains every position of the TCP: centre (3,) m in base_link and radius in m.

    The polyline from a point on axis 1 over a point on each axis to the TCP is a chain of rigid pieces; no posture
    reaches farther than their sum.

    Args:
        robot: kinematic model.
        T_flange_tcp: (4, 4) TCP relative to the flange.
    """
    tcp = (robot.T_base_flange_zero @ T_flange_tcp)[:3, 3]
    pieces = np.linalg.norm(np.diff(np.vstack([robot.point, tcp]), axis=0), axis=1)
    return robot.point[0], float(pieces.sum())


def trim_axis(values: Array, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the part of a coarse axis to sample finely: used values and one more step on either side.

    Args:
        values: (n,) increasing.
        used: (n,) True where something was found.

    Returns:
        Lowest and highest; the whole axis where nothing was found.
    """
    found = np.flatnonzero(used)
    if not len(found):
        return float(values[0]), float(values[-1])
    return float(values[max(found[0] - 1, 0)]), float(values[min(found[-1] + 1, len(values) - 1)])
