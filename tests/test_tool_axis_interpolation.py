"""Tool axis between two points: one rule for planner, verifier and programs (docs/conventions.md)."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.numerics import rigid_transforms
from machopt.planning.stations.planning_path import build_planning_path
from machopt.verification.motion.path_geometry import axis_interpolation


def random_axes(count: int, seed: int) -> np.ndarray:
    axes = np.random.default_rng(seed).normal(size=(count, 3))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("interpolate", [rigid_transforms.interpolate_axis, axis_interpolation.interpolate_axis])
def test_axis_rotates_uniformly_in_the_plane_of_both_ends(interpolate: object) -> None:
    start, end = random_axes(200, 1), random_axes(200, 2)
    share = np.random.default_rng(3).random(200)
    found = interpolate(start, end, share)  # type: ignore[operator]
    for a, b, f, axis in zip(start, end, share, found, strict=True):
        normal = np.cross(a, b)
        angle = np.arctan2(np.linalg.norm(normal), a @ b)
        turn = Slerp([0.0, 1.0], Rotation.from_rotvec([np.zeros(3), normal / np.linalg.norm(normal) * angle]))
        np.testing.assert_allclose(axis, turn(f).apply(a), atol=1e-12)


@pytest.mark.parametrize("interpolate", [rigid_transforms.interpolate_axis, axis_interpolation.interpolate_axis])
def test_equal_axes_remain_unchanged(interpolate: object) -> None:
    axes = random_axes(20, 4)
    np.testing.assert_allclose(interpolate(axes, axes, np.full(20, 0.3)), axes, atol=1e-15)  # type: ignore[operator]


@pytest.mark.parametrize("angle", [5.0, 45.0, 90.0, 170.0])
@pytest.mark.parametrize("length", [0.0, 1e-4, 0.1])
def test_planned_path_rotates_the_axis_uniformly(angle: float, length: float) -> None:
    """Linear interpolation of the vector would deviate by 0.46° in the middle of a move of 45°."""
    end = np.radians(angle)
    toolpath = Toolpath(
        position=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [length, 0.0, 0.0]]),
        axis=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, np.sin(end), np.cos(end)]]),
        move=np.array([MoveKind.RAPID, MoveKind.CUT, MoveKind.CUT], np.int8),
        feed=np.array([np.nan, 0.05, 0.05]),
        operation=np.zeros(3, np.int32),
        operations=(ToolpathOperation(label="a", kind="trajectory"),),
        reference=np.full((3, 3), np.nan),
        tolerance=np.full(3, np.nan),
        line=np.arange(3, dtype=np.int32),
        events=(),
        source="made up",
        format="csv",
        sha256="",
        ignored=(),
        warnings=(),
    )
    path = build_planning_path(toolpath)
    inner = path.index > 1.0
    expected = (path.index[inner] - 1.0) * end
    np.testing.assert_allclose(np.arctan2(path.axis[inner, 1], path.axis[inner, 2]), expected, atol=1e-9)
