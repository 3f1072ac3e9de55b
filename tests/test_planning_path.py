"""Planning path: complete points, directions according to the contract, plunges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from property_example_count import NIGHTLY, scale_example_count

from machopt.data_types.toolpath import MoveKind, Toolpath, ToolpathOperation
from machopt.numerics.rigid_transforms import compute_tool_rotation, normalise_vectors, wrap_angle
from machopt.planning.stations import path_station_selection
from machopt.planning.stations import planning_path as path_module
from machopt.planning.stations.planning_path import (
    SEGMENT,
    SEGMENT_AXIS,
    PlanningPath,
    build_planning_path,
    compute_tcp_poses,
)

UP = (0.0, 0.0, 1.0)
C, R, A = MoveKind.CUT, MoveKind.RAPID, MoveKind.APPROACH
Rows = list[tuple[tuple[float, float, float], tuple[float, float, float], MoveKind]]


def toolpath(rows: Rows, kind: str = "trajectory", reference: np.ndarray | None = None, feed: float = 0.02) -> Toolpath:
    n = len(rows)
    position, axis = np.array([r[0] for r in rows], float), np.array([r[1] for r in rows], float)
    move = np.array([r[2] for r in rows], np.int8)
    return Toolpath(
        position=position,
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        move=move,
        feed=np.where(move == MoveKind.RAPID, np.nan, feed),
        operation=np.zeros(n, np.int32),
        operations=(ToolpathOperation("op", kind),),  # type: ignore[arg-type]
        reference=np.full((n, 3), np.nan) if reference is None else reference,
        tolerance=np.full(n, np.nan),
        line=np.arange(n, dtype=np.int32),
        source="test",
        format="test",
        sha256="",
    )


def square(side: float = 0.1) -> Rows:
    """A closed contour, entered by a plunge and left by a retract along the tool axis."""
    corners = [(0, 0), (side, 0), (side, side), (0, side), (0, 0)]
    rows: Rows = [((0, 0, 0.05), UP, R), ((0, 0, 0.0), UP, C)]
    rows += [((x, y, 0.0), UP, C) for x, y in corners[1:]]
    return [*rows, ((0, 0, 0.05), UP, MoveKind.RETRACT)]


def swaying(n: int, seed: int) -> Toolpath:
    rng = np.random.default_rng(seed)
    position = np.cumsum(rng.normal(size=(n, 3)) * [0.03, 0.02, 0.004], axis=0)
    axis = normalise_vectors(np.array([0, 0, 1.0]) + np.cumsum(rng.normal(size=(n, 3)) * 0.03, axis=0))
    move = np.where(rng.uniform(size=n) < 0.2, MoveKind.RAPID, MoveKind.CUT).astype(np.int8)
    return toolpath([(tuple(p), tuple(a), MoveKind(int(m))) for p, a, m in zip(position, axis, move, strict=True)])


def length_weight(path: PlanningPath) -> np.ndarray:
    """For each cut segment, add half its length to either end; the whole to its end if its start is not a cut point."""
    out = np.zeros(len(path.index))
    for i in range(1, len(out)):
        if path.move[i] == MoveKind.CUT:
            length = float(np.linalg.norm(path.position[i] - path.position[i - 1]))
            out[i] += length / 2
            out[i - 1 if path.move[i - 1] == MoveKind.CUT else i] += length / 2
    return out / out.sum() if out.any() else path.counted / path.counted.sum()


def at_point(path: PlanningPath, k: int) -> int:
    return int(np.flatnonzero(path.is_point & (np.round(path.index) == k))[0])


# --- points, runs, lengths ---------------------------------------------------------------------------------


@settings(max_examples=scale_example_count(30), deadline=None, derandomize=not NIGHTLY)
@given(st.integers(1, 40), st.integers(0, 1000))
def test_every_toolpath_point_is_present_once_in_order(n: int, seed: int) -> None:
    tp = swaying(n, seed)
    path = build_planning_path(tp)
    np.testing.assert_array_equal(path.index[path.is_point], np.arange(n))
    np.testing.assert_array_equal(path.position[path.is_point], tp.position)
    np.testing.assert_allclose(path.axis[path.is_point], tp.axis, atol=1e-15)
    np.testing.assert_array_equal(path.move[path.is_point], tp.move)
    assert (np.diff(path.index) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(path.axis, axis=1), 1, atol=1e-12)
    # between points: on the straight line, in the plane of the two axes, at most one planning step apart
    for p in np.flatnonzero(~path.is_point):
        k, f = int(path.index[p]), path.index[p] % 1
        np.testing.assert_allclose(path.position[p], (1 - f) * tp.position[k] + f * tp.position[k + 1], atol=1e-12)
        assert abs(np.linalg.det([path.axis[p], tp.axis[k], tp.axis[k + 1]])) < 1e-9
        assert path.move[p] == tp.move[k + 1]
    same = path.run[1:] == path.run[:-1]
    gap = np.linalg.norm(np.diff(path.position, axis=0), axis=1)[same]
    turn = np.linalg.norm(np.diff(path.axis, axis=0), axis=1)[same]
    assert gap.max(initial=0) <= SEGMENT * (1 + 1e-9)
    assert turn.max(initial=0) <= SEGMENT_AXIS * 1.01  # equal parts of the chord are not exactly equal angles
    # a run starts at the end of each rapid move and contains no further rapid move
    first = [a for a, _ in path.runs]
    rapid = np.flatnonzero(path.move == MoveKind.RAPID)
    assert set(rapid) | {0} == set(first)
    assert [b for _, b in path.runs] == [*(a - 1 for a in first[1:]), len(path.index) - 1]
    for r, (a, b) in enumerate(path.runs):
        assert (path.run[a : b + 1] == r).all()


def test_length_and_time_count_all_but_rapid_moves() -> None:
    path = build_planning_path(toolpath(square()))
    assert path.s[-1] == pytest.approx(0.05 + 0.4 + 0.05)
    assert path.time[-1] == pytest.approx((0.05 + 0.4 + 0.05) / 0.02)
    assert (np.diff(path.s) >= 0).all()
    two: Rows = [((0, 0, 0), UP, R), ((0.1, 0, 0), UP, C), ((5, 5, 5), UP, R), ((5.1, 5, 5), UP, C)]
    assert build_planning_path(toolpath(two)).s[-1] == pytest.approx(0.2)


@pytest.mark.parametrize("stations", [1500, 60])
def test_weights_equal_the_cut_length(stations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_station_selection, "ALL_STATIONS", stations)
    monkeypatch.setattr(path_station_selection, "MAX_STATIONS", stations)
    rows: Rows = [((0, 0, 0.05), UP, R), ((0, 0, 0.0), UP, A)]
    rows += [((x, 0, 0), UP, C) for x in (0.001, 0.002, 0.003, 0.5)] + [((0.5, 0, 0.05), UP, MoveKind.RETRACT)]
    rows += [((0.7, 0, 0.05), UP, R), ((0.7, 0, 0.045), UP, A), ((0.7, 0, 0.015), UP, C), ((0.7, 0, 0.05), UP, R)]
    for tp in (toolpath(rows), swaying(200, 7)):
        path = build_planning_path(tp)
        np.testing.assert_allclose(path.weight, length_weight(path), atol=1e-15)
        assert path.weight.sum() == pytest.approx(1.0)
        assert (path.weight[~path.counted] == 0).all()
        assert path.station_weight.sum() == pytest.approx(1.0)
        # for values interpolated between stations, the mean over the stations equals the mean over all points
        values = np.random.default_rng(1).normal(size=len(path.stations))
        every = np.interp(np.arange(len(path.index)), path.stations, values)
        assert path.station_weight @ values == pytest.approx(path.weight @ every, abs=1e-12)
    path = build_planning_path(toolpath(rows))
    hole = path.run == path.run[at_point(path, 9)]
    assert path.weight[hole].sum() == pytest.approx(0.03 / 0.53)  # a hole is weighted by its depth
    assert path.motion_share[hole] == pytest.approx(0.03 / 0.53)
    # the same contour with more points has the same mean of any quantity that is linear along it
    dense = build_planning_path(toolpath([r for r in rows if r[0][0] not in (0.001, 0.002)]))
    assert path.weight @ path.position[:, 0] == pytest.approx(dense.weight @ dense.position[:, 0], abs=1e-5)
    touches = build_planning_path(toolpath([((0, 0, 0), UP, C), ((1, 0, 0), UP, R), ((1, 0, 0), UP, C)]))
    np.testing.assert_allclose(touches.weight, [0.5, 0, 0.5])


def test_corners_and_cut_ends_get_additional_points_on_request() -> None:
    tp = toolpath(square())
    plain, dense = build_planning_path(tp), build_planning_path(tp, corners=0.002)
    added = np.setdiff1d(dense.index, plain.index)
    around = np.array([-0.002, -0.001, 0.001, 0.002])
    # closed square: segment lengths before and after the plunge (a cut here), three corners and the end of the cut
    lengths = {1: (0.05, 0.1), 2: (0.1, 0.1), 3: (0.1, 0.1), 4: (0.1, 0.1), 5: (0.1, 0.05)}
    wanted = [k + d / (before if d < 0 else after) for k, (before, after) in lengths.items() for d in around]
    np.testing.assert_allclose(added, wanted, atol=1e-12)
    gentle = [((0.02 * k, 0.0002 * k * k, 0), UP, C) for k in range(10)]  # 1.1° between segments
    assert len(build_planning_path(toolpath(gentle), corners=0.002).index) == len(
        build_planning_path(toolpath(gentle)).index
    )
    short = toolpath([((0, 0, 0), UP, R), ((0.001, 0, 0), UP, C), ((0.001, 0.001, 0), UP, C)])
    # half-way points; an added point that coincides with a toolpath point is omitted
    assert len(build_planning_path(short, corners=0.001).index) == 5


def test_single_and_repeated_points_are_valid_paths() -> None:
    one = build_planning_path(toolpath([((0, 0, 0), UP, C)]))
    assert len(one.index) == 1
    assert one.runs == ((0, 0),)
    assert one.counted.all()
    again = build_planning_path(toolpath([((0, 0, 0), UP, C)] * 3 + [((0.05, 0, 0), UP, C)]))
    assert np.isfinite(again.reference).all()
    np.testing.assert_allclose(again.travel, np.broadcast_to([1.0, 0, 0], again.travel.shape), atol=1e-12)
    assert not again.plunge.any()


# --- direction of travel and gamma -------------------------------------------------------------------------


def test_travel_is_outgoing_and_a_plunge_uses_that_of_its_cut() -> None:
    path = build_planning_path(toolpath(square()))
    expected = {0: (1, 0, 0), 1: (1, 0, 0), 2: (0, 1, 0), 3: (-1, 0, 0), 4: (0, -1, 0), 5: (0, -1, 0), 6: (0, -1, 0)}
    for k, direction in expected.items():
        np.testing.assert_allclose(path.travel[at_point(path, k)], direction, atol=1e-12)
    assert path.plunge[at_point(path, 1)]
    assert path.plunge[at_point(path, 6)]
    assert not path.plunge[at_point(path, 0)]  # a rapid move is not a plunge
    between = (path.index > 1) & (path.index <= 5)
    assert not path.plunge[between].any()
    assert path.plunge[(path.index > 0) & (path.index <= 1)].all()  # all of its planning points


def test_travel_is_normal_to_an_inclined_tool() -> None:
    axis = (0.3, 0.1, 0.9)
    path = build_planning_path(
        toolpath([((0, 0, 0), axis, R), ((0.05, 0.01, 0), axis, C), ((0.06, 0.05, 0.01), axis, C)])
    )
    np.testing.assert_allclose(np.sum(path.travel * path.axis, axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(path.travel, axis=1), 1, atol=1e-12)


def test_plunge_tolerance_is_between_one_and_two_degrees() -> None:
    for angle, expected in ((0.9, True), (2.0, False)):
        x = 0.01 * np.tan(np.radians(angle))
        path = build_planning_path(toolpath([((0, 0, 0.01), UP, R), ((x, 0, 0), UP, C), ((0.05, 0, 0), UP, C)]))
        assert bool(path.plunge[at_point(path, 1)]) is expected


def test_reference_is_travel_for_milling_and_workpiece_x_for_holes() -> None:
    milling = build_planning_path(toolpath(square()))
    R0 = compute_tool_rotation(milling.axis, milling.reference, -milling.offset)  # gamma = 0
    np.testing.assert_allclose(R0[:, :, 0], milling.travel, atol=1e-12)
    np.testing.assert_allclose(R0[:, :, 2], -milling.axis, atol=1e-12)
    for axis, direction in (((0.2, 0.3, 0.9), (1, 0, 0)), ((1, 0, 0), (0, 1, 0)), ((-1, 0.001, 0), (0, 1, 0))):
        a = np.array(axis) / np.linalg.norm(axis)
        tip = tuple(0.02 * a)
        holes = build_planning_path(toolpath([(tip, axis, R), ((0, 0, 0), axis, C)], kind="point"))
        across = np.array(direction, float) - np.dot(direction, a) * a
        R0 = compute_tool_rotation(holes.axis, holes.reference, -holes.offset)
        np.testing.assert_allclose(
            R0[:, :, 0], np.broadcast_to(across / np.linalg.norm(across), (len(R0), 3)), atol=1e-9
        )


@settings(max_examples=scale_example_count(40), deadline=None, derandomize=not NIGHTLY)
@given(st.integers(2, 30), st.integers(0, 1000), st.floats(-3, 3))
def test_phi_about_the_transported_reference_equals_gamma_about_the_natural_one(n: int, seed: int, phi: float) -> None:
    path = build_planning_path(swaying(n, seed))
    every = np.arange(len(path.index), dtype=np.int32)
    poses = compute_tcp_poses(path, every, np.full(len(every), phi))
    natural = compute_tool_rotation(path.axis, path.travel, wrap_angle(phi + path.offset))
    np.testing.assert_allclose(poses[:, :3, :3], natural, atol=1e-9)
    np.testing.assert_allclose(poses[:, :3, 3], path.position)
    np.testing.assert_allclose(np.sum(path.reference * path.axis, axis=1), 0, atol=1e-12)
    two = compute_tcp_poses(path, every[:3], np.zeros((len(every[:3]), 4)) + phi)
    np.testing.assert_allclose(two, np.broadcast_to(poses[:3, None], two.shape), atol=1e-15)


def test_constant_phi_does_not_rotate_the_tool_about_itself() -> None:
    """The reference is carried by minimal rotations: no rotation about the tool axis between planning points."""
    path = build_planning_path(swaying(30, 3))
    every = np.arange(len(path.index), dtype=np.int32)
    turned = compute_tcp_poses(path, every, np.zeros(len(every)))[:, :3, :3]
    for a, b in path.runs:
        for p in range(a, b):
            step = turned[p + 1] @ turned[p].T
            twist = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
            # the axis of a minimal rotation is normal to both tool axes
            assert abs(twist @ path.axis[p]) < 1e-9
            assert abs(twist @ path.axis[p + 1]) < 1e-9


def test_closed_contour_turns_gamma_once_and_phi_not_at_all() -> None:
    path = build_planning_path(toolpath(square()))
    corner = [path.offset[at_point(path, k)] for k in (1, 2, 3, 4)]
    # TCP z points down: a left turn of the path is a negative rotation about it, so gamma increases for a fixed tool
    np.testing.assert_allclose(np.abs(wrap_angle(np.diff(corner))), np.pi / 2, atol=1e-9)
    assert abs(np.sum(wrap_angle(np.diff(corner)))) == pytest.approx(1.5 * np.pi)
    np.testing.assert_allclose(path.reference, np.broadcast_to([1.0, 0, 0], path.reference.shape), atol=1e-12)


def test_reference_of_the_file_takes_precedence() -> None:
    rows = square()
    own = np.tile([0.0, 1.0, 0.2], (len(rows), 1))
    path = build_planning_path(toolpath(rows, reference=own))
    R0 = compute_tool_rotation(path.axis, path.reference, -path.offset)
    np.testing.assert_allclose(R0[:, :, 0], np.broadcast_to([0.0, 1, 0], (len(R0), 3)), atol=1e-9)


def test_reference_along_the_tool_axis_falls_back_to_the_natural_one() -> None:
    """Such a reference has no direction; the natural one is used (a NaN would make every rotation unreachable)."""
    rows = square()
    own = np.tile([0.0, 1.0, 0.0], (len(rows), 1))
    own[2] = UP
    path = build_planning_path(toolpath(rows, reference=own))
    assert np.isfinite(path.reference).all()
    assert np.isfinite(path.offset).all()


# --- stations ----------------------------------------------------------------------------------------------


def test_dense_paths_are_thinned_evenly_with_the_ends_of_every_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_station_selection, "ALL_STATIONS", 60)
    monkeypatch.setattr(path_station_selection, "MAX_STATIONS", 60)
    rows: Rows = []
    for k in range(4):
        rows += [((0, 0.1 * k, 0.02), UP, R)] + [((x, 0.1 * k, 0.0), UP, C) for x in np.linspace(0, 0.1 * (k + 1), 200)]
    path = build_planning_path(toolpath(rows))
    stations = path.stations
    assert len(stations) <= 60 + 8
    assert (np.diff(stations) > 0).all()
    for a, b in path.runs:
        assert a in stations
        assert b in stations
        inside = stations[(stations >= a) & (stations <= b)]
        assert np.diff(path.s[inside])[1:-1].max() < 2.5 * path.s[-1] / 60
    fixed = build_planning_path(toolpath(rows), keep=(77, 333))  # with rotations fixed by the user
    assert {77.0, 333.0} <= set(fixed.index[fixed.stations])
    assert len(fixed.stations) <= len(stations) + 2
    short = build_planning_path(toolpath(rows[:50]))
    np.testing.assert_array_equal(short.stations, np.arange(len(short.index)))


def test_stations_follow_detail_not_a_count() -> None:
    def straight(length: float, points: int) -> Rows:
        return [((0, 0, 0.02), UP, R)] + [((x, 0, 0.0), UP, C) for x in np.linspace(0, length, points)]

    def stations(rows: Rows) -> int:
        return len(build_planning_path(toolpath(rows)).stations)

    once = stations(straight(1.0, 3000))
    assert once == pytest.approx(1.0 / path_station_selection.SPACING, abs=10)  # including the bend at the approach
    assert stations(straight(1.0, 30_000)) == pytest.approx(once, abs=10)  # denser points are not more detail
    assert stations(straight(2.0, 3000)) == pytest.approx(2 * once, abs=10)
    circle = [((0, 0, 0.02), UP, R)]  # radius 1 mm: the circumference is below SPACING
    circle += [((0.002 * np.cos(a), 0.002 * np.sin(a), 0.0), UP, C) for a in np.linspace(0, 2 * np.pi, 3000)]
    assert stations(circle) > 50
    tilting = [((0, 0, 0.02), UP, R)]
    tilting += [((1e-3 * a, 0, 0.0), (np.sin(a), 0, np.cos(a)), C) for a in np.linspace(0, 1.0, 3000)]
    assert stations(tilting) == pytest.approx(1.0 / path_station_selection.TILT, abs=10)


def test_rounded_coordinates_are_no_bends() -> None:
    x = np.arange(0, 3000) * 5e-5  # m, points 0.05 mm apart
    rough = [((0, 0, 0.02), UP, R)] + [((a, round(0.3 * a, 6), 0.0), UP, C) for a in x]
    exact = [((0, 0, 0.02), UP, R)] + [((a, 0.3 * a, 0.0), UP, C) for a in x]
    assert len(build_planning_path(toolpath(rough)).stations) <= 1.5 * len(
        build_planning_path(toolpath(exact)).stations
    )


def test_path_with_too_much_detail_keeps_its_proportions(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: Rows = [((0, 0, 0.02), UP, R)] + [((x, 0, 0.0), UP, C) for x in np.linspace(0, 1.0, 3000)]
    rows += [((1.0 + 0.005 * np.sin(a), 0.005 - 0.005 * np.cos(a), 0.0), UP, C) for a in np.linspace(0, 6, 3000)]
    every = build_planning_path(toolpath(rows)).stations
    monkeypatch.setattr(path_station_selection, "MAX_STATIONS", 100)
    few = build_planning_path(toolpath(rows)).stations
    assert len(few) <= 110
    assert (few > 3000).mean() == pytest.approx((every > 3000).mean(), abs=0.05)


def test_points_inserted_late_in_a_path_are_no_toolpath_points() -> None:
    """Near the index 30,000 fractions are small relative to the index:
    a point of the toolpath is recognised by an absolute tolerance."""
    near = [((1e-5 * k, 0.0, 0.0), UP, C) for k in range(30_000)]
    path = build_planning_path(toolpath([((0.0, 0.0, 0.05), UP, R), *near, ((0.4, 0.0, 0.0), UP, C)]))
    assert path.is_point.sum() == 30_002
    assert len(path.index) > 30_002  # the last segment and the approach are divided
    np.testing.assert_array_equal(path.index[path.is_point], np.arange(30_002))


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5)), min_size=1, max_size=30))
def test_point_without_direction_uses_the_next_or_previous_of_its_run(
    points: list[tuple[bool, int]],
) -> None:
    """Compared with the definition, point by point; one in six values begins a run."""
    good = np.array([g for g, _ in points])
    joined = np.array([k > 0 for _, k in points])
    joined[0] = False
    run = np.cumsum(~joined)
    for i, found in enumerate(path_module._find_nearest_valid(good, joined)):
        mine = [k for k in range(len(good)) if good[k] and run[k] == run[i]]
        later, before = [k for k in mine if k >= i], [k for k in mine if k < i]
        assert found == (later[0] if later else before[-1] if before else -1)
