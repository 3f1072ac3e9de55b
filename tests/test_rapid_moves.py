"""Rapid moves: limits by differences of the samples, straight segments, detours, messages of refusals."""

from __future__ import annotations

import io
import tokenize
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count
from small_cell import limits, pose, small_cell

import machopt
from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import CollisionShape
from machopt.kinematics.urdf_loading import load_chain
from machopt.planning.motion import rapid_moves
from machopt.planning.motion.rapid_moves import (
    BlockedRapid,
    FreeSpace,
    RapidMove,
    RapidTiming,
    plan_rapid,
    retime_straight_segments,
)

STEP, SAMPLE = np.deg2rad(1.0), 0.012


def plan(q_from: np.ndarray, q_to: np.ndarray, collision: CollisionModel | None = None, **more: object) -> object:
    fields: dict[str, object] = {
        "timing": RapidTiming(limits(), scale=0.8, sample=SAMPLE),
        "space": FreeSpace(collision=collision, step=STEP),
        "detours": list,
        "rng": np.random.default_rng(0),
    }
    return plan_rapid(np.asarray(q_from, float), np.asarray(q_to, float), **{**fields, **more})  # type: ignore[arg-type]


def ratios(q: np.ndarray, scale: float) -> list[float]:
    """Return the largest velocity, acceleration and jerk (by differences) divided
    by the scaled limits; at rest before and after."""
    x = np.vstack([np.repeat(q[:1], 3, 0), q, np.repeat(q[-1:], 3, 0)])
    out = []
    for bound in (limits().velocity, limits().acceleration, limits().jerk):
        x = np.diff(x, axis=0) / SAMPLE
        out.append(float((np.abs(x) / bound).max() / scale))
    return out


angle = st.floats(-2.0, 2.0)


@settings(max_examples=scale_example_count(60), deadline=None, derandomize=not NIGHTLY)
@given(st.lists(angle, min_size=6, max_size=6), st.lists(angle, min_size=6, max_size=6), st.floats(0.05, 1.0))
def test_samples_respect_the_limits_and_the_line(a: list[float], b: list[float], scale: float) -> None:
    start, end = np.array(a), np.array(b)
    q = retime_straight_segments(np.array([start, end]), limits(), scale, SAMPLE)
    np.testing.assert_array_equal(q[0], start)
    np.testing.assert_array_equal(q[-1], end)
    # Third differences of values near 2 rad lose 1e-15/0.012³ ≈ 1e-9 rad/s³ to rounding.
    assert max(ratios(q, scale)) <= 1.0 + 1e-6
    delta = end - start
    if np.abs(delta).max() > 1e-6:
        share = (q - start) @ delta / (delta @ delta)
        np.testing.assert_allclose(q, start + share[:, None] * delta, atol=1e-12)
        assert (np.diff(share) >= -1e-12).all()


def test_long_move_is_limited_by_the_slowest_joint() -> None:
    """The slowest joint reaches its velocity limit and determines the duration."""
    a, b = np.zeros(6), np.deg2rad([150, 20, 0, 0, 0, 0.0])
    q = retime_straight_segments(np.array([a, b]), limits(), 1.0, SAMPLE)
    v, acc, j = 120.0, 300.0, 2000.0
    ideal = 150 / v + v / acc + acc / j  # trapezoid with jerk-limited ramps
    assert ideal <= (len(q) - 1) * SAMPLE <= ideal + SAMPLE
    assert ratios(q, 1.0)[0] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("size", [1e-12, 1e-10, 2e-9, 1e-6, 1e-3])
def test_tiny_moves(size: float) -> None:
    q = retime_straight_segments(np.array([np.zeros(6), np.full(6, size)]), limits(), 0.8, SAMPLE)
    assert max(ratios(q, 0.8)) <= 1.0 + 1e-6
    assert q[-1, 0] == size


def test_zero_move_is_one_sample() -> None:
    move = plan(np.ones(6), np.ones(6))
    assert isinstance(move, RapidMove)
    assert move.q.shape == (1, 6)
    assert move.kind == "direct"


def test_waypoints_are_samples_at_rest() -> None:
    points = np.array([np.zeros(6), np.full(6, 0.3), [0.5, 0, 0.2, -1, 0, 1]])
    q = retime_straight_segments(points, limits(), 0.8, SAMPLE)
    corner = int(np.flatnonzero((q == points[1]).all(axis=1))[0])
    assert np.abs(q[corner + 1] - q[corner]).max() < 1e-3  # start from rest: j t³/6
    assert max(ratios(q, 0.8)) <= 1.0 + 1e-6


@pytest.fixture(scope="module")
def walled(tmp_path_factory: pytest.TempPathFactory) -> CollisionModel:
    """A wall in front of the robot that the arm must pass above or by folding back."""
    wall = CollisionShape(name="wall", kind="box", size=(1.0, 0.1, 1.3), mesh=None, T_parent_shape=pose(1.5, 0.0, 0.65))
    cell = replace(small_cell(tmp_path_factory.mktemp("c")), obstacles=(wall,))
    cell = replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    robot, shapes = load_chain(cell)
    return CollisionModel(cell, robot, shapes, 0.002)


LEFT, RIGHT = np.deg2rad([-35, -50, 90, 0, 45, 0.0]), np.deg2rad([35, -50, 90, 0, 45, 0.0])


def test_free_straight_line_is_used(walled: CollisionModel) -> None:
    move = plan(LEFT, LEFT + np.deg2rad([5, 3, 0, 0, 0, 90]), walled, detours=lambda: pytest.fail("not asked"))
    assert isinstance(move, RapidMove)
    assert move.kind == "direct"


def test_first_free_detour_is_used(walled: CollisionModel) -> None:
    up = np.deg2rad([[-35, -110, 90, 0, 45, 0], [35, -110, 90, 0, 45, 0.0]])
    beyond = up + np.deg2rad([400.0, 0, 0, 0, 0, 0])  # outside the joint limits
    through = np.array([0.5 * (LEFT + RIGHT)])
    move = plan(LEFT, RIGHT, walled, detours=lambda: [beyond, through, up])
    assert isinstance(move, RapidMove)
    assert move.kind == "retract"
    np.testing.assert_array_equal(move.waypoints, np.vstack([LEFT, up, RIGHT]))
    assert not walled.check_configurations(move.q, np.zeros(len(move.q), bool)).hit.any()
    assert max(ratios(move.q, 0.8)) <= 1.0 + 1e-6


def test_random_search_finds_a_reproducible_way(walled: CollisionModel) -> None:
    first, again = (plan(LEFT, RIGHT, walled, rng=np.random.default_rng(7)) for _ in range(2))
    assert isinstance(first, RapidMove)
    assert isinstance(again, RapidMove)
    assert first.kind == "sampled"
    np.testing.assert_array_equal(first.q, again.q)
    np.testing.assert_array_equal(first.q[[0, -1]], [LEFT, RIGHT])
    assert len(first.waypoints) <= 8
    assert not walled.check_configurations(first.q, np.zeros(len(first.q), bool)).hit.any()


def test_obstacles_are_named(walled: CollisionModel) -> None:
    answer = plan(LEFT, RIGHT, walled, iterations=0)
    assert isinstance(answer, BlockedRapid)
    assert answer.reason == "way"
    assert "wall" in answer.pair
    assert 0 < answer.fraction < 1
    np.testing.assert_allclose(answer.where, LEFT + answer.fraction * (RIGHT - LEFT))
    inside = 0.5 * (LEFT + RIGHT)
    for ends, reason in (((inside, RIGHT), "start"), ((LEFT, inside), "end")):
        answer = plan(*ends, walled)
        assert isinstance(answer, BlockedRapid)
        assert answer.reason == reason


def test_ruckig_stays_offline() -> None:
    """Ruckig sends waypoints to a cloud service when they are set; no source file may contain the name."""
    word = "intermediate" + "_positions"
    for file in Path(machopt.__file__).parent.rglob("*.py"):
        names = {t.string for t in tokenize.generate_tokens(io.StringIO(file.read_text()).readline)}
        assert word not in names, file


def test_random_corners_are_cut_where_the_line_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    path, rng = np.random.default_rng(1).normal(size=(9, 6)), np.random.default_rng(2)
    nobody = rapid_moves._Space(collision=None, barred=None, step=STEP, measure=np.ones(6))
    np.testing.assert_array_equal(rapid_moves._cut_corners(nobody, path, rng), path[[0, -1]])
    monkeypatch.setattr(rapid_moves._Space, "free", lambda *_: False)
    np.testing.assert_array_equal(rapid_moves._cut_corners(nobody, path, rng), path)
    # only lines on one side of the middle are free
    side = np.arange(9) >= 4
    at = {row.tobytes(): bool(s) for row, s in zip(path, side, strict=True)}
    monkeypatch.setattr(rapid_moves._Space, "free", lambda _, a, b: at[a.tobytes()] == at[b.tobytes()])
    np.testing.assert_array_equal(rapid_moves._cut_corners(nobody, path, rng), path[[0, 3, 4, 8]])
