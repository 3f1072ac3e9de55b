"""Path curve of a run: tolerances, smoothness, indices of points."""

from __future__ import annotations

import numpy as np
import pytest

from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_tool_rotation
from machopt.planning.retiming.path_curve import (
    CornerTolerances,
    PathCurve,
    RunPoints,
    build_curves,
    compute_path_parameter,
)

TOLERANCE = 15e-6  # m
AXIS_TOLERANCE = np.radians(0.03)


def curves(
    position: Array, axis: Array | None = None, phi: Array | None = None, feed: float = 0.025
) -> list[PathCurve]:
    n = len(position)
    axis = np.tile([0.0, 0.0, 1.0], (n, 1)) if axis is None else axis
    phi = np.zeros(n) if phi is None else phi
    reference = np.tile([1.0, 0.0, 0.0], (n, 1))
    points = RunPoints(
        position=np.asarray(position, float), axis=axis, reference=reference, phi=phi, feed=np.full(n, feed)
    )
    made = build_curves(points, CornerTolerances(TOLERANCE, AXIS_TOLERANCE))
    assert isinstance(made, list)
    return made


def arc(n: int, step: float, radius: float) -> Array:
    t = np.arange(n) * step / radius
    return np.column_stack([radius * np.sin(t), radius * (1 - np.cos(t)), 0 * t])


def polyline_at(curve: PathCurve, u: Array) -> Array:
    return np.column_stack([np.interp(u, curve.u, curve.X[:, d]) for d in range(curve.X.shape[1])])


RNG = np.random.default_rng(4)
PATHS = {
    "right angle": np.array([[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0]]),
    "arc of 3 mm chords": arc(60, 0.003, 0.1),
    "arc of 0.3 mm chords": arc(300, 0.0003, 0.02),
    "noise of 2 µm": arc(300, 0.0003, 0.02) + RNG.uniform(-2e-6, 2e-6, (300, 3)),
    "jog of 1 µm": np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 1e-6, 0], [0.02, 1e-6, 0]]),
    "steps of any size": np.cumsum(RNG.uniform(0, 1, (80, 3)) * 10 ** RNG.uniform(-6, -2, (80, 1)), axis=0),
}


@pytest.mark.parametrize("name", PATHS)
def test_rounding_stays_within_tolerance(name: str) -> None:
    (curve,) = curves(PATHS[name])
    u = np.unique(np.concatenate([curve.nodes(), np.linspace(curve.u[0], curve.u[-1], 5000)]))
    away = curve.coordinates(u)[:, 0] - polyline_at(curve, u)
    assert np.linalg.norm(away[:, :3], axis=1).max() < 1.1 * TOLERANCE
    assert np.abs(away[[0, -1]]).max() < 1e-15


def test_tolerance_is_used_at_a_sharp_corner() -> None:
    (curve,) = curves(PATHS["right angle"])
    at_vertex = curve.coordinates(curve.u[1:2])[0, 0, :3] - PATHS["right angle"][1]
    assert np.linalg.norm(at_vertex) == pytest.approx(TOLERANCE, rel=0.05)


def test_tiny_jog_does_not_make_a_sharp_corner() -> None:
    (curve,) = curves(PATHS["jog of 1 µm"])
    assert curve.width[1:-1, 0].min() > 1e-3


def test_axis_stays_within_its_tolerance() -> None:
    n = 40
    axis = np.column_stack([0.01 * RNG.uniform(-1, 1, n), 0.01 * RNG.uniform(-1, 1, n), np.ones(n)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    (curve,) = curves(arc(n, 0.003, 0.1), axis)
    u = np.linspace(curve.u[0], curve.u[-1], 4000)
    rounded, straight = curve.coordinates(u)[:, 0, 3:6], polyline_at(curve, u)[:, 3:6]
    cos = np.sum(rounded * straight, axis=1) / np.linalg.norm(rounded, axis=1) / np.linalg.norm(straight, axis=1)
    assert np.arccos(np.clip(cos, -1, 1)).max() < 1.1 * AXIS_TOLERANCE


@pytest.mark.parametrize("name", PATHS)
def test_derivatives_are_those_of_the_curve(name: str) -> None:
    (curve,) = curves(PATHS[name])
    nodes = curve.nodes()
    h = 0.01 * np.diff(nodes).min()
    u = (nodes[:-1] + 0.37 * np.diff(nodes))[:, None] + h * np.array([-1.0, 0.0, 1.0])
    X = curve.coordinates(u.ravel()).reshape(len(u), 3, 4, -1)
    for order in range(3):
        scale = np.abs(X[:, 1, order + 1]).max() + np.abs(X[:, 1, order]).max() * 1e-9 / h
        slope = (X[:, 2, order] - X[:, 0, order]) / (2 * h)
        assert np.abs(slope - X[:, 1, order + 1]).max() < 2e-2 * scale


def test_poses_are_rotations_and_reach_the_ends() -> None:
    n = 50
    s = np.linspace(0, 1, n)
    axis = np.column_stack([0.3 * np.sin(4 * s), 0.2 * s, np.ones(n)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    phi = np.sin(3 * s)
    (curve,) = curves(arc(n, 0.002, 0.05), axis, phi)
    jets, driven = curve.jets(curve.nodes())
    R = jets.rotation[:, 0]
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() < 1e-12
    reference = np.tile([1.0, 0.0, 0.0], (n, 1))
    assert np.allclose(R[[0, -1]], compute_tool_rotation(axis, reference, phi)[[0, -1]], atol=1e-12)
    planned = np.interp(curve.index(curve.nodes()), np.arange(n), phi)
    assert np.abs(driven - planned).max() < np.radians(0.5)


def test_reversal_is_a_stop() -> None:
    made = curves(np.array([[0, 0, 0], [0.05, 0, 0], [0.02, 0, 0], [0.08, 0, 0]]))
    assert [(int(c.first[0]), int(c.last[-1])) for c in made] == [(0, 1), (1, 2), (2, 3)]


def test_repeated_points_are_merged_and_counted() -> None:
    (curve,) = curves(np.repeat(arc(10, 0.003, 0.1), 3, axis=0))
    index = curve.index(np.linspace(curve.u[0], curve.u[-1], 2000))
    assert (np.diff(index) >= 0).all()
    assert curve.last[0] == 2
    assert curve.first[-1] == 27
    assert curve.last[-1] == 29


def test_path_without_length_has_no_curve() -> None:
    assert curves(np.zeros((4, 3))) == []
    assert curves(np.zeros((1, 3))) == []


def test_opposite_axes_are_refused() -> None:
    up = np.array([[0.0, 0, 1], [0, 0, -1]])
    position, ref = np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.tile([1.0, 0, 0], (2, 1))
    feed = np.full(2, 0.02)
    points = RunPoints(position=position, axis=up, reference=ref, phi=np.zeros(2), feed=feed)
    assert build_curves(points, CornerTolerances(TOLERANCE, AXIS_TOLERANCE)) == 1


def test_path_parameter_measures_travel_and_rotation() -> None:
    position = np.array([[0.0, 0, 0], [0.3, 0, 0], [0.3, 0, 0]])
    axis, ref = np.tile([0.0, 0, 1], (3, 1)), np.tile([1.0, 0, 0], (3, 1))
    s = compute_path_parameter(position, axis, ref, np.array([0.0, 0.0, 0.1]))
    assert s[1] == pytest.approx(0.3)
    assert s[2] - s[1] == pytest.approx(0.01, rel=1e-3)
