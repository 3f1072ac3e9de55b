"""Blended corners of rapid moves: timing, clearance, and possible paths of a controller."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from machopt.data_types.cell import JointLimits
from machopt.data_types.toolpath import MoveKind, ToolpathEvent
from machopt.numerics.array_types import Array
from machopt.planning.cost.rapid_time import compute_rest_time
from machopt.planning.motion.corner_timing import measure_fastest_time, time_legs
from machopt.planning.motion.motion_segment import MotionSegment
from machopt.planning.motion.rapid_chain import CornerSpace
from machopt.planning.motion.rapid_corners import list_rounded_corners, round_rapid_corners
from machopt.planning.motion.rapid_moves import RapidTiming, retime_straight_segments
from machopt.planning.motion.rapid_shortcuts import shorten_detour
from machopt.programs.writing.rapid_zones import compute_rapid_zone_limits
from machopt.verification.motion.checks.rapid_corners import CornerTriangle, list_corner_triangles

LIMITS = np.radians(
    [[105, 101, 107, 136, 129, 206], [300, 289, 306, 389, 369, 589], [2143, 2061, 2184, 2776, 2633, 4204]]
)
SAMPLE = 0.012
TIMING = RapidTiming(JointLimits(np.full(6, -9.0), np.full(6, 9.0), *LIMITS), 0.8, SAMPLE)
NODES = np.array(
    [np.zeros(6), [0.0, -0.1, 0.05, 0.0, 0.05, 0.0], [0.4, -0.1, 0.06, 0.1, 0.05, 0.2], [0.4, 0, 0, 0.1, 0, 0.2]]
)


def steps_of(count: int, seed: int) -> Array:
    """Return random steps in which some joints do not move."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(count, 6)) * rng.uniform(0.01, 1.0, size=(count, 1))
    steps[rng.random((count, 6)) < 0.2] = 0.0
    steps[:, 0] += 1e-3
    return np.asarray(steps)


@pytest.mark.parametrize(("count", "seed"), list(itertools.product((2, 3, 5), range(6))))
def test_blended_motion_respects_every_limit(count: int, seed: int) -> None:
    steps, most = steps_of(count, seed), np.full(count - 1, 0.5)
    timing = time_legs(steps, LIMITS, most)
    assert timing is not None
    time = np.linspace(0.0, timing.duration, 20_001)
    x = timing.compute_shares(time) @ steps
    np.testing.assert_allclose(x[-1], steps.sum(axis=0), atol=1e-9)
    for order, limit in enumerate(LIMITS, start=1):  # a difference is a mean of the derivative
        ratio = np.abs(np.diff(x, n=order, axis=0)) / time[1] ** order / limit
        assert ratio.max() <= 1.0 + 1e-3  # third differences of 20,000 samples lose six digits


@pytest.mark.parametrize(("count", "seed"), list(itertools.product((2, 3, 5), range(6))))
def test_blend_takes_less_time_than_stops_and_at_most_half_a_segment(count: int, seed: int) -> None:
    steps, most = steps_of(count, seed), np.full(count - 1, 0.5)
    timing = time_legs(steps, LIMITS, most)
    assert timing is not None
    assert timing.duration < measure_fastest_time(steps, LIMITS, False)
    for corner in range(1, count):
        assert all(0.0 < share <= 0.5 + 1e-9 for share in timing.get_rounded_shares(corner))


@pytest.mark.parametrize("seed", range(10))
def test_stops_have_the_time_of_jerk_limited_lines(seed: int) -> None:
    """The closed form of the objective equals the duration that Ruckig computes for each line."""
    steps = steps_of(3, seed)
    lines = sum(compute_rest_time(*(np.abs(step) / LIMITS).max(axis=1)) for step in steps)
    assert measure_fastest_time(steps, LIMITS, False) == pytest.approx(lines, rel=1e-9)


@pytest.mark.parametrize("most", [0.5, 0.35, 0.2])
def test_blend_curve_stays_in_its_triangle(most: float) -> None:
    steps = np.diff(NODES, axis=0)
    timing = time_legs(steps, LIMITS, np.full(2, most))
    assert timing is not None
    x = NODES[0] + timing.compute_shares(np.linspace(0.0, timing.duration, 5_001)) @ steps
    triangles = [
        CornerTriangle(NODES[n], NODES[n - 1], NODES[n + 1], np.array(timing.get_rounded_shares(n))) for n in (1, 2)
    ]
    off = np.min([triangle.measure_deviation(x) for triangle in triangles], axis=0)
    assert off.max() < 1e-12


def build_legs(nodes: Array = NODES, *, rest: int = 0) -> list[MotionSegment]:
    """Return a cut, a rapid move to each further node (points 1, 2, …), and a cut."""
    legs = []
    for n, (a, b) in enumerate(itertools.pairwise(nodes)):
        x = retime_straight_segments(np.array([a, b]), TIMING.limits, TIMING.scale, SAMPLE)
        legs.append(
            MotionSegment(
                name="rapid",
                q=x,
                index=np.linspace(n, n + 1, len(x)),
                move=np.full(len(x), MoveKind.RAPID, np.int8),
                operation=np.zeros(len(x), np.int32),
                gamma=np.full(len(x), np.nan),
                waypoints=b[None],
                waypoint_index=np.array([n + 1.0]),
                waypoint_feed=np.array([np.nan]),
                external=np.empty((len(x), 0)),
                waypoint_external=np.empty((1, 0)),
            )
        )
    legs[0] = legs[0].standing(-1, rest)
    return legs


class Wall:
    """Collides where the distance of the joints from the corner, along its bisector, exceeds a limit."""

    def __init__(self, corner: Array, most: float) -> None:
        self.corner, self.most = corner, most

    def is_hit(self, x: Array) -> Any:
        """Return (S,) whether the first two joints are inside the corner by more than the limit."""
        return (x[:, 0] > 1e-6) & (x[:, 1] - self.corner[1] > self.most)

    def check_motion(self, q: Array, cutting: object, step: float, **_: object) -> SimpleNamespace:
        """Return contacts along the path, 100 samples per step."""
        hit = np.zeros(len(q), bool)
        for n in range(1, len(q)):
            hit[n] = self.is_hit(q[n - 1] + np.linspace(0.0, 1.0, 101)[:, None] * (q[n] - q[n - 1])).any()
        return SimpleNamespace(hit=hit)

    def check_configurations(self, q: Array, cutting: object) -> SimpleNamespace:
        """Return contacts of configurations."""
        return SimpleNamespace(hit=self.is_hit(q))


def space(collision: object = None, deviation: float = 0.07, barred: Any = None) -> CornerSpace:
    """The tool position is the first three joints, in metres."""

    def compute_tcp(x: Array) -> Array:
        T = np.tile(np.eye(4), (len(x), 1, 1))
        T[:, :3, 3] = x[:, :3]
        return T

    return CornerSpace(
        timing=TIMING,
        collision=cast(Any, collision),
        step=0.01,
        deviation=deviation,
        compute_tcp=compute_tcp,
        compute_true=lambda x: x,
        barred=barred,
    )


def no_events(*events: ToolpathEvent) -> Any:
    """A toolpath of which only the events are used."""
    return SimpleNamespace(events=events)


def duration(legs: list[MotionSegment]) -> int:
    return sum(len(leg.q) - 1 for leg in legs)


def test_segments_are_blended_and_their_corners_listed() -> None:
    before = build_legs()
    after = round_rapid_corners(before, no_events(), space())
    corners = list_rounded_corners(after)
    assert duration(after) < 0.9 * duration(before)
    assert corners is not None
    np.testing.assert_array_equal(corners.q, NODES[1:3])
    x = np.concatenate([after[0].q, *(leg.q[1:] for leg in after[1:])])
    np.testing.assert_array_equal(x[[0, -1]], NODES[[0, -1]])
    triangles = list_corner_triangles(corners, x)
    assert np.min([triangle.measure_deviation(x) for triangle in triangles], axis=0).max() < 1e-12
    for order, limit in enumerate(LIMITS, start=1):
        padded = np.pad(x, ((3, 3), (0, 0)), mode="edge")
        assert (np.abs(np.diff(padded, n=order, axis=0)) / SAMPLE**order / limit).max() <= 0.8 + 1e-9


@pytest.mark.parametrize("kind", ["dwell", "stop", "spindle", "coolant", "tool"])
def test_machine_stops_at_events_of_the_file(kind: Any) -> None:
    events = [ToolpathEvent(2, kind, "M0")]
    corners = list_rounded_corners(round_rapid_corners(build_legs(), no_events(*events), space()))
    assert corners is not None
    np.testing.assert_array_equal(corners.q, NODES[2:3])


def test_comment_causes_no_stop() -> None:
    corners = list_rounded_corners(
        round_rapid_corners(build_legs(), no_events(ToolpathEvent(2, "comment", "PAINT")), space())
    )
    assert corners is not None
    assert len(corners) == 2


def test_machine_stops_at_dwells() -> None:
    legs = round_rapid_corners(build_legs(rest=5), no_events(), space())
    corners = list_rounded_corners(legs)
    assert corners is not None
    assert len(corners) == 1
    assert (legs[0].q[-6:] == NODES[1]).all()


@pytest.mark.parametrize("most", [0.02, 0.004])
def test_tool_passes_the_corner_within_its_limit(most: float) -> None:
    legs = round_rapid_corners(build_legs(), no_events(), space(deviation=most))
    x = np.concatenate([leg.q for leg in legs])
    fine = np.concatenate([a + np.linspace(0, 1, 9)[:, None] * (b - a) for a, b in itertools.pairwise(x)])
    for node in NODES[1:3]:
        assert np.linalg.norm(fine[:, :3] - node[:3], axis=1).min() <= most + 1e-5  # tolerance: chords between samples
    assert list_rounded_corners(legs) is not None


@pytest.mark.parametrize("room", [0.03, 0.02])
def test_corner_with_little_room_has_a_smaller_blend(room: float) -> None:
    """The whole blend triangle is free, and both ends of the blend are nearer to the corner than without the wall."""
    nodes = NODES[:3]
    wall = Wall(nodes[1], room)
    free, tight = (
        list_rounded_corners(round_rapid_corners(build_legs(nodes), no_events(), space(collision)))
        for collision in (None, wall)
    )
    assert free is not None
    assert tight is not None
    assert (tight.share < free.share).any()
    ends = [nodes[1] + share * (end - nodes[1]) for share, end in zip(tight.share[0], nodes[[0, 2]], strict=True)]
    for f in np.linspace(0.0, 1.0, 50):
        chord = nodes[1] + f * (np.array(ends) - nodes[1])
        assert not wall.is_hit(chord[0] + np.linspace(0, 1, 50)[:, None] * (chord[1] - chord[0])).any()


def test_machine_stops_where_the_blend_would_be_too_small() -> None:
    """Slowing down to a low speed takes longer than stopping, because it needs an additional S-curve."""
    assert time_legs(np.diff(NODES, axis=0), LIMITS, np.full(2, 0.01)) is None


def test_motion_without_room_is_unchanged() -> None:
    before = build_legs()
    blocked = replace(space(), barred=lambda _: True)
    after = round_rapid_corners(before, no_events(), blocked)
    assert all(a is b for a, b in zip(before, after, strict=True))


def test_shortcuts_remove_or_cut_via_points() -> None:
    way = np.array([np.zeros(6), [0, -0.4, 0, 0, 0, 0], [0.6, -0.4, 0, 0, 0, 0], [0.6, 0, 0, 0, 0, 0]], float)
    time = measure_fastest_time(np.diff(way, axis=0), LIMITS, True)
    anywhere = shorten_detour(way, LIMITS, True, lambda _: True)
    np.testing.assert_array_equal(anywhere, way[[0, -1]])
    assert shorten_detour(way, LIMITS, True, lambda _: False) is way

    def is_free(trial: Array) -> bool:  # an obstacle between the ends, 0.3 high
        fine = np.concatenate([a + np.linspace(0, 1, 51)[:, None] * (b - a) for a, b in itertools.pairwise(trial)])
        return not ((np.abs(fine[:, 0] - 0.3) < 0.1) & (fine[:, 1] > -0.3)).any()

    around = shorten_detour(way, LIMITS, True, is_free)
    assert is_free(around)
    assert measure_fastest_time(np.diff(around, axis=0), LIMITS, True) <= time
    stopping = shorten_detour(way, LIMITS, False, is_free)
    assert len(stopping) <= len(way)


@pytest.mark.parametrize("seed", range(8))
def test_no_place_outside_the_triangle_is_in_the_zone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corner, start, end = rng.normal(size=(3, 1, 6))
    share = rng.uniform(0.05, 0.5, size=(1, 2))

    def place(x: Array) -> Array:  # curved path
        return np.column_stack([np.cos(x[:, 0]) + x[:, 3], np.sin(x[:, 1]) + 0.2 * x[:, 4], x[:, 2] ** 2])

    zone = float(compute_rapid_zone_limits(corner, (start, end), share, place)[0])
    for n, other in enumerate((start, end)):
        t = np.linspace(share[0, n], 1.0, 400)[:, None]
        away = np.linalg.norm(place(corner + t * (other - corner)) - place(corner), axis=1)
        assert away.min() >= zone * (1 - 2e-2)  # 33 samples of a curve
        assert zone <= 0.5 * away[-1]


def test_moving_external_axis_has_no_distance_bound() -> None:
    corner, start, end = np.zeros((1, 7)), np.ones((1, 7)), -np.ones((1, 7))
    assert compute_rapid_zone_limits(corner, (start, end), np.full((1, 2), 0.5), lambda x: x[:, :3])[0] == 0.0


def cut_leg(at: Array, index: float, move: MoveKind) -> MotionSegment:
    """Return a short feed move that starts or ends at a position."""
    leg = build_legs(np.array([at - 0.01, at]))[0]
    return replace(leg, name="run", index=np.full(len(leg.q), index), move=np.full(len(leg.q), move, np.int8))


def test_points_near_the_straight_line_are_passed_without_a_corner() -> None:
    """All samples are on the straight move with its timing; the targets are within the distance from it."""
    nodes = np.array([np.zeros(6), [0.3, 0.03, 0, 0.1, 0, 0], [0.6, 0.02, 0, 0.3, 0, 0], [0.9, 0, 0, 0.4, 0, 0]])
    legs = round_rapid_corners(build_legs(nodes), no_events(), space(deviation=0.05))
    x = np.concatenate([legs[0].q, *(leg.q[1:] for leg in legs[1:])])
    np.testing.assert_allclose(
        x, retime_straight_segments(nodes[[0, -1]], TIMING.limits, TIMING.scale, SAMPLE), atol=1e-12
    )
    corners = list_rounded_corners(legs)
    assert corners is not None
    assert len(corners) == 2
    for triangle, node in zip(list_corner_triangles(corners, x), nodes[1:3], strict=True):
        assert triangle.is_straight
        assert np.linalg.norm(triangle.corner[:3] - node[:3]) <= 0.05
    assert all((leg.waypoints[-1] == q).all() for leg, q in zip(legs, corners.q, strict=False))


def test_passed_point_beside_a_corner_keeps_half_the_distance() -> None:
    nodes = np.array([np.zeros(6), [0.1, 0.002, 0, 0, 0, 0], [0.5, 0, 0, 0, 0, 0], [0.5, 0.6, 0, 0, 0, 0]])
    corners = list_rounded_corners(round_rapid_corners(build_legs(nodes), no_events(), space(deviation=0.02)))
    assert corners is not None
    assert len(corners) == 2
    assert (corners.share <= 0.5).all()
    np.testing.assert_array_equal(corners.q[1], nodes[2])


@pytest.mark.parametrize("case", ["cut", "below another cut", "in contact", "barred"])
def test_no_point_is_passed_near_possible_material(case: str) -> None:
    nodes = np.array([np.zeros(6), [0.3, 0.03, 0, 0.1, 0, 0], [0.9, 0, 0, 0.4, 0, 0]])
    legs = build_legs(nodes)
    keep = space(deviation=0.05)
    if case == "cut":
        legs = [cut_leg(nodes[0], 0.0, MoveKind.CUT), *legs]
    elif case == "below another cut":
        legs = [cut_leg(nodes[0], 0.0, MoveKind.RETRACT), *legs]
        keep = replace(keep, is_above_cuts=lambda _: False)
    elif case == "in contact":
        keep = replace(keep, collision=cast(Any, Wall(np.array([0.3, -0.05]), -0.04)))
    else:
        keep = replace(keep, barred=lambda x: bool((x[:, 1] == 0.0).all()))
    out = round_rapid_corners(legs, no_events(), keep)
    targets = [leg.waypoints[-1] for leg in out if leg.name == "rapid"]
    np.testing.assert_array_equal(targets, nodes[1:])


@pytest.mark.parametrize("sideways", [0.0, 1e-12, 1e-5, 1e-3])
def test_machine_stops_where_joints_reverse(sideways: float) -> None:
    nodes = np.zeros((4, 6))
    nodes[1, :2], nodes[2, 0], nodes[2, 1], nodes[3, 1] = (0.3, 0.1), 0.1, 0.1 / 3.0 + sideways, 0.4
    corners = list_rounded_corners(round_rapid_corners(build_legs(nodes), no_events(), space(deviation=1e-6)))
    assert corners is None or not (np.abs(corners.q - nodes[1]).max(axis=1) < 1e-9).any()


def list_near_straight_legs(off: float, count: int) -> Array:
    """Return nodes on a line; every second one is offset from it."""
    nodes = np.zeros((count, 6))
    nodes[:, 0] = 0.05 * np.arange(count)
    nodes[1:-1:2, 1] = off
    return nodes


@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("count", [3, 6])
def test_flat_corners_have_representable_shares(off: float, count: int) -> None:
    legs = round_rapid_corners(build_legs(list_near_straight_legs(off, count)), no_events(), space(deviation=1e-3))
    corners = list_rounded_corners(legs)
    assert corners is not None
    shares = np.round(corners.share, 6)  # rounded as in the table
    assert shares.min() > 0.0
    assert off > 1e-9 or shares.min() == 0.5
    x = np.concatenate([legs[0].q, *(leg.q[1:] for leg in legs[1:])])
    x = np.radians(np.round(np.degrees(x), 9))
    triangles = list_corner_triangles(replace(corners, share=shares), x)
    assert np.min([triangle.measure_deviation(x) for triangle in triangles], axis=0).max() <= 1e-9
    for n, triangle in enumerate(triangles):
        row = int(corners.sample[n])
        parts = x[corners.before[n] : row + 1], x[row : corners.after[n] + 1][::-1]
        assert triangle.measure_excess(*parts, SAMPLE) <= 1e-6
