"""Transition costs computed once for all searches over a grid give the same result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_sequence_search import VELOCITY, random_problem

from machopt.data_types.plan_options import ObjectiveWeights, PlanOptions
from machopt.planning.sequence_search import transition_cost_table
from machopt.planning.sequence_search.dynamic_programming import SequenceChoice, SequenceGrid
from machopt.planning.sequence_search.transition_cost_table import TransitionCostTable

OPTIONS = PlanOptions(weights=ObjectiveWeights(mean=1.0, worst=0.7, travel=0.3, rotation=0.4))


def is_equal(a: SequenceChoice, b: SequenceChoice) -> bool:
    """Check equality to the last bit."""
    return (
        all(np.array_equal(x, y) for x, y in ((a.rotation, b.rotation), (a.branch, b.branch), (a.turn, b.turn)))
        and (a.total, a.bound, a.broken) == (b.total, b.bound, b.broken)
        and np.array_equal(a.q, b.q, equal_nan=True)
    )


@pytest.mark.parametrize("stable", [True, False])
@pytest.mark.parametrize("seed", range(12))
def test_repeated_search_over_a_grid_gives_the_same_choice(seed: int, stable: bool) -> None:
    path, candidates, scores = random_problem(seed)
    candidates = replace(candidates, stable=stable)
    used = SequenceGrid.build(path, candidates, scores, VELOCITY, OPTIONS)
    for k in range(4):  # each round removes vertices, later whole stations, which changes the predecessor
        fresh = TransitionCostTable.none_yet(used.window, *candidates.q.shape[1:3], stable)
        assert is_equal(used.choose(), replace(used, priced=fresh).choose())
        assert used.priced.turns.any()
        gone = np.random.default_rng((seed, k)).uniform(size=candidates.feasible.shape) < 0.4
        candidates.feasible[gone] = False
        candidates.feasible[2] &= seed % 3 > 0


@pytest.mark.parametrize("stable", [True, False])
def test_limited_memory_for_steps_gives_the_same_choice(stable: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    path, candidates, scores = random_problem(1)
    candidates = replace(candidates, stable=stable)
    whole = SequenceGrid.build(path, candidates, scores, VELOCITY, OPTIONS)
    monkeypatch.setattr(transition_cost_table, "MOST", len(whole.priced.price) // 2)
    half = SequenceGrid.build(path, candidates, scores, VELOCITY, OPTIONS)
    assert 0 < len(half.priced.price) <= len(whole.priced.price) // 2
    assert is_equal(half.choose(), whole.choose())
    monkeypatch.setattr(transition_cost_table, "MOST", 0)
    none = SequenceGrid.build(path, candidates, scores, VELOCITY, OPTIONS)
    assert not len(none.priced.price)
    assert is_equal(none.choose(), whole.choose())
