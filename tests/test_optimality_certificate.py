"""Optimality certificate compared with every sequence of small problems; more freedom never increases the cost."""

from __future__ import annotations

import math
import threading
import weakref
from dataclasses import replace
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from property_example_count import scale_example_count
from small_cell import small_cell
from test_planning_path import Rows, toolpath
from test_sequence_search import VELOCITY, every_price, random_problem

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.data_types.stiffness import ArmStiffness
from machopt.data_types.toolpath import MoveKind
from machopt.planning.optimality_certificate import compute_certificate
from machopt.planning.pipeline import nested_grids, path_planner
from machopt.planning.pipeline.collision_free_search import CollisionFreeSearch
from machopt.planning.pipeline.nested_grids import list_nested_strides, thin_grid
from machopt.planning.pipeline.path_planner import plan_path
from machopt.planning.pipeline.plan_data_types import Plan
from machopt.planning.sequence_search.dynamic_programming import choose_sequence
from machopt.planning.sequence_search.worst_value_constraint import GAP

EXACT = 1e-12  # relative to J: rounding
CURVES = 2 * GAP  # relative to J: a choice may miss GAP, and a smooth curve is a local optimum; 30 jobs were below 2e-4
weights = st.builds(
    ObjectiveWeights,
    mean=st.floats(0.1, 2.0),
    worst=st.floats(0.0, 4.0),
    travel=st.floats(0.0, 0.5),
    rotation=st.floats(0.0, 0.5),
    feed=st.floats(0.0, 4.0),
)
seeds = st.integers(0, 10**6)
rapids = st.sampled_from([(0, 3), (0,), (0, 2, 4)])


@given(seeds, rapids, weights)
@settings(max_examples=scale_example_count(60), deadline=None)
def test_bound_and_choice_against_every_sequence(seed: int, rapid: tuple[int, ...], priced: ObjectiveWeights) -> None:
    path, candidates, scores = random_problem(seed, rapid)
    options = PlanOptions(weights=priced, preferred_rotation=0.4)
    total, worst = every_price(path, candidates, scores, options)
    ideal, choice = (
        np.min(total + priced.worst * worst, initial=np.inf),
        choose_sequence(path, candidates, scores, VELOCITY, options),
    )
    if not np.isfinite(ideal):
        assert choice.broken
        return
    assert choice.bound <= ideal * (1 + EXACT)
    assert ideal * (1 - EXACT) <= choice.total <= ideal * (1 + 1.01 * GAP)


@given(seeds, rapids, weights, st.data())
@settings(max_examples=scale_example_count(60), deadline=None)
def test_more_freedom_never_increases_the_cost(
    seed: int, rapid: tuple[int, ...], priced: ObjectiveWeights, data: st.DataObject
) -> None:
    """Removing rotations or branches, as with a narrower range or a coarser grid, never improves the result."""
    path, candidates, scores = random_problem(seed, rapid)
    options = PlanOptions(weights=priced)
    rotations = data.draw(st.sets(st.integers(0, 3), min_size=1))
    branches = data.draw(st.sets(st.integers(0, 1), min_size=1))
    mask = np.zeros((4, 2), bool)
    mask[np.ix_(sorted(rotations), sorted(branches))] = True
    narrow = replace(candidates, feasible=candidates.feasible & mask[None, :, :, None])
    few, many = (choose_sequence(path, c, scores, VELOCITY, options) for c in (narrow, candidates))
    if few.broken or few.dropped.any():
        return
    assert not many.broken
    assert many.total <= few.total * (1 + 1.01 * GAP)
    assert many.bound <= few.total * (1 + EXACT)


def test_coarser_grids_use_every_kth_rotation() -> None:
    assert list_nested_strides(8) == []  # 45°
    assert list_nested_strides(12) == []  # 30°: 60° is too coarse
    assert list_nested_strides(24) == [2, 3]  # 15°
    assert list_nested_strides(36) == [2, 3, 4]  # 10°
    assert list_nested_strides(37) == []
    assert list_nested_strides(72) == [2]
    assert list_nested_strides(180) == [2, 3, 4, 5]
    assert list_nested_strides(360) == [2, 3, 4, 5, 6, 8, 9, 10]
    _, candidates, scores = random_problem(0)
    coarse, priced = thin_grid(candidates, scores, 2)
    np.testing.assert_array_equal(coarse.q, candidates.q[:, [0, 2]])
    np.testing.assert_array_equal(priced.cost, scores.cost[:, [0, 2]])
    assert priced.scale == scores.scale


def test_coarse_choices_are_repeated_after_a_vertex_is_removed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path, candidates, scores = random_problem(3)
    made: list[int] = []
    result = nested_grids.choose_sequence
    monkeypatch.setattr(nested_grids, "list_nested_strides", lambda _: [2])
    monkeypatch.setattr(nested_grids, "choose_sequence", lambda *a: made.append(1) or result(*a))
    wide = np.zeros(len(path.stations), bool)
    search = SimpleNamespace(
        path=path,
        candidates=candidates,
        scores=scores,
        velocity=VELOCITY,
        options=PlanOptions(),
        chooser=SimpleNamespace(wide=wide),
    )
    coarser = nested_grids.NestedGridSearch(search)  # type: ignore[arg-type]
    coarser.choose()
    first = coarser.find_sequence(2)[2]
    assert made == [1]
    at = len(wide) // 2
    candidates.feasible[at, first.rotation[at] * 2, first.branch[at]] = False
    again = coarser.find_sequence(2)[2]
    assert made == [1, 1]
    assert (again.rotation[at], again.branch[at]) != (first.rotation[at], first.branch[at])


# --- whole plans ---------------------------------------------------------------------------------------------------


def one_scale(monkeypatch: pytest.MonkeyPatch, scale: float = 1e-6) -> None:
    """Set one scale: c₀ is the median over the candidates and would differ between grids and ranges."""
    score_candidates = path_planner.score_candidates
    monkeypatch.setattr(path_planner, "score_candidates", lambda *a: replace(score_candidates(*a), scale=scale))


def plan_rows(folder: FilePath, rows: Rows, priced: ObjectiveWeights, step: float, reach: float = 180.0) -> Plan:
    cell = small_cell(folder, stiffness=ArmStiffness(joints=np.array([1.4e6, 4.0e5, 9.4e5, 3.6e5, 3.7e5, 3.8e5])))
    options = PlanOptions(
        weights=priced,
        rotation_step=math.radians(step),
        collision=False,
        rotation_range=(-math.radians(reach), math.radians(reach)),
    )
    return plan_path(cell, toolpath(rows, feed=0.01), options)


@st.composite
def jobs(draw: st.DrawFn) -> Rows:
    """Return a rapid move and up to nine cuts over the block, with changing tool inclinations."""
    rng = np.random.default_rng(draw(seeds))
    n = draw(st.integers(3, 10))
    along = np.cumsum(rng.uniform(0.005, 0.02, n))
    lean = rng.uniform(-0.3, 0.3, (2, 1)) + np.cumsum(rng.normal(size=(2, n)) * 0.03, axis=1)
    axis = np.column_stack([lean[0], lean[1], np.ones(n)])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    y = draw(st.floats(-0.2, 0.2))
    return [
        ((float(along[k]) - 0.1, y, 0.02), tuple(axis[k]), MoveKind.RAPID if k == 0 else MoveKind.CUT) for k in range(n)
    ]


@given(
    jobs(), st.floats(0.1, 2.0), st.sampled_from([(10.0, 5.0), (20.0, 10.0), (30.0, 15.0), (10.0, 2.0), (20.0, 5.0)])
)
@settings(
    max_examples=scale_example_count(5), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_refinement_and_wider_range_never_worsen_the_plan(
    tmp_path: FilePath, rows: Rows, worst: float, steps: tuple[float, float]
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        one_scale(patch)
        priced = ObjectiveWeights(worst=worst)
        coarse, fine, narrow = (
            plan_rows(tmp_path, rows, priced, step, reach)
            for step, reach in ((steps[0], 180.0), (steps[1], 180.0), (steps[1], 60.0))
        )
    if not np.isfinite(coarse.chosen.objective.total):
        return
    J = fine.chosen.objective.total
    exact = steps != (20.0, 5.0)  # for a fine grid, grids coarser than 10° are not searched
    assert coarse.chosen.objective.total * (1 + (1e-6 if exact else CURVES)) >= J
    assert narrow.chosen.objective.total * (1 + CURVES) >= J
    found = compute_certificate(fine)
    assert found is not None
    assert 0.0 <= found.gap <= 1.01 * GAP
    assert found.objective <= found.grid * (1 + EXACT)
    assert found.bound <= found.grid * (1 + EXACT)


def test_parallel_computation_changes_no_plan_and_runs_once(
    tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows: Rows = [
        ((0.02 * k - 0.1, 0.05, 0.02), (0.1, 0.02 * k, 1.0), MoveKind.CUT if k else MoveKind.RAPID) for k in range(8)
    ]
    searches: list[weakref.ref[CollisionFreeSearch]] = []
    made: list[str] = []
    coarse, begun = nested_grids.choose_sequence, CollisionFreeSearch.begin

    def begin(search: CollisionFreeSearch) -> None:
        searches.append(weakref.ref(search))
        made.append(f"first {threading.current_thread() is threading.main_thread()}")
        begun(search)

    def choose_coarse(*a: Any) -> Any:
        made.append(f"coarse {threading.current_thread() is threading.main_thread()}")
        return coarse(*a)

    monkeypatch.setattr(CollisionFreeSearch, "begin", begin)
    monkeypatch.setattr(nested_grids, "choose_sequence", choose_coarse)
    plans = []
    for cores in (1, 2):
        monkeypatch.setattr("machopt.numerics.parallel_map.count_threads", lambda cores=cores: cores)
        monkeypatch.setattr(nested_grids, "count_threads", lambda cores=cores: cores)
        plans.append(plan_rows(tmp_path, rows, ObjectiveWeights(), 5.0))
    assert made == ["first True", "coarse True", "first False", "coarse False"]
    one, two = (p.chosen for p in plans)
    np.testing.assert_array_equal(one.assignment.phi, two.assignment.phi)
    np.testing.assert_array_equal(one.assignment.q, two.assignment.q)
    assert one.objective == two.objective
    assert [search() for search in searches] == [None, None]  # costs are released after planning
