"""Start of a refinement, its motion near bodies, and the whole turns of the joints in a sequence."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_external_axis_collision import cell_of, model_of, random_x
from test_planning_path import UP, A, C, R, Rows, toolpath

from machopt.planning.continuous_refinement.distance_constraints import KEPT, add_distance_constraints
from machopt.planning.continuous_refinement.quadratic_model import OffsetBounds
from machopt.planning.continuous_refinement.starting_point import RefinementStart, compute_transition_weights
from machopt.planning.external_axis_optimization.whole_turns import compute_run_turns
from machopt.planning.stations.path_subset import select_path_runs
from machopt.planning.stations.planning_path import build_planning_path

TURN = 2.0 * np.pi


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1))
def test_whole_turns_of_runs_are_the_best_of_all(seed: int) -> None:
    """Trying all whole turns finds no shorter joint travel between runs within the limits."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 4, 3)
    q = np.concatenate([rng.uniform(-7, 7, (1, 6)) + np.cumsum(rng.uniform(-0.4, 0.4, (n, 6)), axis=0) for n in counts])
    ends = np.cumsum(counts)
    runs = [np.arange(b - n, b) for b, n in zip(ends, counts, strict=True)]
    lower, upper = -rng.uniform(3.3, 6.0, 6), rng.uniform(3.3, 6.0, 6)
    near = np.clip(rng.normal(size=q.shape), lower, upper)
    turns = compute_run_turns(q, runs, lower, upper, near)
    for rows in runs:
        assert (turns[rows] == turns[rows[0]]).all()

    def price(joint: int, of_run: tuple[float, ...]) -> tuple[float, float]:
        there = [q[rows, joint] + TURN * n for rows, n in zip(runs, of_run, strict=True)]
        over = sum(max(0.0, lower[joint] - v.min(), v.max() - upper[joint]) for v in there)
        return over, sum(abs(b[0] - a[-1]) for a, b in itertools.pairwise(there))

    for joint in range(6):
        own = price(joint, tuple(turns[rows[0], joint] for rows in runs))
        best = min(price(joint, t) for t in itertools.product(range(-3, 4), repeat=len(runs)))
        assert own == pytest.approx(best, abs=1e-4)


def test_infeasible_start_moves_back_towards_the_plan() -> None:
    left = np.zeros(40, bool)
    assert (compute_transition_weights(left, 4) == 1.0).all()
    left[10] = True
    share = compute_transition_weights(left, 4)
    assert (share[6:15] == 0.0).all()
    assert (share[:1] > 0.0).all()
    assert (share[22:] == 1.0).all()
    assert (np.diff(share[14:]) >= 0.0).all()
    start = RefinementStart(np.full(40, 2.0), np.full((40, 1), 3.0), np.zeros((40, 6)))
    nearer = start.nearer(np.ones(40), np.ones((40, 1)), share)
    np.testing.assert_array_equal(nearer.phi, 1.0 + share)
    np.testing.assert_array_equal(nearer.external[:, 0], 1.0 + 2.0 * share)


def test_detailed_segments_get_more_stations() -> None:
    """Both ends of each run are stations, and every segment has stations."""
    y = np.linspace(0.0, 1.0, 201)
    rows: Rows = [((0, 0, 0.02), UP, R), ((0, 0, 0), UP, A), *(((v, 0, 0), UP, C) for v in y[1:])]
    path = build_planning_path(toolpath(rows))
    busy = np.where(path.s > 0.9 * path.s[-1], 1.0, 0.0)
    even, led_there = select_path_runs(path, [0], 40), select_path_runs(path, [0], 40, busy)
    assert len(led_there.stations) <= len(even.stations) + 1
    for part in (even, led_there):
        assert {0, len(path.index) - 1} <= set(part.stations.tolist())
    late = [int((path.s[part.stations] > 0.9 * path.s[-1]).sum()) for part in (even, led_there)]
    assert late[1] > 3 * late[0]
    assert np.diff(path.s[led_there.stations]).max() < 0.1 * path.s[-1]


@pytest.mark.parametrize("kind", [{"rail": True}, {"rail": True, "table": True}])
def test_distances_are_linear_in_the_offsets(tmp_path: Path, kind: dict[str, bool]) -> None:
    """After a small step, the measured distance equals that
    of the linear bound while the nearest pair does not change."""
    cell = cell_of(tmp_path, **kind)
    model, clearance = model_of(cell, 0.005), 0.005
    x = random_x(cell, 300, 3)
    cutting = np.zeros(len(x), bool)
    found = model.find_nearest_pair(x, cutting, 0.08)
    near = (found.distance > 0.02) & (found.distance < 0.06)
    assert near.sum() > 5
    x, cutting, d = x[near], cutting[near], 3
    rng = np.random.default_rng(0)
    lean = rng.uniform(-1.0, 1.0, (len(x), x.shape[1], d))
    free = OffsetBounds(
        *(side * np.ones((len(x), d)) for side in (-1, 1)), np.zeros((len(x), 0, d)), *[np.zeros((len(x), 0))] * 2
    )
    message = np.ones(len(x), bool)
    message[0] = False
    bounds = add_distance_constraints(free, model, x, lean, cutting, message)
    assert bounds.lean.shape == (len(x), 1, d)
    assert bounds.under[0, 0] == -np.inf
    assert (bounds.over == np.inf).all()
    assert bounds.under[message, 0] == pytest.approx(
        KEPT - (model.find_nearest_pair(x, cutting, 0.1).distance[message] - clearance)
    )
    z = rng.uniform(-1.0, 1.0, (len(x), d)) * np.radians(0.1)
    moved = model.find_nearest_pair(x + np.einsum("nkd,nd->nk", lean, z), cutting, 0.1)
    before = model.find_nearest_pair(x, cutting, 0.1)
    same = message & (moved.pair == before.pair)
    expected = before.distance + np.einsum("nd,nd->n", bounds.lean[:, 0], z)
    assert same.sum() > 3
    away = np.abs(moved.distance - expected)[same]
    assert np.median(away) < 2e-5
    assert np.median(away) < 0.05 * np.median(np.abs(moved.distance - before.distance)[same])


def test_no_bound_without_a_contact(tmp_path: Path) -> None:
    cell = cell_of(tmp_path, rail=True)
    x = random_x(cell, 4)
    free = OffsetBounds(*[np.zeros((4, 2))] * 2, np.zeros((4, 1, 2)), *[np.zeros((4, 1))] * 2)
    none = np.zeros(4, bool)
    assert add_distance_constraints(free, model_of(cell), x, np.zeros((4, x.shape[1], 2)), none, none) is free
