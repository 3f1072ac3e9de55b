"""Rapid moves remain above the cuts where no part geometry is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_cell import limits, pose, small_cell
from test_planning_path import UP, A, C, R, Rows, toolpath

from machopt.collision.collision_model import CollisionModel
from machopt.data_types.cell import CollisionShape
from machopt.kinematics.urdf_loading import load_chain
from machopt.planning.motion import blocked_rapid_break, segment_planner
from machopt.planning.motion.depth_below_cuts import MOST, SAME_SIDE, CutSurface
from machopt.planning.motion.rapid_moves import UNDER, BlockedRapid, FreeSpace, RapidMove, RapidTiming, plan_rapid

RADIUS = 5e-3


def rotate_axis_evenly(a: np.ndarray, b: np.ndarray, f: float) -> np.ndarray:
    """Return the axis rotated uniformly from a to b."""
    angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
    if angle < 1e-12:
        return a
    return np.asarray((np.sin((1 - f) * angle) * a + np.sin(f * angle) * b) / np.sin(angle))


SLOT: Rows = [((0, 0, 0.02), UP, R), ((0, 0, 0), UP, A), ((0.1, 0, 0), UP, C), ((0.1, 0, 0.02), UP, R)]
STEPPED: Rows = [*SLOT, ((0, 0.004, 0.02), UP, R), ((0, 0.004, -0.01), UP, A), ((0.1, 0.004, -0.01), UP, C)]


def tools(*places: tuple[float, float, float], tilt: float = 0.0) -> np.ndarray:
    """Return downward tool poses (S, 4, 4), tilted about x."""
    c, s = np.cos(tilt), np.sin(tilt)
    T = np.tile(np.eye(4), (len(places), 1, 1))
    T[:, :3, :3] = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.diag([1.0, -1.0, -1.0])
    T[:, :3, 3] = places
    return T


def test_tip_below_a_cut_is_below_it_by_the_exact_distance() -> None:
    level = CutSurface(toolpath(SLOT), RADIUS)
    assert level.under(tools((0.05, 0, 0.01))) == 0.0
    np.testing.assert_allclose(level.under(tools((0.05, 0, 0.01), (0.05, 0.001, -0.003), (0.03, 0, -0.002))), 0.003)
    assert level.under(tools((0.05, 0.1, -0.07))) == 0.0  # no information next to the cut
    assert level.under(tools((0.05, 0, -0.003), tilt=np.radians(40.0))) == 0.0  # too oblique for a statement
    assert level.under(tools((0.05, 0, -0.003), tilt=np.radians(20.0))) > 0.002


def test_depth_cut_nearby_is_free() -> None:
    level = CutSurface(toolpath(STEPPED), RADIUS)
    assert level.under(tools((0.05, 0.002, -0.008))) == 0.0
    np.testing.assert_allclose(level.under(tools((0.05, 0.002, -0.012))), 0.002)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_result_equals_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows: Rows = [(tuple(rng.normal(size=3) * 0.02), tuple(rng.normal(size=3) * 0.3 + UP), C) for _ in range(6)]
    path, tcp = toolpath(rows), tools(*[tuple(p) for p in rng.normal(size=(8, 3)) * 0.02], tilt=0.1)
    deepest = 0.0
    for T in tcp:
        heights = []
        for k in range(1, len(path)):
            a, b = path.position[k - 1], path.position[k]
            count = int(np.clip(np.ceil(np.linalg.norm(b - a) / RADIUS), 1, MOST))
            for f in np.arange(count + 1) / count:
                up, axis = T[:3, 3] - a - f * (b - a), rotate_axis_evenly(path.axis[k - 1], path.axis[k], f)
                aside = np.linalg.norm(up) ** 2 - (up @ axis) ** 2
                if -axis @ T[:3, 2] > SAME_SIDE and aside <= RADIUS**2:
                    heights.append(up @ axis)
        deepest = max(deepest, -max(heights, default=0.0))
    np.testing.assert_allclose(CutSurface(path, RADIUS).under(tcp), deepest, atol=1e-12)


def test_part_geometry_takes_precedence(tmp_path: Path) -> None:
    cell = small_cell(tmp_path)
    bare = replace(cell, workpiece=replace(cell.workpiece, geometry=()))
    assert cell.workpiece.geometry
    assert CutSurface.build(cell, toolpath(SLOT)) is None
    assert CutSurface.build(bare, toolpath(SLOT[:2])) is None  # no cutting move
    assert CutSurface.build(bare, toolpath(SLOT)) is not None


HERE, THERE = np.deg2rad([-20, -60, 90, 0, 45, 0.0]), np.deg2rad([20, -60, 90, 0, 45, 0.0])
ABOVE = np.deg2rad([[-20, -90, 90, 0, 45, 0], [20, -90, 90, 0, 45, 0.0]])


def rapid(barred: object, *, known_free: bool = False) -> RapidMove | BlockedRapid:
    return plan_rapid(
        HERE,
        THERE,
        timing=RapidTiming(limits(), 0.8, 0.012),
        space=FreeSpace(collision=None, step=0.02, barred=barred),  # type: ignore[arg-type]
        detours=lambda: [ABOVE[:1], ABOVE],
        rng=np.random.default_rng(0),
        known_free=known_free,
    )


def test_blocked_move_takes_a_detour() -> None:
    """Also if the move is known to be collision-free; the first detour that is not blocked is used."""
    for known in (False, True):
        move = rapid(low_in_the_middle, known_free=known)
        assert isinstance(move, RapidMove)
        assert move.kind == "retract"
        np.testing.assert_array_equal(move.waypoints, np.vstack([HERE, ABOVE, THERE]))
    assert isinstance(rapid(lambda q: False), RapidMove)


def low_in_the_middle(q: np.ndarray) -> bool:
    return bool((q[np.abs(q[:, 0]) < 0.1, 1] > np.deg2rad(-85.0)).any())


def test_rapid_tree_respects_blocked_regions(tmp_path: Path) -> None:
    """Without detours a path over the cuts is found, with and without collision bodies; it was reported as blocked."""
    cell = small_cell(tmp_path)
    wall = CollisionShape(name="wall", kind="box", size=(0.4, 0.02, 0.4), mesh=None, T_parent_shape=pose(1.1, 0.0, 0.2))
    robot, shapes = load_chain(cell)
    walled = CollisionModel(replace(cell, obstacles=(wall,)), robot, shapes, 0.0)
    for collision in (None, walled):
        move = plan_rapid(
            HERE,
            THERE,
            timing=RapidTiming(limits(), 0.8, 0.012),
            space=FreeSpace(collision=collision, step=0.02, barred=low_in_the_middle),
            detours=list,
            rng=np.random.default_rng(0),
        )
        assert isinstance(move, RapidMove)
        assert move.kind == "sampled"
        assert not low_in_the_middle(move.q)
        np.testing.assert_array_equal(move.q[[0, -1]], [HERE, THERE])
        assert (
            collision is None
            or not collision.check_motion(move.waypoints, np.zeros(len(move.waypoints), bool), 0.02).any
        )


def test_all_ways_blocked_is_the_reason() -> None:
    answer = rapid(lambda q: True)
    assert isinstance(answer, BlockedRapid)
    assert (answer.pair, answer.reason) == (UNDER, "way")


def test_moves_from_and_to_home_are_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    """These moves were not checked; only a home position below a cut permits them."""
    requested: list[bool] = []

    def rapid(*_: object, space: FreeSpace, **__: object) -> BlockedRapid:
        requested.append(space.barred is not None)
        return BlockedRapid(UNDER, HERE, 0.0, "way")

    monkeypatch.setattr(segment_planner, "plan_rapid", rapid)
    maker = cast(Any, object.__new__(segment_planner.SegmentPlanner))
    maker.level, maker.free, maker.rng = CutSurface(toolpath(SLOT), RADIUS), frozenset(), None
    maker._passes_below_cut = lambda x: bool((x[:, 0] > 1.0).any())
    setup = SimpleNamespace(driven=SimpleNamespace(limits=limits()), collision=None, per_rad=np.ones(6))
    maker.plan = SimpleNamespace(setup=setup)
    maker.options = SimpleNamespace(rapid_scale=0.8, rapid_blend=0.0, sample=0.012, collision_step=0.02)
    low, high, point = (
        blocked_rapid_break.RestPose(np.full(6, x), index, 0) for x, index in ((2.0, np.nan), (0.0, np.nan), (2.0, 3.0))
    )
    for a, b in ((high, point), (point, high), (point, point), (low, point), (point, low)):
        maker.rapid(a, b, 0)
    maker.rapid(replace(low, change=True), point, 0)  # a tool change is no rest pose
    assert requested == [True, True, True, False, False, True]
