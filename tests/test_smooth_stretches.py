"""Smooth segments of a run: inserted points and deviation from the lines of the file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from test_retiming import make

from machopt.numerics.array_types import Array
from machopt.planning.retiming import path_curve
from machopt.planning.retiming.path_curve import CornerTolerances, build_curves
from machopt.planning.retiming.run_retiming import RunInput, RunTrajectory, retime_run
from machopt.planning.retiming.smooth_stretches import fill_smooth_stretches

TOLERANCE, LEAN = 15e-6, float(np.radians(0.03))
SCALE = np.r_[np.full(3, 1 / TOLERANCE), np.full(3, 1 / LEAN)]
RADIUS, FAST = 0.12, 0.4  # m, m/s


def circle(step: float, count: int = 200) -> Array:
    """Return points on a circle with the axis along z."""
    t = np.arange(count) * step / RADIUS
    return np.column_stack([RADIUS * np.sin(t), RADIUS * (1 - np.cos(t)), 0 * t, 0 * t, 0 * t, 1 + 0 * t])


def fill(pose: Array, feed: float = FAST) -> object:
    """Return the filled polyline."""
    u = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(pose[:, :3], axis=0), axis=1))]
    return fill_smooth_stretches(u, pose, SCALE, np.full(len(u), 0.1 * feed))


def test_added_points_are_on_the_curve() -> None:
    filled = fill(circle(0.002))
    assert filled is not None
    x, y = filled.pose[:, :2].T  # type: ignore[attr-defined]
    assert len(x) > 2 * 200
    assert np.abs(np.hypot(x, y - RADIUS) - RADIUS).max() < 1e-8  # the points themselves are exactly on it


def zigzag() -> Array:
    n = np.arange(60)
    return np.column_stack([0.002 * n, 0.002 * (n % 2), 0 * n, 0 * n, 0 * n, 1 + 0 * n]).astype(float)


def polygon() -> Array:
    t = np.repeat(np.arange(8), 6) * np.pi / 4
    step = 0.002 * np.column_stack([np.cos(t), np.sin(t)])
    place = np.cumsum(step, axis=0)
    return np.column_stack([place, 0 * t, 0 * t, 0 * t, 1 + 0 * t])


def noise() -> Array:
    pose = circle(0.002)
    centre = np.array([0.0, RADIUS])
    pose[:, :2] += (pose[:, :2] - centre) * np.random.default_rng(0).uniform(-2e-4, 2e-4, (len(pose), 1))  # ±24 µm
    return pose


@pytest.mark.parametrize(
    ("pose", "feed"),
    [
        (zigzag(), FAST),
        (polygon(), FAST),
        (circle(0.005), FAST),  # 26 µm from the chords
        (circle(0.002), 0.05),
        (circle(0.0004), FAST),
        (circle(0.002)[:3], FAST),
        (np.column_stack([0.002 * np.arange(50), *np.zeros((4, 50)), np.ones(50)]), FAST),
    ],
    ids=["zigzag", "polygon", "beyond the tolerance", "slow", "dense", "three points", "straight"],
)
def test_lines_remain_lines(pose: Array, feed: float) -> None:
    assert fill(pose, feed) is None


def test_noise_is_not_followed() -> None:
    filled = fill(noise())
    assert filled is None or len(filled.pose) < 1.2 * 200  # type: ignore[attr-defined]


def test_line_after_an_arc_remains_a_line() -> None:
    arc = circle(0.002, 60)
    way = arc[-1, :3] - arc[-2, :3]
    line = arc[-1] + np.arange(1, 40)[:, None] * np.r_[way, 0.0, 0.0, 0.0]
    filled = fill(np.vstack([arc, line]))
    assert filled is not None
    rows = filled.segment  # type: ignore[attr-defined]
    assert not ((rows > 60.0) & (rows != np.round(rows))).any()


def build_run(step: float, feed: float = FAST) -> RunInput:
    pose = circle(step, int(0.5 / step))
    return make(pose[:, :3], feed=feed)


@pytest.mark.parametrize("step", [0.001, 0.002, 0.003])
def test_run_respects_the_tolerance_of_the_lines(step: float) -> None:
    run = build_run(step)
    (curve,) = build_curves(run.points, CornerTolerances(TOLERANCE, LEAN))  # type: ignore[misc]
    assert len(curve.u) > 1.5 * len(run.position)
    u = np.linspace(curve.u[0], curve.u[-1], 20_000)
    place = curve.coordinates(u)[:, 0, :3]
    a, b = run.position[:-1], run.position[1:]
    k = np.clip(curve.index(u).astype(int), 0, len(a) - 1)
    way = (b - a)[k]
    share = np.clip(np.sum((place - a[k]) * way, axis=1) / np.sum(way**2, axis=1), 0.0, 1.0)
    assert np.linalg.norm(place - a[k] - share[:, None] * way, axis=1).max() <= TOLERANCE
    assert np.abs(curve.index(curve.u) - np.sort(curve.index(curve.u))).max() == 0.0


def test_fast_run_takes_less_time_and_a_slow_one_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def drive(step: float, feed: float) -> RunTrajectory:
        out = retime_run(build_run(step, feed))
        assert isinstance(out, RunTrajectory)
        return out

    fast, slow = drive(0.002, FAST), drive(0.002, 0.05)
    never: Callable[..., None] = lambda *_: None  # noqa: E731
    monkeypatch.setattr(path_curve, "fill_smooth_stretches", never)
    assert fast.duration < 0.85 * drive(0.002, FAST).duration
    assert slow.duration == drive(0.002, 0.05).duration
    assert fast.point[0] == 0.0
    assert fast.point[-1] == 249.0
    assert (np.diff(fast.point) >= 0.0).all()
