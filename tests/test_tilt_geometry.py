"""Tilt of a ball cutter: equations, ranges at corners, steps; the joint search compared with other implementations."""

from __future__ import annotations

import itertools
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from machopt.data_types.plan_options import PlanOptions, TiltRange
from machopt.data_types.toolpath import Toolpath
from machopt.errors import CellError
from machopt.numerics.array_types import Array
from machopt.numerics.rigid_transforms import compute_tool_rotation, normalise_vectors
from machopt.numerics.tool_tilt import (
    compute_tilted_axis,
    compute_tilted_tip,
    measure_lead_and_side,
    rotate_with_axis,
)
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.planning.stations.tilt_curve import TiltCurve, tilt_path
from machopt.planning.tilt import tilt_smoothing
from machopt.planning.tilt.step_limit import BULGE, limit_steps
from machopt.planning.tilt.tilt_and_rotation_search_kernel import find_joint_sequence
from machopt.planning.tilt.tilt_cost_parabolas import build_local_costs
from machopt.planning.tilt.tilt_grid import build_tilt_nodes
from machopt.planning.tilt.tilt_limits import MARGIN, compute_tilt_limits, hold_outside_cuts
from machopt.planning.tilt.tilt_smoothing import price_tangents, smooth_tilts
from machopt.toolpath.toolpath_reader import read_toolpath

HEADER = "x_mm,y_mm,z_mm,i,j,k,move,feed_mm_min,operation\n"
RADIUS = 0.0085  # m
FREE = PlanOptions(tilt=TiltRange((radians(-5), radians(5)), (radians(-5), radians(5))))
CORNER = (
    "-100,-60,40,0,0,1,rapid,,face",
    "-100,-60,-0.5,0,0,1,cut,500,face",  # a plunge
    "60,-60,-0.5,0,0.1,1,cut,1500,face",
    "60,40,-0.5,0,0,1,cut,1500,wall",  # turns by 90°
    "60,40,20,0,0,1,retract,1000,wall",
)


def make_path(folder: Path, rows: tuple[str, ...] = CORNER) -> tuple[Toolpath, PlanningPath]:
    file = folder / "path.csv"
    file.write_text(HEADER + "\n".join(rows) + "\n")
    toolpath = read_toolpath(file)
    return toolpath, build_planning_path(toolpath)


@pytest.fixture
def corner(tmp_path: Path) -> tuple[Toolpath, PlanningPath]:
    return make_path(tmp_path)


def random_frames(count: int) -> tuple[Array, Array, np.random.Generator]:
    rng = np.random.default_rng(7)
    axis = normalise_vectors(rng.normal(size=(count, 3)))
    travel = normalise_vectors(np.cross(axis, rng.normal(size=(count, 3))))
    return axis, travel, rng


def test_lead_and_side_are_rotations_of_the_axis() -> None:
    axis, travel, rng = random_frames(50)
    angle = rng.uniform(-0.4, 0.4, 50)
    zero = np.zeros(50)
    across = np.cross(axis, travel)
    lead = Rotation.from_rotvec(angle[:, None] * across).apply(axis)  # about a × t, towards t
    side = Rotation.from_rotvec(-angle[:, None] * travel).apply(axis)  # about −t, towards a × t
    assert np.allclose(compute_tilted_axis(axis, travel, angle, zero), lead, atol=1e-14)
    assert np.allclose(compute_tilted_axis(axis, travel, zero, angle), side, atol=1e-14)


def test_measuring_inverts_tilting() -> None:
    axis, travel, rng = random_frames(50)
    lead, side = rng.uniform(-0.5, 0.5, (2, 50))
    tilted = compute_tilted_axis(axis, travel, lead, side)
    assert np.allclose(measure_lead_and_side(axis, travel, tilted), (lead, side), atol=1e-14)
    angle = np.arctan(np.hypot(np.tan(lead), np.tan(side)))
    assert np.allclose(np.arccos(np.sum(axis * tilted, axis=1)), angle, atol=1e-12)


def test_ball_turns_about_its_centre() -> None:
    axis, travel, rng = random_frames(20)
    tip = rng.normal(size=(20, 3))
    tilted = compute_tilted_axis(axis, travel, *rng.uniform(-0.3, 0.3, (2, 20)))
    moved = compute_tilted_tip(tip, axis, tilted, RADIUS)
    assert np.allclose(moved + RADIUS * tilted, tip + RADIUS * axis, atol=1e-15)


def test_smallest_rotation_moves_one_axis_to_the_other() -> None:
    axis, travel, rng = random_frames(20)
    tilted = compute_tilted_axis(axis, travel, *rng.uniform(-0.3, 0.3, (2, 20)))
    assert np.allclose(rotate_with_axis(axis, axis, tilted), tilted, atol=1e-14)
    normal = normalise_vectors(np.cross(axis, tilted))
    assert np.allclose(rotate_with_axis(normal, axis, tilted), normal, atol=1e-14)


def test_gamma_is_measured_from_the_travel_normal_to_the_tilted_axis(corner: tuple[Toolpath, PlanningPath]) -> None:
    _, path = corner
    n = len(path.index)
    axis = compute_tilted_axis(path.axis, path.travel, np.full(n, 0.08), np.full(n, -0.06))
    tilted = tilt_path(path, axis, RADIUS)
    x = compute_tool_rotation(tilted.axis, tilted.reference, -tilted.offset)[..., 0]  # gamma = 0
    wanted = path.travel - np.sum(path.travel * axis, axis=1, keepdims=True) * axis
    assert np.allclose(x, normalise_vectors(wanted), atol=1e-9)
    assert np.allclose(tilted.position + RADIUS * axis, path.position + RADIUS * path.axis, atol=1e-15)
    assert tilted.programmed.position is path.position
    assert tilted.lead == pytest.approx(np.full(n, 0.08))


def test_zero_tilt_changes_no_bit(corner: tuple[Toolpath, PlanningPath]) -> None:
    _, path = corner
    same = tilt_path(path, path.axis.copy(), RADIUS)
    for name in ("position", "axis", "reference", "offset"):
        assert np.array_equal(getattr(same, name), getattr(path, name))


def test_curve_is_sampled_between_its_points(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    n = len(path.index)
    axis = compute_tilted_axis(path.axis, path.travel, np.linspace(0.0, 0.08, n), np.zeros(n))
    curve = TiltCurve(path.index, axis, RADIUS)
    assert np.array_equal(curve.sample(path.index), axis)
    more = build_planning_path(toolpath, corners=0.004)
    sampled = curve.tilt_path(more)
    assert np.allclose(sampled.axis[np.searchsorted(more.index, path.index)], axis, atol=1e-12)
    assert np.allclose(np.linalg.norm(sampled.axis, axis=1), 1.0, atol=1e-12)


def test_plunge_uses_the_travel_of_the_next_cut(corner: tuple[Toolpath, PlanningPath]) -> None:
    _, path = corner
    before = path.index <= 1.0  # the rapid point and the plunge
    assert np.allclose(path.travel[before], [1.0, 0.0, 0.0], atol=1e-12)


def test_corner_respects_both_ranges(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    ranges = {"face": TiltRange((0.0, 0.08), (-0.02, 0.06)), "wall": TiltRange((-0.05, 0.03), (0.0, 0.02))}
    limits = compute_tilt_limits(path, toolpath, PlanOptions(tilt_operations=tuple(ranges.items())))
    rng = np.random.default_rng(3)
    wild = rng.normal(scale=0.3, size=path.axis.shape)
    wild -= np.sum(wild * path.axis, axis=1, keepdims=True) * path.axis
    w = limits.project(wild)
    assert limits.find_excess(w).max() < 1e-9
    p = int(np.flatnonzero(path.index == 2.0)[0])  # leaves along y and arrives along x
    lead, side = measure_lead_and_side(path.axis[p], np.array([1.0, 0.0, 0.0]), normalise_vectors(path.axis[p] + w[p]))
    assert -1e-9 <= lead <= 0.08 + 1e-9
    # the axis is inclined by 5.7° there, relative to the x axis of the frame
    assert -0.02 - 1e-3 <= side <= 0.06 + 1e-3


def test_range_without_zero_is_refused_at_a_sharp_corner(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    with pytest.raises(CellError) as caught:
        compute_tilt_limits(path, toolpath, PlanOptions(tilt=TiltRange((radians(3), radians(8)))))
    assert caught.value.where == "tilt_deg"


def test_fixed_lead_follows_a_curve(tmp_path: Path) -> None:
    angle = np.radians(np.arange(0, 90, 5))
    rows = [f"{60 * np.cos(a):.6f},{60 * np.sin(a):.6f},0,0,0,1,{'cut' if a else 'rapid'},1000,arc" for a in angle]
    toolpath, path = make_path(tmp_path, tuple(rows))
    lead = radians(3)
    limits = compute_tilt_limits(path, toolpath, PlanOptions(tilt=TiltRange((lead, lead))))
    w = limits.project(np.zeros_like(path.axis))
    cut = limits.cuts[0]
    found, side = measure_lead_and_side(path.axis, path.travel, normalise_vectors(path.axis + w))
    assert found[cut] == pytest.approx(np.full(cut.sum(), lead), abs=1e-9)
    assert np.abs(side[cut]).max() < 1e-9


def test_moves_outside_cuts_keep_the_adjacent_tilt(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    limits = compute_tilt_limits(path, toolpath, FREE)
    w = limits.project(np.tile([0.05, 0.02, 0.0], (len(path.index), 1)))
    fixed = hold_outside_cuts(path, limits, w)
    last = int(np.flatnonzero(limits.cuts.any(axis=0))[-1])
    assert path.index[last] == 3.0
    assert np.allclose(fixed[last:], fixed[last], atol=1e-12)


def test_axial_run_is_not_tilted(tmp_path: Path) -> None:
    toolpath, path = make_path(tmp_path, ("0,0,20,0,0,1,rapid,,a", "0,0,-3,0,0,1,cut,300,a", "0,0,20,0,0,1,retract,,a"))
    assert not compute_tilt_limits(path, toolpath, FREE).is_free.any()


def test_steps_are_limited_inside_the_ranges(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    limits = compute_tilt_limits(path, toolpath, FREE)
    rng = np.random.default_rng(5)
    w = limit_steps(path, limits, rng.normal(scale=0.2, size=path.axis.shape), RADIUS)
    step = np.linalg.norm(np.diff(w, axis=0), axis=1)[limits.cuts[0, :-1]]
    assert RADIUS * step.max() ** 2 / 8 < 1.01 * BULGE
    assert limits.find_excess(w).max() < 1e-6


def make_search(seed: int) -> tuple[dict[str, Array], int]:
    """Return a small random search: stations, vertices with rotation and branch, costs and joints."""
    rng = np.random.default_rng(seed)
    S, R, B, K = 5, 6, 2, 2
    cells = [(s, r, k, b) for s in range(S) for r in range(R) for k in range(K) for b in range(B)]
    keep = [c for c in cells if rng.uniform() < 0.7]
    station = np.array([c[0] for c in keep])
    label = np.array([[c[1], c[3]] for c in keep], np.int64)
    number = station * R + label[:, 0]
    begin = np.searchsorted(number, np.arange(S * R + 1)).astype(np.int64)
    price = rng.uniform(0, 1, len(keep))
    price[rng.uniform(size=len(keep)) < 0.1] = np.inf
    return {
        "first": np.ascontiguousarray(begin[::R]),
        "label": label,
        "price": price,
        "q": rng.uniform(0, 2 * np.pi, (len(keep), 6)),
        "begin": np.ascontiguousarray(np.column_stack([begin[:-1].reshape(S, R), begin[R::R]])),
        "joined": np.array([False, True, True, False, True]),
        "step": rng.uniform(0, 0.3, (S, 4)),
        "slowness": rng.uniform(0, 1, 6),
        "rule": np.array([R, 1, 0.5, 1.0, 2.5, 50.0]),
    }, S


def price_sequence(given: dict[str, Array], chosen: tuple[int, ...]) -> float:
    """Return J of a sequence of vertices, implemented independently of the kernel."""
    total = 0.0
    count, window, angle, stable, jump, broken = given["rule"]
    for s, n in enumerate(chosen):
        total += given["price"][n]
        if s == 0:
            continue
        m = chosen[s - 1]
        d = np.abs((given["q"][n] - given["q"][m] + np.pi) % (2 * np.pi) - np.pi)
        turn = abs(given["label"][n, 0] - given["label"][m, 0])
        turn = min(turn, count - turn)
        travel, spin, late, seconds = given["step"][s]
        cost = travel * d.sum()
        if given["joined"][s]:
            if turn > window or d.max() > jump or (stable and given["label"][n, 1] != given["label"][m, 1]):
                cost = broken
            else:
                cost += spin * turn * angle + late * max((d * given["slowness"]).max() - seconds, 0.0)
        total += min(cost, broken)
    return float(total)


@pytest.mark.parametrize("seed", range(6))
def test_joint_search_finds_the_cheapest_sequence(seed: int) -> None:
    given, S = make_search(seed)
    found = find_joint_sequence(*given.values())
    vertices = [range(given["first"][s], given["first"][s + 1]) for s in range(S)]
    usable = [[n for n in some if np.isfinite(given["price"][n])] for some in vertices]
    value = {n: given["price"][n] for n in usable[0]}
    for s in range(1, S):  # Bellman's equation over all pairs
        value = {n: min(value[m] + _price_step(given, s, m, n) for m in usable[s - 1]) for n in usable[s]}
    assert price_sequence(given, tuple(found)) == pytest.approx(min(value.values()), abs=1e-9)


def _price_step(given: dict[str, Array], s: int, m: int, n: int) -> float:
    """Return the cost of the step to station s and of its vertex."""
    alone = {**given, "joined": np.array([False, given["joined"][s]]), "step": given["step"][[0, s]]}
    return price_sequence(alone, (m, n)) - float(given["price"][m])


def test_gradient_and_hessian_of_the_smoothing_agree_with_its_cost(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    limits = compute_tilt_limits(path, toolpath, FREE)
    nodes = build_tilt_nodes(path, limits)
    rng = np.random.default_rng(11)
    cost = 1.0 + 0.2 * rng.uniform(size=(len(path.stations), len(nodes.tangent)))
    costs = build_local_costs(nodes, limits, path.stations.astype(np.intp), cost)
    problem = tilt_smoothing._TiltProblem(
        costs=costs,
        share=np.full(len(costs.rows), 1.0 / len(costs.rows)),
        smooth=tilt_smoothing._build_smoothness(path, costs),
        mean=1.0,
        worst=0.5,
    )
    x = rng.uniform(-0.05, 0.05, costs.low.shape)
    slope, _ = problem.differentiate(x)
    for k in range(0, x.size, 5):
        step = np.zeros(x.size)
        step[k] = 1e-6
        by_difference = (problem.price(x + step.reshape(x.shape)) - problem.price(x - step.reshape(x.shape))) / 2e-6
        assert slope[k] == pytest.approx(by_difference, abs=1e-6)


def test_smoothing_finds_the_cheap_end_of_a_range(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    limits = compute_tilt_limits(path, toolpath, replace(FREE, tilt=TiltRange((radians(-5), radians(5)))))
    nodes = build_tilt_nodes(path, limits)
    cost = np.tile([1.2, 1.0, 0.8], (len(path.stations), 1))  # decreases with the lead angle
    costs = build_local_costs(nodes, limits, path.stations.astype(np.intp), cost)
    flat = np.zeros_like(path.axis)
    w = smooth_tilts(path, costs, limits, FREE, flat)
    lead, _ = measure_lead_and_side(path.axis, path.travel, normalise_vectors(path.axis + w))
    middle = (path.index > 1.2) & (path.index < 1.6)
    assert lead[middle] == pytest.approx(np.full(middle.sum(), radians(5)), abs=2e-3)
    assert price_tangents(path, costs, FREE, w) < price_tangents(path, costs, FREE, flat)


def test_grid_contains_the_ends_of_both_ranges(corner: tuple[Toolpath, PlanningPath]) -> None:
    toolpath, path = corner
    limits = compute_tilt_limits(path, toolpath, FREE)
    nodes = build_tilt_nodes(path, limits)
    p = int(np.flatnonzero(path.index == 1.0)[0])
    tilted = normalise_vectors(path.axis[p] + nodes.tangent[:, p])
    found = {
        tuple(np.round(np.degrees(measure_lead_and_side(path.axis[p], path.travel[p], a)), 6).tolist()) for a in tilted
    }
    end = round(5.0 - float(np.degrees(MARGIN)), 6)
    assert found == set(itertools.product((-end, 0.0, end), repeat=2))
