"""Retimed runs, checked with the exported samples alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from machopt.data_types.cell import JointLimits
from machopt.kinematics.inverse.solver import refine_by_newton
from machopt.kinematics.machine import Machine
from machopt.kinematics.robot import Robot
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import build_transform, compute_tool_rotation, invert_transform
from machopt.planning.retiming import time_law
from machopt.planning.retiming.path_curve import compute_path_parameter
from machopt.planning.retiming.run_retiming import RunFailure, RunInput, RunTrajectory, retime_run

FLANGE = build_transform(np.array([[0, 0, 1], [0, -1, 0], [1, 0, 0]]), np.array([3.115, 0, 0.99]))
ROBOT = Robot(  # a large six-axis arm, stretched forward at zero
    joints=tuple("123456"),
    axis=np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], float),
    point=np.array(
        [[0, 0, 1.045], [0.5, 0, 1.045], [1.8, 0, 1.045], [1.8, 0, 0.99], [2.825, 0, 0.99], [2.825, 0, 0.99]], float
    ),
    T_base_flange_zero=FLANGE,
    lower=np.full(6, -6.0),
    upper=np.full(6, 6.0),
)
TCP = build_transform(np.eye(3), np.array([0.05, 0, 0.3]))
HOME = np.array([0.1, -1.2, 1.3, 0.2, 0.8, 0.3])
T_BASE_WORKPIECE = ROBOT.compute_fk(HOME, TCP) @ build_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
MACHINE = Machine(  # the arm at the world origin with a fixed part
    robot=ROBOT,
    axis=ROBOT.axis,
    point=ROBOT.point,
    slides=np.zeros(6, bool),
    column=np.arange(6),
    sign=np.ones(6),
    positioner=0,
    rail=0,
    T_base_workpiece_zero=T_BASE_WORKPIECE,
    T_world_base_zero=np.eye(4),
)
LIMITS = JointLimits(
    np.full(6, -6.0),
    np.full(6, 6.0),
    np.radians([90, 80, 75, 90, 83, 130.0]),
    np.radians([200, 200, 200, 350, 350, 500.0]),
    np.radians([2000, 2000, 2000, 4000, 4000, 6000.0]),
)


def make(
    position: object, axis: object = None, phi: Array | None = None, feed: object = 0.025, limits: JointLimits = LIMITS
) -> RunInput:
    p = np.asarray(position, float)
    n = len(p)
    a = np.tile([0.0, 0, 1], (n, 1)) if axis is None else np.asarray(axis, float)
    a = a / np.linalg.norm(a, axis=1)[:, None]
    phi = np.zeros(n) if phi is None else phi
    reference = np.tile([1.0, 0, 0], (n, 1))
    q, seed = np.empty((n, 6)), HOME
    for k, T in enumerate(T_BASE_WORKPIECE @ build_transform(compute_tool_rotation(a, reference, phi), p)):
        seed, error = refine_by_newton(ROBOT, T, seed, TCP, 30)
        assert error < 1e-9
        q[k] = seed
    return RunInput(
        position=p,
        axis=a,
        reference=reference,
        phi=phi,
        q=q,
        feed=np.broadcast_to(np.asarray(feed, float), n).copy(),
        machine=MACHINE,
        external=np.empty((n, 0)),
        T_flange_tcp=TCP,
        robot=ROBOT,
        limits=limits,
    )


def distance(p: Array, a: Array, b: Array) -> float:
    d = b - a
    t = np.clip((p - a) @ d / (d @ d), 0, 1) if (d @ d) > 0 else 0.0
    return float(np.linalg.norm(p - a - t * d))


def drive(run: RunInput) -> RunTrajectory:
    out = retime_run(run)
    assert isinstance(out, RunTrajectory), out
    n = len(run.position)
    T = invert_transform(T_BASE_WORKPIECE) @ ROBOT.compute_fk(out.q, TCP)
    k = np.clip(np.floor(out.point).astype(int), 0, n - 2)
    f = (out.point - k)[:, None]
    near = [
        min(
            distance(T[i, :3, 3], run.position[j], run.position[j + 1]) for j in range(max(0, m - 1), min(n - 1, m + 2))
        )
        for i, m in enumerate(k)
    ]
    assert max(near) < 20e-6
    axis = run.axis[k] + f * (run.axis[k + 1] - run.axis[k])
    cos = -np.sum(T[:, :3, 2] * axis, axis=1) / np.linalg.norm(axis, axis=1)
    assert np.degrees(np.arccos(np.clip(cos, -1, 1))).max() < 0.05
    still = np.concatenate([np.repeat(out.q[:1], 3, 0), out.q, np.repeat(out.q[-1:], 3, 0)])
    v = np.diff(still, axis=0) / run.sample
    a = np.diff(v, axis=0) / run.sample
    j = np.diff(a, axis=0) / run.sample
    for x, limit in ((v, run.limits.velocity), (a, run.limits.acceleration), (j, run.limits.jerk)):
        assert (np.abs(x) / limit).max() < 1.0
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / run.sample
    feeds = np.r_[run.feed[1], run.feed[1:]]
    on = np.clip(np.ceil(out.point[1:]).astype(int), 1, n - 1)
    assert (speed <= 1.002 * feeds[on] + 1e-9).all()
    assert (np.diff(out.point) >= 0).all()
    assert out.point[0] == 0
    assert out.point[-1] == n - 1
    assert np.allclose(out.q[[0, -1]], run.q[[0, -1]], atol=1e-8)
    assert out.duration == pytest.approx((len(out.q) - 1) * run.sample)
    return out


def contour(n: int, step: float) -> tuple[Array, Array]:
    t = np.arange(n) * step / 0.12
    p = np.column_stack([0.12 * np.sin(t), 0.1 * (1 - np.cos(t)), 0.02 * np.sin(2 * t)])
    return p, np.column_stack([0.25 * np.sin(1.3 * t), 0.2 * np.cos(0.7 * t) - 0.2, np.ones(n)])


def zigzag() -> Array:
    x = np.linspace(0, 0.1, 11)
    rows = [np.column_stack([x if k % 2 == 0 else x[::-1], np.full(11, 0.005 * k), np.zeros(11)]) for k in range(5)]
    return np.concatenate(rows)


def scale_limits(factor: float) -> JointLimits:
    return replace(
        LIMITS, velocity=LIMITS.velocity * factor, acceleration=LIMITS.acceleration * factor, jerk=LIMITS.jerk * factor
    )


def noise(n: int) -> Array:
    return np.random.default_rng(1).uniform(-2e-6, 2e-6, (n, 3))


RUNS: dict[str, tuple[Callable[[], RunInput], float]] = {  # and the smallest share of time at the programmed feed
    "plunge": (lambda: make([[0, 0, 0], [0, 0, -0.02]], feed=0.005), 0.95),
    "one micrometre": (lambda: make([[0, 0, 0], [1e-6, 0, 0]]), 0.0),
    "eight hundred micrometres": (lambda: make(np.column_stack([np.arange(800) * 1e-6, *np.zeros((2, 800))])), 0.0),
    "straight": (lambda: make(np.column_stack([np.linspace(0, 0.3, 31), *np.zeros((2, 31))])), 0.97),
    "repeated points": (lambda: make(*(np.repeat(x, 2, axis=0) for x in contour(40, 0.003))), 0.95),
    "reorientation": (lambda: make(np.zeros((2, 3)), [[0, 0, 1], [0.5, 0.1, 1]]), 0.0),
    "spin": (lambda: make(np.zeros((3, 3)), phi=np.array([0, 0.4, 0.8])), 0.0),
    "travel, turn, travel": (
        lambda: make(
            [[0, 0, 0], [0.03, 0, 0], [0.03, 0, 0], [0.06, 0, 0]], [[0, 0, 1], [0, 0, 1], [0.3, 0.1, 1], [0.3, 0.1, 1]]
        ),
        0.6,
    ),
    "there and back": (lambda: make([[0, 0, 0], [0.05, 0, 0], [0.02, 0, 0], [0.08, 0, 0]]), 0.9),
    "zigzag pocket": (lambda: make(zigzag()), 0.93),
    "five axes, 3 mm": (lambda: make(*contour(300, 0.003)), 0.98),
    "five axes, 0.3 mm": (lambda: make(*contour(500, 0.0003)), 0.93),
    "five axes, noise": (lambda: make(contour(500, 0.0003)[0] + noise(500), contour(500, 0.0003)[1]), 0.93),
    "wandering rotation": (
        lambda: make(*contour(200, 0.003), phi=np.cumsum(np.random.default_rng(2).normal(0, 0.005, 200))),
        0.95,
    ),
    "feed × 10 and back": (
        lambda: make(*contour(120, 0.003), feed=np.where(np.arange(120) // 10 % 2, 0.005, 0.05)),
        0.9,
    ),
    "feed × 10 at each point": (lambda: make(*contour(60, 0.003), feed=np.where(np.arange(60) % 2, 0.005, 0.05)), 0.5),
    "link, then cut": (
        lambda: make([[0, 0, 0], [0, 0, 0.1], [0.3, 0.1, 0.1], [0.3, 0.1, 0.05]], feed=np.array([0.5, 0.5, 0.5, 0.02])),
        0.6,
    ),
    "axes too slow": (lambda: make(*contour(60, 0.003), limits=scale_limits(0.01)), 0.0),
}


@pytest.mark.parametrize("name", RUNS)
def test_samples_respect_tolerances_limits_and_feed(name: str) -> None:
    build, least = RUNS[name]
    out = drive(build())
    assert out.held_share >= least
    assert out.held[1:].mean() == pytest.approx(out.held_share)


def test_limiting_axis_is_named() -> None:
    limits = replace(LIMITS, velocity=LIMITS.velocity * np.array([1, 1, 1, 0.004, 1, 1]))
    out = drive(make(*contour(60, 0.003), limits=limits))
    worst = min((d for d in out.dips if d.where == "path"), key=lambda d: d.ratio, default=out.dips[0])
    assert (worst.joint, worst.limit) == (4, "velocity")


def test_ramps_and_corners_are_separated() -> None:
    out = drive(make([[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0]]))
    assert [d.where for d in out.dips] == ["start", "path", "stop"]
    corner = out.dips[1]
    assert corner.first < 1 < corner.last
    assert corner.ratio > 0.05
    assert corner.at(np.array([7.0, 8.0])).first == 7.0


def test_rotation_given_as_a_curve_is_followed() -> None:
    p, a = contour(60, 0.003)
    first = make(p, a)
    s = compute_path_parameter(first.position, first.axis, first.reference, first.phi)

    def curve(x: Array) -> Array:
        return 0.3 * np.sin(20.0 * x)

    run = replace(make(p, a, phi=curve(s)), phi_curve=curve)
    out = drive(run)
    assert np.abs(out.phi - np.interp(out.point, np.arange(60), run.phi)).max() < 2e-3


def test_feed_of_a_move_applies_from_its_first_point() -> None:
    """After a slow move the faster feed applies at once: only the axes delay it; the feed is not interpolated."""
    feed = np.array([0.0, 0.0025, 0.025, 0.025, 0.025, 0.025])
    out = drive(make(np.column_stack([np.linspace(0, 0.1, 6), *np.zeros((2, 6))]), feed=feed))
    reached = out.point[np.flatnonzero(out.speed > 0.95 * 0.025)[0]]
    assert 1.0 < reached < 1.25


def test_zero_length_is_one_sample_at_rest() -> None:
    out = retime_run(make(np.zeros((3, 3))))
    assert isinstance(out, RunTrajectory)
    assert out.point.tolist() == [0, 2]


def test_infeasible_run_is_returned_as_data() -> None:
    run = make([[0, 0, 0], [0.02, 0, 0]])
    far = replace(run, position=np.array([[0, 0, 0], [5.0, 0, 0]]))
    out = retime_run(far)
    assert isinstance(out, RunFailure)
    assert 0 <= out.point <= 1
    narrow = replace(LIMITS, upper=np.maximum(run.q[0], run.q[1]) - 1e-3)
    out = retime_run(replace(run, limits=narrow))
    assert isinstance(out, RunFailure)
    assert "range" in out.reason


def test_no_run_without_a_feed() -> None:
    with pytest.raises(ValueError, match="feed"):
        retime_run(make([[0, 0, 0], [0.02, 0, 0]], feed=0.0))


def test_smooth_profile_respects_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    def stuck(*_: object) -> tuple[int, Array]:
        return 2, np.empty((0, 5))

    monkeypatch.setattr(time_law, "compute_greedy_time_law", stuck)
    drive(make(*contour(20, 0.003)))


@pytest.mark.parametrize("seed", range(12))
def test_speed_settles_at_the_programmed_feed(seed: int) -> None:
    draw = np.random.default_rng(seed)
    u = np.linspace(0.0, draw.uniform(0.02, 0.3), int(draw.integers(20, 200)))
    slope = draw.uniform(0.3, 1.5, 6) * draw.choice([-1.0, 1.0], 6)  # rad/m of each joint
    bend = draw.uniform(-2.0, 2.0, 6)
    derivatives = np.stack([slope + np.outer(u, bend), np.tile(bend, (len(u), 1)), np.zeros((len(u), 6))], axis=-1)
    feed = draw.uniform(0.005, 0.08)
    cap = np.full(len(u), feed)
    limits = LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk
    law = time_law.compute_time_law(
        time_law.SpeedBounds(
            u=u, derivatives=derivatives, cap=cap, velocity=limits[0], acceleration=limits[1], jerk=limits[2]
        ),
        0.004,
    )
    moving = law.a[np.abs(law.a) > 1e-6]
    reversals = int((np.diff(np.sign(moving)) != 0).sum())
    assert reversals <= 1, f"the acceleration changes its sign {reversals} times at one feed"
    assert (law.v <= feed * (1.0 + 1e-6)).all()
    if u[-1] > 0.1:
        assert np.median(law.v) > 0.985 * feed
