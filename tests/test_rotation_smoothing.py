"""Rotation smoothing: known optimum, plunges, fixed points, shipped paths."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from test_planning_path import Rows, at_point, toolpath

from machopt.cell.cell_reader import load_cell
from machopt.data_types.plan_options import FixedRotation, ObjectiveWeights, PlanOptions
from machopt.data_types.toolpath import MoveKind
from machopt.numerics.rigid_transforms import wrap_angle
from machopt.planning.cost.stiffness_index import CandidateScores, compute_load_directions, score_candidates
from machopt.planning.pipeline.planning_setup import prepare_planning
from machopt.planning.sampling.candidate_enumeration import _forbid_by_user, enumerate_candidates
from machopt.planning.sampling.candidate_grid import CandidateGrid
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, choose_sequence
from machopt.planning.smoothing.corridor import compute_corridor
from machopt.planning.smoothing.rotation_smoothing import follow_grid_rotation, smooth_rotation
from machopt.planning.stations import path_station_selection
from machopt.planning.stations.planning_path import PlanningPath, build_planning_path
from machopt.toolpath.toolpath_reader import read_toolpath

ROOT = FilePath(__file__).resolve().parent.parent
UP = (0.0, 0.0, 1.0)
C, R = MoveKind.CUT, MoveKind.RAPID
STEP = np.radians(5.0)
VELOCITY = np.full(6, 2.0)
# the cost of the valley dominates; no ties
FREE = ObjectiveWeights(mean=1.0, worst=0.0, travel=1e-5, rotation=1e-5, feed=0.0)


def valley(
    path: PlanningPath, target: np.ndarray, low: float = -np.pi, high: float = np.pi
) -> tuple[CandidateGrid, CandidateScores]:
    """Return one branch whose joint 6 is phi, with the minimum cost at phi = target (S,): the optimum is known."""
    phi = np.arange(72) * STEP - np.pi
    S = len(path.stations)
    q = np.zeros((S, 72, 1, 6))
    q[..., 0, 5] = phi
    turns = np.zeros((3, 6))
    turns[1, 5], turns[2, 5] = 2 * np.pi, -2 * np.pi
    feasible = np.ones((S, 72, 1, 3), bool)
    feasible &= ((phi >= low) & (phi <= high))[None, :, None, None]
    cost = 1.5 - np.cos(phi[None] - target[:, None])
    return (
        CandidateGrid(
            branch=np.arange(1),
            phi=phi,
            q=q,
            turns=turns,
            reason=np.zeros((S, 72, 1), np.uint8),
            feasible=feasible,
            stable=True,
            shortfall=np.zeros(S),
        ),
        CandidateScores(cost[..., None], "stiffness", 1.0),
    )


def build_straight_path(n: int, length: float = 0.3, feed: float = 0.002) -> PlanningPath:
    rows: Rows = [((0, 0, 0), UP, R)] + [((x, 0, 0), UP, C) for x in np.linspace(0, length, n)[1:]]
    return build_planning_path(toolpath(rows, feed=feed))


def best_of(
    path: PlanningPath, candidates: CandidateGrid, scores: CandidateScores, options: PlanOptions
) -> SequenceChoice:
    return choose_sequence(path, candidates, scores, VELOCITY, options)


# --- a known optimum ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn_at", [0.3, 3.0])
def test_known_optimum_between_grid_steps_is_found(turn_at: float) -> None:
    """Also where it crosses the discontinuity of the grid at 180° (turn_at = 3 rad)."""
    path = build_straight_path(101, feed=0.02)
    s = path.s[path.stations] / path.s[-1]
    target = turn_at + 0.4 * np.sin(3 * s)
    candidates, scores = valley(path, target)
    options = PlanOptions(weights=FREE)
    choice = best_of(path, candidates, scores, options)
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, options)
    grid = follow_grid_rotation(path, candidates, choice)
    off, off_grid = (np.degrees(np.abs(wrap_angle(x.phi - target))) for x in (curve, grid))
    counted = path.counted  # the preceding rapid point has no cost and only follows
    assert off_grid[counted].max() > 2.0  # the error of the grid alone is up to half a step
    assert off[counted].max() < 0.6  # bending and rotation have a small cost: the error is below an eighth of a step
    assert np.abs(np.diff(curve.phi)).max() < np.radians(2.0)  # continuous across the discontinuity of the grid
    np.testing.assert_allclose(
        wrap_angle(curve.seed[:, 5] - curve.phi), 0, atol=1e-9
    )  # joints are linear in phi to first order: exact here


def test_curve_is_twice_continuously_differentiable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Convergence order: half the spacing halves the jumps
    of the second difference quotient; kinks would double them."""
    monkeypatch.setattr(path_station_selection, "MAX_STATIONS", 150)
    path = build_straight_path(1201, feed=0.1)
    target = 0.3 + 0.5 * np.sin(5 * path.s[path.stations] / path.s[-1])
    candidates, scores = valley(path, target)
    options = PlanOptions(weights=FREE)
    choice = best_of(path, candidates, scores, options)

    def jump(phi: np.ndarray, stride: int) -> float:
        second = np.diff(phi[::stride], 2) / (stride / 1200) ** 2
        return float(np.abs(np.diff(second)).max())

    curve, grid = (
        x.phi
        for x in (
            smooth_rotation(path, candidates, scores, choice, VELOCITY, options),
            follow_grid_rotation(path, candidates, choice),
        )
    )
    assert jump(curve, 2) > 1.6 * jump(curve, 1)  # 2 for piecewise constant third derivatives
    assert jump(grid, 2) < 0.7 * jump(grid, 1)  # the value for a curve with kinks


def test_curve_stays_in_the_feasible_range() -> None:
    path = build_straight_path(101)
    target = np.linspace(0.0, 1.5, len(path.stations))
    candidates, scores = valley(path, target, low=np.radians(-10), high=np.radians(50))
    options = PlanOptions(weights=FREE)
    choice = best_of(path, candidates, scores, options)
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, options)
    # the corridor is enforced at stations to 1/20 of a step (smooth.py), which leaves little room between them
    assert np.degrees(curve.phi.max()) < 50 + 0.3
    assert np.degrees(curve.phi.min()) > -10 - 0.3
    band = compute_corridor(candidates, scores, choice, np.arange(len(path.stations)))
    np.testing.assert_allclose(np.degrees(band.phi + band.high)[-1], 50)
    assert (band.low <= 0).all()
    assert (band.high >= 0).all()


def test_corridor_ends_at_infeasible_rotations_and_jumps() -> None:
    path = build_straight_path(11)
    candidates, scores = valley(path, np.zeros(len(path.stations)))
    candidates.q[:, 40:, 0, 2] = 2.0  # from 20° on another configuration with the same branch index
    choice = best_of(path, candidates, scores, PlanOptions(weights=FREE))
    band = compute_corridor(candidates, scores, choice, np.arange(len(path.stations)))
    np.testing.assert_allclose(np.degrees(band.phi + band.high), 15.0)  # 2 rad in joint 3 are not one step
    np.testing.assert_allclose(np.degrees(band.low), -80.0)  # the maximum width of a corridor
    np.testing.assert_allclose(band.slope[:, 5], 1.0)


def test_plunges_keep_the_rotation() -> None:
    rows: Rows = [((0, 0, 0.05), UP, R), ((0, 0, 0), UP, C)]
    rows += [((x, 0, 0), UP, C) for x in np.linspace(0, 0.2, 41)[1:]]
    rows += [((0.2, 0, 0.04), UP, C), ((0.2, 0, 0), UP, C)]  # a peck in the middle
    rows += [((x, 0, 0), UP, C) for x in np.linspace(0.2, 0.4, 41)[1:]] + [((0.4, 0, 0.05), UP, MoveKind.RETRACT)]
    path = build_planning_path(toolpath(rows, feed=0.002))
    target = 0.2 + 1.5 * path.s[path.stations] / path.s[-1]
    candidates, scores = valley(path, target)
    options = PlanOptions(weights=FREE)
    choice = best_of(path, candidates, scores, options)
    for curve in (
        smooth_rotation(path, candidates, scores, choice, VELOCITY, options),
        follow_grid_rotation(path, candidates, choice),
    ):
        assert np.ptp(curve.phi) > 0.5
        turned = np.abs(np.diff(curve.phi))
        assert path.plunge.sum() >= 10
        assert turned[path.plunge[1:]].max() < 1e-12


@pytest.mark.parametrize("degrees", [12.34, -31.0])
def test_fixed_rotation_is_exact_on_a_contour(degrees: float) -> None:
    path = build_straight_path(101)
    k = 50
    p = at_point(path, k)
    options = PlanOptions(
        weights=FREE, fixed=(FixedRotation(k, float(wrap_angle(np.radians(degrees) + path.offset[p]))),)
    )
    candidates, scores = valley(path, np.zeros(len(path.stations)))
    _forbid_by_user(path, candidates.phi, options, candidates.reason, candidates.feasible)
    choice = best_of(path, candidates, scores, options)
    assert not choice.broken
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, options)
    gamma = wrap_angle(curve.phi + path.offset)
    assert wrap_angle(gamma[p] - options.fixed[0].gamma) == pytest.approx(0.0, abs=1e-6)  # rad
    ends = np.degrees(curve.phi[[0, -1]])
    assert np.abs(ends).max() < 1.0  # away from the fixed point the valley dominates


def test_fixed_rotation_is_exact_in_a_hole() -> None:
    rows: Rows = []
    for x in (0.0, 0.1, 0.2):
        rows += [((x, 0, 0.05), UP, R), ((x, 0, -0.01), UP, C)]
    path = build_planning_path(toolpath(rows, kind="point"))
    p = at_point(path, 3)
    options = PlanOptions(fixed=(FixedRotation(3, np.radians(33.3)),))
    candidates, scores = valley(path, np.zeros(len(path.stations)))
    _forbid_by_user(path, candidates.phi, options, candidates.reason, candidates.feasible)
    choice = best_of(path, candidates, scores, options)
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, options)
    assert wrap_angle(curve.phi[p] + path.offset[p] - np.radians(33.3)) == pytest.approx(0.0, abs=1e-12)
    for a, b in path.runs:
        assert np.ptp(curve.phi[a : b + 1]) == 0.0


def test_hole_uses_the_minimum_of_its_valley() -> None:
    rows: Rows = []
    for x in (0.0, 0.1, 0.2):
        rows += [((x, 0, 0.05), UP, R), ((x, 0, -0.01), UP, C)]
    path = build_planning_path(toolpath(rows, kind="point"))
    target = np.radians([11.9, 22.8, 33.7])[path.run[path.stations]]
    candidates, scores = valley(path, target)
    options = PlanOptions(weights=ObjectiveWeights(mean=1.0, worst=0.5, travel=0.0, rotation=0.0))
    choice = best_of(path, candidates, scores, options)
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, options)
    off = np.degrees(np.abs(curve.phi - target[np.arange(len(path.index))]))
    assert off.max() < 5.0 / 8 / 2 + 0.05  # the fine grid of 1/8 step


def test_missing_stations_leave_a_gap_and_the_rest_is_smooth() -> None:
    path = build_straight_path(61)
    candidates, scores = valley(path, np.full(len(path.stations), 0.3))
    candidates.feasible[20] = False
    choice = best_of(path, candidates, scores, PlanOptions(weights=FREE))
    curve = smooth_rotation(path, candidates, scores, choice, VELOCITY, PlanOptions(weights=FREE))
    assert np.isnan(curve.phi[path.stations[20]])
    assert np.isnan(curve.seed[path.stations[20]]).all()
    rest = np.delete(np.arange(1, len(path.index)), path.stations[20] - 1)
    assert np.degrees(np.abs(curve.phi[rest] - 0.3)).max() < 0.7


# --- shipped paths -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell_name", "name"),
    [
        ("kr500_milling", "plain.csv"),
        ("kr500_milling", "cylinder_head_face.cls"),
        ("kr240_drilling", "panel_holes.csv"),
        ("cutting_cobot", "bone_tracks.csv"),
    ],
)
def test_shipped_path_stays_in_its_corridor(cell_name: str, name: str) -> None:
    cell, tp = load_cell(ROOT / "cells" / cell_name), read_toolpath(ROOT / "toolpaths" / name)
    options = PlanOptions(collision=False, rotation_range=tuple(np.radians([-100.0, 100.0])))  # type: ignore[arg-type]
    setup, path, velocity = prepare_planning(cell, options), build_planning_path(tp), cell.limits.velocity[:6]
    candidates = enumerate_candidates(path, setup.arm, options)
    d = compute_load_directions(path, setup.arm, setup.elasticity, options.force)
    scores = score_candidates(path, candidates, setup.elasticity, d, options)
    choice = choose_sequence(path, candidates, scores, velocity, options)
    curve = smooth_rotation(path, candidates, scores, choice, velocity, options)
    position = np.searchsorted(path.stations, np.arange(len(path.index)))
    for a, b in path.runs:
        rows = np.arange(position[a], position[b] + 1)
        if choice.dropped[rows].any():
            continue
        band = compute_corridor(candidates, scores, choice, rows)
        offset = wrap_angle(curve.phi[path.stations[rows]] - band.phi)
        assert (offset >= band.low - 0.051 * STEP).all()
        assert (offset <= band.high + 0.051 * STEP).all()
    gamma = np.degrees(wrap_angle(curve.phi + path.offset))
    assert np.nanmax(np.abs(gamma[path.stations])) < 100.3
    assert np.nanmax(np.abs(np.diff(curve.phi)[path.plunge[1:]]), initial=0.0) < 1e-9
